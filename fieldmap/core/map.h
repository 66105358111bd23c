/* map.h: flux density, its derivatives and the scalar potential from the coefficients of a map.
 *
 * SI units, z up: points in m, currents in A, B in T, gradient[3 * i + j] = dB_i/dx_j in T/m, second[9 * i + 3 * j + k] =
 * d2B_i/dx_j dx_k in T/m^2. harmonic_map.h describes maps.
 *
 * Nothing is allocated, and a map is never written to: any number of threads may use it.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_MAP_H
#define FIELDMAP_MAP_H

#include "harmonic_map.h"
#include "hermite.h"

/* Numbers of a node in Hermite form: three components of eight. A map of the potential has one component. */
enum { FIELDMAP_NODE = 24, FIELDMAP_CORNER = 8 };

/* Fill pointers to the corners of a cell in Hermite form, in the map or in `room`, 8 * FIELDMAP_NODE numbers. */
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

/* Fill results with NaN where the field is unknown. */
static inline void fieldmap_unknown(fm_real *out, int count)
{
    const fm_real zero = FM(0);
    int i;
    for (i = 0; i < count; i++) out[i] = zero / zero;
}

/* Fill `row` with the coefficients at a spot, summed at weights: of its polynomial, or of the eight corners of its cell. */
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

/* flux[3] and, unless NULL, gradient[9] at a spot from a row of fieldmap_gather. */
FIELDMAP_INLINE void fieldmap_field_of_row(
    const fieldmap *map, const fm_real *row, const fieldmap_spot *spot, fm_real *flux, fm_real *gradient)
{
    if (map->kind == FIELDMAP_HERMITE) {
        const fm_real *corners[8];
        int j;
        for (j = 0; j < 8; j++) corners[j] = row + j * FIELDMAP_NODE;
        fieldmap_field_of_corners(map, corners, spot, flux, gradient);
    } else {
        fm_real local[3];
        fieldmap_from_middle(map, spot, local);
        fieldmap_field_of_polynomial(row, map->degree, map->per_length, local, flux, gradient);
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
        fm_real room[FIELDMAP_MAX_SIZE], local[3];
        const fm_real *c = fieldmap_coefficients(map, weights, spot, 0, room);
        fieldmap_from_middle(map, spot, local);
        fieldmap_field_of_polynomial(c, map->degree, map->per_length, local, flux, gradient);
    }
}

/* flux[3] and, unless NULL, gradient[9] at point[3] for weights of the sets; weights may be NULL for a map of one set. */
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

/* As fieldmap_fields, for polynomials of degree 5 or one polynomial for all points, FIELDMAP_LANES points at a time. */
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

/* flux (count, 3) and, unless NULL, gradient (count, 3, 3) at points (count, 3). Weights of point p begin at weights[p * step];
 * with step 0 they are the same for all points. Returns the number of points outside. */
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
            /* The same map, with coefficients that begin at this set. */
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

/* U, T m, with B = -grad U, at point[3] for weights of the sets. A Hermite form must be a map of the potential. */
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

/* The functions below check their arguments. */

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

#endif
