/* fieldmap.h: flux density, gradient, second gradient and dipole wrench from a map, in C99, with no dependencies.
 *
 * The map is a file that `fieldmap export MAP --to c -o field.fmap` writes; docs/c.md has an example. SI units, z up:
 * points in m, currents in A, B in T, gradient[3 * i + j] = dB_i/dx_j in T/m, second[9 * i + 3 * j + k] =
 * d2B_i/dx_j dx_k in T/m^2, moments in A m^2, wrench = force in N, then torque in N m about the dipole.
 *
 * Every function returns FIELDMAP_OK or the reason why not. Outside the box results are NaN and the status is
 * FIELDMAP_OUTSIDE, unless the map was exported to clamp; NaN and infinity in a point give NaN and
 * FIELDMAP_NOT_FINITE. Nothing is read beyond what was checked when the map was opened: a damaged file is refused.
 * An opened map is never written to, so any number of threads may use it.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_H
#define FIELDMAP_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    FIELDMAP_OK, FIELDMAP_OUTSIDE, FIELDMAP_NOT_FINITE, FIELDMAP_NO_FILE, FIELDMAP_TRUNCATED, FIELDMAP_NOT_A_MAP,
    FIELDMAP_VERSION, FIELDMAP_BYTE_ORDER, FIELDMAP_DAMAGED, FIELDMAP_NO_MEMORY, FIELDMAP_ALIGNMENT, FIELDMAP_ARGUMENT
};

enum { FIELDMAP_MAX_DEGREE = 20, FIELDMAP_MAX_SIZE = 441 };

/* A map: treat as read-only. names: n_coils texts, each ended by a zero byte, one behind the other. constant: 1 if there
 * is a field that no current drives, as of magnets, behind those of the coils: it is in every result. */
typedef struct fieldmap {
    int n_coils;
    int degree;
    double lower[3], upper[3];
    const char *names;
    const double *block;
    void *owned;
    int constant;
} fieldmap;

/* What a status means. */
static inline const char *fieldmap_message(int status)
{
    static const char *const texts[] = {
        "done", "point outside the map's box", "point or current is NaN or infinite",
        "file cannot be opened or read", "file is shorter than it says", "not a map for C (fieldmap export --to c)",
        "written by a newer version", "written for the other byte order", "damaged: sizes or checksum do not fit",
        "no memory", "address is not a multiple of 8", "argument missing"};
    return status >= 0 && status <= FIELDMAP_ARGUMENT ? texts[status] : "unknown status";
}

/* CRC-32 of zlib and PNG, four bits at a time. */
static inline uint32_t fieldmap_checksum(const unsigned char *bytes, size_t size)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};
    uint32_t crc = 0xffffffffu;
    size_t i;
    for (i = 0; i < size; i++) {
        crc = table[(crc ^ bytes[i]) & 15u] ^ (crc >> 4);
        crc = table[(crc ^ ((uint32_t)bytes[i] >> 4)) & 15u] ^ (crc >> 4);
    }
    return crc ^ 0xffffffffu;
}

/* Where things lie in the block of numbers (fieldmap.kernels.map.map_block). */
enum {
    FIELDMAP_KIND = 0, FIELDMAP_RULE = 1, FIELDMAP_SETS = 2, FIELDMAP_DEGREE = 3, FIELDMAP_LOWER = 4,
    FIELDMAP_INVERSE = 7, FIELDMAP_CELLS = 10, FIELDMAP_LOCAL = 13, FIELDMAP_LENGTH = 16,
    FIELDMAP_PER_LENGTH = 17, FIELDMAP_CONSTANT = 18, FIELDMAP_HEADER = 24, FIELDMAP_NAMES = 40
};

/* A whole number from low to high, or -1. NaN fails every comparison. */
static inline long fieldmap_whole(double value, long low, long high)
{
    long whole;
    if (!(value >= (double)low && value <= (double)high)) return -1;
    whole = (long)value;
    return (double)whole == value ? whole : -1;
}

/* Whether the header of a block of `count` numbers is sound and promises exactly that many. */
static inline int fieldmap_check_block(fieldmap *map, const double *block, uint64_t count)
{
    long kind, degree, sets;
    uint64_t left, size;
    int axis;
    if (count < FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    kind = fieldmap_whole(block[FIELDMAP_KIND], 1, 2);
    degree = fieldmap_whole(block[FIELDMAP_DEGREE], 3, FIELDMAP_MAX_DEGREE);
    sets = fieldmap_whole(block[FIELDMAP_SETS], 1, 1000000);
    if (kind < 0 || degree < 0 || sets < 0 || fieldmap_whole(block[FIELDMAP_RULE], 0, 1) < 0)
        return FIELDMAP_DAMAGED;
    size = (uint64_t)((degree + 1) * (degree + 1)) * (uint64_t)sets;
    left = (count - FIELDMAP_HEADER) / size;
    if (left * size != count - FIELDMAP_HEADER) return FIELDMAP_DAMAGED;
    for (axis = 0; axis < 3; axis++) {
        long cells = fieldmap_whole(block[FIELDMAP_CELLS + axis], 1, 1000000);
        double inverse = block[FIELDMAP_INVERSE + axis];
        if (cells < 0 || left % (uint64_t)cells != 0) return FIELDMAP_DAMAGED;
        left /= (uint64_t)cells;
        if (!(inverse > 0.0) || !isfinite(inverse) || !isfinite(block[FIELDMAP_LOWER + axis])) return FIELDMAP_DAMAGED;
        map->lower[axis] = block[FIELDMAP_LOWER + axis];
        map->upper[axis] = block[FIELDMAP_LOWER + axis] + (double)cells / inverse;
    }
    map->n_coils = (int)sets;
    map->degree = (int)degree;
    map->block = block;
    return left == 1 ? FIELDMAP_OK : FIELDMAP_DAMAGED;
}

/* A map in memory (in flash, say), used where it lies: `bytes`, at an address that is a multiple of 8, must outlive
 * the map. No memory is taken. */
static inline int fieldmap_view(fieldmap *map, const void *bytes, size_t size)
{
    const unsigned char *raw = (const unsigned char *)bytes;
    uint32_t order, version, crc, name_bytes;
    uint64_t total, count;
    size_t i, ended = 0;
    int status;
    if (map == NULL || bytes == NULL) return FIELDMAP_ARGUMENT;
    memset(map, 0, sizeof *map);
    if ((uintptr_t)bytes % 8 != 0) return FIELDMAP_ALIGNMENT;
    if (size < 8 || memcmp(raw, "fieldmap", 8) != 0) return FIELDMAP_NOT_A_MAP;
    if (size < FIELDMAP_NAMES) return FIELDMAP_TRUNCATED;
    memcpy(&order, raw + 8, 4);
    memcpy(&version, raw + 12, 4);
    memcpy(&total, raw + 16, 8);
    memcpy(&crc, raw + 24, 4);
    memcpy(&name_bytes, raw + 28, 4);
    memcpy(&count, raw + 32, 8);
    if (order != 0x01020304u) return FIELDMAP_BYTE_ORDER;
    if (version != 1u && version != 2u) return FIELDMAP_VERSION;
    if (total > size) return FIELDMAP_TRUNCATED;
    if (total < size || name_bytes % 8u != 0 || name_bytes > size - FIELDMAP_NAMES) return FIELDMAP_DAMAGED;
    if (count > (size - FIELDMAP_NAMES - name_bytes) / 8 || count * 8 != size - FIELDMAP_NAMES - name_bytes)
        return FIELDMAP_DAMAGED;
    if (crc != fieldmap_checksum(raw + 28, size - 28)) return FIELDMAP_DAMAGED;
    status = fieldmap_check_block(map, (const double *)(const void *)(raw + FIELDMAP_NAMES + name_bytes), count);
    /* What the version says stands under the checksum as well. */
    if (status == FIELDMAP_OK && map->block[FIELDMAP_CONSTANT] != (version == 2u ? 1.0 : 0.0)) status = FIELDMAP_DAMAGED;
    if (status == FIELDMAP_OK && version == 2u) {
        map->constant = 1;
        map->n_coils -= 1;
        if (map->n_coils < 1) status = FIELDMAP_DAMAGED;
    }
    for (i = 0; i < name_bytes; i++) ended += raw[FIELDMAP_NAMES + i] == 0;
    if (status == FIELDMAP_OK && ended < (size_t)map->n_coils) status = FIELDMAP_DAMAGED;
    map->names = (const char *)(raw + FIELDMAP_NAMES);
    if (status != FIELDMAP_OK) memset(map, 0, sizeof *map);
    return status;
}

/* Give back what fieldmap_open or fieldmap_at took. Safe on a map that was never opened but zeroed. */
static inline void fieldmap_close(fieldmap *map)
{
    if (map != NULL) {
        free(map->owned);
        memset(map, 0, sizeof *map);
    }
}

/* Read a file whole. */
static inline int fieldmap_open(fieldmap *map, const char *path)
{
    FILE *file;
    long size;
    void *bytes;
    int status;
    if (map == NULL || path == NULL) return FIELDMAP_ARGUMENT;
    memset(map, 0, sizeof *map);
    file = fopen(path, "rb");
    if (file == NULL) return FIELDMAP_NO_FILE;
    if (fseek(file, 0, SEEK_END) != 0 || (size = ftell(file)) < 0 || fseek(file, 0, SEEK_SET) != 0) {
        fclose(file);
        return FIELDMAP_NO_FILE;
    }
    bytes = malloc(size > 0 ? (size_t)size : 1);
    status = bytes == NULL ? FIELDMAP_NO_MEMORY : FIELDMAP_OK;
    if (bytes != NULL && fread(bytes, 1, (size_t)size, file) != (size_t)size) status = FIELDMAP_NO_FILE;
    fclose(file);
    if (status == FIELDMAP_OK) status = fieldmap_view(map, bytes, (size_t)size);
    if (status == FIELDMAP_OK)
        map->owned = bytes;
    else
        free(bytes);
    return status;
}

/* Name of coil k, or NULL. */
static inline const char *fieldmap_coil_name(const fieldmap *map, int k)
{
    const char *name;
    if (map == NULL || map->names == NULL || k < 0 || k >= map->n_coils) return NULL;
    for (name = map->names; k > 0; k--) name += strlen(name) + 1;
    return name;
}

/* Number of the cell of a point and the point from the cell's middle, in units of LENGTH. */
static inline int fieldmap_locate(const fieldmap *map, const double *point, double *local, size_t *cell)
{
    const double *block = map->block;
    int axis, inside = 1;
    *cell = 0;
    if (!(isfinite(point[0]) && isfinite(point[1]) && isfinite(point[2]))) return FIELDMAP_NOT_FINITE;
    for (axis = 0; axis < 3; axis++) {
        double cells = block[FIELDMAP_CELLS + axis];
        double u = (point[axis] - block[FIELDMAP_LOWER + axis]) * block[FIELDMAP_INVERSE + axis];
        double index;
        if (!(u >= -1e-9 && u <= cells + 1e-9)) {
            inside = 0;
            u = u > 0.0 ? cells : 0.0;
        }
        index = (double)(long)(u < 0.0 ? 0.0 : u);
        if (index > cells - 1.0) index = cells - 1.0;
        local[axis] = (u - index - 0.5) * block[FIELDMAP_LOCAL + axis];
        *cell = *cell * (size_t)cells + (size_t)index;
    }
    return inside || block[FIELDMAP_RULE] == 1.0 ? FIELDMAP_OK : FIELDMAP_OUTSIDE;
}

/* Regular solid harmonics of degree 0 to `degree` at a point (docs/theory/lookup.md (3)). */
static inline void fieldmap_harmonics(int degree, const double *point, double *out)
{
    double x = point[0], y = point[1], z = point[2], r2 = x * x + y * y + z * z;
    double sector = 1.0, sector_imaginary = 0.0;
    int l, m;
    for (m = 0; m <= degree; m++) {
        double before = 0.0, before_imaginary = 0.0, here = sector, here_imaginary = sector_imaginary, half;
        for (l = m; l <= degree; l++) {
            int at = m > 0 ? l * l + 2 * m - 1 : l * l;
            double scale = 1.0 / ((l + 1) * (l + 1) - m * m);
            double up = (2 * l + 1) * z * scale, down = r2 * scale, next;
            out[at] = here;
            if (m > 0) out[at + 1] = here_imaginary;
            next = up * here - down * before;
            before = here;
            here = next;
            next = up * here_imaginary - down * before_imaginary;
            before_imaginary = here_imaginary;
            here_imaginary = next;
        }
        half = 0.5 / (m + 1);
        before = half * (x * sector - y * sector_imaginary);
        sector_imaginary = half * (x * sector_imaginary + y * sector);
        sector = before;
    }
}

/* Field and gradient of the polynomial c from the five independent second derivatives (docs/theory/lookup.md (6)).
 *
 * a[m + 2] and b[m + 2]: coefficients of one degree for m = -2 to degree + 2, with R^(-m) = (-1)^m conj R^m; a[2] is
 * doubled, and what belongs to m = 0 is halved. */
static inline void fieldmap_polynomial(const double *c, int degree, const double *point, double *flux, double *gradient)
{
    double harmonics[FIELDMAP_MAX_SIZE], sum[5] = {0, 0, 0, 0, 0}, euler[5] = {0, 0, 0, 0, 0};
    double x = point[0], y = point[1], z = point[2];
    double xx, yy, zz, xy, xz, yz;
    int l, m, i;
    fieldmap_harmonics(degree - 2, point, harmonics);
    for (l = 0; l <= degree - 2; l++) {
        double a[FIELDMAP_MAX_DEGREE + 5], b[FIELDMAP_MAX_DEGREE + 5], part[5] = {0, 0, 0, 0, 0};
        const double *row = c + (l + 2) * (l + 2);
        a[2] = 2.0 * row[0];
        b[2] = 0.0;
        for (m = 1; m <= l + 2; m++) {
            a[m + 2] = row[2 * m - 1];
            b[m + 2] = row[2 * m];
        }
        a[1] = -a[3], b[1] = b[3], a[0] = a[4], b[0] = -b[4];
        for (m = 0; m <= l; m++) {
            double p = harmonics[m > 0 ? l * l + 2 * m - 1 : l * l] * (m > 0 ? 1.0 : 0.5);
            double q = m > 0 ? harmonics[l * l + 2 * m] : 0.0;
            part[0] += a[m + 2] * p + b[m + 2] * q;
            part[1] += (a[m + 3] - a[m + 1]) * p + (b[m + 3] - b[m + 1]) * q;
            part[2] += (b[m + 3] + b[m + 1]) * p - (a[m + 3] + a[m + 1]) * q;
            part[3] += (a[m + 4] + a[m]) * p + (b[m + 4] + b[m]) * q;
            part[4] += (b[m + 4] - b[m]) * p - (a[m + 4] - a[m]) * q;
        }
        for (i = 0; i < 5; i++) {
            sum[i] += part[i];
            euler[i] += part[i] / (l + 1);
        }
    }
    zz = euler[0], xz = 0.5 * euler[1], yz = 0.5 * euler[2], xy = 0.25 * euler[4];
    xx = 0.25 * euler[3] - 0.5 * zz;
    yy = -zz - xx;
    flux[0] = 0.5 * c[2] + xx * x + xy * y + xz * z;
    flux[1] = 0.5 * c[3] + xy * x + yy * y + yz * z;
    flux[2] = c[1] + xz * x + yz * y + zz * z;
    zz = sum[0], xz = 0.5 * sum[1], yz = 0.5 * sum[2], xy = 0.25 * sum[4];
    xx = 0.25 * sum[3] - 0.5 * zz;
    gradient[0] = xx, gradient[1] = xy, gradient[2] = xz;
    gradient[3] = xy, gradient[4] = -zz - xx, gradient[5] = yz;
    gradient[6] = xz, gradient[7] = yz, gradient[8] = zz;
}

/* out (degree^2 numbers): coefficients of the derivative along an axis of the polynomial c. */
static inline void fieldmap_differentiate(const double *c, int degree, int axis, double *out)
{
    int l, m;
    for (l = 0; l < degree; l++) {
        const double *row = c + (l + 1) * (l + 1);
        for (m = 0; m <= l; m++) {
            int at = m > 0 ? l * l + 2 * m - 1 : l * l;
            double fold = m == 1 ? 1.0 : 0.5;
            double a = row[m > 0 ? 2 * m - 1 : 0], b = m > 0 ? row[2 * m] : 0.0;
            if (axis != 2) {
                double below = m > 0 ? fold * row[m > 1 ? 2 * m - 3 : 0] : 0.0;
                double below_b = m > 1 ? fold * row[2 * m - 2] : 0.0;
                a = axis == 0 ? 0.5 * row[2 * m + 1] - below : 0.5 * row[2 * m + 2] + below_b;
                b = axis == 0 ? 0.5 * row[2 * m + 2] - below_b : -0.5 * row[2 * m + 1] - below;
            }
            out[at] = a;
            if (m > 0) out[at + 1] = b;
        }
    }
}

/* Coefficients at currents of the polynomial that holds at a point, and the point in its coordinates. currents may be
 * NULL for a map of fixed currents. */
static inline int fieldmap_superpose(
    const fieldmap *map, const double *currents, const double *point, double *c, double *local)
{
    size_t cell, size, m;
    const double *set;
    int status, k;
    if (map == NULL || map->block == NULL || point == NULL) return FIELDMAP_ARGUMENT;
    if (currents == NULL && map->n_coils + map->constant != 1) return FIELDMAP_ARGUMENT;
    status = fieldmap_locate(map, point, local, &cell);
    if (status != FIELDMAP_OK) return status;
    size = (size_t)((map->degree + 1) * (map->degree + 1));
    set = map->block + FIELDMAP_HEADER + cell * (size_t)(map->n_coils + map->constant) * size;
    for (m = 0; m < size; m++) c[m] = 0.0;
    for (k = 0; k < map->n_coils + map->constant; k++, set += size) {
        double ampere = currents == NULL || k == map->n_coils ? 1.0 : currents[k];
        if (!isfinite(ampere)) return FIELDMAP_NOT_FINITE;
        for (m = 0; m < size; m++) c[m] += ampere * set[m];
    }
    return FIELDMAP_OK;
}

/* flux[3] and, unless NULL, gradient[9] at point[3] for currents[n_coils]. */
static inline int fieldmap_field(
    const fieldmap *map, const double *currents, const double *point, double *flux, double *gradient)
{
    double c[FIELDMAP_MAX_SIZE], local[3], slope[9];
    int i, status;
    if (flux == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_superpose(map, currents, point, c, local);
    if (status == FIELDMAP_OK) {
        /* A constant degree lets the compiler unroll the sums. */
        if (map->degree == 5)
            fieldmap_polynomial(c, 5, local, flux, slope);
        else
            fieldmap_polynomial(c, map->degree, local, flux, slope);
    }
    for (i = 0; i < 3 && status != FIELDMAP_OK; i++) flux[i] = (double)NAN;
    for (i = 0; i < 9 && gradient != NULL; i++)
        gradient[i] = status == FIELDMAP_OK ? slope[i] * map->block[FIELDMAP_PER_LENGTH] : (double)NAN;
    return status;
}

/* second[27] at point[3] for currents[n_coils]. */
static inline int fieldmap_second_gradient(
    const fieldmap *map, const double *currents, const double *point, double *second)
{
    double c[FIELDMAP_MAX_SIZE], one[FIELDMAP_MAX_SIZE], two[FIELDMAP_MAX_SIZE], three[FIELDMAP_MAX_SIZE];
    double harmonics[FIELDMAP_MAX_SIZE], local[3], scale;
    int i, j, k, s, status, degree, size;
    if (second == NULL) return FIELDMAP_ARGUMENT;
    for (i = 0; i < 27; i++) second[i] = (double)NAN;
    status = fieldmap_superpose(map, currents, point, c, local);
    if (status != FIELDMAP_OK) return status;
    degree = map->degree;
    size = (degree - 2) * (degree - 2);
    scale = map->block[FIELDMAP_PER_LENGTH] * map->block[FIELDMAP_PER_LENGTH];
    fieldmap_harmonics(degree - 3, local, harmonics);
    for (i = 0; i < 3; i++) {
        fieldmap_differentiate(c, degree, i, one);
        for (j = 0; j < 3; j++) {
            fieldmap_differentiate(one, degree - 1, j, two);
            for (k = 0; k < 3; k++) {
                double total = 0.0;
                fieldmap_differentiate(two, degree - 2, k, three);
                for (s = 0; s < size; s++) total += three[s] * harmonics[s];
                second[9 * i + 3 * j + k] = scale * total;
            }
        }
    }
    return FIELDMAP_OK;
}

/* wrench[6] on a dipole of moment[3] at point[3]: F_j = m_i dB_i/dx_j, then T = m x B. */
static inline int fieldmap_wrench(
    const fieldmap *map, const double *currents, const double *point, const double *moment, double *wrench)
{
    double flux[3], slope[9];
    int j, status;
    if (moment == NULL || wrench == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_field(map, currents, point, flux, slope);
    if (status == FIELDMAP_ARGUMENT) return status;
    for (j = 0; j < 3; j++) wrench[j] = moment[0] * slope[j] + moment[1] * slope[3 + j] + moment[2] * slope[6 + j];
    wrench[3] = moment[1] * flux[2] - moment[2] * flux[1];
    wrench[4] = moment[2] * flux[0] - moment[0] * flux[2];
    wrench[5] = moment[0] * flux[1] - moment[1] * flux[0];
    return status;
}

/* The map at fixed currents, asked with currents = NULL from then on: a copy, to be closed. `map` may be closed. */
static inline int fieldmap_at(const fieldmap *map, const double *currents, fieldmap *fixed)
{
    size_t size, places, n, m;
    double *block;
    const double *set;
    int k;
    if (map == NULL || map->block == NULL || currents == NULL || fixed == NULL) return FIELDMAP_ARGUMENT;
    size = (size_t)((map->degree + 1) * (map->degree + 1));
    places = (size_t)map->block[FIELDMAP_CELLS] * (size_t)map->block[FIELDMAP_CELLS + 1];
    places *= (size_t)map->block[FIELDMAP_CELLS + 2];
    block = (double *)calloc(FIELDMAP_HEADER + places * size, sizeof(double));
    if (block == NULL) return FIELDMAP_NO_MEMORY;
    memcpy(block, map->block, FIELDMAP_HEADER * sizeof(double));
    block[FIELDMAP_SETS] = 1.0;
    block[FIELDMAP_CONSTANT] = 0.0;
    set = map->block + FIELDMAP_HEADER;
    for (n = 0; n < places; n++)
        for (k = 0; k < map->n_coils + map->constant; k++, set += size)
            for (m = 0; m < size; m++)
                block[FIELDMAP_HEADER + n * size + m] += (k == map->n_coils ? 1.0 : currents[k]) * set[m];
    *fixed = *map;
    fixed->n_coils = 1;
    fixed->constant = 0;
    fixed->names = NULL;
    fixed->block = block;
    fixed->owned = block;
    return FIELDMAP_OK;
}

#endif
