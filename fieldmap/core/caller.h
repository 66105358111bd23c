/* caller.h: one interface to all kinds of maps, for callers that hold only an address.
 *
 * FieldMap.compiled() gives numba such an address; C code can use it through pointers to functions. The interface is the same
 * for maps at fixed currents, of linear iron, of saturating iron and with a table of currents. Nothing is allocated. Several
 * threads may use one caller at a time, except with saturating iron, whose state belongs to one thread.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_CALLER_H
#define FIELDMAP_CALLER_H

#include "bodies.h"
#include "current_table.h"
#include "electrical.h"
#include "flux_linkage.h"

/* Largest number of fields that a table may add to those of the coils: it bounds the stack. */
enum { FIELDMAP_CALLER_FIELDS = 4096 };

/* map: the fields. iron: model of saturating iron that gives their weights from the currents; table: used instead of the model.
 * If both are NULL, the currents are the weights. body: for wrench and linkages, or NULL. linkage: of the coils. */
typedef struct fieldmap_caller {
    const fieldmap *map;
    fieldmap_iron_state *iron;
    const fieldmap_current_table *table;
    const fieldmap_magnetic_body *body;
    fieldmap_linkage linkage;
} fieldmap_caller;

/* Number of currents that a caller takes. */
static inline int fieldmap_caller_coils(const fieldmap_caller *of)
{
    if (of->iron != NULL) return of->iron->map->n_coils;
    return of->table != NULL ? 6 : of->map->n_coils;
}

/* The weights of the fields at currents, or NULL if the solve fails. The weights are valid until the next solve. */
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

/* Fill flux[3] and gradient[9] at point[3] for currents[], or for NULL if the map has fixed currents. Both are NaN unless the
 * status is FIELDMAP_OK: outside the box, beyond the domain of the iron, or outside a table or its division of currents. */
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

/* Numbers of room that fieldmap_caller_wrench needs; fieldmap_caller_linkages needs no more. */
static inline size_t fieldmap_caller_room(const fieldmap_caller *of)
{
    const size_t fields = (size_t)fieldmap_sets(of->map), coils = (size_t)fieldmap_caller_coils(of);
    const size_t points = of->body == NULL ? 0 : (size_t)fieldmap_body_points(of->body);
    const size_t reacting = (size_t)of->map->reacting;
    const size_t sites = points * (sizeof(fieldmap_site) / sizeof(double));
    return fields * (1 + 6 + coils + 12 * points) + 12 * points * reacting + sites;
}

/* Fill wrench[6], N and N m, about the origin of the body at a place[3] with rotation r[9], and slopes[6 * coils], its
 * derivatives with respect to the currents. A table is refused, because it does not have slopes everywhere. Results are NaN
 * unless the status is FIELDMAP_OK. */
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

/* Fill linkages[coils], Wb, with the contribution of the body, if there is one, at the pose of fieldmap_caller_wrench, and
 * inductance[coils * coils], H, without it. A table is refused. Results are NaN unless the status is FIELDMAP_OK. */
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
