/* fieldmap32.h: flux density, gradient and dipole wrench from a map in single precision, for microcontrollers.
 *
 * C99 without any library: no memory is taken, nothing is printed, no function of a library is called, there is no
 * recursion and every loop has a bound. The map is a header that `fieldmap export MAP --to c32 -o NAME.h` writes, with
 * its coefficients as constants, for flash; docs/c.md has an example, sizes and numbers of operations. SI units, z up:
 * points in m, currents in A, B in T, gradient[3 * i + j] = dB_i/dx_j in T/m, moments in A m^2, wrench = force in N,
 * then torque in N m about the dipole.
 *
 * Every function returns FM32_OK or why not; results are zero then. A point outside the box gives FM32_OUTSIDE, unless
 * the map was exported to clamp. Written in the spirit of MISRA C: one exit a function, braces, fixed widths, explicit
 * conversions; no checker of MISRA was run.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP32_H
#define FIELDMAP32_H

#include <stddef.h>
#include <stdint.h>

/* Largest degree of a map that this file is compiled for: it bounds the stack. */
#ifndef FM32_MAX_DEGREE
#define FM32_MAX_DEGREE 20
#endif
#ifndef FM32_REAL
#define FM32_REAL float
#endif
#define FM32_MAX_SIZE ((FM32_MAX_DEGREE + 1) * (FM32_MAX_DEGREE + 1))
#define FM32_HARMONICS ((FM32_MAX_DEGREE - 1) * (FM32_MAX_DEGREE - 1))

typedef FM32_REAL fm32_real;

enum { FM32_OK = 0, FM32_OUTSIDE = 1, FM32_NOT_FINITE = 2, FM32_ARGUMENT = 3 };

/* This file knows maps with a field that no current drives. */
#define FM32_CONSTANT_FIELD 1

/* A map. coefficients: of all cells, of all coils, (degree + 1)^2 numbers each; constant: 1 if there is one more set
 * behind those of the coils, of a field that no current drives: it is in every result. */
typedef struct {
    int32_t coils;
    int32_t degree;
    int32_t clamps;
    int32_t cells[3];
    float lower[3];
    float inverse[3];
    float local[3];
    float per_length;
    const float *coefficients;
    int32_t constant;
} fm32_map;

/* Whether a number is one: infinity less itself is not. */
static inline int32_t fm32_is_finite(fm32_real x)
{
    const fm32_real difference = x - x;
    return (difference == (fm32_real)0.0f) ? 1 : 0;
}

/* Cell of a point, and its place there from the middle. */
static inline int32_t fm32_locate(const fm32_map *map, const fm32_real point[3], fm32_real local[3], int32_t *cell)
{
    int32_t status = FM32_OK;
    int32_t axis;
    *cell = 0;
    for (axis = 0; axis < 3; axis++) {
        const int32_t count = map->cells[axis];
        const fm32_real cells = (fm32_real)(float)count;
        fm32_real u = (point[axis] - (fm32_real)map->lower[axis]) * (fm32_real)map->inverse[axis];
        int32_t index = 0;
        if (fm32_is_finite(point[axis]) == 0) {
            status = FM32_NOT_FINITE;
            u = (fm32_real)0.0f;
        }
        if ((u < (fm32_real)-1.0e-5f) || (u > (cells + (fm32_real)1.0e-5f))) {
            if ((map->clamps == 0) && (status == FM32_OK)) {
                status = FM32_OUTSIDE;
            }
        }
        if (u < (fm32_real)0.0f) {
            u = (fm32_real)0.0f;
        }
        if (u > cells) {
            u = cells;
        }
        /* Found by counting up to the number of cells: no conversion that could overflow. */
        while ((index < (count - 1)) && (u >= (fm32_real)(float)(index + 1))) {
            index++;
        }
        local[axis] = (u - (fm32_real)(float)index - (fm32_real)0.5f) * (fm32_real)map->local[axis];
        *cell = (*cell * count) + index;
    }
    return status;
}

/* Regular solid harmonics of degree 0 to `degree` at a point (docs/theory/lookup.md (3)). */
static inline void fm32_harmonics(int32_t degree, const fm32_real p[3], fm32_real out[FM32_HARMONICS])
{
    const fm32_real r2 = (p[0] * p[0]) + (p[1] * p[1]) + (p[2] * p[2]);
    fm32_real sector = (fm32_real)1.0f;
    fm32_real sector_b = (fm32_real)0.0f;
    int32_t m;
    for (m = 0; m <= degree; m++) {
        fm32_real before = (fm32_real)0.0f;
        fm32_real before_b = (fm32_real)0.0f;
        fm32_real here = sector;
        fm32_real here_b = sector_b;
        fm32_real half;
        int32_t l;
        for (l = m; l <= degree; l++) {
            const fm32_real scale = (fm32_real)1.0f / (fm32_real)(float)(((l + 1) * (l + 1)) - (m * m));
            const fm32_real up = (fm32_real)(float)((2 * l) + 1) * p[2] * scale;
            const fm32_real down = r2 * scale;
            fm32_real next;
            if (m > 0) {
                out[(l * l) + (2 * m) - 1] = here;
                out[(l * l) + (2 * m)] = here_b;
            } else {
                out[l * l] = here;
            }
            next = (up * here) - (down * before);
            before = here;
            here = next;
            next = (up * here_b) - (down * before_b);
            before_b = here_b;
            here_b = next;
        }
        half = (fm32_real)0.5f / (fm32_real)(float)(m + 1);
        before = half * ((p[0] * sector) - (p[1] * sector_b));
        sector_b = half * ((p[0] * sector_b) + (p[1] * sector));
        sector = before;
    }
}

/* What one degree of the polynomial adds to zz, 2 xz, 2 yz, 2 (xx - yy), 4 xy: see fieldmap.h. */
static inline void fm32_degree(int32_t l, const fm32_real *row, const fm32_real *harmonics, fm32_real part[5])
{
    fm32_real a[FM32_MAX_DEGREE + 5];
    fm32_real b[FM32_MAX_DEGREE + 5];
    int32_t m;
    for (m = 0; m < 5; m++) {
        part[m] = (fm32_real)0.0f;
    }
    a[2] = row[0] + row[0];
    b[2] = (fm32_real)0.0f;
    for (m = 1; m <= (l + 2); m++) {
        a[m + 2] = row[(2 * m) - 1];
        b[m + 2] = row[2 * m];
    }
    a[1] = -a[3];
    b[1] = b[3];
    a[0] = a[4];
    b[0] = -b[4];
    for (m = 0; m <= l; m++) {
        fm32_real p = harmonics[l * l] * (fm32_real)0.5f;
        fm32_real q = (fm32_real)0.0f;
        if (m > 0) {
            p = harmonics[(l * l) + (2 * m) - 1];
            q = harmonics[(l * l) + (2 * m)];
        }
        part[0] += (a[m + 2] * p) + (b[m + 2] * q);
        part[1] += ((a[m + 3] - a[m + 1]) * p) + ((b[m + 3] - b[m + 1]) * q);
        part[2] += ((b[m + 3] + b[m + 1]) * p) - ((a[m + 3] + a[m + 1]) * q);
        part[3] += ((a[m + 4] + a[m]) * p) + ((b[m + 4] + b[m]) * q);
        part[4] += ((b[m + 4] - b[m]) * p) - ((a[m + 4] - a[m]) * q);
    }
}

/* Field and gradient of the polynomial c (docs/theory/lookup.md (6)). */
static inline void fm32_polynomial(
    const fm32_real *c, int32_t degree, const fm32_real p[3], fm32_real flux[3], fm32_real gradient[9])
{
    fm32_real harmonics[FM32_HARMONICS];
    fm32_real sum[5];
    fm32_real euler[5];
    fm32_real part[5];
    fm32_real xx;
    fm32_real yy;
    int32_t l;
    int32_t i;
    for (i = 0; i < 5; i++) {
        sum[i] = (fm32_real)0.0f;
        euler[i] = (fm32_real)0.0f;
    }
    fm32_harmonics(degree - 2, p, harmonics);
    for (l = 0; l <= (degree - 2); l++) {
        const fm32_real share = (fm32_real)1.0f / (fm32_real)(float)(l + 1);
        fm32_degree(l, &c[(l + 2) * (l + 2)], harmonics, part);
        for (i = 0; i < 5; i++) {
            sum[i] += part[i];
            euler[i] += part[i] * share;
        }
    }
    /* From the five sums to xx, yy, zz, xy, xz, yz, first over degree + 1 for the field. */
    xx = ((fm32_real)0.25f * euler[3]) - ((fm32_real)0.5f * euler[0]);
    yy = -euler[0] - xx;
    flux[0] = ((fm32_real)0.5f * c[2]) + (xx * p[0]) + ((fm32_real)0.25f * euler[4] * p[1])
        + ((fm32_real)0.5f * euler[1] * p[2]);
    flux[1] = ((fm32_real)0.5f * c[3]) + ((fm32_real)0.25f * euler[4] * p[0]) + (yy * p[1])
        + ((fm32_real)0.5f * euler[2] * p[2]);
    flux[2] = c[1] + ((fm32_real)0.5f * euler[1] * p[0]) + ((fm32_real)0.5f * euler[2] * p[1]) + (euler[0] * p[2]);
    xx = ((fm32_real)0.25f * sum[3]) - ((fm32_real)0.5f * sum[0]);
    gradient[0] = xx;
    gradient[1] = (fm32_real)0.25f * sum[4];
    gradient[2] = (fm32_real)0.5f * sum[1];
    gradient[3] = gradient[1];
    gradient[4] = -sum[0] - xx;
    gradient[5] = (fm32_real)0.5f * sum[2];
    gradient[6] = gradient[2];
    gradient[7] = gradient[5];
    gradient[8] = sum[0];
}

/* flux[3] and gradient[9] at point[3] for currents[coils]; currents may be NULL for a map of fixed currents. */
static inline int32_t fm32_field(
    const fm32_map *map, const fm32_real *currents, const fm32_real point[3], fm32_real flux[3], fm32_real gradient[9])
{
    fm32_real c[FM32_MAX_SIZE];
    fm32_real local[3];
    int32_t status = FM32_ARGUMENT;
    const int32_t sets = map->coils + map->constant;
    int32_t cell = 0;
    int32_t k;
    int32_t i;
    for (i = 0; i < 3; i++) {
        flux[i] = (fm32_real)0.0f;
    }
    for (i = 0; i < 9; i++) {
        gradient[i] = (fm32_real)0.0f;
    }
    if ((map->degree >= 3) && (map->degree <= FM32_MAX_DEGREE) && ((currents != NULL) || (sets == 1))) {
        status = fm32_locate(map, point, local, &cell);
    }
    for (k = 0; (k < map->coils) && (currents != NULL); k++) {
        if ((fm32_is_finite(currents[k]) == 0) && (status == FM32_OK)) {
            status = FM32_NOT_FINITE;
        }
    }
    if (status == FM32_OK) {
        const int32_t size = (map->degree + 1) * (map->degree + 1);
        const float *set = &map->coefficients[(size_t)cell * (size_t)sets * (size_t)size];
        for (i = 0; i < size; i++) {
            c[i] = (fm32_real)0.0f;
        }
        for (k = 0; k < sets; k++) {
            fm32_real ampere = (fm32_real)1.0f;
            if ((currents != NULL) && (k < map->coils)) {
                ampere = currents[k];
            }
            for (i = 0; i < size; i++) {
                c[i] += ampere * (fm32_real)set[i];
            }
            set = &set[size];
        }
        fm32_polynomial(c, map->degree, local, flux, gradient);
        for (i = 0; i < 9; i++) {
            gradient[i] = gradient[i] * (fm32_real)map->per_length;
        }
    }
    return status;
}

/* wrench[6] on a dipole of moment[3] at point[3]: F_j = m_i dB_i/dx_j, then T = m x B. */
static inline int32_t fm32_wrench(const fm32_map *map, const fm32_real *currents, const fm32_real point[3],
    const fm32_real moment[3], fm32_real wrench[6])
{
    fm32_real flux[3];
    fm32_real g[9];
    const int32_t status = fm32_field(map, currents, point, flux, g);
    int32_t j;
    for (j = 0; j < 3; j++) {
        wrench[j] = (moment[0] * g[j]) + (moment[1] * g[3 + j]) + (moment[2] * g[6 + j]);
    }
    wrench[3] = (moment[1] * flux[2]) - (moment[2] * flux[1]);
    wrench[4] = (moment[2] * flux[0]) - (moment[0] * flux[2]);
    wrench[5] = (moment[0] * flux[1]) - (moment[1] * flux[0]);
    return status;
}

#endif
