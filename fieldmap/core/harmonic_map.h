/* harmonic_map.h: a map, its coefficients at a point, and flux density and gradient of harmonic polynomials.
 *
 * A map holds sets of coefficients at places: the cells of a grid (polynomials of degree 5 that solve Laplace's equation), its
 * nodes (Hermite form), or one place for the whole box (one polynomial). Set s of place n begins at (n * sets + s) * size. The
 * field is the sum of the sets, each times its weight, such as the current of its coil. If `constant` is 1, there is one more
 * set, a field that no current drives, and its weight is 1.
 *
 * This file has all that a microcontroller needs (fieldmap32.h); map.h adds functions that take more code and stack.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_HARMONIC_MAP_H
#define FIELDMAP_HARMONIC_MAP_H

#include "harmonics.h"

enum {
    FIELDMAP_OK, FIELDMAP_OUTSIDE, FIELDMAP_NOT_FINITE, FIELDMAP_NO_FILE, FIELDMAP_TRUNCATED, FIELDMAP_NOT_A_MAP,
    FIELDMAP_VERSION, FIELDMAP_BYTE_ORDER, FIELDMAP_DAMAGED, FIELDMAP_NO_MEMORY, FIELDMAP_ALIGNMENT, FIELDMAP_ARGUMENT,
    FIELDMAP_UNLINKED
};

/* Form of a map. Files store these numbers. */
enum { FIELDMAP_HERMITE, FIELDMAP_HARMONIC, FIELDMAP_GLOBAL };

/* Flux linkages of the coils without payload and saturating iron (docs/theory/flux_linkage.md): inductance[coils * coils], H,
 * and constant[coils], Wb. coils: 0 if they are unknown. */
typedef struct fieldmap_linkage {
    int coils;
    const fm_real *inductance, *constant;
} fieldmap_linkage;

/* A map: treat as read-only. cells: along each axis; inverse: 1 / spacing, 1/m; local: spacing divided by the unit of length of
 * the polynomials; per_length: 1 / that unit, 1/m; clamps: whether a point outside gets the value at the nearest point of the
 * box, not NaN. names: of the coils, one after the other, each ended by a zero byte; owned: memory of fieldmap_open. reaction:
 * coefficients of `reacting` sets of the iron's reaction to magnets, laid out like those of the fields, or NULL; the last
 * `repelled` sets have the sign -1 (reaction.h). linkage: of the coils of a file. */
typedef struct fieldmap {
    int n_coils, constant, degree, kind, clamps, size;
    int cells[3];
    fm_real lower[3], upper[3], inverse[3], local[3], per_length;
    const fm_real *coefficients;
    const char *names;
    void *owned;
    const fm_real *reaction;
    int reacting, repelled;
    fieldmap_linkage linkage;
} fieldmap;

/* Add the linkages at currents[coils] to linkages[coils]. */
static inline void fieldmap_add_linkages(const fieldmap_linkage *of, const fm_real *currents, fm_real *linkages)
{
    int k, j;
    for (k = 0; k < of->coils; k++) {
        linkages[k] += of->constant[k];
        for (j = 0; j < of->coils; j++) linkages[k] += of->inductance[k * of->coils + j] * currents[j];
    }
}

/* Number of sets of coefficients of a map. */
static inline int fieldmap_sets(const fieldmap *map)
{
    return map->n_coils + map->constant;
}

/* Margin for rounding, in cells: a point this far outside counts as inside. */
#define FIELDMAP_EDGE (sizeof(fm_real) < 8 ? FM(1e-5) : FM(1e-9))

/* Location of a point: cell (i, j, k), and coordinates 0 to 1 in the cell. */
typedef struct fieldmap_spot {
    int cell[3];
    fm_real t[3];
} fieldmap_spot;

/* Find the spot of a point. Returns FIELDMAP_OK where the field is known; FIELDMAP_OUTSIDE, with the nearest spot of the box;
 * or FIELDMAP_NOT_FINITE, with any spot. */
FIELDMAP_INLINE int fieldmap_locate(const fieldmap *map, const fm_real *point, fieldmap_spot *spot)
{
    int axis, inside = 1, finite = 1;
    for (axis = 0; axis < 3; axis++) {
        const fm_real cells = (fm_real)map->cells[axis], last = cells - FM(1);
        const fm_real u = (point[axis] - map->lower[axis]) * map->inverse[axis];
        /* NaN fails every comparison. */
        const fm_real above = u > FM(0) ? u : FM(0), in = above < cells ? above : cells;
        const int index = (int)(in < last ? in : last);
        inside &= (u >= -FIELDMAP_EDGE) & (u <= cells + FIELDMAP_EDGE);
        finite &= fieldmap_finite(point[axis]);
        spot->cell[axis] = index;
        spot->t[axis] = in - (fm_real)index;
    }
    return !finite ? FIELDMAP_NOT_FINITE : inside || map->clamps ? FIELDMAP_OK : FIELDMAP_OUTSIDE;
}

/* Address of the sets of cell `spot`, or of the node at its corner 4 i + 2 j + k. */
static inline const fm_real *fieldmap_sets_at(const fieldmap *map, const fieldmap_spot *spot, int corner)
{
    const int nodes = map->kind == FIELDMAP_HERMITE;
    size_t place = (size_t)(spot->cell[0] + (corner >> 2 & 1));
    place = place * (size_t)(map->cells[1] + nodes) + (size_t)(spot->cell[1] + (corner >> 1 & 1));
    place = place * (size_t)(map->cells[2] + nodes) + (size_t)(spot->cell[2] + (corner & 1));
    return map->coefficients + place * (size_t)fieldmap_sets(map) * (size_t)map->size;
}

/* Fill out (size numbers) with the sum of the sets of a place, each times its weight of weights[n_coils]. */
static inline void fieldmap_sum_sets(const fieldmap *map, const fm_real *sets, const fm_real *weights, fm_real *out)
{
    const int size = map->size;
    int m, s;
    if (map->n_coils > 0)
        for (m = 0; m < size; m++) out[m] = weights[0] * sets[m];
    else
        for (m = 0; m < size; m++) out[m] = FM(0);
    for (s = 1; s < map->n_coils; s++) {
        const fm_real *set = sets + (size_t)s * (size_t)size, weight = weights[s];
        for (m = 0; m < size; m++) out[m] += weight * set[m];
    }
    if (map->constant) {
        const fm_real *set = sets + (size_t)map->n_coils * (size_t)size;
        for (m = 0; m < size; m++) out[m] += set[m];
    }
}

/* The coefficients at a spot: the sum at weights, written to `room`, or, if weights is NULL, the only set of the map. */
static inline const fm_real *fieldmap_coefficients(
    const fieldmap *map, const fm_real *weights, const fieldmap_spot *spot, int corner, fm_real *room)
{
    const fm_real *sets = fieldmap_sets_at(map, spot, corner);
    if (weights == NULL) return sets;
    fieldmap_sum_sets(map, sets, weights, room);
    return room;
}

/* Fill local[3], the spot in the coordinates of its polynomial: from the middle of the cell, in the unit of length. */
FIELDMAP_INLINE void fieldmap_from_middle(const fieldmap *map, const fieldmap_spot *spot, fm_real local[3])
{
    int axis;
    for (axis = 0; axis < 3; axis++) local[axis] = (spot->t[axis] - FM(0.5)) * map->local[axis];
}

/* Fill flux[3] and, unless NULL, gradient[9] from the nine numbers of harmonics.h. */
FIELDMAP_INLINE void fieldmap_store(fm_real per_length, const fm_real *nine, size_t step, fm_real *flux, fm_real *gradient)
{
    flux[0] = nine[0], flux[1] = nine[step], flux[2] = nine[2 * step];
    if (gradient == NULL) return;
    gradient[0] = per_length * nine[3 * step];
    gradient[1] = gradient[3] = per_length * nine[4 * step];
    gradient[2] = gradient[6] = per_length * nine[5 * step];
    gradient[4] = per_length * nine[6 * step];
    gradient[5] = gradient[7] = per_length * nine[7 * step];
    gradient[8] = per_length * nine[8 * step];
}

/* flux[3] and, unless NULL, gradient[9] of the polynomial c at a place in its coordinates. If the compiler knows the degree,
 * inlining leaves only the code for that degree. */
FIELDMAP_INLINE void fieldmap_field_of_polynomial(
    const fm_real *c, int degree, fm_real per_length, const fm_real *local, fm_real *flux, fm_real *gradient)
{
    fm_real nine[FIELDMAP_NINE];
    if (FIELDMAP_MAX_DEGREE >= 5 && degree == 5)
        fieldmap_polynomial_5(c, 1, local[0], local[1], local[2], nine);
    else
        fieldmap_polynomial(c, degree, 1, local, local + 1, local + 2, nine);
    fieldmap_store(per_length, nine, 1, flux, gradient);
}

/* FIELDMAP_OK if a map can be evaluated at these currents, which may be NULL for a map of fixed currents. */
static inline int fieldmap_check(const fieldmap *map, const fm_real *currents, const fm_real *point)
{
    int k;
    if (map == NULL || map->coefficients == NULL || point == NULL) return FIELDMAP_ARGUMENT;
    if (currents == NULL && fieldmap_sets(map) != 1) return FIELDMAP_ARGUMENT;
    for (k = 0; currents != NULL && k < map->n_coils; k++)
        if (!fieldmap_finite(currents[k])) return FIELDMAP_NOT_FINITE;
    return FIELDMAP_OK;
}

#endif
