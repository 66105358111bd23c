/* electrical.h: coils that the flux linkages of a map couple with each other and with a payload, and what drives them
 * (docs/theory/electrical.md).
 *
 *     V_k = R_k I_k + d(linkage_k)/dt,   linkage = that of coils and iron at I + sum dB/dI . m of the payload
 *
 * A step is that of the implicit midpoint rule. The voltage of a coil is e - g times its mean current in the step: of a
 * source e is what is asked for; a current controller adds its gains; a limit replaces what is asked for. The linkages are
 * the state. What Newton's method leaves of them in a step is made good in the next one. Nothing is allocated. In double
 * precision.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_ELECTRICAL_H
#define FIELDMAP_ELECTRICAL_H

#include "currents.h"
#include "flux_linkage.h"

/* Where the voltage of a coil comes from: what is asked for, a limit of the supply, or one of the current. */
enum {
    FIELDMAP_CURRENT_LOWEST = -2, FIELDMAP_SUPPLY_LOWEST = -1, FIELDMAP_ASKED = 0, FIELDMAP_SUPPLY_HIGHEST = 1,
    FIELDMAP_CURRENT_HIGHEST = 2
};

/* Newton steps of a step in time; rounds for what limits hold in one of them, and the first of them, for all coils at once. */
enum { FIELDMAP_ELECTRICAL_STEPS = 12, FIELDMAP_LIMIT_ROUNDS = 64, FIELDMAP_TOGETHER_ROUNDS = 8 };

/* How far currents stray by the tangent at most until the iron is solved again, over the domain of the iron. */
#define FIELDMAP_STRAY 0.02

/* How far they may stray in any case: so near, the tangent misses less than any tolerance. */
#define FIELDMAP_NEAR 1e-7

/* A coil and its drive. resistance: ohm, at the reference temperature; lower, upper: V, of the supply; proportional, V/A,
 * integral, V/(A s): gains of a current controller, both 0 of a source of voltage; current_lower, current_upper: A, where a
 * source of voltage stops; slope: A/s or V/s, of what is asked for. A bridge loses `loss`, V, against the current, and in
 * proportion to it within `ripple`, A. warming: K/W; capacity: J/K; coefficient: 1/K, of the resistance; reference, ambient:
 * degC. */
typedef struct fieldmap_coil {
    double resistance, lower, upper, proportional, integral, current_lower, current_upper, slope, loss, ripple;
    double warming, capacity, coefficient, reference, ambient;
} fieldmap_coil;

enum { FIELDMAP_COIL = 15 };

/* linear: linkages of the coils, to which saturating iron adds (StoredLinkage). largest: A, of the domain of that iron.
 *
 * State of each coil: linkage, Wb; integral: of its controller, V; asked: what is asked for, after the limit of slope;
 * voltage: mean of the last step, V; heat, input: J, so far; temperature, degC; source: see the enumeration. known: whether
 * the linkages are those of a run. counted: heat by the last fieldmap_warm.
 *
 * strayed: how far the currents are from those at which saturating iron was solved; reach: how far they may, A, below 0 where
 * it was not. resistance: at the temperature; met: linkages of coils and iron at the currents; tangent[n * n]: incremental
 * inductances at currents `at`, slopes[fields * n]: derivatives of the weights there; factor: of the matrix of a step of length
 * `step`, 0 for none, with inverses on its diagonal. along: the payload in each field. rows: for each of so many dipoles `points`
 * of the payload the coefficients, `row` numbers, of the derivative of the field by each current, in the cell of the map that is
 * one less than its number in `cells`, 0 for none. The rest is room. */
typedef struct fieldmap_electrical {
    int n, fields, points, row, known;
    double step, largest;
    const fieldmap_coil *coils;
    fieldmap_linkage linear;
    double *linkage, *integral, *asked, *voltage, *heat, *input, *temperature, *source, *counted, *strayed, *resistance;
    double *met, *at, *guess, *change, *right, *given, *gain, *total, *moved, *before, *tangent, *factor, *slopes, *along, *each, *reach, *rows, *cells;
    int64_t tangents, steps;
} fieldmap_electrical;

/* Arrays of n numbers, which begin with those of the state. */
enum { FIELDMAP_ELECTRICAL_ARRAYS = 21, FIELDMAP_ELECTRICAL_STATE = 8 };

/* Numbers of n coils in a map of so many fields, with a payload of so many dipoles. */
static inline size_t fieldmap_electrical_room(int n, const fieldmap *map, int points)
{
    const size_t coils = (size_t)n, fields = (size_t)fieldmap_sets(map), row = (size_t)fieldmap_path_row(map);
    return coils * (FIELDMAP_ELECTRICAL_ARRAYS + 2 * coils + fields) + 4 * fields + 1 + (size_t)points * (coils * row + 1);
}

/* Lay out the arrays in memory of fieldmap_electrical_room() numbers that are zero. */
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

/* Resistances at the temperatures. */
static inline void fieldmap_resist_warm(fieldmap_electrical *e)
{
    int k;
    for (k = 0; k < e->n; k++) {
        const fieldmap_coil *coil = e->coils + k;
        e->resistance[k] = coil->resistance * (1.0 + coil->coefficient * (e->temperature[k] - coil->reference));
    }
    e->step = 0.0;
}

/* Advance the temperatures by a time in which the windings took the heat since the last call. */
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

/* Fill along[fields]: m . b of the body's moments in each field of the map, times `scale`. Moments of soft iron are those in
 * the field as it is. */
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

/* total[n]: linkages of coils and iron that are met, and of the payload. */
static inline void fieldmap_total_linkages(const fieldmap_electrical *e, int saturating, double *total)
{
    memcpy(total, e->met, (size_t)e->n * sizeof(double));
    fieldmap_add_payload_linkages(e->n, e->fields, e->along, saturating ? e->slopes : NULL, total);
}

/* From the linkages of the iron in met[n], times mu0, to those of coils and iron at currents. */
static inline void fieldmap_meet_coils(fieldmap_electrical *e, const double *currents)
{
    int k;
    for (k = 0; k < e->n; k++) e->met[k] /= FIELDMAP_MU0;
    fieldmap_add_linkages(&e->linear, currents, e->met);
}

/* Fill met[n] at currents, at which the iron was solved. */
static inline void fieldmap_meet(fieldmap_electrical *e, fieldmap_iron_state *iron, const double *currents)
{
    int k;
    for (k = 0; k < e->n; k++) e->met[k] = 0.0;
    if (iron != NULL) fieldmap_iron_linkages(iron, e->met);
    fieldmap_meet_coils(e, currents);
}

/* As fieldmap_meet, after a solve that moved the currents: from what it knew before its last step, and the derivative of the
 * tangent. */
static inline void fieldmap_meet_solved(fieldmap_electrical *e, const fieldmap_iron_state *iron, const double *currents)
{
    const int wide = iron->map->wide;
    int k;
    fieldmap_iron_link(iron->map, iron->vector, e->met);
    for (k = 0; k < e->n; k++)
        e->met[k] -= fieldmap_iron_mixed_dot(iron->sides + (size_t)k * (size_t)wide, iron->change, wide);
    fieldmap_meet_coils(e, currents);
}

/* Add to the tangent what soft iron of the payload adds to the inductances: b . dm/dB b' of the fields b per ampere. */
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

/* Incremental inductances and derivatives of the weights at currents, at which the field is. Those of iron that has no solution
 * stay as they are. */
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

/* The rows of dipole p of the payload in the cell of a spot, of number `cell`. */
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

/* As fieldmap_total_linkages by the tangent, of a payload without soft iron: its dipoles in the derivatives of the field by the
 * currents. */
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

/* The field at the dipoles of the payload follows a change of the currents by the tangent, where the path keeps it in the cell of
 * the rows. */
static inline void fieldmap_path_by_tangent(const fieldmap_electrical *e, const fieldmap_path *field, const double *change)
{
    const size_t rows = (size_t)e->n * (size_t)e->row;
    int p;
    for (p = 0; p < field->points; p++) {
        if (field->places[p] + 1 != (int64_t)e->cells[p]) field->places[p] = -1;
        else fieldmap_add_sets(e->rows + (size_t)p * rows, e->row, e->n, change, field->rows + (size_t)p * (size_t)e->row);
    }
}

/* Voltage that the bridge of a coil loses against a current. */
static inline double fieldmap_bridge_loss(const fieldmap_coil *coil, double current)
{
    if (fabs(current) < coil->ripple) return coil->loss / coil->ripple * current;
    return current > 0.0 ? coil->loss : -coil->loss;
}

/* Begin a run at currents, which the field follows, with the linkages that belong to them. Controllers begin with the voltages
 * that keep them, and so does what is asked of sources of voltage. */
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

/* What is asked for goes to the commands as fast as its slope allows. */
static inline void fieldmap_ask(fieldmap_electrical *e, const double *commands, double h)
{
    int k;
    for (k = 0; k < e->n; k++) {
        const double most = h * e->coils[k].slope, by = commands[k] - e->asked[k];
        e->asked[k] = fabs(by) <= most ? commands[k] : e->asked[k] + (by > 0.0 ? most : -most);
    }
}

/* given, gain: voltage of coil k, given - gain times its mean current, without the loss of a bridge. current: at the beginning
 * of the step of length h. */
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

/* The source of coil k at its mean current and that at the end of a step, where its voltage without the loss of a bridge is
 * `driving`. */
static inline double fieldmap_next_source(const fieldmap_electrical *e, int k, double driving, double begin, double change, double h)
{
    const fieldmap_coil *coil = e->coils + k;
    const double mean = begin + 0.5 * change, end = begin + change, source = e->source[k];
    const double slack = 1e-9 * (fabs(driving) + fabs(e->asked[k]));
    double given, gain, wanted, within;
    fieldmap_law_of_coil(e, k, FIELDMAP_ASKED, begin, h, &given, &gain);
    wanted = given - gain * mean;
    within = wanted < coil->lower ? coil->lower : wanted > coil->upper ? coil->upper : wanted;
    /* A limit of the current holds as long as what is asked for would drive it further. */
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

/* change[n] of the currents in a step of length h, with `right` for the linkages, and what limits hold: fills given and gain,
 * with the loss of a bridge. */
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
            /* All at once, coils that are coupled strongly may go round in circles. One by one, the first of them first, and
             * from limit to limit by way of what is asked for, they come to an end: Murty's rule. After the last round the
             * voltages are those of the sources that were taken. */
            if (round >= FIELDMAP_TOGETHER_ROUNDS && next * e->source[k] == FIELDMAP_SUPPLY_LOWEST) next = FIELDMAP_ASKED;
            if (round < FIELDMAP_LIMIT_ROUNDS - 1 && (!moved || round < FIELDMAP_TOGETHER_ROUNDS)) e->source[k] = next;
            moved = 1;
        }
    }
}

/* Take the step to the currents `guess`: the linkages by Faraday's law, integrals, energies. held: set if a limit holds. */
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
            /* At a limit the integral is that of the reference which the limit allows, so that nothing winds up. */
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

/* Whether the currents `guess` meet the linkages of a step, of which at most a share of the step is left; else the next Newton
 * step begins from them. last: what was left before. */
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
    /* What the solve of the iron may leave teaches nothing. */
    *last = left <= 0.5 * tolerance * whole ? 0.0 : left / fmax(moved, 1e-300);
    return *last <= 0.02;
}

/* Correct the tangent by the linkages that a change of the currents made: the update of Broyden, Fletcher, Goldfarb and Shanno,
 * which keeps it symmetric and positive. from: the linkages before. */
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

/* Along the last move of the guess: how far the linkages `total` lie below those of Faraday's law at a guess, times the move. The
 * sum falls along a move that Newton's method takes, to zero where the step along it ends. */
static inline double fieldmap_short_along(const fieldmap_electrical *e, const double *currents, const double *guess,
                                          const double *total, double h)
{
    double sum = 0.0;
    int k;
    for (k = 0; k < e->n; k++) sum += (fieldmap_wanted_linkage(e, k, currents[k], guess[k], h) - total[k]) * e->moved[k];
    return sum;
}

/* After a solve, to which the currents strayed by the tangent, set their reach. What the tangent misses grows with the square of
 * the way: the next one is as long as the tangent may miss half of the tolerance of the iron, over its domain, and at most
 * twice as long. */
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

/* A step, from linkages in `total`, whose currents stay so near to those at which the iron was solved that the tangent has its
 * linkages and weights. 0 for another. */
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

/* Advance the currents of the coils by a step of length h in which the body comes to a place, turned by r[9], and the weights
 * of the field with them. within: whether the currents lie where it is known how the field follows them. The status of the
 * map. */
static inline int fieldmap_drive_coils(fieldmap_electrical *e, fieldmap_superposition *of, const fieldmap_path *field,
                                       const fieldmap_magnetic_body *body, const double *place, const double *r,
                                       const double *commands, double h, double *currents, double *weights, int *held, int *within)
{
    const int n = e->n, saturating = of->iron != NULL, on_path = of->on_path, exact = !saturating && body->n_soft == 0;
    /* Iron with hysteresis is led along the whole path, and soft iron of the payload follows the field. */
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
            /* Trials are no path of iron with hysteresis. */
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
            /* Iron that leaves saturation takes much more flux than the tangent has it. */
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
