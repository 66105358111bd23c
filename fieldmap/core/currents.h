/* currents.h: from the outputs of a controller to the voltages of the coils, their currents, and the weights of the fields
 * of a map (docs/theory/closed_loop.md (1) to (4), docs/theory/control.md (6)).
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CURRENTS_H
#define FIELDMAP_CURRENTS_H

#include "current_table.h"
#include "iron.h"

/* Voltages from outputs. division = 1: the outputs are a lift and two directions of six coils. division = 0: the voltages are
 * matrix[n_coils * n_outputs] times the outputs, plus constant[n_coils]. */
typedef struct fieldmap_allocation {
    int division, n_coils, n_outputs;
    double exponent;
    const double *matrix, *constant;
} fieldmap_allocation;

static inline void fieldmap_allocate(const fieldmap_allocation *allocation, const double *outputs, double *voltages)
{
    int k, j;
    if (allocation->division) {
        fieldmap_divide(outputs[0], outputs[1], outputs[2], allocation->exponent, voltages);
        return;
    }
    for (k = 0; k < allocation->n_coils; k++) {
        const double *row = allocation->matrix + (size_t)k * (size_t)allocation->n_outputs;
        voltages[k] = allocation->constant[k];
        for (j = 0; j < allocation->n_outputs; j++) voltages[k] += row[j] * outputs[j];
    }
}

/* A coil for steps of one length h. decay: exp(-R h / L) of its winding; amplifier_decay: exp(-h / tau) of the amplifier, 0 for
 * one that responds at once within the limits of its supply; highest, lowest: V / R at the limits of the supply. */
typedef struct fieldmap_winding {
    double decay, amplifier_decay, highest, lowest;
} fieldmap_winding;

/* Advance currents[n] by one step towards commands[n]. held: a supply limit was active; moved: a current changed.
 *
 * In L di/dt + R i = V the supply limits the voltage V of the amplifier. Each current takes the value that the amplifier
 * demands, clipped to the values that the limits of the supply reach. The step is exact for any length. */
static inline void fieldmap_advance_currents(
    const fieldmap_winding *windings, int n, const double *commands, double *currents, int *held, int *moved)
{
    int k;
    *held = *moved = 0;
    for (k = 0; k < n; k++) {
        const fieldmap_winding *w = windings + k;
        const double wanted = commands[k] + (currents[k] - commands[k]) * w->amplifier_decay;
        const double high = w->highest + (currents[k] - w->highest) * w->decay;
        const double low = w->lowest + (currents[k] - w->lowest) * w->decay;
        const double above = wanted > low ? wanted : low, next = above < high ? above : high;
        *held |= wanted > high || wanted < low;
        *moved |= next != currents[k];
        currents[k] = next;
    }
}

/* Whether the currents follow their commands without delay. */
static inline int fieldmap_at_once(const fieldmap_winding *windings, int n)
{
    int k, at_once = 1;
    for (k = 0; k < n; k++) at_once &= windings[k].decay == 0.0 && windings[k].amplifier_decay == 0.0;
    return at_once;
}

/* Weights of a map's fields from the currents, times `scale`, a calibration. Linear iron, or saturating iron linearised about
 * currents, has a field for each coil and possibly one more of weight 1. For saturating iron the weights come from a table over
 * a division of currents, or from its model, whose solve starts from an extrapolation of the last solves. on_path: whether the
 * currents are on the path that iron with hysteresis remembers; trial currents are not.
 *
 * Counters: solves, Newton steps, solves that did not converge and left the iron unchanged, and solves at currents outside the
 * domain of the model. */
typedef struct fieldmap_superposition {
    double scale;
    int n_coils, n_fields, on_path;
    fieldmap_iron_state *iron;
    const fieldmap_current_table *table;
    int64_t solves, newton_steps, unsolved, outside;
} fieldmap_superposition;

/* Fill the weights from the model; returns whether the currents lie in its domain. A solve that fails leaves the iron
 * unchanged. Weights are NaN for currents that are not finite. */
static inline int fieldmap_follow_iron(fieldmap_superposition *of, const double *currents, double *weights)
{
    fieldmap_iron_state *state = of->iron;
    double signals[FIELDMAP_IRON_MAX_SIGNALS];
    const int status = of->on_path ? fieldmap_iron_step(state, currents) : fieldmap_iron_follow(state, currents);
    int f, inside;
    of->newton_steps += state->steps;
    of->solves++;
    of->unsolved += status != FIELDMAP_OK;
    inside = fieldmap_iron_signals(state->map, currents, signals);
    of->outside += !inside;
    for (f = 0; f < of->n_fields; f++) {
        weights[f] = of->scale * (f < of->n_coils ? currents[f] : state->solution[f]);
        if (status == FIELDMAP_NOT_FINITE) weights[f] = NAN;
    }
    return inside;
}

/* Fill weights[n_fields] at currents[n_coils]. Returns 0 for currents outside the table, where the weights are extrapolated
 * with its slopes, or outside the domain of the model, which is solved there as well. */
static inline int fieldmap_follow(fieldmap_superposition *of, const double *currents, double *weights)
{
    int f, within = 1;
    if (of->iron != NULL) return fieldmap_follow_iron(of, currents, weights);
    if (of->table != NULL) {
        within = fieldmap_table_weights(of->table, currents, weights) != FIELDMAP_TABLE_BEYOND;
        for (f = 0; f < of->n_fields; f++) weights[f] *= of->scale;
        return within;
    }
    for (f = 0; f < of->n_fields; f++) weights[f] = of->scale * (f < of->n_coils ? currents[f] : 1.0);
    return within;
}

#endif
