/* caller.h: all kinds of maps behind one question, for callers that hold an address and nothing else.
 *
 * FieldMap.compiled() gives numba such an address; callers in C with pointers to functions can take these as well. A map at
 * fixed currents, of linear iron, of saturating iron and with a table of currents answer alike. Nothing is allocated. Any
 * number of threads may use one caller at a time, but for saturating iron: its state remembers the last currents, and
 * belongs to one thread.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CALLER_H
#define FIELDMAP_CALLER_H

#include "bodies.h"
#include "current_table.h"
#include "electrical.h"
#include "flux_linkage.h"

/* Most fields behind those of the coils that a table may give. */
enum { FIELDMAP_CALLER_FIELDS = 4096 };

/* map: all fields whose sum is asked for. iron: from currents to their weights, where the iron saturates; table: instead of
 * it. Both NULL: the currents are the weights. body: what wrench and linkages are asked of, or NULL. linkage: of the coils. */
typedef struct fieldmap_caller {
    const fieldmap *map;
    fieldmap_iron_state *iron;
    const fieldmap_current_table *table;
    const fieldmap_magnetic_body *body;
    fieldmap_linkage linkage;
} fieldmap_caller;

/* How many currents a caller is asked with. */
static inline int fieldmap_caller_coils(const fieldmap_caller *of)
{
    if (of->iron != NULL) return of->iron->map->n_coils;
    return of->table != NULL ? 6 : of->map->n_coils;
}

/* The weights of the fields at currents, which lie in the state until the next solve. NULL: none. */
static inline const double *fieldmap_caller_solved(fieldmap_iron_state *state, const double *currents)
{
    return fieldmap_iron_follow(state, currents) == FIELDMAP_OK ? state->solution : NULL;
}

static inline int fieldmap_caller_tabled(
    const fieldmap_caller *of, const double *currents, const double *point, double *flux, double *gradient)
{
    double weights[6 + FIELDMAP_CALLER_FIELDS];
    if (fieldmap_table_weights(of->table, currents, weights) != FIELDMAP_TABLE_FOUND) return FIELDMAP_IRON_BEYOND;
    return fieldmap_field_of_weights(of->map, weights, point, flux, gradient);
}

/* flux[3] and gradient[9] at point[3] for currents[], or NULL of a map at fixed currents. NaN unless the status is FIELDMAP_OK:
 * outside the box; beyond the domain of the iron; off the division of a table or beyond it. */
static inline int fieldmap_caller_field(
    const fieldmap_caller *of, const double *currents, const double *point, double *flux, double *gradient)
{
    int status = FIELDMAP_IRON_BEYOND;
    if (currents == NULL && (of->iron != NULL || of->table != NULL || fieldmap_sets(of->map) != 1)) {
        status = FIELDMAP_ARGUMENT;
    } else if (of->iron != NULL) {
        const double *weights = fieldmap_caller_solved(of->iron, currents);
        if (weights != NULL) return fieldmap_field_of_weights(of->map, weights, point, flux, gradient);
    } else if (of->table != NULL) {
        status = fieldmap_caller_tabled(of, currents, point, flux, gradient);
        if (status != FIELDMAP_IRON_BEYOND) return status;
    } else {
        return fieldmap_field_of_weights(of->map, currents, point, flux, gradient);
    }
    fieldmap_unknown(flux, 3);
    fieldmap_unknown(gradient, 9);
    return status;
}

/* How many numbers of room a wrench takes; linkages take no more. */
static inline size_t fieldmap_caller_room(const fieldmap_caller *of)
{
    const size_t fields = (size_t)fieldmap_sets(of->map), coils = (size_t)fieldmap_caller_coils(of);
    const size_t points = of->body == NULL ? 0 : (size_t)fieldmap_body_points(of->body);
    const size_t reacting = (size_t)of->map->reacting;
    const size_t sites = points * (sizeof(fieldmap_site) / sizeof(double));
    return fields * (1 + 6 + coils + 12 * points) + 12 * points * reacting + sites;
}

/* wrench[6], N and N m, on the body at a place[3], turned by r[9], about its origin, and slopes[6 * coils], its derivatives
 * by the currents. Not of a table, which has no slopes everywhere. NaN unless the status is FIELDMAP_OK. */
static inline int fieldmap_caller_wrench(const fieldmap_caller *of, const double *currents, const double *place,
                                         const double *r, double *room, double *wrench, double *slopes)
{
    const int fields = fieldmap_sets(of->map), coils = fieldmap_caller_coils(of), points = fieldmap_body_points(of->body);
    double *weights = room, *by_weight = weights + fields, *by_current = by_weight + 6 * (size_t)fields;
    double *flux = by_current + (size_t)fields * (size_t)coils, *gradient = flux + 3 * (size_t)points * (size_t)fields;
    const int reacting = of->map->reacting;
    const fieldmap own = fieldmap_reaction(of->map);
    double *back = gradient + 9 * (size_t)points * (size_t)fields, *back_slope = back + 3 * (size_t)points * (size_t)reacting;
    fieldmap_placed placed = {of->body, {0.0}, {0.0}};
    fieldmap_bodies alone = {1, points, &placed, (fieldmap_site *)(back_slope + 9 * (size_t)points * (size_t)reacting),
                             {fields, weights, flux, gradient}, {reacting, of->map->repelled, back, back_slope}, {0.0}};
    int status = of->table == NULL ? FIELDMAP_OK : FIELDMAP_ARGUMENT, p, i, c, f;
    if (status == FIELDMAP_OK && of->iron != NULL) {
        status = fieldmap_iron_slopes(of->iron, currents, weights, by_current);
    } else {
        for (f = 0; f < fields; f++) weights[f] = f < coils ? currents[f] : 1.0;
    }
    for (p = 0; p < points && status == FIELDMAP_OK; p++) {
        double arm[3], point[3];
        fieldmap_body_arm(of->body, p, r, arm);
        for (i = 0; i < 3; i++) point[i] = place[i] + arm[i];
        status = fieldmap_each_field(of->map, point, flux + 3 * (size_t)p * (size_t)fields,
                                     gradient + 9 * (size_t)p * (size_t)fields);
        if (status == FIELDMAP_OK && reacting > 0)
            status = fieldmap_each_field(&own, point, back + 3 * (size_t)p * (size_t)reacting,
                                         back_slope + 9 * (size_t)p * (size_t)reacting);
    }
    if (status != FIELDMAP_OK) {
        fieldmap_unknown(wrench, 6);
        fieldmap_unknown(slopes, 6 * coils);
        return status;
    }
    memcpy(placed.turn, r, sizeof placed.turn);
    fieldmap_place_bodies(&alone);
    fieldmap_bodies_wrench(&alone, wrench, NULL);
    fieldmap_bodies_slopes(&alone, slopes, by_weight);
    for (i = 0; i < 6; i++)
        for (c = 0; c < coils; c++) {
            const double *row = by_weight + (size_t)i * (size_t)fields;
            double sum = of->iron == NULL ? row[c] : 0.0;
            for (f = 0; f < fields && of->iron != NULL; f++) sum += row[f] * by_current[(size_t)f * (size_t)coils + (size_t)c];
            slopes[i * coils + c] = sum;
        }
    return FIELDMAP_OK;
}

/* linkages[coils], Wb, with a body as of fieldmap_caller_wrench if there is one, and inductance[coils * coils], H, of the coils
 * without it. Not of a table. NaN unless the status is FIELDMAP_OK. */
static inline int fieldmap_caller_linkages(const fieldmap_caller *of, const double *currents, const double *place,
                                           const double *r, double *room, double *linkages, double *inductance)
{
    const int n = fieldmap_caller_coils(of), fields = fieldmap_sets(of->map), linked = of->table == NULL && of->linkage.coils == n;
    double *along = room, *weights = along + fields, *slopes = of->iron == NULL ? NULL : weights + fields;
    const fieldmap_path field = {of->map, weights, 0, NULL, NULL};
    int k, status = linked ? FIELDMAP_OK : FIELDMAP_UNLINKED;
    if (linked && slopes != NULL) {
        status = fieldmap_solve_linkages(of->iron, &of->linkage, currents, weights, slopes, linkages, inductance);
    } else if (linked) {
        for (k = 0; k < fields; k++) weights[k] = k < n ? currents[k] : 1.0;
        for (k = 0; k < n; k++) linkages[k] = 0.0;
        fieldmap_add_linkages(&of->linkage, currents, linkages);
        memcpy(inductance, of->linkage.inductance, (size_t)(n * n) * sizeof(double));
    }
    if (status == FIELDMAP_OK && of->body != NULL)
        status = fieldmap_payload_along(&field, of->body, place, r, 1.0, fields, along);
    if (status != FIELDMAP_OK) {
        fieldmap_unknown(linkages, n);
        fieldmap_unknown(inductance, n * n);
    } else if (of->body != NULL) {
        fieldmap_add_payload_linkages(n, fields, along, slopes, linkages);
    }
    return status;
}

#endif
