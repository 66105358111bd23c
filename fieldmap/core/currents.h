/* currents.h: from the outputs of a controller to the voltages of the coils, their currents, and the weights of the fields
 * of a map (docs/theory/closed_loop.md (1) to (4), docs/theory/control.md (6)).
 *
 * In double precision.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CURRENTS_H
#define FIELDMAP_CURRENTS_H

#include "current_table.h"
#include "iron.h"

/* Outputs to voltages: those of a lift and two directions, where `division` is 1, of six coils; else matrix[n_coils *
 * n_outputs] times the outputs, plus constant[n_coils]. */
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

/* A coil for one length h of step. decay: exp(-R h / L) of its winding; amplifier_decay: exp(-h / tau) of the amplifier's
 * own answer, 0 where it follows at once as far as its supply allows; highest, lowest: final currents of the supply, V / R. */
typedef struct fieldmap_winding {
    double decay, amplifier_decay, highest, lowest;
} fieldmap_winding;

/* Advance currents[n] by one step towards commands[n]; whether a supply limit held one back, and whether any changed.
 *
 * L di/dt + R i = V, V what the amplifier asks for within its supply. The current goes where the amplifier steers it unless
 * the supply's limits allow less: exact for any length of step. */
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

/* Whether currents take their commands at once. */
static inline int fieldmap_at_once(const fieldmap_winding *windings, int n)
{
    int k, at_once = 1;
    for (k = 0; k < n; k++) at_once &= windings[k].decay == 0.0 && windings[k].amplifier_decay == 0.0;
    return at_once;
}

/* How the weights of a map's fields follow the currents, times `scale`, a calibration. Of linear iron, or saturating iron
 * linearised about currents: a field for each coil, and one of weight 1 behind them if there is one more. Of saturating
 * iron: by a table over a current division, or by its model, solved at these currents from where the last solves lead.
 * on_path: whether the currents are those of a path, along which the cells of iron with hysteresis move, or of trials.
 *
 * What solves have done so far: how many, their Newton steps, those that did not converge, at which the iron stayed as it
 * was, and those of currents beyond the domain of the model. */
typedef struct fieldmap_superposition {
    double scale;
    int n_coils, n_fields, on_path;
    fieldmap_iron_state *iron;
    const fieldmap_current_table *table;
    int64_t solves, newton_steps, unsolved, outside;
} fieldmap_superposition;

/* Weights by the model; whether the currents lie in its domain. Where a solve fails the iron stays as it was. NaN for
 * currents that are not finite. */
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

/* weights[n_fields] at currents[n_coils]; 0 for currents beyond a table, which goes on with its slopes there, or beyond the
 * domain of a model, which is solved there, too. */
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
