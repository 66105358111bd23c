/* reaction.h: the iron's reaction to magnets: the field of the iron that the magnets magnetise (docs/theory/reaction.md).
 *
 *     w_k = sum m . b_k,   B = sum_k s_k w_k b_k,   energy -1/2 sum_k s_k w_k^2
 *
 * The first sum runs over the dipoles m of one or more bodies. The fields b_k, T/sqrt(J), are sets of coefficients like those
 * of the map's own fields; the sign s_k is -1 for the last `repelled` of them. The moments of soft iron depend on B.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_REACTION_H
#define FIELDMAP_REACTION_H

#include "map.h"
#include "wrench.h"

/* Largest number of fields of a reaction. */
enum { FIELDMAP_REACTION_FIELDS = 64 };

/* The fields of a map's reaction as a separate map. */
FIELDMAP_INLINE fieldmap fieldmap_reaction(const fieldmap *map)
{
    fieldmap own = *map;
    own.coefficients = map->reaction;
    own.n_coils = map->reacting, own.constant = 0;
    own.reaction = NULL, own.reacting = 0;
    return own;
}

/* Fill row[2 l + 3]: the derivatives along moment[3] of the harmonics of degree l + 1, from the harmonics of degree l. The
 * transpose of fieldmap_differentiate. */
FIELDMAP_INLINE void fieldmap_row_along(const fm_real *moment, int l, const fm_real *from, fm_real *row)
{
    const fm_real x = FM(0.5) * moment[0], y = FM(0.5) * moment[1], z = moment[2];
    int m;
    for (m = 0; m <= 2 * l; m++) row[m] = z * from[m];
    row[2 * l + 1] = row[2 * l + 2] = FM(0);
    row[1] += x * from[0];
    row[2] += y * from[0];
    for (m = 1; m <= l; m++) {
        const fm_real fold = m == 1 ? FM(2) : FM(1), a = from[2 * m - 1], b = from[2 * m];
        row[2 * m + 1] += x * a - y * b;
        row[2 * m + 2] += x * b + y * a;
        row[m > 1 ? 2 * m - 3 : 0] -= fold * (x * a + y * b);
        if (m > 1) row[2 * m - 2] += fold * (y * a - x * b);
    }
}

/* out[(degree + 1)^2]: the derivative of every harmonic along moment[3] at a place in its coordinates. */
FIELDMAP_INLINE void fieldmap_harmonics_along(const fm_real *moment, int degree, const fm_real *local, fm_real *out)
{
    fm_real harmonics[FIELDMAP_MAX_SIZE];
    int l;
    out[0] = FM(0);
    if (FIELDMAP_MAX_DEGREE >= 5 && degree == 5) {
        /* A loop over l would not be unrolled. */
        fieldmap_harmonics_4(local, harmonics);
        fieldmap_row_along(moment, 0, harmonics, out + 1);
        fieldmap_row_along(moment, 1, harmonics + 1, out + 4);
        fieldmap_row_along(moment, 2, harmonics + 4, out + 9);
        fieldmap_row_along(moment, 3, harmonics + 9, out + 16);
        fieldmap_row_along(moment, 4, harmonics + 16, out + 25);
        return;
    }
    fieldmap_harmonics(degree - 1, 1, local, local + 1, local + 2, harmonics);
    for (l = 0; l < degree; l++) fieldmap_row_along(moment, l, harmonics + l * l, out + (l + 1) * (l + 1));
}

/* Vector register at any address, if the compiler has such a type: compilers would unroll short loops, not vectorise them. */
#if defined(__GNUC__) || defined(__clang__)
#ifdef __AVX__
enum { FIELDMAP_REGISTER = 32 / sizeof(fm_real) };
#else
enum { FIELDMAP_REGISTER = 16 / sizeof(fm_real) };
#endif
typedef fm_real fm_register __attribute__((vector_size(FIELDMAP_REGISTER * sizeof(fm_real)), aligned(sizeof(fm_real)), may_alias));
#endif

/* Sum of products. */
FIELDMAP_INLINE fm_real fieldmap_product(const fm_real *a, const fm_real *b, int count)
{
    fm_real sum = FM(0);
    int i = 0;
#if defined(__GNUC__) || defined(__clang__)
    const int lanes = FIELDMAP_REGISTER;
    fm_register even = {FM(0)}, odd = {FM(0)};
    int lane;
    /* Two independent sums hide the latency of the additions. */
    for (; i + 2 * lanes <= count; i += 2 * lanes) {
        even += *(const fm_register *)(a + i) * *(const fm_register *)(b + i);
        odd += *(const fm_register *)(a + i + lanes) * *(const fm_register *)(b + i + lanes);
    }
    for (; i + lanes <= count; i += lanes) even += *(const fm_register *)(a + i) * *(const fm_register *)(b + i);
    even += odd;
    for (lane = 0; lane < lanes / 2; lane++) sum += even[lane] + even[lane + lanes / 2];
#endif
    for (; i < count; i++) sum += a[i] * b[i];
    return sum;
}

/* Add moment[3] . field of each of `count` sets of coefficients of a cell, at a place in its coordinates, to along[k]. */
FIELDMAP_INLINE void fieldmap_add_sets_along(
    const fm_real *moment, int degree, const fm_real *local, const fm_real *sets, int count, fm_real *along)
{
    const int size = (degree + 1) * (degree + 1);
    fm_real harmonics[FIELDMAP_MAX_SIZE];
    int k;
    fieldmap_harmonics_along(moment, degree, local, harmonics);
    for (k = 0; k < count; k++, sets += size) along[k] += fieldmap_product(harmonics, sets, size);
}

/* Add moment[3] . field of each of `count` rows of fieldmap_gather, at a spot, to along[k]. */
static inline void fieldmap_add_rows_along(const fieldmap *map, const fieldmap_spot *spot, const fm_real *moment, const fm_real *rows,
                                           int count, fm_real *along)
{
    int k, i;
    if (map->kind != FIELDMAP_HERMITE) {
        fm_real local[3];
        fieldmap_from_middle(map, spot, local);
        /* If the compiler knows the degree, only the code for that degree is left. */
        if (map->degree == 5) fieldmap_add_sets_along(moment, 5, local, rows, count, along);
        else fieldmap_add_sets_along(moment, map->degree, local, rows, count, along);
        return;
    }
    for (k = 0; k < count; k++, rows += 8 * FIELDMAP_NODE) {
        fm_real flux[3];
        fieldmap_field_of_row(map, rows, spot, flux, NULL);
        for (i = 0; i < 3; i++) along[k] += moment[i] * flux[i];
    }
}

/* Add moment[3] . field k of a map, at weight 1 and point[3], to along[k]. The constant field is left out. */
static inline int fieldmap_add_along(const fieldmap *map, const fm_real *point, const fm_real *moment, fm_real *along)
{
    fieldmap_spot spot;
    const int status = fieldmap_locate(map, point, &spot);
    int k, i;
    if (status != FIELDMAP_OK) return status;
    if (map->kind != FIELDMAP_HERMITE) {
        fieldmap_add_rows_along(map, &spot, moment, fieldmap_sets_at(map, &spot, 0), map->n_coils, along);
    } else {
        fieldmap own = *map;
        for (k = 0; k < map->n_coils; k++, own.coefficients += map->size) {
            fm_real flux[3];
            fieldmap_field_at(&own, NULL, &spot, flux, NULL);
            for (i = 0; i < 3; i++) along[k] += moment[i] * flux[i];
        }
    }
    return status;
}

/* Add moment[3] . field k of a map's reaction at point[3] to weights[k]. */
static inline int fieldmap_reaction_add(const fieldmap *map, const fm_real *point, const fm_real *moment, fm_real *weights)
{
    const fieldmap own = fieldmap_reaction(map);
    return fieldmap_add_along(&own, point, moment, weights);
}

/* Turn weights w_k of a map's reaction into s_k w_k, in place. */
static inline void fieldmap_reaction_signs(const fieldmap *map, fm_real *weights)
{
    int k;
    for (k = map->reacting - map->repelled; k < map->reacting; k++) weights[k] = -weights[k];
}

/* Add a map's reaction with signed weights at a point to flux[3] and gradient[9]. */
static inline int fieldmap_reaction_field(
    const fieldmap *map, const fm_real *weights, const fm_real *point, fm_real *flux, fm_real *gradient)
{
    const fieldmap own = fieldmap_reaction(map);
    fm_real back[3], slope[9];
    const int status = fieldmap_field_of_weights(&own, weights, point, back, slope);
    int i;
    for (i = 0; i < 3; i++) flux[i] += back[i];
    for (i = 0; i < 9; i++) gradient[i] += slope[i];
    return status;
}

/* Add `count` sets, each times its weight, to the coefficients `row` of a polynomial. */
FIELDMAP_INLINE void fieldmap_add_sets(const fm_real *FIELDMAP_RESTRICT sets, int size, int count,
                                       const fm_real *FIELDMAP_RESTRICT weights, fm_real *FIELDMAP_RESTRICT row)
{
    int k, i;
    for (k = 0; k < count; k++, sets += size)
        for (i = 0; i < size; i++) row[i] += weights[k] * sets[i];
}

/* Add the coefficients of the reaction to one dipole of moment[3] at a spot to the coefficients `row` of a polynomial. */
FIELDMAP_INLINE void fieldmap_reaction_to_row(
    const fieldmap *map, int degree, const fieldmap_spot *spot, const fm_real *moment, fm_real *row)
{
    const fieldmap own = fieldmap_reaction(map);
    const fm_real *sets = fieldmap_sets_at(&own, spot, 0);
    fm_real local[3], weights[FIELDMAP_REACTION_FIELDS];
    int k;
    for (k = 0; k < map->reacting; k++) weights[k] = FM(0);
    fieldmap_from_middle(map, spot, local);
    fieldmap_add_sets_along(moment, degree, local, sets, map->reacting, weights);
    fieldmap_reaction_signs(map, weights);
    fieldmap_add_sets(sets, (degree + 1) * (degree + 1), map->reacting, weights, row);
}

/* As fieldmap_field_at_dipole, for a Hermite form. */
static inline int fieldmap_hermite_at_dipole(
    const fieldmap *map, const fm_real *weights, const fm_real *point, const fm_real *moment, fm_real *flux, fm_real *gradient)
{
    fm_real reacting[FIELDMAP_REACTION_FIELDS] = {FM(0)};
    const int status = fieldmap_field_of_weights(map, weights, point, flux, gradient);
    if (status != FIELDMAP_OK) return status;
    fieldmap_reaction_add(map, point, moment, reacting);
    fieldmap_reaction_signs(map, reacting);
    return fieldmap_reaction_field(map, reacting, point, flux, gradient);
}

/* flux[3] and gradient[9] at point[3] for weights of the sets, with the reaction to one dipole of moment[3] there. */
static inline int fieldmap_field_at_dipole(
    const fieldmap *map, const fm_real *weights, const fm_real *point, const fm_real *moment, fm_real *flux, fm_real *gradient)
{
    fieldmap_spot spot;
    fm_real row[FIELDMAP_MAX_SIZE];
    int status, i;
    if (map->kind == FIELDMAP_HERMITE) return fieldmap_hermite_at_dipole(map, weights, point, moment, flux, gradient);
    status = fieldmap_locate(map, point, &spot);
    if (status != FIELDMAP_OK) return status;
    if (weights == NULL) {
        const fm_real *only = fieldmap_sets_at(map, &spot, 0);
        for (i = 0; i < map->size; i++) row[i] = only[i];
    } else {
        fieldmap_gather(map, weights, &spot, row);
    }
    /* If the compiler knows the degree, only the code for that degree is left. */
    if (map->degree == 5) fieldmap_reaction_to_row(map, 5, &spot, moment, row);
    else fieldmap_reaction_to_row(map, map->degree, &spot, moment, row);
    fieldmap_field_of_row(map, row, &spot, flux, gradient);
    return status;
}

/* wrench[6] on one dipole of moment[3] at point[3] for weights of the sets, including its own reaction if the map has one. */
static inline int fieldmap_wrench_of_weights(
    const fieldmap *map, const fm_real *weights, const fm_real *point, const fm_real *moment, fm_real *wrench)
{
    fm_real flux[3], gradient[9];
    const int status = map->reaction == NULL ? fieldmap_field_of_weights(map, weights, point, flux, gradient)
                                             : fieldmap_field_at_dipole(map, weights, point, moment, flux, gradient);
    if (status == FIELDMAP_OK)
        fieldmap_dipole_wrench(flux, gradient, moment, wrench);
    else
        fieldmap_unknown(wrench, 6);
    return status;
}

/* wrench[6] on a dipole of moment[3] at point[3] for currents[n_coils]. */
static inline int fieldmap_wrench(
    const fieldmap *map, const fm_real *currents, const fm_real *point, const fm_real *moment, fm_real *wrench)
{
    int status;
    if (moment == NULL || wrench == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_check(map, currents, point);
    if (status == FIELDMAP_OK) return fieldmap_wrench_of_weights(map, currents, point, moment, wrench);
    if (status != FIELDMAP_ARGUMENT) fieldmap_unknown(wrench, 6);
    return status;
}

/* Fill linkages[n_coils], Wb, of coils and linear iron at currents[n_coils], and of a dipole of moment[3] at point[3], unless
 * both are NULL. */
static inline int fieldmap_flux_linkage(
    const fieldmap *map, const fm_real *currents, const fm_real *point, const fm_real *moment, fm_real *linkages)
{
    int k, status;
    if (map == NULL || currents == NULL || linkages == NULL || (point == NULL) != (moment == NULL)) return FIELDMAP_ARGUMENT;
    if (map->linkage.coils != map->n_coils) return FIELDMAP_UNLINKED;
    status = fieldmap_check(map, currents, point == NULL ? map->lower : point);
    for (k = 0; k < map->n_coils; k++) linkages[k] = FM(0);
    if (status == FIELDMAP_OK && point != NULL) status = fieldmap_add_along(map, point, moment, linkages);
    if (status == FIELDMAP_OK) fieldmap_add_linkages(&map->linkage, currents, linkages);
    else fieldmap_unknown(linkages, map->n_coils);
    return status;
}

#endif
