/* inverse.h: the outputs of a controller that give a wanted force on the magnets, by Newton's method
 * (docs/theory/closed_loop.md (14)).
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_INVERSE_H
#define FIELDMAP_INVERSE_H

#include "machine.h"

/* machine: used for the search only, not the one in motion. rounds: Newton steps per sample; lower, upper: limits of the
 * outputs; signals: the outputs of the last sample, from which the search begins, and its result; believed: state of the body,
 * with a fixed rotation and the position of the sample. */
typedef struct fieldmap_inverse_map {
    fieldmap_machine *machine;
    const fieldmap_allocation *allocation;
    int rounds;
    double lower[3], upper[3], *signals;
    fieldmap_state *believed;
} fieldmap_inverse_map;

/* The force[3] of the field on the magnets at signals. Returns 0 outside the map. */
static inline int fieldmap_force_of_signals(const fieldmap_inverse_map *inverse, const double *signals, double *force)
{
    fieldmap_machine *machine = inverse->machine;
    const fieldmap_state *state = inverse->believed;
    double r[9], wrench[6], *currents = machine->scratch;
    int k, status;
    fieldmap_allocate(inverse->allocation, signals, currents);
    for (k = 0; k < machine->n_coils; k++)
        currents[k] = machine->drives[k].gain * currents[k] + machine->drives[k].offset;
    fieldmap_machine_follow(machine, currents);
    fieldmap_rotation(state->turn, r);
    status = fieldmap_body_wrench(&machine->field, &machine->body.magnetic, state->position, r, wrench, NULL);
    for (k = 0; k < 3; k++) force[k] = wrench[k];
    return status == FIELDMAP_OK;
}

static inline double fieldmap_largest(const double *v)
{
    return fmax(fmax(fabs(v[0]), fabs(v[1])), fabs(v[2]));
}

/* Change the signals so that the force on the magnets at `believed` is wanted[3], N. Returns the largest component of the
 * missing force, N; NaN outside the map.
 *
 * Every round computes the slopes by one-sided differences of 1e-4 of the span of the limits. Signals stay within their limits,
 * which may not allow the force. */
static inline double fieldmap_find_signals(const fieldmap_inverse_map *inverse, const double *wanted)
{
    double *signals = inverse->signals, force[3], left[3] = {0.0}, J[9], solved[9], step[3];
    int round, i, j;
    for (round = 0; round <= inverse->rounds; round++) {
        if (!fieldmap_force_of_signals(inverse, signals, force)) return NAN;
        for (i = 0; i < 3; i++) left[i] = wanted[i] - force[i];
        if (round == inverse->rounds || fieldmap_largest(left) < 1e-12) break;
        for (j = 0; j < 3; j++) {
            const double ds = 1e-4 * (inverse->upper[j] - inverse->lower[j]);
            double moved[3] = {signals[0], signals[1], signals[2]};
            moved[j] += ds;
            fieldmap_force_of_signals(inverse, moved, force);
            for (i = 0; i < 3; i++) J[3 * i + j] = (force[i] - wanted[i] + left[i]) / ds;
        }
        fieldmap_inverse(J, solved);
        fieldmap_to_map(solved, left, step);
        /* A singular matrix leaves the signals unchanged. */
        if (!isfinite(step[0] + step[1] + step[2])) break;
        for (j = 0; j < 3; j++) signals[j] = fieldmap_within(signals[j] + step[j], inverse->lower[j], inverse->upper[j]);
    }
    return fieldmap_largest(left);
}

#endif
