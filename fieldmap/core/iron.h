/* iron.h: the weights of the fields of saturating iron at any currents, and their derivatives.
 *
 * A reduced model of the iron is solved by Newton's method (docs/theory/current_dependence.md). The caller gives the memory of
 * a solver state, fieldmap_iron_memory() bytes for each thread; nothing here allocates. A solve takes at most
 * FIELDMAP_IRON_STEPS steps. A solve with the currents of the last one returns at once. Results are double; some sums are in
 * single precision, where a later step corrects their rounding.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_REDUCED_IRON_H
#define FIELDMAP_REDUCED_IRON_H

#include <math.h>
#include <string.h>

#include "block.h"
#include "division.h"
#include "iron_law.h"

enum { FIELDMAP_IRON_BEYOND = 32, FIELDMAP_IRON_NOT_CONVERGED = 33, FIELDMAP_IRON_MEMORY = 34 };

enum {
    FIELDMAP_IRON_STEPS = 60, FIELDMAP_IRON_PAIRS = 12, FIELDMAP_IRON_PASSED = 3, FIELDMAP_IRON_LANES = 16,
    FIELDMAP_IRON_TILE = 4, FIELDMAP_IRON_POINTS = 16, FIELDMAP_IRON_TOGETHER = 256, FIELDMAP_IRON_SIZES = 20,
    FIELDMAP_IRON_MAX_SIGNALS = 256, FIELDMAP_IRON_MAX_DEGREE = 30
};

/* A map of saturating iron; treat it as read-only. fields: the fields of the coils, the iron and a background; their weighted
 * sum is the field of the map. The model has p points, r modes, c coils and k fields of the iron. Rows over the modes are
 * padded with zeros to `wide` numbers. A model without coils, signals and terms is used while maps are made: it is solved for
 * applied fields at its points (fieldmap_iron_solve_in). Iron with hysteresis has n_cells play cells at each point, with the
 * pinning fields of its law, in ascending order, and their shares; other iron has none. remembered: the memory with which a
 * state begins (fieldmap_iron_copy); NULL for demagnetised iron. */
typedef struct fieldmap_iron {
    fieldmap fields;
    int n_coils, n_fields, p, r, wide, k, has_fixed, n_laws, n_knots, n_terms, n_signals, division, checked, n_cells;
    double exponent, limit, off, tolerance;
    const double *source, *fixed, *weights, *law, *offset, *knots, *coefficients, *air, *constant, *output;
    const double *terms, *matrix, *inverse, *lower, *upper, *pinning, *shares, *remembered;
    const float *gradients, *expansion;
    void *owned;
} fieldmap_iron;

/* State and work space of the solver; one for each thread. steps, left_over: number of steps and estimated relative error, in
 * the energy norm, of the last solve. tolerance: allowed relative error; checked: whether currents outside the domain are
 * refused. The caller may set these two. cells: memory of the cells (fieldmap_cell_moved); zeros are demagnetised iron. heat:
 * total heat of the steps, times mu0, T^2 m^3. */
typedef struct fieldmap_iron_state {
    const fieldmap_iron *map;
    int count, steps, checked;
    double left_over, tolerance, heat;
    double *currents, *amplitudes, *factor, *h, *solution, *applied, *vector, *moved, *step_h, *residual, *response;
    double *change, *rest, *left, *changes, *responses, *susceptible, *cells, *products, *material;
    float *single, *single_change, *total, *sides, *rows;
    int *piece;
} fieldmap_iron_state;

/* The next `count` of `left` unread numbers, or NULL if there are fewer. */
static inline const double *fieldmap_iron_take(const double **at, uint64_t *left, uint64_t count)
{
    const double *here = *at;
    if (count > *left) return NULL;
    *at += count;
    *left -= count;
    return here;
}

/* Whether `count` numbers, `step` apart, are whole and lie in low..high, so that they can be used as indices. */
static inline int fieldmap_iron_positions(const double *values, int count, int step, long low, long high)
{
    int i;
    for (i = 0; i < count; i++)
        if (fieldmap_whole(values[(size_t)i * (size_t)step], low, high) < 0) return 0;
    return 1;
}

/* Whether points begin..end follow laws that the knots hold. */
static inline int fieldmap_iron_laws_fit(const fieldmap_iron *map, int begin, int end)
{
    int i;
    if (map->offset[0] != 0.0 || map->offset[map->n_laws] != (double)map->n_knots) return 0;
    for (i = 0; i < map->n_laws; i++)
        if (fieldmap_whole(map->offset[i], 0, map->n_knots - 1) < 0 || !(map->offset[i] < map->offset[i + 1])) return 0;
    return fieldmap_iron_positions(map->law + begin, end - begin, 1, 0, map->n_laws - 1);
}

/* Take the arrays of the model, which follow its sizes, and check the numbers that are used as indices. */
static inline int fieldmap_iron_arrays(fieldmap_iron *map, const double *at, uint64_t left)
{
    const uint64_t p = (uint64_t)map->p, r = (uint64_t)map->r, c = (uint64_t)map->n_coils, d = (uint64_t)map->n_signals;
    const uint64_t t = (uint64_t)map->n_terms, n = (uint64_t)map->n_knots, matrix = map->division ? 0 : c * d;
    const uint64_t w = (uint64_t)map->wide, k = (uint64_t)map->k, laws = (uint64_t)map->n_laws;
    const uint64_t singles = (3 * p + t) * w / 2, cells = (uint64_t)map->n_cells;
    const double *numbers;
    int i;
    if (3 * p * c + (map->has_fixed ? 3 * p : 0) + 2 * p + laws + 1 + 5 * n + r * r + r + k * r + 3 * t + 2 * matrix
            + 2 * d + cells * (laws + 1) + singles != left)
        return FIELDMAP_DAMAGED;
    map->source = fieldmap_iron_take(&at, &left, 3 * p * c);
    map->fixed = fieldmap_iron_take(&at, &left, map->has_fixed ? 3 * p : 0);
    map->weights = fieldmap_iron_take(&at, &left, p);
    map->law = fieldmap_iron_take(&at, &left, p);
    map->offset = fieldmap_iron_take(&at, &left, (uint64_t)map->n_laws + 1);
    map->knots = fieldmap_iron_take(&at, &left, n);
    map->coefficients = fieldmap_iron_take(&at, &left, 4 * n);
    map->air = fieldmap_iron_take(&at, &left, r * r);
    map->constant = fieldmap_iron_take(&at, &left, r);
    map->output = fieldmap_iron_take(&at, &left, (uint64_t)map->k * r);
    map->terms = fieldmap_iron_take(&at, &left, 3 * t);
    map->matrix = fieldmap_iron_take(&at, &left, matrix);
    map->inverse = fieldmap_iron_take(&at, &left, matrix);
    map->lower = fieldmap_iron_take(&at, &left, d);
    map->upper = fieldmap_iron_take(&at, &left, d);
    map->pinning = fieldmap_iron_take(&at, &left, cells * laws);
    map->shares = fieldmap_iron_take(&at, &left, cells);
    numbers = fieldmap_iron_take(&at, &left, 3 * p * (uint64_t)map->wide / 2);
    map->gradients = (const float *)(const void *)numbers;
    numbers = fieldmap_iron_take(&at, &left, t * (uint64_t)map->wide / 2);
    map->expansion = (const float *)(const void *)numbers;
    if (!fieldmap_iron_laws_fit(map, 0, map->p)) return FIELDMAP_DAMAGED;
    for (i = 0; i < map->n_terms; i++)
        if (fieldmap_whole(map->terms[3 * i], 0, i > 0 ? i - 1 : 0) < 0) return FIELDMAP_DAMAGED;
    if (!fieldmap_iron_positions(map->terms + 1, map->n_terms, 3, 0, map->n_signals - 1)) return FIELDMAP_DAMAGED;
    if (!fieldmap_iron_positions(map->terms + 2, map->n_terms, 3, 0, FIELDMAP_IRON_MAX_DEGREE)) return FIELDMAP_DAMAGED;
    return FIELDMAP_OK;
}

/* Make a model from `count` numbers, which must outlive it: sizes, then arrays. */
static inline int fieldmap_iron_of_numbers(fieldmap_iron *map, const double *numbers, uint64_t count)
{
    /* Upper limits of the sizes: 3 p, and products of numbers of modes, must fit into an int. */
    static const long most[13] = {500000000, 4096, 4096 + 16, 256, 4096, 1, 4096, 1000000, 100000,
                                  FIELDMAP_IRON_MAX_SIGNALS, 1, 1, 4096 + 257};
    long sizes[13];
    int i, coils;
    if (count < FIELDMAP_IRON_SIZES) return FIELDMAP_DAMAGED;
    for (i = 0; i < 13; i++) {
        sizes[i] = fieldmap_whole(numbers[i], 0, most[i]);
        if (sizes[i] < 0) return FIELDMAP_DAMAGED;
    }
    map->p = (int)sizes[0], map->r = (int)sizes[1], map->wide = (int)sizes[2], map->n_coils = (int)sizes[3];
    map->k = (int)sizes[4], map->has_fixed = (int)sizes[5], map->n_laws = (int)sizes[6], map->n_knots = (int)sizes[7];
    map->n_terms = (int)sizes[8], map->n_signals = (int)sizes[9], map->division = (int)sizes[10];
    map->checked = (int)sizes[11], map->n_fields = (int)sizes[12];
    map->n_cells = (int)fieldmap_whole(numbers[17], 0, 256);
    map->exponent = numbers[13], map->limit = numbers[14], map->off = numbers[15], map->tolerance = numbers[16];
    map->remembered = NULL;
    coils = map->n_coils > 0;
    if (map->n_cells < 0 || map->p < 1 || map->r < 1 || map->n_laws < 1 || map->n_knots < 1 || (map->n_terms > 0) != coils
        || (map->n_signals > 0) != coils || map->wide < map->r || map->wide % FIELDMAP_IRON_LANES != 0
        || map->n_fields != map->n_coils + map->k + map->has_fixed
        || (map->division && (map->n_coils != 6 || map->n_signals != 3)) || !(map->tolerance > 0.0))
        return FIELDMAP_DAMAGED;
    return fieldmap_iron_arrays(map, numbers + FIELDMAP_IRON_SIZES, count - FIELDMAP_IRON_SIZES);
}

/* Number of rows, rounded up to whole tiles. */
static inline int fieldmap_iron_tiles(int rows)
{
    return (rows + FIELDMAP_IRON_TILE - 1) / FIELDMAP_IRON_TILE * FIELDMAP_IRON_TILE;
}

/* Address of the next array of `count` elements of `size` bytes, aligned to 64 bytes; NULL if memory is NULL. */
static inline void *fieldmap_iron_place(unsigned char *memory, size_t *used, size_t count, size_t size)
{
    void *here = memory == NULL ? NULL : memory + *used;
    *used += (count * size + 63) / 64 * 64;
    return here;
}

/* Lay out the arrays of a state in memory, which may be NULL. Returns the number of bytes that they take. */
static inline size_t fieldmap_iron_lay_out(const fieldmap_iron *map, fieldmap_iron_state *s, unsigned char *memory)
{
    const size_t n = 3 * (size_t)map->p, p = (size_t)map->p, r = (size_t)map->r, w = (size_t)map->wide, d = sizeof(double);
    const size_t c = (size_t)map->n_coils, f = sizeof(float), pairs = FIELDMAP_IRON_PAIRS;
    size_t used = 0;
    s->currents = (double *)fieldmap_iron_place(memory, &used, FIELDMAP_IRON_PASSED * c, d);
    s->amplitudes = (double *)fieldmap_iron_place(memory, &used, FIELDMAP_IRON_PASSED * r, d);
    s->factor = (double *)fieldmap_iron_place(memory, &used, r * r, d);
    s->h = (double *)fieldmap_iron_place(memory, &used, n, d);
    s->solution = (double *)fieldmap_iron_place(memory, &used, (size_t)map->n_fields, d);
    s->applied = (double *)fieldmap_iron_place(memory, &used, n, d);
    s->vector = (double *)fieldmap_iron_place(memory, &used, n, d);
    s->moved = (double *)fieldmap_iron_place(memory, &used, n, d);
    s->step_h = (double *)fieldmap_iron_place(memory, &used, n, d);
    s->residual = (double *)fieldmap_iron_place(memory, &used, w, d);
    s->response = (double *)fieldmap_iron_place(memory, &used, w, d);
    s->change = (double *)fieldmap_iron_place(memory, &used, w, d);
    s->rest = (double *)fieldmap_iron_place(memory, &used, w, d);
    s->left = (double *)fieldmap_iron_place(memory, &used, w, d);
    s->changes = (double *)fieldmap_iron_place(memory, &used, pairs * r, d);
    s->responses = (double *)fieldmap_iron_place(memory, &used, pairs * r, d);
    s->susceptible = (double *)fieldmap_iron_place(memory, &used, 6 * p, d);
    s->cells = (double *)fieldmap_iron_place(memory, &used, 4 * p * (size_t)map->n_cells, d);
    s->products = (double *)fieldmap_iron_place(memory, &used, (size_t)map->n_terms, d);
    s->material = (double *)fieldmap_iron_place(memory, &used, w, d);
    s->single = (float *)fieldmap_iron_place(memory, &used, w, f);
    s->single_change = (float *)fieldmap_iron_place(memory, &used, w, f);
    s->total = (float *)fieldmap_iron_place(memory, &used, (size_t)fieldmap_iron_tiles(map->r) * w, f);
    s->sides = (float *)fieldmap_iron_place(memory, &used, (size_t)fieldmap_iron_tiles(map->n_coils) * w, f);
    s->rows = (float *)fieldmap_iron_place(memory, &used, 3 * FIELDMAP_IRON_POINTS * w, f);
    s->piece = (int *)fieldmap_iron_place(memory, &used, p * (size_t)(map->n_cells > 0 ? map->n_cells : 1), sizeof(int));
    return used;
}

/* Bytes that a state needs. */
static inline size_t fieldmap_iron_memory(const fieldmap_iron *map)
{
    fieldmap_iron_state state;
    return map == NULL || map->p == 0 ? 0 : fieldmap_iron_lay_out(map, &state, NULL);
}

static inline size_t fieldmap_iron_copy(fieldmap_iron_state *s, double *out, const double *in);

/* Begin a state. memory: of the caller, at an address that is a multiple of 64; it must outlive the state. */
static inline int fieldmap_iron_start(
    fieldmap_iron_state *state, const fieldmap_iron *map, void *memory, size_t size)
{
    const int pieces = map != NULL && map->n_cells > 0 ? map->n_cells : 1;
    int i, k;
    if (state == NULL || map == NULL || map->p == 0 || memory == NULL) return FIELDMAP_ARGUMENT;
    if ((uintptr_t)memory % 64 != 0 || size < fieldmap_iron_memory(map)) return FIELDMAP_IRON_MEMORY;
    memset(state, 0, sizeof *state);
    memset(memory, 0, fieldmap_iron_memory(map));
    fieldmap_iron_lay_out(map, state, (unsigned char *)memory);
    state->map = map;
    state->tolerance = map->tolerance;
    state->checked = map->checked;
    for (i = 0; i < map->p; i++)
        for (k = 0; k < pieces; k++) state->piece[(size_t)i * (size_t)pieces + (size_t)k] = (int)map->offset[(int)map->law[i]];
    if (map->remembered != NULL) fieldmap_iron_copy(state, NULL, map->remembered);
    return FIELDMAP_OK;
}

/* Sum of lanes, which are overwritten. Halves are added, so that a compiler can use vectors. */
FIELDMAP_INLINE float fieldmap_iron_sum(float *FIELDMAP_RESTRICT lanes)
{
    int j;
    for (j = 0; j < 8; j++) lanes[j] += lanes[j + 8];
    for (j = 0; j < 4; j++) lanes[j] += lanes[j + 4];
    return (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]);
}

/* Scalar products out[3] of the three rows of a point and b, `wide` numbers each, in lanes that a compiler can vectorise. */
FIELDMAP_INLINE void fieldmap_iron_dots(
    const float *FIELDMAP_RESTRICT g, const float *FIELDMAP_RESTRICT b, int wide, float out[3])
{
    float x[FIELDMAP_IRON_LANES] = {0}, y[FIELDMAP_IRON_LANES] = {0}, z[FIELDMAP_IRON_LANES] = {0};
    int i, j;
    for (i = 0; i < wide; i += FIELDMAP_IRON_LANES)
        for (j = 0; j < FIELDMAP_IRON_LANES; j++) {
            x[j] += g[i + j] * b[i + j];
            y[j] += g[wide + i + j] * b[i + j];
            z[j] += g[2 * wide + i + j] * b[i + j];
        }
    out[0] = fieldmap_iron_sum(x), out[1] = fieldmap_iron_sum(y), out[2] = fieldmap_iron_sum(z);
}

FIELDMAP_INLINE double fieldmap_iron_mixed_dot(const float *a, const double *b, int wide)
{
    double lanes[8] = {0};
    int i, j;
    for (i = 0; i < wide; i += 8)
        for (j = 0; j < 8; j++) lanes[j] += (double)a[i + j] * b[i + j];
    for (j = 0; j < 4; j++) lanes[j] += lanes[j + 4];
    return (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]);
}

static inline double fieldmap_iron_product(const double *a, const double *b, int count)
{
    double lanes[8] = {0}, total = 0.0;
    int i, j;
    for (i = 0; i + 8 <= count; i += 8)
        for (j = 0; j < 8; j++) lanes[j] += a[i + j] * b[i + j];
    for (; i < count; i++) total += a[i] * b[i];
    for (j = 0; j < 4; j++) lanes[j] += lanes[j + 4];
    return total + ((lanes[0] + lanes[2]) + (lanes[1] + lanes[3]));
}

/* Fill out[] with the signals nearest to currents. Returns whether the currents lie in the domain. */
static inline int fieldmap_iron_signals(const fieldmap_iron *map, const double *currents, double *out)
{
    double largest = 0.0, worst = 0.0;
    int inside, j, k;
    for (k = 0; k < map->n_coils; k++) largest = fmax(largest, fabs(currents[k]));
    if (map->division) {
        worst = fieldmap_division_signals(currents, map->exponent, out);
    } else {
        for (j = 0; j < map->n_signals; j++)
            out[j] = fieldmap_iron_product(map->inverse + (size_t)j * (size_t)map->n_coils, currents, map->n_coils);
        for (k = 0; k < map->n_coils; k++)
            worst = fmax(worst, fabs(fieldmap_iron_product(
                map->matrix + (size_t)k * (size_t)map->n_signals, out, map->n_signals) - currents[k]));
        if (largest > 0.0) worst /= largest;
    }
    inside = worst <= map->off && largest <= map->limit;
    for (j = 0; j < map->n_signals; j++) inside = inside && map->lower[j] <= out[j] && out[j] <= map->upper[j];
    return inside;
}

/* The Chebyshev polynomial of a degree, at x. */
static inline double fieldmap_chebyshev(int degree, double x)
{
    double before = x, here = 1.0, next;
    for (; degree > 0; degree--) next = 2.0 * x * here - before, before = here, here = next;
    return here;
}

/* Fill the first guess a[] of the amplitudes: a Chebyshev expansion at the signals, moved into the domain if they lie outside.
 * */
static inline void fieldmap_iron_expand(const fieldmap_iron *map, fieldmap_iron_state *s, const double *values, double *a)
{
    double x[FIELDMAP_IRON_MAX_SIGNALS];
    int i, j, m;
    for (j = 0; j < map->n_signals; j++) {
        double width = map->upper[j] - map->lower[j];
        x[j] = width > 0.0 ? fmin(fmax(2.0 * (values[j] - map->lower[j]) / width - 1.0, -1.0), 1.0) : 0.0;
    }
    for (m = 0; m < map->wide; m++) s->single[m] = 0.0f;
    for (i = 0; i < map->n_terms; i++) {
        const double *term = map->terms + 3 * i;
        const float *row = map->expansion + (size_t)i * (size_t)map->wide;
        float share;
        s->products[i] = i > 0 ? s->products[(int)term[0]] * fieldmap_chebyshev((int)term[2], x[(int)term[1]]) : 1.0;
        share = (float)s->products[i];
        for (m = 0; m < map->wide; m++) s->single[m] += share * row[m];
    }
    for (m = 0; m < map->r; m++) a[m] = (double)s->single[m];
}

/* The law at point p. */
static inline fieldmap_iron_curve fieldmap_iron_curve_of(const fieldmap_iron *map, int p)
{
    const int law = (int)map->law[p];
    fieldmap_iron_curve of;
    of.knots = map->knots, of.coefficients = map->coefficients;
    of.low = (int)map->offset[law], of.high = (int)map->offset[law + 1] - 1;
    return of;
}

/* Pinning fields of the cells at point p; NULL without hysteresis. The last is the largest. */
static inline const double *fieldmap_iron_pinning(const fieldmap_iron *map, int p)
{
    const double *pinning = map->pinning + (size_t)map->law[p] * (size_t)map->n_cells;
    return map->n_cells > 0 && pinning[map->n_cells - 1] > 0.0 ? pinning : NULL;
}

/* Fill j[3 count] = w J at h of `count` points from `first` on, where w are their weights; susceptible: w dJ/dh (6 entries
 * each), or NULL. after: the new memory of the cells, or NULL. Returns mu0 times the heat of the cells, 0 without `after`. */
static inline double fieldmap_iron_polarise(const fieldmap_iron *map, const fieldmap_iron_state *s, int first, int count,
    const double *h, double *j, double *susceptible, double *after)
{
    const int cells = map->n_cells;
    fieldmap_cell_lanes moving;
    int n, i;
    moving.count = 0, moving.heat = 0.0;
    for (n = 0; n < count; n++, h += 3, j += 3) {
        const int p = first + n;
        const fieldmap_iron_curve of = fieldmap_iron_curve_of(map, p);
        const double *pinning = fieldmap_iron_pinning(map, p);
        double *derivative = susceptible == NULL ? NULL : susceptible + 6 * n;
        int *piece = s->piece + (size_t)p * (size_t)(cells > 0 ? cells : 1);
        if (pinning == NULL) {
            const double size = fieldmap_norm(h) + 1e-14;
            double slope, chord = fieldmap_iron_law(&of, piece, size, &slope) / size, share = map->weights[p] * (chord - 1.0);
            for (i = 0; i < 3; i++) j[i] = share * h[i];
            if (derivative != NULL)
                fieldmap_symmetric(share, map->weights[p] * (slope - chord) / (size * size), h, derivative);
        } else {
            const size_t at = 4 * (size_t)p * (size_t)cells;
            fieldmap_cells_add(&moving, &of, piece, cells, pinning, map->shares, map->weights[p], h, s->cells + at, j,
                after == NULL ? NULL : after + at, derivative);
        }
    }
    fieldmap_cells_finish(&moving);
    return moving.heat;
}

/* Number of points from `first` on that are processed together, so that their rows stay in the cache. */
static inline int fieldmap_iron_some(const fieldmap_iron *map, int first)
{
    return map->p - first < FIELDMAP_IRON_POINTS ? map->p - first : FIELDMAP_IRON_POINTS;
}

/* Fill h at amplitudes a (padded with zeros to `wide` numbers), with sums in double precision. */
static inline void fieldmap_iron_field_at(const fieldmap_iron *map, fieldmap_iron_state *s, const double *a)
{
    int i;
    for (i = 0; i < 3 * map->p; i++)
        s->h[i] = s->applied[i] - fieldmap_iron_mixed_dot(map->gradients + (size_t)i * (size_t)map->wide, a, map->wide);
}

/* Fill h, vector = w J and the residual at amplitudes a (padded to `wide` numbers), with sums in double precision. */
static inline void fieldmap_iron_evaluate(const fieldmap_iron *map, fieldmap_iron_state *s, const double *a)
{
    const int w = map->wide, r = map->r;
    double *residual = s->residual;
    int i, j, p;
    for (j = 0; j < w; j++) residual[j] = 0.0;
    for (p = 0; p < map->p; p += FIELDMAP_IRON_POINTS) {
        const int rows = 3 * fieldmap_iron_some(map, p);
        const float *g = map->gradients + 3 * (size_t)p * (size_t)w;
        double *h = s->h + 3 * (size_t)p, *v = s->vector + 3 * (size_t)p;
        for (i = 0; i < rows; i++) h[i] = s->applied[3 * p + i] - fieldmap_iron_mixed_dot(g + i * w, a, w);
        fieldmap_iron_polarise(map, s, p, rows / 3, h, v, NULL, NULL);
        for (i = 0; i < rows; i += 3, g += 3 * w, v += 3)
            for (j = 0; j < w; j++) residual[j] += v[0] * (double)g[j] + v[1] * (double)g[w + j] + v[2] * (double)g[2 * w + j];
    }
    for (i = 0; i < r; i++)
        s->residual[i] += map->constant[i] - fieldmap_iron_product(map->air + (size_t)i * (size_t)r, a, r);
}

/* out (`wide` numbers) += the three rows of a point, each times its share. */
FIELDMAP_INLINE void fieldmap_iron_add_rows(
    const float *FIELDMAP_RESTRICT g, int w, const float share[3], float *FIELDMAP_RESTRICT out)
{
    const float x = share[0], y = share[1], z = share[2];
    int j;
    for (j = 0; j < w; j++) out[j] += x * g[j] + y * g[w + j] + z * g[2 * w + j];
}

/* Add the sum over some points in `single` to `material`, and clear it. Single precision over all points of a model with a
 * hundred thousand points would lose 1e-4. */
static inline void fieldmap_iron_collect(fieldmap_iron_state *s)
{
    int j;
    for (j = 0; j < s->map->wide; j++) {
        s->material[j] += (double)s->single[j];
        s->single[j] = 0.0f;
    }
}

/* One pass over the points after a change of the amplitudes: step_h = G change, moved = w J at h - step_h,
 * material = G^T (moved - vector). before, behind: derivative along the step of the law's part of the functional, at the
 * beginning and the end of the step. */
static inline void fieldmap_iron_pass(const fieldmap_iron *map, fieldmap_iron_state *s, double *before, double *behind)
{
    const int w = map->wide;
    int i, j, p;
    *before = *behind = 0.0;
    for (j = 0; j < w; j++) s->single[j] = 0.0f, s->material[j] = 0.0;
    for (p = 0; p < map->p; p += FIELDMAP_IRON_POINTS) {
        const int rows = 3 * fieldmap_iron_some(map, p);
        const float *g = map->gradients + 3 * (size_t)p * (size_t)w;
        double h[3 * FIELDMAP_IRON_POINTS], *step_h = s->step_h + 3 * p, *moved = s->moved + 3 * p;
        const double *vector = s->vector + 3 * p;
        float d[3], step[3];
        for (i = 0; i < rows; i += 3) {
            fieldmap_iron_dots(g + i * w, s->single_change, w, step);
            for (j = 0; j < 3; j++) {
                step_h[i + j] = (double)step[j];
                h[i + j] = s->h[3 * p + i + j] - step_h[i + j];
            }
        }
        fieldmap_iron_polarise(map, s, p, rows / 3, h, moved, NULL, NULL);
        for (i = 0; i < rows; i += 3) {
            for (j = 0; j < 3; j++) {
                *before += vector[i + j] * step_h[i + j];
                *behind += moved[i + j] * step_h[i + j];
                d[j] = (float)(moved[i + j] - vector[i + j]);
            }
            fieldmap_iron_add_rows(g + i * w, w, d, s->single);
        }
        if (p % FIELDMAP_IRON_TOGETHER == FIELDMAP_IRON_TOGETHER - FIELDMAP_IRON_POINTS) fieldmap_iron_collect(s);
    }
    fieldmap_iron_collect(s);
}

/* Line search for a step that is too long: returns the share in (0, 1) of the step at which the functional is lowest. moved and
 * material are those of the shorter step. */
static inline double fieldmap_iron_shorter(
    const fieldmap_iron *map, fieldmap_iron_state *s, double rest, double curved, double start, double end)
{
    const int w = map->wide;
    double low = 0.0, high = 1.0, low_value = start, high_value = end, t = 1.0;
    int attempt, i, j, p;
    for (attempt = 0; attempt < 11; attempt++) {
        double share = low_value / (low_value - high_value), value = 0.0;
        t = low + (high - low) * fmin(fmax(share, 0.1), 0.9);
        for (p = 0; p < map->p; p += FIELDMAP_IRON_POINTS) {
            const int rows = 3 * fieldmap_iron_some(map, p);
            double h[3 * FIELDMAP_IRON_POINTS], *moved = s->moved + 3 * p;
            for (i = 0; i < rows; i++) h[i] = s->h[3 * p + i] - t * s->step_h[3 * p + i];
            fieldmap_iron_polarise(map, s, p, rows / 3, h, moved, NULL, NULL);
            for (i = 0; i < rows; i++) value += moved[i] * s->step_h[3 * p + i];
        }
        value -= rest + t * curved;
        if (fabs(value) < 0.1 * fabs(start)) break;
        if (value < 0.0) {
            high = t;
            high_value = value;
        } else {
            low = t;
            low_value = value;
        }
    }
    for (j = 0; j < w; j++) s->material[j] = 0.0;
    for (i = 0; i < 3 * map->p; i++) {
        const float share = (float)(s->moved[i] - s->vector[i]), *g = map->gradients + (size_t)i * (size_t)w;
        for (j = 0; j < w; j++) s->single[j] += share * g[j];
        if (i % FIELDMAP_IRON_TOGETHER == FIELDMAP_IRON_TOGETHER - 1) fieldmap_iron_collect(s);
    }
    fieldmap_iron_collect(s);
    return t;
}

/* Fill out with three rows (`wide` numbers each) of w dJ/dh G at a point, one for each component. */
FIELDMAP_INLINE void fieldmap_iron_rows(
    const float *FIELDMAP_RESTRICT g, int w, const double *susceptible, float *FIELDMAP_RESTRICT out)
{
    float d[6];
    int j;
    for (j = 0; j < 6; j++) d[j] = (float)susceptible[j];
    for (j = 0; j < w; j++) {
        const float x = g[j], y = g[w + j], z = g[2 * w + j];
        out[j] = d[0] * x + d[1] * y + d[2] * z;
        out[w + j] = d[1] * x + d[3] * y + d[4] * z;
        out[2 * w + j] = d[2] * x + d[4] * y + d[5] * z;
    }
}

/* out[i * w + j] += sum over k of left[k * step + i] right[k * w + j], for FIELDMAP_IRON_TILE values of i and
 * FIELDMAP_IRON_LANES values of j. k runs over the three components of each of `points` points. The tile is small enough for a
 * compiler to keep the sums in registers. */
FIELDMAP_INLINE void fieldmap_iron_add_tile(const float *FIELDMAP_RESTRICT left, int step,
    const float *FIELDMAP_RESTRICT right, int w, int points, float *FIELDMAP_RESTRICT out)
{
    float a[FIELDMAP_IRON_LANES], b[FIELDMAP_IRON_LANES], c[FIELDMAP_IRON_LANES], d[FIELDMAP_IRON_LANES];
    int j, p;
    for (j = 0; j < FIELDMAP_IRON_LANES; j++)
        a[j] = out[j], b[j] = out[w + j], c[j] = out[2 * w + j], d[j] = out[3 * w + j];
    for (p = 0; p < points; p++) {
        const float *x = left, *y = left + step, *z = left + 2 * step;
        for (j = 0; j < FIELDMAP_IRON_LANES; j++) {
            const float rx = right[j], ry = right[w + j], rz = right[2 * w + j];
            a[j] += x[0] * rx, a[j] += y[0] * ry, a[j] += z[0] * rz;
            b[j] += x[1] * rx, b[j] += y[1] * ry, b[j] += z[1] * rz;
            c[j] += x[2] * rx, c[j] += y[2] * ry, c[j] += z[2] * rz;
            d[j] += x[3] * rx, d[j] += y[3] * ry, d[j] += z[3] * rz;
        }
        left += 3 * step, right += 3 * w;
    }
    for (j = 0; j < FIELDMAP_IRON_LANES; j++)
        out[j] = a[j], out[w + j] = b[j], out[2 * w + j] = c[j], out[3 * w + j] = d[j];
}

/* out (count numbers) -= share times a row. */
FIELDMAP_INLINE void fieldmap_iron_subtract(
    double share, const double *FIELDMAP_RESTRICT row, int count, double *FIELDMAP_RESTRICT out)
{
    int j;
    for (j = 0; j < count; j++) out[j] -= share * row[j];
}

/* Row i of the upper triangle of the tangent. */
FIELDMAP_INLINE void fieldmap_iron_tangent_row(const fieldmap_iron *map, const fieldmap_iron_state *s, int i, double *row)
{
    const float *of_law = s->total + (size_t)i * (size_t)map->wide;
    const double *of_air = map->air + (size_t)i * (size_t)map->r;
    int j;
    for (j = i; j < map->r; j++) row[j] = (double)of_law[j] + of_air[j];
}

/* Cholesky factor U of the tangent, K = U^T U. Each finished row is subtracted from the rest of K. */
static inline void fieldmap_iron_factorise(const fieldmap_iron *map, fieldmap_iron_state *s)
{
    const int r = map->r;
    int i, j, k;
    for (i = 0; i < r; i++) fieldmap_iron_tangent_row(map, s, i, s->factor + (size_t)i * (size_t)r);
    for (i = 0; i < r; i++) {
        double *row = s->factor + (size_t)i * (size_t)r, pivot;
        const double whole = (double)s->total[(size_t)i * (size_t)map->wide + (size_t)i] + map->air[(size_t)i * (size_t)r + (size_t)i];
        if (row[i] < 1e-7 * whole) {
            /* The pivot is only rounding: this mode depends on earlier ones. It is decoupled from them. */
            for (k = 0; k < i; k++) s->factor[(size_t)k * (size_t)r + (size_t)i] = 0.0;
            fieldmap_iron_tangent_row(map, s, i, row);
        }
        pivot = 1.0 / sqrt(row[i]);
        for (j = i; j < r; j++) row[j] *= pivot;
        for (k = i + 1; k < r; k++)
            fieldmap_iron_subtract(row[k], row + k, r - k, s->factor + (size_t)k * (size_t)r + k);
    }
}

/* Fill the Cholesky factor of the tangent at h, and `sides`, the right-hand sides for the fields per ampere of the first
 * `coils` coils. */
static inline void fieldmap_iron_tangent(const fieldmap_iron *map, fieldmap_iron_state *s, int coils)
{
    const int w = map->wide, r = map->r;
    int i, j, k, p, first;
    fieldmap_iron_polarise(map, s, 0, map->p, s->h, s->moved, s->susceptible, NULL);
    for (j = 0; j < fieldmap_iron_tiles(r) * w; j++) s->total[j] = 0.0f;
    for (j = 0; j < fieldmap_iron_tiles(coils) * w; j++) s->sides[j] = 0.0f;
    for (first = 0; first < map->p; first += FIELDMAP_IRON_POINTS) {
        const int points = map->p - first < FIELDMAP_IRON_POINTS ? map->p - first : FIELDMAP_IRON_POINTS;
        const float *g = map->gradients + 3 * (size_t)first * (size_t)w;
        for (p = 0; p < points; p++)
            fieldmap_iron_rows(g + 3 * p * w, w, s->susceptible + 6 * (size_t)(first + p), s->rows + 3 * p * w);
        for (i = 0; i < r; i += FIELDMAP_IRON_TILE)
            /* Only the upper triangle is needed. */
            for (j = i / FIELDMAP_IRON_LANES * FIELDMAP_IRON_LANES; j < w; j += FIELDMAP_IRON_LANES)
                fieldmap_iron_add_tile(g + i, w, s->rows + j, w, points, s->total + (size_t)i * (size_t)w + j);
        for (i = 0; i < coils; i += FIELDMAP_IRON_TILE) {
            float unit[3 * FIELDMAP_IRON_POINTS * FIELDMAP_IRON_TILE];
            for (k = 0; k < 3 * points; k++)
                for (j = 0; j < FIELDMAP_IRON_TILE; j++) {
                    const double *of = map->source + ((size_t)k + 3 * (size_t)first) * (size_t)map->n_coils;
                    unit[k * FIELDMAP_IRON_TILE + j] = i + j < coils ? (float)of[i + j] : 0.0f;
                }
            for (j = 0; j < w; j += FIELDMAP_IRON_LANES)
                fieldmap_iron_add_tile(
                    unit, FIELDMAP_IRON_TILE, s->rows + j, w, points, s->sides + (size_t)i * (size_t)w + j);
        }
    }
    fieldmap_iron_factorise(map, s);
}

/* out = (U^T U)^-1 right; right is overwritten. */
static inline void fieldmap_iron_solve(const fieldmap_iron_state *s, double *right, double *out)
{
    const int r = s->map->r;
    int i;
    for (i = 0; i < r; i++) {
        const double *row = s->factor + (size_t)i * (size_t)r + i;
        out[i] = right[i] / row[0];
        fieldmap_iron_subtract(out[i], row + 1, r - i - 1, right + i + 1);
    }
    for (i = r - 1; i >= 0; i--) {
        const double *row = s->factor + (size_t)i * (size_t)r + i;
        out[i] = (out[i] - fieldmap_iron_product(row + 1, out + i + 1, r - i - 1)) / row[0];
    }
}

/* Fill change, the step that limited-memory BFGS gives for the residual, from the factor and the pairs of the last steps. */
static inline void fieldmap_iron_direction(fieldmap_iron_state *s, int pairs)
{
    const int r = s->map->r;
    double shares[FIELDMAP_IRON_PAIRS];
    int i, k;
    for (i = 0; i < r; i++) s->left[i] = s->residual[i];
    for (k = pairs - 1; k >= 0; k--) {
        const double *c = s->changes + (size_t)k * (size_t)r, *y = s->responses + (size_t)k * (size_t)r;
        shares[k] = fieldmap_iron_product(c, s->left, r) / fieldmap_iron_product(c, y, r);
        for (i = 0; i < r; i++) s->left[i] -= shares[k] * y[i];
    }
    fieldmap_iron_solve(s, s->left, s->change);
    for (k = 0; k < pairs; k++) {
        const double *c = s->changes + (size_t)k * (size_t)r, *y = s->responses + (size_t)k * (size_t)r;
        const double excess = fieldmap_iron_product(y, s->change, r) / fieldmap_iron_product(c, y, r);
        for (i = 0; i < r; i++) s->change[i] += (shares[k] - excess) * c[i];
    }
}

/* Store the pair (change, response) of a step, in place of the oldest if there is no room. Returns the number of pairs. */
static inline int fieldmap_iron_keep(fieldmap_iron_state *s, int pairs)
{
    const size_t r = (size_t)s->map->r, all = (FIELDMAP_IRON_PAIRS - 1) * r;
    if (!(fieldmap_iron_product(s->change, s->response, (int)r) > 0.0)) return pairs;
    if (pairs == FIELDMAP_IRON_PAIRS) {
        memmove(s->changes, s->changes + r, all * sizeof(double));
        memmove(s->responses, s->responses + r, all * sizeof(double));
        pairs -= 1;
    }
    memcpy(s->changes + (size_t)pairs * r, s->change, r * sizeof(double));
    memcpy(s->responses + (size_t)pairs * r, s->response, r * sizeof(double));
    return pairs + 1;
}

/* a . K a. */
static inline double fieldmap_iron_energy(const fieldmap_iron_state *s, const double *a)
{
    const int r = s->map->r;
    double total = 0.0;
    int i;
    for (i = 0; i < r; i++) {
        const double part = fieldmap_iron_product(s->factor + (size_t)i * (size_t)r + i, a + i, r - i);
        total += part * part;
    }
    return total;
}

/* Scalar product of the last step of the currents and the vector from the newest currents to `place`. */
static inline double fieldmap_iron_along(const fieldmap_iron_state *s, const double *place)
{
    const int c = s->map->n_coils;
    const double *last = s->currents + (FIELDMAP_IRON_PASSED - 1) * c, *before = s->count > 1 ? last - c : last;
    double total = 0.0;
    int k;
    for (k = 0; k < c; k++) total += (place[k] - last[k]) * (last[k] - before[k]);
    return total;
}

/* Fill the Lagrange weights at `at` for the polynomial through the nodes from `first` on. Earlier nodes have weight zero. */
static inline void fieldmap_iron_lagrange(const double *nodes, int count, double at, int first, double *weights)
{
    int j, m;
    for (j = 0; j < count; j++) {
        weights[j] = j >= first ? 1.0 : 0.0;
        for (m = first; m < count; m++)
            if (j >= first && m != j) weights[j] *= (at - nodes[m]) / (nodes[j] - nodes[m]);
    }
}

/* Fill the first guess a[r] of the amplitudes at currents `aim` by extrapolation of the last states. The polynomials through
 * the last one, two and three states are functions of the position of the currents along the last step. The polynomial that
 * predicts the currents `aim` best is used: on a smooth path the highest degree, after a jump or with noise a lower one.
 * Extrapolation goes at most two steps forward. The oldest state is used only if it lies at least a quarter of a step behind
 * the next one. Errors that differ by less than 1e-9 of the step count as equal. */
static inline void fieldmap_iron_continue(const fieldmap_iron *map, fieldmap_iron_state *s, const double *aim, double *a)
{
    const int c = map->n_coils, r = map->r, count = s->count, last = s->count - 1;
    const double *passed = s->currents + (FIELDMAP_IRON_PASSED - count) * c;
    const double *states = s->amplitudes + (FIELDMAP_IRON_PASSED - count) * r;
    double nodes[FIELDMAP_IRON_PASSED] = {0}, weights[FIELDMAP_IRON_PASSED] = {0};
    double length, at = 0.0, least = (double)INFINITY;
    int best = last, first, i, j, k;
    length = -fieldmap_iron_along(s, passed + (last > 0 ? last - 1 : 0) * c);
    if (length > 0.0) at = fmin(fmax(fieldmap_iron_along(s, aim) / length, 0.0), 2.0);
    for (j = 0; j < count; j++) nodes[j] = fieldmap_iron_along(s, passed + j * c) / fmax(length, 1e-300);
    for (first = last; first >= 0; first--) {
        double miss = 0.0;
        if (first < last && !(length > 0.0)) break;
        if (first < last - 1 && nodes[first] > nodes[first + 1] - 0.25) break;
        fieldmap_iron_lagrange(nodes, count, at, first, weights);
        for (k = 0; k < c; k++) {
            double value = -aim[k];
            for (j = 0; j < count; j++) value += weights[j] * passed[j * c + k];
            miss += value * value;
        }
        if (miss <= least + 1e-9 * length) {
            best = first;
            least = fmin(miss, least);
        }
    }
    fieldmap_iron_lagrange(nodes, count, at, best, weights);
    for (i = 0; i < r; i++) {
        a[i] = 0.0;
        for (j = 0; j < count; j++) a[i] += weights[j] * states[j * r + i];
    }
}

/* Fill applied[3 p], the field of coils and background at the points, T. */
static inline void fieldmap_iron_apply(const fieldmap_iron *map, fieldmap_iron_state *s, const double *currents)
{
    const int c = map->n_coils;
    int i, k;
    for (i = 0; i < 3 * map->p; i++) {
        const double *unit = map->source + (size_t)i * (size_t)c;
        double total = map->has_fixed ? map->fixed[i] : 0.0;
        for (k = 0; k < c; k++) total += unit[k] * currents[k];
        s->applied[i] = total;
    }
}

/* Store the newest state after the earlier ones (near = 1) or instead of them, and fill solution, the weights of all fields. */
static inline void fieldmap_iron_remember(
    const fieldmap_iron *map, fieldmap_iron_state *s, const double *currents, const double *a, int near)
{
    const size_t c = (size_t)map->n_coils, r = (size_t)map->r, before = FIELDMAP_IRON_PASSED - 1;
    size_t f;
    if (near) {
        memmove(s->currents, s->currents + c, before * c * sizeof(double));
        memmove(s->amplitudes, s->amplitudes + r, before * r * sizeof(double));
    }
    s->count = !near ? 1 : s->count < FIELDMAP_IRON_PASSED ? s->count + 1 : FIELDMAP_IRON_PASSED;
    memcpy(s->currents + before * c, currents, c * sizeof(double));
    memcpy(s->amplitudes + before * r, a, r * sizeof(double));
    memcpy(s->solution, currents, c * sizeof(double));
    for (f = 0; f < (size_t)map->k; f++) s->solution[c + f] = fieldmap_iron_product(map->output + f * r, a, (int)r);
    if (map->has_fixed) s->solution[c + (size_t)map->k] = 1.0;
}

/* Newton's method in the field `applied`. a (padded to `wide` numbers): first guess, overwritten by the result. Returns whether
 * it converged. tolerance: allowed relative error in the energy norm. near: the factor belongs to a state nearby; otherwise the
 * tangent is computed first. The factor is kept, and BFGS pairs correct it, while the decrement is below 0.1, each step reduces
 * the decrement to less than 0.6 times, and no step is too long. */
static inline int fieldmap_iron_newton(fieldmap_iron_state *s, double *a, int near, double tolerance)
{
    const fieldmap_iron *map = s->map;
    const int r = map->r, w = map->wide;
    double left_over = (double)INFINITY, decrement = (double)INFINITY, before = (double)INFINITY, farthest = 0.0, largest = 1e-300;
    int known = near, found = 0, pairs = 0, steps = 0, attempt, i;
    for (i = 0; i < w; i++) s->change[i] = s->residual[i] = 0.0;
    fieldmap_iron_evaluate(map, s, a);
    while (steps < FIELDMAP_IRON_STEPS) {
        double slope = 0.0, energy, was, end, rest, curved, share, t = 1.0, *swap;
        int fresh = 0;
        steps++;
        for (attempt = 0; attempt < 2; attempt++) {
            fresh = !known;
            if (fresh) {
                fieldmap_iron_tangent(map, s, 0);
                pairs = 0;
            }
            fieldmap_iron_direction(s, pairs);
            slope = fieldmap_iron_product(s->residual, s->change, r);
            energy = fieldmap_iron_energy(s, a);
            largest = fmax(largest, energy);
            decrement = sqrt(fmax(slope, 0.0) / fmax(energy, 1e-6 * largest));
            known = fresh || decrement < 0.6 * before;
            if (known) break;
        }
        share = before > 0.0 && before < (double)INFINITY ? fmin(decrement / before, 0.9) : 0.5;
        left_over = decrement * fmax(1.0, share / (1.0 - share));
        if ((fresh || before < (double)INFINITY || near) && left_over < tolerance) {
            if (1e-6 * farthest < tolerance) {
                for (i = 0; i < r; i++) a[i] += s->change[i];
                found = 1;
                break;
            }
            fieldmap_iron_evaluate(map, s, a);
            before = (double)INFINITY;
            farthest = 0.0;
            continue;
        }
        before = decrement;
        farthest = fmax(farthest, decrement);
        known = decrement < 0.1;
        for (i = 0; i < w; i++) s->single_change[i] = i < r ? (float)s->change[i] : 0.0f;
        fieldmap_iron_pass(map, s, &was, &end);
        for (i = 0; i < r; i++) s->left[i] = fieldmap_iron_product(map->air + (size_t)i * (size_t)r, s->change, r);
        rest = was - slope;
        curved = fieldmap_iron_product(s->left, s->change, r);
        end -= rest + curved;
        if (end < -0.3 * fabs(slope)) {
            t = fieldmap_iron_shorter(map, s, rest, curved, slope, end);
            known = 0;
        }
        for (i = 0; i < 3 * map->p; i++) s->h[i] -= t * s->step_h[i];
        swap = s->vector;
        s->vector = s->moved;
        s->moved = swap;
        for (i = 0; i < r; i++) {
            s->response[i] = t * s->left[i] - s->material[i];
            s->residual[i] -= s->response[i];
            s->change[i] *= t;
            a[i] += s->change[i];
        }
        pairs = fieldmap_iron_keep(s, pairs);
    }
    s->steps = steps;
    s->left_over = left_over;
    return found;
}

/* Solve for the amplitudes at currents[n_coils]; the result stays in the state. If the last solve had the same currents and
 * reached this tolerance, its result is used again. If no signal has moved by more than a tenth of its range, the solve begins
 * at the extrapolation of the last states, otherwise at the expansion. A solve that fails clears the last states. */
static inline int fieldmap_iron_solve_at(fieldmap_iron_state *s, const double *currents, double tolerance)
{
    const fieldmap_iron *map = s->map;
    const int c = map->n_coils;
    const double *last = s->currents + (FIELDMAP_IRON_PASSED - 1) * c;
    double values[FIELDMAP_IRON_MAX_SIGNALS] = {0}, behind[FIELDMAP_IRON_MAX_SIGNALS] = {0}, *a = s->rest;
    int same, near, i, k;
    for (k = 0; k < c; k++)
        if (!isfinite(currents[k])) return FIELDMAP_NOT_FINITE;
    if (!fieldmap_iron_signals(map, currents, values) && s->checked) return FIELDMAP_IRON_BEYOND;
    same = s->count > 0 && s->left_over < tolerance;
    for (k = 0; k < c; k++) same = same && last[k] == currents[k];
    if (same) return FIELDMAP_OK;
    near = s->count > 0;
    if (near) fieldmap_iron_signals(map, last, behind);
    /* With hysteresis there is no expansion: solves begin at the last states, or at zero. */
    for (k = 0; k < map->n_signals && map->n_cells == 0; k++) near = near && fabs(values[k] - behind[k]) <= 0.1 * (map->upper[k] - map->lower[k]);
    for (i = 0; i < map->wide; i++) a[i] = 0.0;
    if (near)
        fieldmap_iron_continue(map, s, currents, a);
    else
        fieldmap_iron_expand(map, s, values, a);
    fieldmap_iron_apply(map, s, currents);
    if (!fieldmap_iron_newton(s, a, near, tolerance)) {
        s->count = 0;
        return FIELDMAP_IRON_NOT_CONVERGED;
    }
    fieldmap_iron_remember(map, s, currents, a, near);
    return FIELDMAP_OK;
}

/* Solve in the field applied[3 p] of coils and background at the points, T. amplitudes[r]: first guess, overwritten by the
 * result, by the last iterate if the solve fails, or by NaN if an input is not finite. The next solve at currents does not use
 * earlier states. */
static inline int fieldmap_iron_solve_in(
    fieldmap_iron_state *state, const double *applied, double *amplitudes, double tolerance)
{
    const fieldmap_iron *map;
    double *a;
    int finite = 1, found, i;
    if (state == NULL || state->map == NULL || applied == NULL || amplitudes == NULL) return FIELDMAP_ARGUMENT;
    map = state->map, a = state->rest;
    state->count = state->steps = 0;
    for (i = 0; i < 3 * map->p; i++) finite = finite && isfinite(applied[i]);
    for (i = 0; i < map->r; i++) finite = finite && isfinite(amplitudes[i]);
    if (!finite) {
        for (i = 0; i < map->r; i++) amplitudes[i] = (double)NAN;
        return FIELDMAP_NOT_FINITE;
    }
    for (i = 0; i < map->wide; i++) a[i] = i < map->r ? amplitudes[i] : 0.0;
    memcpy(state->applied, applied, 3 * (size_t)map->p * sizeof(double));
    found = fieldmap_iron_newton(state, a, 0, tolerance);
    memcpy(amplitudes, a, (size_t)map->r * sizeof(double));
    return found ? FIELDMAP_OK : FIELDMAP_IRON_NOT_CONVERGED;
}

/* Solve at currents that change little from call to call. A solve that begins at the last states and fails is repeated from the
 * expansion. */
static inline int fieldmap_iron_follow(fieldmap_iron_state *state, const double *currents)
{
    const int status = fieldmap_iron_solve_at(state, currents, state->tolerance), steps = state->steps;
    int again;
    if (status != FIELDMAP_IRON_NOT_CONVERGED) return status;
    again = fieldmap_iron_solve_at(state, currents, state->tolerance);
    state->steps += steps;
    return again;
}

/* The cells remember the state of the last solve, and their heat is counted: equation (5). */
static inline void fieldmap_iron_advance(fieldmap_iron_state *s)
{
    const fieldmap_iron *map = s->map;
    int i;
    for (i = 0; i < map->wide; i++) s->rest[i] = i < map->r ? s->amplitudes[(FIELDMAP_IRON_PASSED - 1) * map->r + i] : 0.0;
    fieldmap_iron_field_at(map, s, s->rest);
    s->heat += fieldmap_iron_polarise(map, s, 0, map->p, s->h, s->moved, NULL, s->cells);
}

/* Go straight from the currents of the last step to currents[n_coils]. The cells then remember the state, and `solution` holds
 * its weights. If the status is not FIELDMAP_OK, the cells do not change. */
static inline int fieldmap_iron_step(fieldmap_iron_state *s, const double *currents)
{
    int status;
    if (s == NULL || s->map == NULL || currents == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_iron_follow(s, currents);
    if (status == FIELDMAP_OK && s->map->n_cells > 0) fieldmap_iron_advance(s);
    return status;
}

/* Copy the memory of a state, on which later solves and steps depend, to `out` or from `in`; the other one is NULL. If both are
 * NULL, only count it. Returns its number of doubles: the number of last states, the error of their solve and the heat, then
 * the states, the factor of the tangent, the weights, and the cells. */
static inline size_t fieldmap_iron_copy(fieldmap_iron_state *s, double *out, const double *in)
{
    const fieldmap_iron *map = s->map;
    const size_t r = (size_t)map->r, passed = FIELDMAP_IRON_PASSED;
    double *const parts[5] = {s->currents, s->amplitudes, s->factor, s->solution, s->cells};
    const size_t sizes[5] = {passed * (size_t)map->n_coils, passed * r, r * r, (size_t)map->n_fields,
                             4 * (size_t)map->p * (size_t)map->n_cells};
    size_t used = 3;
    int i;
    if (out != NULL) out[0] = (double)s->count, out[1] = s->left_over, out[2] = s->heat;
    if (in != NULL) s->count = (int)fieldmap_whole(in[0], 0, FIELDMAP_IRON_PASSED), s->left_over = in[1], s->heat = in[2];
    for (i = 0; i < 5; i++) {
        if (out != NULL) memcpy(out + used, parts[i], sizes[i] * sizeof(double));
        if (in != NULL) memcpy(parts[i], in + used, sizes[i] * sizeof(double));
        used += sizes[i];
    }
    if (s->count < 0) s->count = 0;
    /* A solve at the same currents returns at once and does not compute the applied field, so it is computed here. */
    if (in != NULL && s->count > 0) fieldmap_iron_apply(map, s, s->currents + (passed - 1) * (size_t)map->n_coils);
    return used;
}

/* Fill weights[n_fields] of the map's fields at currents[n_coils]: the currents, the weights of the fields of the iron, and 1
 * for a background if there is one. */
static inline int fieldmap_iron_weights(fieldmap_iron_state *state, const double *currents, double *weights)
{
    int f, status;
    if (state == NULL || state->map == NULL || currents == NULL || weights == NULL) return FIELDMAP_ARGUMENT;
    status = fieldmap_iron_solve_at(state, currents, state->tolerance);
    for (f = 0; f < state->map->n_fields; f++) weights[f] = status == FIELDMAP_OK ? state->solution[f] : (double)NAN;
    return status;
}

/* Fill moved[3] = w dJ/dh (s - G change) at point p, the derivative of its moment with respect to the current of a coil;
 * `change` is the derivative of the amplitudes. held: the amplitudes are held constant. */
FIELDMAP_INLINE void fieldmap_iron_moved(
    const fieldmap_iron *map, const fieldmap_iron_state *s, int p, int coil, int held, double *moved)
{
    const int w = map->wide;
    const float *g = map->gradients + 3 * (size_t)p * (size_t)w;
    const double *d = s->susceptible + 6 * (size_t)p, *unit = map->source + 3 * (size_t)p * (size_t)map->n_coils + coil;
    double u[3];
    int i;
    for (i = 0; i < 3; i++)
        u[i] = unit[i * map->n_coils] - (held ? 0.0 : fieldmap_iron_mixed_dot(g + i * w, s->change, w));
    moved[0] = d[0] * u[0] + d[1] * u[1] + d[2] * u[2];
    moved[1] = d[1] * u[0] + d[3] * u[1] + d[4] * u[2];
    moved[2] = d[2] * u[0] + d[4] * u[1] + d[5] * u[2];
}

/* Fill residual = G^T w dJ/dh (s - G change) - A change, with the field per ampere s of a coil: the residual of the equation
 * for `change`, the derivative of the amplitudes with respect to the coil's current. Sums are in double precision. */
static inline void fieldmap_iron_left_of_slope(const fieldmap_iron *map, fieldmap_iron_state *s, int coil)
{
    const int w = map->wide, r = map->r;
    double *residual = s->residual;
    int i, j, p;
    for (j = 0; j < w; j++) residual[j] = 0.0;
    for (p = 0; p < map->p; p++) {
        const float *g = map->gradients + 3 * (size_t)p * (size_t)w;
        double m[3];
        fieldmap_iron_moved(map, s, p, coil, 0, m);
        for (j = 0; j < w; j++) residual[j] += m[0] * (double)g[j] + m[1] * (double)g[w + j] + m[2] * (double)g[2 * w + j];
    }
    for (i = 0; i < r; i++) residual[i] -= fieldmap_iron_product(map->air + (size_t)i * (size_t)r, s->change, r);
}

/* Fill linkages[n_coils], mu0 times the flux linkages of moments w J, T^2 m^3/A: docs/theory/flux_linkage.md (3). */
static inline void fieldmap_iron_link(const fieldmap_iron *map, const double *moments, double *linkages)
{
    enum { LANES = 8, ROWS = 4 };
    const int coils = map->n_coils, rows = 3 * map->p, whole = (rows - 1 - LANES / coils) / ROWS * ROWS;
    int c, i, j;
    for (c = 0; c < coils; c += LANES) {
        const int width = coils - c < LANES ? coils - c : LANES;
        const double *at = map->source + c;
        double w[LANES] = {0}, x[LANES] = {0}, y[LANES] = {0}, z[LANES] = {0};
        /* Lanes beyond the coils read numbers of the next rows, and are ignored. */
        for (i = 0; i < whole; i += ROWS, at += ROWS * coils)
            for (j = 0; j < LANES; j++) {
                w[j] += at[j] * moments[i];
                x[j] += at[coils + j] * moments[i + 1];
                y[j] += at[2 * coils + j] * moments[i + 2];
                z[j] += at[3 * coils + j] * moments[i + 3];
            }
        for (; i < rows; i++, at += coils)
            for (j = 0; j < width; j++) w[j] += at[j] * moments[i];
        for (j = 0; j < width; j++) linkages[c + j] = (w[j] + x[j]) + (y[j] + z[j]);
    }
}

/* Fill linkages[n_coils], as fieldmap_iron_link, of the state of the last solve. */
static inline void fieldmap_iron_linkages(fieldmap_iron_state *s, double *linkages)
{
    const fieldmap_iron *map = s->map;
    int i;
    for (i = 0; i < map->wide; i++) s->rest[i] = i < map->r ? s->amplitudes[(FIELDMAP_IRON_PASSED - 1) * map->r + i] : 0.0;
    fieldmap_iron_evaluate(map, s, s->rest);
    fieldmap_iron_link(map, s->vector, linkages);
}

/* Fill inductance[n_coils], the derivatives of the linkages of the iron with respect to the current of a coil, times mu0:
 * equation (4). The state holds the derivatives of the amplitudes (change) and the moments (susceptible). rough: use the
 * single-precision sums of the tangent, which is about ten times faster. */
static inline void fieldmap_iron_inductance(const fieldmap_iron *map, fieldmap_iron_state *s, int coil, int rough, double *inductance)
{
    const int w = map->wide;
    int p, k;
    for (p = 0; p < map->p; p++) fieldmap_iron_moved(map, s, p, coil, rough, s->step_h + 3 * (size_t)p);
    fieldmap_iron_link(map, s->step_h, inductance);
    for (k = 0; k < map->n_coils && rough; k++)
        inductance[k] -= fieldmap_iron_mixed_dot(s->sides + (size_t)k * (size_t)w, s->change, w);
}

/* For the state of the last solve, fill slopes[n_coils * f + c] = d weights[f] / d currents[c], 1/A, and, unless NULL,
 * linkages[n_coils] and inductance[n_coils * n_coils] of the iron, times mu0. rough: see fieldmap_iron_inductance. */
static inline void fieldmap_iron_slopes_here(
    fieldmap_iron_state *state, double *slopes, double *linkages, double *inductance, int rough)
{
    const fieldmap_iron *map = state->map;
    const int r = map->r, w = map->wide, coils = map->n_coils;
    int c, f, i, k;
    for (f = 0; f < map->n_fields * coils; f++) slopes[f] = 0.0;
    for (i = 0; i < w; i++) state->rest[i] = i < r ? state->amplitudes[(FIELDMAP_IRON_PASSED - 1) * r + i] : 0.0;
    fieldmap_iron_field_at(map, state, state->rest);
    fieldmap_iron_tangent(map, state, coils);
    if (linkages != NULL) fieldmap_iron_link(map, state->moved, linkages);
    for (c = 0; c < coils; c++) {
        slopes[c * coils + c] = 1.0;
        for (i = 0; i < r; i++) state->left[i] = (double)state->sides[(size_t)c * (size_t)w + (size_t)i];
        fieldmap_iron_solve(state, state->left, state->change);
        /* The tangent is summed in single precision; slopes then have a relative error of about 1e-6. For a tolerance below
         * 1e-9 iterative refinement makes it smaller. */
        for (k = 0; k < (state->tolerance < 1e-9 ? 3 : 0); k++) {
            fieldmap_iron_left_of_slope(map, state, c);
            fieldmap_iron_solve(state, state->residual, state->response);
            for (i = 0; i < r; i++) state->change[i] += state->response[i];
        }
        for (f = 0; f < map->k; f++)
            slopes[(coils + f) * coils + c] = fieldmap_iron_product(map->output + (size_t)f * (size_t)r, state->change, r);
        if (inductance != NULL) fieldmap_iron_inductance(map, state, c, rough, inductance + (size_t)c * (size_t)coils);
    }
}

/* As fieldmap_iron_weights, with a hundredth of the tolerance, then fieldmap_iron_slopes_here. */
static inline int fieldmap_iron_linked_slopes(fieldmap_iron_state *state, const double *currents, double *weights,
    double *slopes, double *linkages, double *inductance)
{
    int f, status;
    if (state == NULL || state->map == NULL || currents == NULL || weights == NULL || slopes == NULL)
        return FIELDMAP_ARGUMENT;
    status = fieldmap_iron_solve_at(state, currents, 0.01 * state->tolerance);
    for (f = 0; f < state->map->n_fields; f++) weights[f] = status == FIELDMAP_OK ? state->solution[f] : (double)NAN;
    if (status == FIELDMAP_OK) fieldmap_iron_slopes_here(state, slopes, linkages, inductance, 0);
    for (f = 0; f < state->map->n_fields * state->map->n_coils && status != FIELDMAP_OK; f++) slopes[f] = (double)NAN;
    return status;
}

/* As fieldmap_iron_linked_slopes, without linkages. */
static inline int fieldmap_iron_slopes(
    fieldmap_iron_state *state, const double *currents, double *weights, double *slopes)
{
    return fieldmap_iron_linked_slopes(state, currents, weights, slopes, NULL, NULL);
}

#endif
