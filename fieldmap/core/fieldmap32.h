/* fieldmap32.h: flux density, gradient and dipole wrench from a map in single precision, for microcontrollers.
 *
 * C99 without any library: no memory is allocated, nothing is printed, there is no recursion and every loop has a bound. The
 * map is a header that `fieldmap export MAP --to c32 -o NAME.h` writes, with its coefficients as constants, for flash;
 * docs/c.md has an example, sizes and numbers of operations. SI units, z up: points in m, currents in A, B in T, gradient[3 * i
 * + j] = dB_i/dx_j in T/m, moments in A m^2, wrench = force in N, then torque in N m about the dipole.
 *
 * Every function returns FM32_OK, or an error status with results of zero. A point outside the box gives FM32_OUTSIDE, unless
 * the map was exported to clamp. The formulas are the same as in fieldmap.h, in single precision: a source file includes one of
 * the two.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP32_H
#define FIELDMAP32_H

#ifdef FIELDMAP_REAL_H
#error "a source file includes fieldmap.h or fieldmap32.h, not both"
#endif

/* Largest degree of a map; it bounds the stack. */
#ifndef FM32_MAX_DEGREE
#define FM32_MAX_DEGREE 20
#endif
#ifndef FM32_REAL
#define FM32_REAL float
#endif
#define FIELDMAP_MAX_DEGREE FM32_MAX_DEGREE
#define FIELDMAP_REAL FM32_REAL
#define FIELDMAP_LANES 1

#include "harmonic_map.h"
#include "wrench.h"

typedef fm_real fm32_real;

enum { FM32_OK = FIELDMAP_OK, FM32_OUTSIDE = FIELDMAP_OUTSIDE, FM32_NOT_FINITE = FIELDMAP_NOT_FINITE, FM32_ARGUMENT = 3 };

/* This file supports maps with a field that no current drives. */
#define FM32_CONSTANT_FIELD 1

/* A map. coefficients: of all cells, of all coils, (degree + 1)^2 numbers each; constant: 1 if a set of a field that no current
 * drives follows the sets of the coils; every result contains it; linkage: of the coils. */
typedef struct fm32_map {
    int32_t coils;
    int32_t degree;
    int32_t clamps;
    int32_t cells[3];
    fm32_real lower[3];
    fm32_real inverse[3];
    fm32_real local[3];
    fm32_real per_length;
    const fm32_real *coefficients;
    int32_t constant;
    fieldmap_linkage linkage;
} fm32_map;

/* The map in the form of harmonic_map.h, without the upper corner and the names of the coils, which no function here reads. */
static inline void fm32_as_fieldmap(const fm32_map *map, fieldmap *out)
{
    int axis;
    out->n_coils = (int)map->coils;
    out->constant = (int)map->constant;
    out->degree = (int)map->degree;
    out->kind = FIELDMAP_HARMONIC;
    out->clamps = (int)map->clamps;
    out->size = (out->degree + 1) * (out->degree + 1);
    for (axis = 0; axis < 3; axis++) {
        out->cells[axis] = (int)map->cells[axis];
        out->lower[axis] = map->lower[axis];
        out->inverse[axis] = map->inverse[axis];
        out->local[axis] = map->local[axis];
    }
    out->per_length = map->per_length;
    out->coefficients = map->coefficients;
}

/* The polynomial at a point, in `room` or in the map, and the point in its coordinates. This is a separate function so that its
 * variables have left the stack when the polynomial is evaluated. */
static inline int fm32_polynomial_at(
    const fm32_map *map, const fm32_real *currents, const fm32_real *point, fm32_real *room, const fm32_real **polynomial,
    fm32_real *local)
{
    fieldmap core;
    fieldmap_spot spot;
    int asked, status;
    if (map->degree < 3 || map->degree > FIELDMAP_MAX_DEGREE || map->coils < 1) return FM32_ARGUMENT;
    fm32_as_fieldmap(map, &core);
    asked = fieldmap_check(&core, currents, point);
    if (asked == FIELDMAP_ARGUMENT) return FM32_ARGUMENT;
    status = fieldmap_locate(&core, point, &spot);
    if (status == FIELDMAP_OK) status = asked;
    if (status != FIELDMAP_OK) return status;
    *polynomial = fieldmap_coefficients(&core, currents, &spot, 0, room);
    fieldmap_from_middle(&core, &spot, local);
    return FM32_OK;
}

static inline void fm32_zeros(fm32_real *out, int count)
{
    int i;
    for (i = 0; i < count; i++) out[i] = FM(0);
}

/* flux[3] and, unless NULL, gradient[9] at point[3] for currents[coils]; currents may be NULL for a map of fixed
 * currents. */
static inline int32_t fm32_field(
    const fm32_map *map, const fm32_real *currents, const fm32_real *point, fm32_real *flux, fm32_real *gradient)
{
    fm32_real room[FIELDMAP_MAX_SIZE], local[3];
    const fm32_real *polynomial = NULL;
    const int status = fm32_polynomial_at(map, currents, point, room, &polynomial, local);
    if (status == FM32_OK) {
        fieldmap_field_of_polynomial(polynomial, (int)map->degree, map->per_length, local, flux, gradient);
    } else {
        fm32_zeros(flux, 3);
        if (gradient != NULL) fm32_zeros(gradient, 9);
    }
    return status;
}

/* wrench[6] on a dipole of moment[3] at point[3] for currents[coils]. */
static inline int32_t fm32_wrench(
    const fm32_map *map, const fm32_real *currents, const fm32_real *point, const fm32_real *moment, fm32_real *wrench)
{
    fm32_real flux[3], gradient[9];
    const int32_t status = fm32_field(map, currents, point, flux, gradient);
    if (status == FM32_OK)
        fieldmap_dipole_wrench(flux, gradient, moment, wrench);
    else
        fm32_zeros(wrench, 6);
    return status;
}

/* linkages[coils], Wb, of coils and linear iron at currents[coils], and of a dipole of moment[3] at point[3]. Returns
 * FM32_ARGUMENT for a map without linkages. */
static inline int32_t fm32_flux_linkage(
    const fm32_map *map, const fm32_real *currents, const fm32_real *point, const fm32_real *moment, fm32_real *linkages)
{
    fieldmap core;
    fieldmap_spot spot;
    const fm32_real *set = NULL;
    fm32_real room[FIELDMAP_MAX_SIZE], local[3], flux[3];
    int k, i, status = map->linkage.coils == map->coils && currents != NULL ? FM32_OK : FM32_ARGUMENT;
    if (status == FM32_OK) status = fm32_polynomial_at(map, currents, point, room, &set, local);
    fm32_zeros(linkages, (int)map->coils);
    if (status != FM32_OK) return status;
    fm32_as_fieldmap(map, &core);
    fieldmap_locate(&core, point, &spot);
    set = fieldmap_sets_at(&core, &spot, 0);
    for (k = 0; k < core.n_coils; k++, set += core.size) {
        fieldmap_field_of_polynomial(set, core.degree, core.per_length, local, flux, NULL);
        for (i = 0; i < 3; i++) linkages[k] += moment[i] * flux[i];
    }
    fieldmap_add_linkages(&map->linkage, currents, linkages);
    return status;
}

#endif
