/* electrical.h: drives of coils that flux linkages couple with each other and with a payload (docs/theory/electrical.md).
 *
 *     V_k = R_k I_k + d(linkage_k)/dt,   linkage = linkage of coils and iron at I + sum dB/dI . m of the payload
 *
 * Steps follow the implicit midpoint rule. In a step the voltage of a coil is e - g times its mean current. For a voltage
 * source e is the demand and g is 0; a current controller sets both by its gains; an active limit replaces the demand. The
 * linkages are the state, so the next step corrects the error that Newton's method leaves in the currents. Nothing is
 * allocated.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_ELECTRICAL_H
#define FIELDMAP_ELECTRICAL_H

#include "currents.h"
#include "flux_linkage.h"

/* Source of the voltage of a coil: the demand, a limit of the supply, or a limit of the current. */
enum {
    FIELDMAP_CURRENT_LOWEST = -2, FIELDMAP_SUPPLY_LOWEST = -1, FIELDMAP_ASKED = 0, FIELDMAP_SUPPLY_HIGHEST = 1,
    FIELDMAP_CURRENT_HIGHEST = 2
};

/* Largest numbers of Newton steps in a time step, and of rounds to find the active limits in a Newton step. In the first rounds
 * (together) all coils may change their limits at once. */
enum { FIELDMAP_ELECTRICAL_STEPS = 12, FIELDMAP_LIMIT_ROUNDS = 64, FIELDMAP_TOGETHER_ROUNDS = 8 };

/* Largest change of the currents by the tangent until the iron is solved again, as a share of the iron's domain. */
#define FIELDMAP_STRAY 0.02

/* Change that is always allowed, as a share of the domain: the error of the tangent is then below any tolerance. */
#define FIELDMAP_NEAR 1e-7

/* A coil and its drive. resistance: ohm, at the reference temperature; lower, upper: V, of the supply; proportional, V/A,
 * integral, V/(A s): gains of a current controller, both 0 for a voltage source; current_lower, current_upper: A, limits of a
 * voltage source; slope: A/s or V/s, largest rate of the demand. loss: V, voltage drop of the bridge against the current,
 * proportional to the current below `ripple`, A. warming: K/W; capacity: J/K; coefficient: 1/K, of the resistance; reference,
 * ambient: degC. */
typedef struct fieldmap_coil {
    double resistance, lower, upper, proportional, integral, current_lower, current_upper, slope, loss, ripple;
    double warming, capacity, coefficient, reference, ambient;
} fieldmap_coil;

enum { FIELDMAP_COIL = 15 };

/* linear: linkages of the coils without saturating iron (StoredLinkage). largest: A, size of the domain of that iron.
 *
 * State of each coil: linkage, Wb; integral: of its controller, V; asked: demand after the limit of slope; voltage: mean of the
 * last step, V; heat, input: J, so far; temperature, degC; source: see the enumeration. known: whether a run has begun.
 * counted: heat at the last fieldmap_warm.
 *
 * strayed: change of the currents since saturating iron was solved; reach: largest change allowed, A, below 0 if the solve
 * failed. resistance: at the temperature; met: linkages of coils and iron at the currents; tangent[n * n]: incremental
 * inductances at currents `at`, slopes[fields * n]: derivatives of the weights there; factor: of the matrix of a step of length
 * `step` (0: none yet), with inverses on its diagonal. along: the payload in each field. rows: for each of the `points` dipoles
 * of the payload, coefficients (`row` numbers) of the derivative of the field with respect to each current, in the cell of the
 * map whose number plus 1 is in `cells`, 0 for none. The rest is room. */
typedef struct fieldmap_electrical {
    int n, fields, points, row, known;
    double step, largest;
    const fieldmap_coil *coils;
    fieldmap_linkage linear;
    double *linkage, *integral, *asked, *voltage, *heat, *input, *temperature, *source, *counted, *strayed, *resistance;
    double *met, *at, *guess, *change, *right, *given, *gain, *total, *moved, *before, *tangent, *factor, *slopes, *along, *each, *reach, *rows, *cells;
    int64_t tangents, steps;
} fieldmap_electrical;

/* Number of arrays of n numbers; the first FIELDMAP_ELECTRICAL_STATE of them are the state. */
enum { FIELDMAP_ELECTRICAL_ARRAYS = 21, FIELDMAP_ELECTRICAL_STATE = 8 };

/* Numbers of memory for n coils in a map, with a payload of `points` dipoles. */
static inline size_t fieldmap_electrical_room(int n, const fieldmap *map, int points)
{
    const size_t coils = (size_t)n, fields = (size_t)fieldmap_sets(map), row = (size_t)fieldmap_path_row(map);
    return coils * (FIELDMAP_ELECTRICAL_ARRAYS + 2 * coils + fields) + 4 * fields + 1 + (size_t)points * (coils * row + 1);
}

/* Lay out the arrays in memory of fieldmap_electrical_room() zeros. */
static inline void fieldmap_electrical_start(fieldmap_electrical *e, const fieldmap *map, int points, double *memory)
{
    const size_t n = (size_t)e->n;
    double **const arrays[FIELDMAP_ELECTRICAL_ARRAYS] = {
        &e->linkage, &e->integral, &e->asked, &e->voltage, &e->heat, &e->input, &e->temperature, &e->source, &e->counted,
        &e->strayed, &e->resistance, &e->met, &e->at, &e->guess, &e->change, &e->right, &e->given, &e->gain, &e->total,
        &e->moved, &e->before};
    int k;
    for (k = 0; k < FIELDMAP_ELECTRICAL_ARRAYS; k++, memory += n) *arrays[k] = memory;
    e->tangent = memory, e->factor = e->tangent + n * n, e->slopes = e->factor + n * n;
    e->along = e->slopes + n * (size_t)e->fields, e->each = e->along + e->fields, e->reach = e->each + 3 * e->fields;
    e->points = points, e->row = fieldmap_path_row(map), e->cells = e->reach + 1, e->rows = e->cells + points;
    for (k = 0; k < e->n; k++) e->temperature[k] = e->coils[k].ambient;
}

/* Update the resistances to the temperatures. */
static inline void fieldmap_resist_warm(fieldmap_electrical *e)
{
    int k;
    for (k = 0; k < e->n; k++) {
        const fieldmap_coil *coil = e->coils + k;
        e->resistance[k] = coil->resistance * (1.0 + coil->coefficient * (e->temperature[k] - coil->reference));
    }
    e->step = 0.0;
}

/* Advance the temperatures by a time, with the heat of the windings since the last call. */
static inline void fieldmap_warm(fieldmap_electrical *e, double time)
{
    int k, warmed = 0;
    for (k = 0; k < e->n; k++) {
        const fieldmap_coil *coil = e->coils + k;
        const double power = (e->heat[k] - e->counted[k]) / time, end = coil->ambient + power * coil->warming;
        if (!(coil->warming > 0.0)) continue;
        e->temperature[k] = end + (e->temperature[k] - end) * exp(-time / (coil->warming * coil->capacity));
        e->counted[k] = e->heat[k];
        warmed |= coil->coefficient != 0.0;
    }
    if (warmed) fieldmap_resist_warm(e);
}

/* Fill along[fields]: m . b of the body's moments (soft iron: in the present field) in each field of the map, times `scale`. */
static inline int fieldmap_payload_along(const fieldmap_path *field, const fieldmap_magnetic_body *body, const double *place,
                                         const double *r, double scale, int fields, double *along)
{
    const int points = fieldmap_body_points(body);
    double room[FIELDMAP_REACTION_FIELDS], at[3];
    const double *reacting = NULL;
    int p, i, status = FIELDMAP_OK;
    for (i = 0; i < fields; i++) along[i] = 0.0;
    if (body->n_soft > 0) status = fieldmap_body_reaction(field, body, place, r, room, &reacting, at);
    for (p = 0; p < points && status == FIELDMAP_OK; p++) {
        double moment[3];
        status = fieldmap_body_dipole(field, body, place, r, p, reacting, at, moment);
        if (status == FIELDMAP_OK) status = fieldmap_add_along(field->map, at, moment, along);
    }
    for (i = 0; i < fields; i++) along[i] *= scale;
    return status;
}

/* Fill total[n]: the linkages met[n] of coils and iron, plus the linkages of the payload. */
static inline void fieldmap_total_linkages(const fieldmap_electrical *e, int saturating, double *total)
{
    memcpy(total, e->met, (size_t)e->n * sizeof(double));
    fieldmap_add_payload_linkages(e->n, e->fields, e->along, saturating ? e->slopes : NULL, total);
}

/* Turn met[n], mu0 times the linkages of the iron, into the linkages of coils and iron at currents. */
static inline void fieldmap_meet_coils(fieldmap_electrical *e, const double *currents)
{
    int k;
    for (k = 0; k < e->n; k++) e->met[k] /= FIELDMAP_MU0;
    fieldmap_add_linkages(&e->linear, currents, e->met);
}

/* Fill met[n] at currents at which the iron is solved. */
static inline void fieldmap_meet(fieldmap_electrical *e, fieldmap_iron_state *iron, const double *currents)
{
    int k;
    for (k = 0; k < e->n; k++) e->met[k] = 0.0;
    if (iron != NULL) fieldmap_iron_linkages(iron, e->met);
    fieldmap_meet_coils(e, currents);
}

/* As fieldmap_meet after a solve, from the moments before its last Newton step and their first-order change. */
static inline void fieldmap_meet_solved(fieldmap_electrical *e, const fieldmap_iron_state *iron, const double *currents)
{
    const int wide = iron->map->wide;
    int k;
    fieldmap_iron_link(iron->map, iron->vector, e->met);
    for (k = 0; k < e->n; k++)
        e->met[k] -= fieldmap_iron_mixed_dot(iron->sides + (size_t)k * (size_t)wide, iron->change, wide);
    fieldmap_meet_coils(e, currents);
}

/* Add the inductances of soft iron in the payload to the tangent: b . dm/dB b', with the fields b per ampere. */
static inline void fieldmap_add_soft_payload(fieldmap_electrical *e, const fieldmap_path *field, const fieldmap_magnetic_body *body,
                                             const double *place, const double *r, double scale)
{
    const int n = e->n;
    double *unit = e->each, arm[3], at[3], flux[3], gradient[9], inside[3], own[9], slope[9], moved[3];
    int p, k, j, f, i;
    for (p = body->n_dipoles; p < fieldmap_body_points(body); p++) {
        if (fieldmap_body_field(field, body, place, r, p, NULL, arm, at, flux, gradient) != FIELDMAP_OK) return;
        fieldmap_to_body(r, flux, inside);
        fieldmap_moment_slope(body->soft + (p - body->n_dipoles), inside, own);
        fieldmap_turned_matrix(r, own, slope);
        fieldmap_each_field(field->map, at, unit, NULL);
        for (k = 0; k < n; k++)
            for (i = 0; i < 3; i++)
                for (f = n; f < e->fields; f++) unit[3 * k + i] += e->slopes[f * n + k] * unit[3 * f + i];
        for (k = 0; k < n; k++) {
            fieldmap_to_map(slope, unit + 3 * k, moved);
            for (j = 0; j < n; j++) e->tangent[j * n + k] += scale * scale * fieldmap_dot(unit + 3 * j, moved);
        }
    }
}

/* Compute incremental inductances and derivatives of the weights at the currents of the field; not if the iron has no
 * solution. */
static inline void fieldmap_make_tangent(fieldmap_electrical *e, fieldmap_iron_state *iron, const fieldmap_path *field,
                                         const fieldmap_magnetic_body *body, const double *place, const double *r, double scale,
                                         const double *currents)
{
    const size_t n = (size_t)e->n;
    int p;
    e->tangents++;
    e->step = 0.0;
    if (iron == NULL) {
        memcpy(e->tangent, e->linear.inductance, n * n * sizeof(double));
    } else {
        if (fieldmap_iron_solve_at(iron, currents, iron->tolerance) != FIELDMAP_OK) return;
        fieldmap_iron_slopes_here(iron, e->slopes, NULL, e->factor, 1);
        for (p = 0; p < e->points; p++) e->cells[p] = 0.0;
        memcpy(e->at, currents, n * sizeof(double));
        fieldmap_add_iron_inductance(&e->linear, e->factor, e->tangent);
    }
    fieldmap_add_soft_payload(e, field, body, place, r, scale);
}

/* The rows of dipole p of the payload in cell number `cell` of the spot, computed if the cell has changed. */
static inline const double *fieldmap_tangent_rows(fieldmap_electrical *e, const fieldmap *map, const fieldmap_spot *spot, int64_t cell,
                                                  int p)
{
    const int n = e->n;
    double *rows = e->rows + (size_t)p * (size_t)n * (size_t)e->row, *by = e->each;
    int k, f;
    if (e->cells[p] == (double)(cell + 1)) return rows;
    for (k = 0; k < n; k++) {
        for (f = 0; f < e->fields; f++) by[f] = f < n ? f == k : e->slopes[f * n + k];
        fieldmap_gather(map, by, spot, rows + (size_t)k * (size_t)e->row);
    }
    e->cells[p] = (double)(cell + 1);
    return rows;
}

/* As fieldmap_total_linkages, by the tangent: the dipoles of a payload without soft iron in the derivatives of the field with
 * respect to the currents. Returns the status of the map. */
static inline int fieldmap_linkages_by_tangent(fieldmap_electrical *e, const fieldmap_path *field, const fieldmap_magnetic_body *body,
                                               const double *place, const double *r, double scale, double *total)
{
    const fieldmap *map = field->map;
    const int n = e->n;
    double *linked = e->right;
    int p, k, status = FIELDMAP_OK;
    for (k = 0; k < n; k++) linked[k] = 0.0;
    for (p = 0; p < e->points && status == FIELDMAP_OK; p++) {
        double at[3], moment[3];
        const double *rows;
        fieldmap_spot spot;
        fieldmap_body_dipole(field, body, place, r, p, NULL, at, moment);
        status = fieldmap_locate(map, at, &spot);
        if (status != FIELDMAP_OK) break;
        rows = fieldmap_tangent_rows(e, map, &spot, fieldmap_cell_number(map, &spot), p);
        fieldmap_add_rows_along(map, &spot, moment, rows, n, linked);
    }
    for (k = 0; k < n; k++) total[k] = e->met[k] + scale * linked[k];
    return status;
}

/* Update the field that the path keeps at the dipoles of the payload after a change of the currents, by the tangent. The field
 * is dropped if its cell is not the cell of the rows. */
static inline void fieldmap_path_by_tangent(const fieldmap_electrical *e, const fieldmap_path *field, const double *change)
{
    const size_t rows = (size_t)e->n * (size_t)e->row;
    int p;
    for (p = 0; p < field->points; p++) {
        if (field->places[p] + 1 != (int64_t)e->cells[p]) field->places[p] = -1;
        else fieldmap_add_sets(e->rows + (size_t)p * rows, e->row, e->n, change, field->rows + (size_t)p * (size_t)e->row);
    }
}

/* Voltage drop of the bridge of a coil at a current. */
static inline double fieldmap_bridge_loss(const fieldmap_coil *coil, double current)
{
    if (fabs(current) < coil->ripple) return coil->loss / coil->ripple * current;
    return current > 0.0 ? coil->loss : -coil->loss;
}

/* Begin a run at the currents of the field, with their linkages. Integrals of controllers and demands of voltage sources begin
 * with the voltages that hold these currents. Returns the status of the map. */
static inline int fieldmap_electrical_begin(fieldmap_electrical *e, const fieldmap_superposition *of, const fieldmap_path *field,
                                            const fieldmap_magnetic_body *body, const double *place, const double *r,
                                            const double *currents)
{
    int k, status;
    e->known = 1;
    *e->reach = FIELDMAP_NEAR * e->largest;
    fieldmap_resist_warm(e);
    fieldmap_make_tangent(e, of->iron, field, body, place, r, of->scale, currents);
    fieldmap_meet(e, of->iron, currents);
    status = fieldmap_payload_along(field, body, place, r, of->scale, e->fields, e->along);
    fieldmap_total_linkages(e, of->iron != NULL, e->linkage);
    for (k = 0; k < e->n; k++) {
        const int controlled = e->coils[k].proportional != 0.0 || e->coils[k].integral != 0.0;
        e->voltage[k] = e->integral[k] = e->resistance[k] * currents[k];
        e->asked[k] = controlled ? currents[k] : e->voltage[k] + fieldmap_bridge_loss(e->coils + k, currents[k]);
    }
    return status;
}

/* Move the demands towards the commands, as fast as their slopes allow. */
static inline void fieldmap_ask(fieldmap_electrical *e, const double *commands, double h)
{
    int k;
    for (k = 0; k < e->n; k++) {
        const double most = h * e->coils[k].slope, by = commands[k] - e->asked[k];
        e->asked[k] = fabs(by) <= most ? commands[k] : e->asked[k] + (by > 0.0 ? most : -most);
    }
}

/* Fill given and gain: the voltage of coil k without the drop of the bridge is given - gain times the mean current. current: at
 * the beginning of the step of length h. */
static inline void fieldmap_law_of_coil(const fieldmap_electrical *e, int k, double source, double current, double h,
                                        double *given, double *gain)
{
    const fieldmap_coil *coil = e->coils + k;
    *gain = 0.0;
    if (source == FIELDMAP_SUPPLY_HIGHEST) {
        *given = coil->upper;
    } else if (source == FIELDMAP_SUPPLY_LOWEST) {
        *given = coil->lower;
    } else if (source != FIELDMAP_ASKED) {
        *gain = 1e6 * (2.0 * e->tangent[k * e->n + k] / h + e->resistance[k]);
        *given = 0.5 * *gain * (current + (source > 0.0 ? coil->current_upper : coil->current_lower));
    } else if (coil->proportional == 0.0 && coil->integral == 0.0) {
        *given = e->asked[k];
    } else {
        *gain = coil->proportional + 0.5 * h * coil->integral;
        *given = *gain * e->asked[k] + e->integral[k];
    }
}

/* Cholesky's factor of tangent + h/2 (R + gain), lower triangle, with the inverses of its diagonal. */
static inline void fieldmap_factor_step(fieldmap_electrical *e, double h)
{
    const int n = e->n;
    int i, j, k;
    for (i = 0; i < n; i++)
        for (j = 0; j <= i; j++) {
            double sum = e->tangent[i * n + j] + (i == j ? 0.5 * h * (e->resistance[i] + e->gain[i]) : 0.0);
            for (k = 0; k < j; k++) sum -= e->factor[i * n + k] * e->factor[j * n + k];
            e->factor[i * n + j] = i == j ? 1.0 / sqrt(sum) : sum * e->factor[j * n + j];
        }
    e->step = h;
}

static inline void fieldmap_solve_step(const fieldmap_electrical *e, double *x)
{
    const int n = e->n;
    int i, k;
    for (i = 0; i < n; i++) {
        for (k = 0; k < i; k++) x[i] -= e->factor[i * n + k] * x[k];
        x[i] *= e->factor[i * n + i];
    }
    for (i = n - 1; i >= 0; i--) {
        for (k = i + 1; k < n; k++) x[i] -= e->factor[k * n + i] * x[k];
        x[i] *= e->factor[i * n + i];
    }
}

/* The next source of coil k in the search for active limits. driving: its voltage without the drop of the bridge; begin,
 * change: current at the beginning of the step, and its change. */
static inline double fieldmap_next_source(const fieldmap_electrical *e, int k, double driving, double begin, double change, double h)
{
    const fieldmap_coil *coil = e->coils + k;
    const double mean = begin + 0.5 * change, end = begin + change, source = e->source[k];
    const double slack = 1e-9 * (fabs(driving) + fabs(e->asked[k]));
    double given, gain, wanted, within;
    fieldmap_law_of_coil(e, k, FIELDMAP_ASKED, begin, h, &given, &gain);
    wanted = given - gain * mean;
    within = wanted < coil->lower ? coil->lower : wanted > coil->upper ? coil->upper : wanted;
    /* A limit of the current stays active while the demand would drive the current further. */
    if (source == FIELDMAP_CURRENT_HIGHEST && driving <= within + slack && driving >= coil->lower) return source;
    if (source == FIELDMAP_CURRENT_LOWEST && driving >= within - slack && driving <= coil->upper) return source;
    if (source == FIELDMAP_CURRENT_HIGHEST || source == FIELDMAP_CURRENT_LOWEST) {
        if (source > 0.0 ? driving < coil->lower : driving > coil->upper)
            return source > 0.0 ? FIELDMAP_SUPPLY_LOWEST : FIELDMAP_SUPPLY_HIGHEST;
    } else if (end > coil->current_upper && driving > coil->lower) {
        return FIELDMAP_CURRENT_HIGHEST;
    } else if (end < coil->current_lower && driving < coil->upper) {
        return FIELDMAP_CURRENT_LOWEST;
    }
    return wanted > coil->upper ? FIELDMAP_SUPPLY_HIGHEST : wanted < coil->lower ? FIELDMAP_SUPPLY_LOWEST : FIELDMAP_ASKED;
}

/* Find change[n] of the currents in a step of length h, and the active limits. right[n]: change of the linkages that the
 * voltages of the step do not make. Fills given and gain, with the drop of the bridge. */
static inline void fieldmap_change_of_currents(fieldmap_electrical *e, const double *currents, double h)
{
    int round, k, moved = 1;
    for (round = 0; round < FIELDMAP_LIMIT_ROUNDS && moved; round++) {
        for (k = 0; k < e->n; k++) {
            const fieldmap_coil *coil = e->coils + k;
            const double before = e->gain[k];
            fieldmap_law_of_coil(e, k, e->source[k], currents[k], h, e->given + k, e->gain + k);
            if (fabs(currents[k]) < coil->ripple) e->gain[k] += coil->loss / coil->ripple;
            else e->given[k] -= fieldmap_bridge_loss(coil, currents[k]);
            if (e->gain[k] != before) e->step = 0.0;
        }
        if (e->step != h) fieldmap_factor_step(e, h);
        for (k = 0; k < e->n; k++)
            e->change[k] = e->right[k] + h * (e->given[k] - (e->resistance[k] + e->gain[k]) * currents[k]);
        fieldmap_solve_step(e, e->change);
        for (k = 0, moved = 0; k < e->n; k++) {
            double given, gain, next;
            fieldmap_law_of_coil(e, k, e->source[k], currents[k], h, &given, &gain);
            next = fieldmap_next_source(e, k, given - gain * (currents[k] + 0.5 * e->change[k]), currents[k], e->change[k], h);
            if (next == e->source[k]) continue;
            /* If all coils change at once, strongly coupled coils may cycle. Later rounds therefore change only the first coil,
             * and pass from limit to limit through the demand, which terminates (Murty's rule). The last round changes no
             * source, so that the voltages belong to the sources. */
            if (round >= FIELDMAP_TOGETHER_ROUNDS && next * e->source[k] == FIELDMAP_SUPPLY_LOWEST) next = FIELDMAP_ASKED;
            if (round < FIELDMAP_LIMIT_ROUNDS - 1 && (!moved || round < FIELDMAP_TOGETHER_ROUNDS)) e->source[k] = next;
            moved = 1;
        }
    }
}

/* Step to the currents `guess`: advance linkages (Faraday's law), integrals and energies. held: set if a limit is active. */
static inline void fieldmap_take_step(fieldmap_electrical *e, double h, double *currents, int *held)
{
    int k;
    for (k = 0; k < e->n; k++) {
        const fieldmap_coil *coil = e->coils + k;
        const double mean = 0.5 * (currents[k] + e->guess[k]), error = e->asked[k] - mean, source = e->source[k];
        const double voltage = e->given[k] - e->gain[k] * mean, fall = e->resistance[k] * mean;
        e->linkage[k] += h * (voltage - fall);
        e->voltage[k] = voltage;
        e->input[k] += h * voltage * mean;
        e->heat[k] += h * fall * mean;
        if (source == FIELDMAP_ASKED) {
            e->integral[k] += h * coil->integral * error;
        } else if (coil->proportional > 0.0) {
            /* At a limit the integral follows the reference that the limit allows, which prevents wind-up. */
            const double share = 0.5 * h * coil->integral / coil->proportional, limit = source > 0.0 ? coil->upper : coil->lower;
            e->integral[k] = (e->integral[k] * (1.0 - share) + 2.0 * share * limit) / (1.0 + share);
        }
        *held |= source != FIELDMAP_ASKED;
        currents[k] = e->guess[k];
    }
}

/* Linkage of coil k by Faraday's law after a step of length h from a current to a guess. */
static inline double fieldmap_wanted_linkage(const fieldmap_electrical *e, int k, double current, double guess, double h)
{
    return e->linkage[k] + h * (e->given[k] - (e->resistance[k] + e->gain[k]) * (0.5 * (current + guess)));
}

/* Whether the error of the linkages at the currents `guess` is at most 0.02 of their change in the step. last: this ratio. */
static inline int fieldmap_step_met(const fieldmap_electrical *e, const double *currents, double h, double tolerance, double *last)
{
    double left = 0.0, whole = 0.0, moved = 0.0;
    int k, j;
    for (k = 0; k < e->n; k++) {
        const double wanted = fieldmap_wanted_linkage(e, k, currents[k], e->guess[k], h);
        double by = 0.0;
        for (j = 0; j < e->n; j++) by += e->tangent[k * e->n + j] * e->change[j];
        left = fmax(left, fabs(wanted - e->total[k])), whole = fmax(whole, fabs(wanted)), moved = fmax(moved, fabs(by));
    }
    /* An error within half the tolerance of the iron's solve counts as zero. */
    *last = left <= 0.5 * tolerance * whole ? 0.0 : left / fmax(moved, 1e-300);
    return *last <= 0.02;
}

/* Correct the tangent by the change of the linkages with a change of the currents: the BFGS update, which keeps the tangent
 * symmetric and positive definite. from: the linkages before the change. */
static inline void fieldmap_learn_tangent(fieldmap_electrical *e, const double *from, const double *change)
{
    const int n = e->n;
    double along = 0.0, across = 0.0;
    int k, j;
    for (k = 0; k < n; k++) {
        for (j = 0, e->right[k] = 0.0; j < n; j++) e->right[k] += e->tangent[k * n + j] * change[j];
        along += (e->total[k] - from[k]) * change[k], across += e->right[k] * change[k];
    }
    if (!(along > 1e-3 * across) || !(along < 1e3 * across)) return;
    for (k = 0; k < n; k++)
        for (j = 0; j < n; j++)
            e->tangent[k * n + j] +=
                (e->total[k] - from[k]) * (e->total[j] - from[j]) / along - e->right[k] * e->right[j] / across;
    e->step = 0.0;
}

/* Scalar product of the last move of the guess and the difference between the linkages of Faraday's law at a guess and `total`.
 * It falls along a Newton move, and the line search looks for its zero. */
static inline double fieldmap_short_along(const fieldmap_electrical *e, const double *currents, const double *guess,
                                          const double *total, double h)
{
    double sum = 0.0;
    int k;
    for (k = 0; k < e->n; k++) sum += (fieldmap_wanted_linkage(e, k, currents[k], guess[k], h) - total[k]) * e->moved[k];
    return sum;
}

/* After a solve, set the reach from the error of the tangent at the distance that the currents have strayed. The error grows
 * with the square of the distance. The reach is the distance at which the error is half of the tolerance of the iron times its
 * domain, and at most twice the last distance. */
static inline void fieldmap_set_reach(fieldmap_electrical *e, const double *currents, double h, double tolerance)
{
    const double allowed = 0.5 * tolerance * e->largest;
    double missed = 0.25 * allowed, far = 0.0;
    int k;
    for (k = 0; k < e->n; k++) e->right[k] = fieldmap_wanted_linkage(e, k, currents[k], e->guess[k], h) - e->total[k];
    fieldmap_solve_step(e, e->right);
    for (k = 0; k < e->n; k++)
        missed = fmax(missed, fabs(e->right[k])), far = fmax(far, fabs(e->strayed[k] + e->change[k]));
    *e->reach = fmax(FIELDMAP_NEAR * e->largest, fmin(FIELDMAP_STRAY * e->largest, far * sqrt(allowed / missed)));
}

/* Try a step from linkages in `total` by the tangent alone. Returns 0, and changes no state, if the currents would leave the
 * reach of the last solve of the iron. */
static inline int fieldmap_step_by_tangent(fieldmap_electrical *e, fieldmap_superposition *of, const fieldmap_path *field,
                                           const double *currents, double h, double *weights, int *within)
{
    const int n = e->n;
    double signals[FIELDMAP_IRON_MAX_SIGNALS], far = 0.0;
    int k, j, f;
    for (k = 0; k < n; k++) e->right[k] = e->linkage[k] - e->total[k];
    fieldmap_change_of_currents(e, currents, h);
    for (k = 0; k < n; k++) far = fmax(far, fabs(e->strayed[k] + e->change[k]));
    if (!(far <= *e->reach)) return 0;
    for (k = 0; k < n; k++) {
        e->strayed[k] += e->change[k];
        e->guess[k] = currents[k] + e->change[k];
        for (j = 0; j < n; j++) e->met[k] += e->tangent[k * n + j] * e->change[j];
    }
    for (k = 0; k < n; k++) e->change[k] *= of->scale, weights[k] += e->change[k];
    for (f = n; f < e->fields; f++) weights[f] += fieldmap_product(e->slopes + f * n, e->change, n);
    fieldmap_path_by_tangent(e, field, e->change);
    *within = fieldmap_iron_signals(of->iron->map, e->guess, signals);
    of->outside += !*within;
    return 1;
}

/* Advance the currents of the coils, and the weights of the field, by a step of length h, at whose end the body is at `place`
 * with rotation r[9]. within: whether the currents lie in the domain of the iron. Returns the status of the map. */
static inline int fieldmap_drive_coils(fieldmap_electrical *e, fieldmap_superposition *of, const fieldmap_path *field,
                                       const fieldmap_magnetic_body *body, const double *place, const double *r,
                                       const double *commands, double h, double *currents, double *weights, int *held, int *within)
{
    const int n = e->n, saturating = of->iron != NULL, on_path = of->on_path, exact = !saturating && body->n_soft == 0;
    /* Steps by the tangent alone are not possible for iron with hysteresis, which follows the whole path, or with soft iron in
     * the payload, which follows the field. */
    const int straying = saturating && body->n_soft == 0 && of->iron->map->n_cells == 0;
    const int64_t unsolved = of->unsolved;
    double left = 0.0, moved = 0.0, start, end, share;
    int k, j, step, trial, turned, met = 0, status;
    fieldmap_ask(e, commands, h);
    if (straying && *e->reach >= 0.0) {
        status = fieldmap_linkages_by_tangent(e, field, body, place, r, of->scale, e->total);
        if (status != FIELDMAP_OK) return status;
        if (fieldmap_step_by_tangent(e, of, field, currents, h, weights, within)) {
            fieldmap_take_step(e, h, currents, held);
            return status;
        }
    }
    status = fieldmap_payload_along(field, body, place, r, of->scale, e->fields, e->along);
    if (status != FIELDMAP_OK) return status;
    fieldmap_total_linkages(e, saturating, e->total);
    for (k = 0; k < n; k++) e->change[k] = e->moved[k] = 0.0;
    for (step = 0; step < FIELDMAP_ELECTRICAL_STEPS && !met && status == FIELDMAP_OK; step++) {
        if (step > !straying && left > 0.2) fieldmap_make_tangent(e, of->iron, field, body, place, r, of->scale, e->guess);
        for (k = 0; k < n; k++)
            for (j = 0, e->right[k] = e->linkage[k] - e->total[k]; j < n; j++)
                e->right[k] += e->tangent[k * n + j] * e->change[j];
        fieldmap_change_of_currents(e, currents, h);
        for (k = turned = 0; k < n; k++) {
            turned |= currents[k] + e->change[k] != (step == 0 ? currents[k] : e->guess[k]);
            e->guess[k] = currents[k] + e->change[k];
            e->moved[k] = e->change[k] - e->moved[k], e->before[k] = e->total[k];
        }
        e->steps++;
        for (k = 0; k < n; k++) e->right[k] = e->guess[k] - e->moved[k];
        start = fieldmap_short_along(e, currents, e->right, e->before, h);
        for (trial = 0; trial < FIELDMAP_ELECTRICAL_STEPS && status == FIELDMAP_OK; trial++) {
            /* Iron with hysteresis must not remember trial currents. */
            of->on_path = 0;
            *within = fieldmap_follow(of, e->guess, weights);
            of->on_path = on_path;
            fieldmap_path_forget(field);
            if (!saturating) fieldmap_meet(e, NULL, e->guess);
            else if (of->unsolved != unsolved) break;
            else if (turned) fieldmap_meet_solved(e, of->iron, e->guess);
            if (exact) break;
            if (body->n_soft > 0) status = fieldmap_payload_along(field, body, place, r, of->scale, e->fields, e->along);
            fieldmap_total_linkages(e, saturating, e->total);
            /* Iron that leaves saturation takes much more flux than the tangent predicts. */
            end = fieldmap_short_along(e, currents, e->guess, e->total, h);
            if (!(end < -0.5 * start) || !(start > 0.0)) break;
            share = fmax(start / (start - end), 0.1);
            for (k = 0; k < n; k++) {
                e->moved[k] *= share;
                e->guess[k] = e->right[k] + e->moved[k];
                e->change[k] = e->guess[k] - currents[k];
            }
            start *= share;
        }
        if (exact || (saturating && of->unsolved != unsolved)) break;
        met = fieldmap_step_met(e, currents, h, saturating ? of->iron->tolerance : 1e-9, &left);
        if (straying && step == 0) fieldmap_set_reach(e, currents, h, of->iron->tolerance);
        if (!straying && left > 1e-3) fieldmap_learn_tangent(e, e->before, e->moved);
        for (k = 0; k < n; k++) e->moved[k] = e->change[k];
    }
    if (saturating && of->unsolved != unsolved) *e->reach = -1.0;
    for (k = 0; k < n; k++) e->strayed[k] = 0.0;
    for (k = 0; k < n && saturating; k++) moved = fmax(moved, fabs(e->guess[k] - e->at[k]));
    if (moved > 0.001 * e->largest) fieldmap_make_tangent(e, of->iron, field, body, place, r, of->scale, e->guess);
    if (saturating && on_path && of->iron->map->n_cells > 0) fieldmap_iron_step(of->iron, e->guess);
    fieldmap_take_step(e, h, currents, held);
    return status;
}

#endif
