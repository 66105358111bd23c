/* map.h: flux density, its derivatives and the scalar potential from the coefficients of a map.
 *
 * SI units, z up: points in m, currents in A, B in T, gradient[3 * i + j] = dB_i/dx_j in T/m, second[9 * i + 3 * j + k] =
 * d2B_i/dx_j dx_k in T/m^2. A map holds sets of coefficients at places: at the cells of a grid (polynomials of degree 5
 * that solve Laplace's equation), at its nodes (Hermite form), or one polynomial for the whole box. Set s of place n
 * begins at (n * sets + s) * size. The field is the sum of the sets, each times its weight, such as the current of its
 * coil. Where `constant` is 1, there is one more set, a field that no current drives, and its weight is 1.
 *
 * Nothing is allocated, and a map is never written to: any number of threads may use it.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MAP_H
#define FIELDMAP_MAP_H

#include "harmonics.h"
#include "hermite.h"
#include "wrench.h"

enum {
    FIELDMAP_OK, FIELDMAP_OUTSIDE, FIELDMAP_NOT_FINITE, FIELDMAP_NO_FILE, FIELDMAP_TRUNCATED, FIELDMAP_NOT_A_MAP,
    FIELDMAP_VERSION, FIELDMAP_BYTE_ORDER, FIELDMAP_DAMAGED, FIELDMAP_NO_MEMORY, FIELDMAP_ALIGNMENT, FIELDMAP_ARGUMENT
};

/* What the coefficients are of. The numbers stand in files. */
enum { FIELDMAP_HERMITE, FIELDMAP_HARMONIC, FIELDMAP_GLOBAL };

/* Numbers of a node in Hermite form: three components of eight. A map of the potential has one component. */
enum { FIELDMAP_NODE = 24, FIELDMAP_CORNER = 8 };

/* A map: treat as read-only. cells: along each axis; inverse: 1 / spacing, 1/m; local: spacing over the unit of length
 * of the polynomials, and per_length its inverse, 1/m; clamps: whether a point outside gets the value at the nearest
 * point of the box, not NaN. names: of the coils, each ended by a zero byte, one behind the other; owned: what
 * fieldmap_open took. */
typedef struct fieldmap {
    int n_coils, constant, degree, kind, clamps, size;
    int cells[3];
    fm_real lower[3], upper[3], inverse[3], local[3], per_length;
    const fm_real *coefficients;
    const char *names;
    void *owned;
} fieldmap;

/* How many sets of coefficients a map has. */
static inline int fieldmap_sets(const fieldmap *map)
{
    return map->n_coils + map->constant;
}

/* Where a point lies: cell (i, j, k), and coordinates 0 to 1 there. */
typedef struct fieldmap_spot {
    int cell[3];
    fm_real t[3];
} fieldmap_spot;

/* FIELDMAP_OK where the field is known; FIELDMAP_OUTSIDE, with the nearest spot of the box; or FIELDMAP_NOT_FINITE, with
 * any spot. A point that rounding puts outside lies inside. */
static inline int fieldmap_locate(const fieldmap *map, const fm_real *point, fieldmap_spot *spot)
{
    const fm_real edge = sizeof(fm_real) < 8 ? FM(1e-5) : FM(1e-9);
    int axis, inside = 1, finite = 1;
    for (axis = 0; axis < 3; axis++) {
        const fm_real cells = (fm_real)map->cells[axis], last = cells - FM(1);
        const fm_real u = (point[axis] - map->lower[axis]) * map->inverse[axis];
        /* NaN fails every comparison. */
        const fm_real above = u > FM(0) ? u : FM(0), in = above < cells ? above : cells;
        const int index = (int)(in < last ? in : last);
        inside &= (u >= -edge) & (u <= cells + edge);
        finite &= fieldmap_finite(point[axis]);
        spot->cell[axis] = index;
        spot->t[axis] = in - (fm_real)index;
    }
    return !finite ? FIELDMAP_NOT_FINITE : inside || map->clamps ? FIELDMAP_OK : FIELDMAP_OUTSIDE;
}

/* Where the sets of cell `spot`, or of the node of its corner 4 i + 2 j + k, begin. */
static inline const fm_real *fieldmap_sets_at(const fieldmap *map, const fieldmap_spot *spot, int corner)
{
    const int nodes = map->kind == FIELDMAP_HERMITE;
    size_t place = (size_t)(spot->cell[0] + (corner >> 2 & 1));
    place = place * (size_t)(map->cells[1] + nodes) + (size_t)(spot->cell[1] + (corner >> 1 & 1));
    place = place * (size_t)(map->cells[2] + nodes) + (size_t)(spot->cell[2] + (corner & 1));
    return map->coefficients + place * (size_t)fieldmap_sets(map) * (size_t)map->size;
}

/* out (size numbers): the sum at weights[n_coils] of the sets of a place, one behind the other. */
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

/* The coefficients at a spot: those of the sum at weights, written to `room`, or those of a map of one set where weights
 * is NULL. */
static inline const fm_real *fieldmap_coefficients(
    const fieldmap *map, const fm_real *weights, const fieldmap_spot *spot, int corner, fm_real *room)
{
    const fm_real *sets = fieldmap_sets_at(map, spot, corner);
    if (weights == NULL) return sets;
    fieldmap_sum_sets(map, sets, weights, room);
    return room;
}

/* The corners of a cell in Hermite form, in `room`, 8 * FIELDMAP_NODE numbers, or in the map. */
static inline void fieldmap_corners(
    const fieldmap *map, const fm_real *weights, const fieldmap_spot *spot, fm_real *room, const fm_real *corners[8])
{
    int corner;
    for (corner = 0; corner < 8; corner++)
        corners[corner] = fieldmap_coefficients(map, weights, spot, corner, room + corner * FIELDMAP_NODE);
}

static inline void fieldmap_bases(const fieldmap *map, const fieldmap_spot *spot, fieldmap_basis axes[3])
{
    int axis;
    for (axis = 0; axis < 3; axis++) fieldmap_hermite_basis(spot->t[axis], map->local[axis], axes + axis);
}

/* The spot in the coordinates of its polynomial: from the middle of the cell, in its unit of length. */
static inline void fieldmap_from_middle(const fieldmap *map, const fieldmap_spot *spot, fm_real local[3])
{
    int axis;
    for (axis = 0; axis < 3; axis++) local[axis] = (spot->t[axis] - FM(0.5)) * map->local[axis];
}

/* flux[3] and, unless NULL, gradient[9] from the nine of harmonics.h. */
static inline void fieldmap_store(fm_real per_length, const fm_real *nine, size_t step, fm_real *flux, fm_real *gradient)
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

/* What a point has where the field is not known. */
static inline void fieldmap_unknown(fm_real *out, int count)
{
    const fm_real zero = FM(0);
    int i;
    for (i = 0; i < count; i++) out[i] = zero / zero;
}

/* The coefficients of a spot, summed at weights, in `row`: those of its polynomial, or of the eight corners of its cell. */
static inline void fieldmap_gather(const fieldmap *map, const fm_real *weights, const fieldmap_spot *spot, fm_real *row)
{
    const fm_real *corners[8];
    if (map->kind == FIELDMAP_HERMITE) fieldmap_corners(map, weights, spot, row, corners);
    else fieldmap_coefficients(map, weights, spot, 0, row);
}

/* flux[3] and, unless NULL, gradient[9] at a spot in Hermite form. */
static inline void fieldmap_field_of_corners(
    const fieldmap *map, const fm_real *corners[8], const fieldmap_spot *spot, fm_real *flux, fm_real *gradient)
{
    fm_real four[4];
    fieldmap_basis axes[3];
    int i, j;
    fieldmap_bases(map, spot, axes);
    for (i = 0; i < 3; i++) {
        fieldmap_hermite_slopes(corners, axes, four);
        flux[i] = four[0];
        for (j = 0; j < 3 && gradient != NULL; j++) gradient[3 * i + j] = four[1 + j];
        for (j = 0; j < 8; j++) corners[j] += FIELDMAP_CORNER;
    }
}

/* flux[3] and, unless NULL, gradient[9] at a spot from the coefficients of its polynomial. */
static inline void fieldmap_field_of_polynomial(
    const fieldmap *map, const fm_real *c, const fieldmap_spot *spot, fm_real *flux, fm_real *gradient)
{
    fm_real local[3], nine[FIELDMAP_NINE];
    fieldmap_from_middle(map, spot, local);
    if (map->degree == 5)
        fieldmap_polynomial_5(c, 1, local[0], local[1], local[2], nine);
    else
        fieldmap_polynomial(c, map->degree, 1, local, local + 1, local + 2, nine);
    fieldmap_store(map->per_length, nine, 1, flux, gradient);
}

/* flux[3] and, unless NULL, gradient[9] at a spot from a row of fieldmap_gather. */
static inline void fieldmap_field_of_row(
    const fieldmap *map, const fm_real *row, const fieldmap_spot *spot, fm_real *flux, fm_real *gradient)
{
    if (map->kind == FIELDMAP_HERMITE) {
        const fm_real *corners[8];
        int j;
        for (j = 0; j < 8; j++) corners[j] = row + j * FIELDMAP_NODE;
        fieldmap_field_of_corners(map, corners, spot, flux, gradient);
    } else {
        fieldmap_field_of_polynomial(map, row, spot, flux, gradient);
    }
}

/* flux[3] and, unless NULL, gradient[9] at a spot. */
static inline void fieldmap_field_at(
    const fieldmap *map, const fm_real *weights, const fieldmap_spot *spot, fm_real *flux, fm_real *gradient)
{
    if (map->kind == FIELDMAP_HERMITE) {
        fm_real room[8 * FIELDMAP_NODE];
        const fm_real *corners[8];
        fieldmap_corners(map, weights, spot, room, corners);
        fieldmap_field_of_corners(map, corners, spot, flux, gradient);
    } else {
        fm_real room[FIELDMAP_MAX_SIZE];
        const fm_real *c = fieldmap_coefficients(map, weights, spot, 0, room);
        fieldmap_field_of_polynomial(map, c, spot, flux, gradient);
    }
}

/* flux[3] and, unless NULL, gradient[9] at point[3] for weights of the sets; weights may be NULL for a map of one. */
static inline int fieldmap_field_of_weights(
    const fieldmap *map, const fm_real *weights, const fm_real *point, fm_real *flux, fm_real *gradient)
{
    fieldmap_spot spot;
    const int status = fieldmap_locate(map, point, &spot);
    if (status == FIELDMAP_OK) {
        fieldmap_field_at(map, weights, &spot, flux, gradient);
    } else {
        fieldmap_unknown(flux, 3);
        if (gradient != NULL) fieldmap_unknown(gradient, 9);
    }
    return status;
}

/* As fieldmap_fields, of harmonic polynomials of degree 5 or of one polynomial for all points: FIELDMAP_LANES at a time. */
static inline size_t fieldmap_fields_in_lanes(
    const fieldmap *map, const fm_real *weights, size_t step, const fm_real *points, size_t count, fm_real *flux, fm_real *gradient)
{
    const int lanes = FIELDMAP_LANES, of_cells = map->kind == FIELDMAP_HARMONIC;
    fm_real c[36 * FIELDMAP_LANES], room[FIELDMAP_MAX_SIZE], nine[FIELDMAP_NINE * FIELDMAP_LANES];
    fm_real x[FIELDMAP_LANES], y[FIELDMAP_LANES], z[FIELDMAP_LANES];
    int status[FIELDMAP_LANES], lane, m;
    size_t first, outside = 0;
    const fm_real *of_box = map->coefficients;
    if (!of_cells && weights != NULL) {
        fieldmap_sum_sets(map, map->coefficients, weights, room);
        of_box = room;
    }
    for (first = 0; first < count; first += (size_t)lanes) {
        const int here = count - first < (size_t)lanes ? (int)(count - first) : lanes;
        for (lane = 0; lane < lanes; lane++) {
            const size_t p = first + (size_t)(lane < here ? lane : here - 1);
            fm_real local[3];
            fieldmap_spot spot;
            status[lane] = fieldmap_locate(map, points + 3 * p, &spot);
            fieldmap_from_middle(map, &spot, local);
            x[lane] = local[0], y[lane] = local[1], z[lane] = local[2];
            if (of_cells) {
                const fm_real *from = fieldmap_coefficients(map, weights == NULL ? NULL : weights + p * step, &spot, 0, room);
                for (m = 0; m < 36; m++) c[m * lanes + lane] = from[m];
            }
        }
        if (of_cells)
            for (lane = 0; lane < lanes; lane++)
                fieldmap_polynomial_5(c + lane, FIELDMAP_LANES, x[lane], y[lane], z[lane], nine + lane);
        else
            fieldmap_polynomial(of_box, map->degree, FIELDMAP_LANES, x, y, z, nine);
        for (lane = 0; lane < here; lane++) {
            fm_real *b = flux + 3 * (first + (size_t)lane);
            fm_real *g = gradient == NULL ? NULL : gradient + 9 * (first + (size_t)lane);
            fieldmap_store(map->per_length, nine + lane, FIELDMAP_LANES, b, g);
            if (status[lane] == FIELDMAP_OK) continue;
            outside += status[lane] == FIELDMAP_OUTSIDE;
            fieldmap_unknown(b, 3);
            if (g != NULL) fieldmap_unknown(g, 9);
        }
    }
    return outside;
}

/* flux (count, 3) and, unless NULL, gradient (count, 3, 3) at points (count, 3). Weights of point p begin at weights[p *
 * step]; with step 0 they are the same for all. How many points lie outside. */
static inline size_t fieldmap_fields(
    const fieldmap *map, const fm_real *weights, size_t step, const fm_real *points, size_t count, fm_real *flux, fm_real *gradient)
{
    size_t p, outside = 0;
    if ((map->kind == FIELDMAP_HARMONIC && map->degree == 5) || (map->kind == FIELDMAP_GLOBAL && step == 0))
        return fieldmap_fields_in_lanes(map, weights, step, points, count, flux, gradient);
    for (p = 0; p < count; p++) {
        const fm_real *w = weights == NULL ? NULL : weights + p * step;
        fm_real *g = gradient == NULL ? NULL : gradient + 9 * p;
        outside += fieldmap_field_of_weights(map, w, points + 3 * p, flux + 3 * p, g) == FIELDMAP_OUTSIDE;
    }
    return outside;
}

/* flux[3 * s] and, unless NULL, gradient[9 * s] of every set s by itself, at weight 1. */
static inline int fieldmap_each_field(const fieldmap *map, const fm_real *point, fm_real *flux, fm_real *gradient)
{
    const int sets = fieldmap_sets(map);
    fieldmap one = *map;
    fieldmap_spot spot;
    int s, status = fieldmap_locate(map, point, &spot);
    for (s = 0; s < sets; s++) {
        fm_real *g = gradient == NULL ? NULL : gradient + 9 * s;
        if (status != FIELDMAP_OK) {
            fieldmap_unknown(flux + 3 * s, 3);
            if (g != NULL) fieldmap_unknown(g, 9);
        } else {
            /* All sets of the map, seen from where this one begins. */
            one.coefficients = map->coefficients + (size_t)s * (size_t)map->size;
            fieldmap_field_at(&one, NULL, &spot, flux + 3 * s, g);
        }
    }
    return status;
}

/* second[27] at point[3] for weights of the sets. */
static inline int fieldmap_second_gradient_of_weights(
    const fieldmap *map, const fm_real *weights, const fm_real *point, fm_real *second)
{
    fieldmap_spot spot;
    const int status = fieldmap_locate(map, point, &spot);
    int i, j;
    if (status != FIELDMAP_OK) {
        fieldmap_unknown(second, 27);
    } else if (map->kind == FIELDMAP_HERMITE) {
        fm_real room[8 * FIELDMAP_NODE], six[6];
        const fm_real *corners[8];
        fieldmap_basis axes[3];
        fieldmap_corners(map, weights, &spot, room, corners);
        fieldmap_bases(map, &spot, axes);
        for (i = 0; i < 3; i++) {
            fm_real *of = second + 9 * i;
            fieldmap_hermite_bends(corners, axes, six);
            of[0] = six[0], of[4] = six[1], of[8] = six[2];
            of[1] = of[3] = six[3], of[2] = of[6] = six[4], of[5] = of[7] = six[5];
            for (j = 0; j < 8; j++) corners[j] += FIELDMAP_CORNER;
        }
    } else {
        fm_real room[FIELDMAP_MAX_SIZE], local[3];
        const fm_real scale = map->per_length * map->per_length;
        const fm_real *c = fieldmap_coefficients(map, weights, &spot, 0, room);
        fieldmap_from_middle(map, &spot, local);
        fieldmap_third_derivatives(c, map->degree, local, second);
        for (i = 0; i < 27; i++) second[i] *= scale;
    }
    return status;
}

/* U, T m, with B = -grad U, at point[3] for weights of the sets. In Hermite form: of a map of the potential. */
static inline int fieldmap_potential_of_weights(
    const fieldmap *map, const fm_real *weights, const fm_real *point, fm_real *potential)
{
    fieldmap_spot spot;
    const int status = fieldmap_locate(map, point, &spot);
    if (status != FIELDMAP_OK) {
        fieldmap_unknown(potential, 1);
    } else if (map->kind == FIELDMAP_HERMITE) {
        fm_real room[8 * FIELDMAP_NODE], four[4];
        const fm_real *corners[8];
        fieldmap_basis axes[3];
        fieldmap_corners(map, weights, &spot, room, corners);
        fieldmap_bases(map, &spot, axes);
        fieldmap_hermite_slopes(corners, axes, four);
        *potential = -four[0];
    } else {
        fm_real room[FIELDMAP_MAX_SIZE], local[3];
        const fm_real *c = fieldmap_coefficients(map, weights, &spot, 0, room);
        fieldmap_from_middle(map, &spot, local);
        *potential = -fieldmap_value(c, map->degree, local) / map->per_length;
    }
    return status;
}

/* What follows is for callers who do not know what they were given. */

/* FIELDMAP_OK if a map can be asked at these currents, which may be NULL for a map of fixed currents. */
static inline int fieldmap_check(const fieldmap *map, const fm_real *currents, const fm_real *point)
{
    int k;
    if (map == NULL || map->coefficients == NULL || point == NULL) return FIELDMAP_ARGUMENT;
    if (currents == NULL && fieldmap_sets(map) != 1) return FIELDMAP_ARGUMENT;
    for (k = 0; currents != NULL && k < map->n_coils; k++)
        if (!fieldmap_finite(currents[k])) return FIELDMAP_NOT_FINITE;
    return FIELDMAP_OK;
}

/* flux[3] and, unless NULL, gradient[9] at point[3] for currents[n_coils]. */
static inline int fieldmap_field(
    const fieldmap *map, const fm_real *currents, const fm_real *point, fm_real *flux, fm_real *gradient)
{
    const int status = fieldmap_check(map, currents, point);
    if (flux == NULL) return FIELDMAP_ARGUMENT;
    if (status == FIELDMAP_OK) return fieldmap_field_of_weights(map, currents, point, flux, gradient);
    fieldmap_unknown(flux, 3);
    if (gradient != NULL) fieldmap_unknown(gradient, 9);
    return status;
}

/* second[27] at point[3] for currents[n_coils]. */
static inline int fieldmap_second_gradient(
    const fieldmap *map, const fm_real *currents, const fm_real *point, fm_real *second)
{
    const int status = fieldmap_check(map, currents, point);
    if (second == NULL) return FIELDMAP_ARGUMENT;
    if (status == FIELDMAP_OK) return fieldmap_second_gradient_of_weights(map, currents, point, second);
    fieldmap_unknown(second, 27);
    return status;
}

/* wrench[6] on a dipole of moment[3] at point[3] for currents[n_coils]. */
static inline int fieldmap_wrench(
    const fieldmap *map, const fm_real *currents, const fm_real *point, const fm_real *moment, fm_real *wrench)
{
    fm_real flux[3], gradient[9];
    int status;
    if (moment == NULL || wrench == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_field(map, currents, point, flux, gradient);
    if (status == FIELDMAP_OK)
        fieldmap_dipole_wrench(flux, gradient, moment, wrench);
    else
        fieldmap_unknown(wrench, 6);
    return status;
}

#endif
