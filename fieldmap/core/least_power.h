/* least_power.h: currents of least power within limits that meet a linear demand: a strictly convex quadratic program.
 *
 *     min sum_k w_k i_k^2    with    A i = b,   lower <= i <= upper                  docs/theory/actuation.md (5)
 *
 * In x_k = sqrt(w_k) i_k the currents that meet the demand are x0 + N y: x0 is the shortest of them, and N an orthonormal basis
 * of the null space of the demand's matrix (pivoted QR). The problem is then to find the shortest y with G y >= h. Lawson and
 * Hanson (Solving Least Squares Problems, 1974, ch. 23, LDP) reduce it to non-negative least squares. This active-set method
 * ends after finitely many steps, and either finds y or proves that there is none. Nothing is allocated.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_LEAST_POWER_H
#define FIELDMAP_LEAST_POWER_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { FIELDMAP_POWER_FOUND, FIELDMAP_POWER_OUT_OF_RANGE, FIELDMAP_POWER_BEYOND_LIMITS, FIELDMAP_POWER_NO_END };

/* The problem: matrix (rows, coils), demand[rows]; lower, upper, weight[coils], weights above 0; limits may be infinite. */
typedef struct fieldmap_power_demand {
    int rows, coils;
    const double *matrix, *demand, *lower, *upper, *weight;
} fieldmap_power_demand;

/* Non-negative least squares: `count` columns of `size` numbers, of length 1, a target, and work space. q (count + 1, size), r
 * (count + 1, count + 1); chosen, inside[count]: the active set; barred[count]: columns that must not enter it now. */
typedef struct fieldmap_nnls {
    int count, size, chosen_count;
    const double *columns, *target;
    double *q, *r, *trial, *residual;
    int *chosen, *inside, *barred;
} fieldmap_nnls;

static inline double fieldmap_inner(const double *a, const double *b, int count)
{
    double total = 0.0;
    int i;
    for (i = 0; i < count; i++) total += a[i] * b[i];
    return total;
}

static inline double fieldmap_length(const double *a, int count)
{
    return sqrt(fieldmap_inner(a, a, count));
}

/* a += factor b */
static inline void fieldmap_add_times(double *a, double factor, const double *b, int count)
{
    int i;
    for (i = 0; i < count; i++) a[i] += factor * b[i];
}

/* Fill trial[chosen_count] of min |sum_p trial_p columns[chosen[p]] - target|, by modified Gram-Schmidt with the target as last
 * column. Returns 0 if the chosen columns are linearly dependent. */
static inline int fieldmap_nnls_least_squares(fieldmap_nnls *s)
{
    const int size = s->size, n = s->chosen_count, width = s->count + 1;
    int p, other;
    for (p = 0; p <= n; p++) {
        const double *from = p < n ? s->columns + (size_t)s->chosen[p] * (size_t)size : s->target;
        memcpy(s->q + (size_t)p * (size_t)size, from, (size_t)size * sizeof(double));
    }
    for (p = 0; p < n; p++) {
        const double before = fieldmap_length(s->columns + (size_t)s->chosen[p] * (size_t)size, size);
        const double *own = s->q + (size_t)p * (size_t)size;
        const double length = fieldmap_length(own, size);
        s->r[p * width + p] = length;
        if (!(length > 1e-10 * before)) return 0;
        for (other = p + 1; other <= n; other++) {
            double *vector = s->q + (size_t)other * (size_t)size;
            const double share = fieldmap_inner(own, vector, size) / length;
            s->r[p * width + other] = share;
            fieldmap_add_times(vector, -share / length, own, size);
        }
    }
    for (p = n - 1; p >= 0; p--) {
        double total = s->r[p * width + n];
        for (other = p + 1; other < n; other++) total -= s->r[p * width + other] * s->trial[other];
        s->trial[p] = total / s->r[p * width + p];
    }
    return 1;
}

/* residual = target - sum_j u_j columns[j] */
static inline void fieldmap_nnls_left_over(fieldmap_nnls *s, const double *u)
{
    int j;
    memcpy(s->residual, s->target, (size_t)s->size * sizeof(double));
    for (j = 0; j < s->count; j++)
        if (u[j] != 0.0) fieldmap_add_times(s->residual, -u[j], s->columns + (size_t)j * (size_t)s->size, s->size);
}

/* The column outside the active set with the steepest descent, or -1. */
static inline int fieldmap_nnls_steepest(const fieldmap_nnls *s)
{
    double best = 1e-13;
    int found = -1, j;
    for (j = 0; j < s->count; j++) {
        double promise;
        if (s->inside[j] || s->barred[j]) continue;
        promise = fieldmap_inner(s->columns + (size_t)j * (size_t)s->size, s->residual, s->size);
        if (promise > best) best = promise, found = j;
    }
    return found;
}

static inline double fieldmap_nnls_lowest_trial(const fieldmap_nnls *s)
{
    double lowest = (double)INFINITY;
    int p;
    for (p = 0; p < s->chosen_count; p++) lowest = s->trial[p] < lowest ? s->trial[p] : lowest;
    return lowest;
}

/* Go from u towards the trial until a number reaches zero, and drop it from the active set. Returns whether one was dropped. */
static inline int fieldmap_nnls_step_back(fieldmap_nnls *s, double *u)
{
    const int before = s->chosen_count;
    double step = 1.0;
    int p, kept = 0;
    for (p = 0; p < before; p++) {
        const double here = u[s->chosen[p]];
        if (s->trial[p] <= 0.0 && here / (here - s->trial[p]) < step) step = here / (here - s->trial[p]);
    }
    for (p = 0; p < before; p++) {
        const int j = s->chosen[p];
        u[j] += step * (s->trial[p] - u[j]);
        if (s->trial[p] <= 0.0 && u[j] <= 1e-14) u[j] = 0.0, s->inside[j] = 0;
        else s->chosen[kept++] = j;
    }
    s->chosen_count = kept;
    return kept < before;
}

/* Fill u[count] >= 0 of min |sum_j u_j columns[j] - target|: NNLS of Lawson and Hanson. Returns 0 if there is no end. */
static inline int fieldmap_nnls_solve(fieldmap_nnls *s, double *u)
{
    int turn, p;
    s->chosen_count = 0;
    for (p = 0; p < s->count; p++) u[p] = 0.0, s->inside[p] = s->barred[p] = 0;
    for (turn = 0; turn < 10 * s->count + 10; turn++) {
        int found, solved;
        fieldmap_nnls_left_over(s, u);
        found = fieldmap_nnls_steepest(s);
        if (found < 0 || s->chosen_count == s->size) return 1;
        s->chosen[s->chosen_count++] = found;
        solved = fieldmap_nnls_least_squares(s);
        if (!solved || s->trial[s->chosen_count - 1] <= 0.0) {
            s->chosen_count--;
            s->barred[found] = 1;
            continue;
        }
        s->inside[found] = 1;
        for (p = 0; p < s->count; p++) s->barred[p] = 0;
        while (s->chosen_count > 0 && fieldmap_nnls_lowest_trial(s) <= 0.0)
            if (!fieldmap_nnls_step_back(s, u) || !fieldmap_nnls_least_squares(s)) return 0;
        for (p = 0; p < s->chosen_count; p++) u[s->chosen[p]] = s->trial[p];
    }
    return 0;
}

/* Numbers of room for non-negative least squares. */
static inline size_t fieldmap_nnls_room(size_t count, size_t size)
{
    return (count + 1) * size + (count + 1) * (count + 1) + count + size;
}

static inline void fieldmap_nnls_lay_out(fieldmap_nnls *s, double *room, int *marks)
{
    const size_t count = (size_t)s->count, size = (size_t)s->size;
    s->q = room, s->r = s->q + (count + 1) * size, s->trial = s->r + (count + 1) * (count + 1);
    s->residual = s->trial + count;
    s->chosen = marks, s->inside = marks + count, s->barred = marks + 2 * count;
}

/* Numbers of room, and numbers of marks, that fieldmap_least_power needs. */
static inline size_t fieldmap_least_power_room(int rows, int coils)
{
    const size_t m = (size_t)rows, n = (size_t)coils;
    return m * n + m + n * n + 7 * n + 2 * n * (n + 1) + (n + 1) + fieldmap_nnls_room(2 * n, n + 1);
}

static inline size_t fieldmap_least_power_marks(int coils)
{
    return 6 * (size_t)coils;
}

/* Swap the row that is longest from column p on into place p. Returns this length. */
static inline double fieldmap_power_pivot(double *rows, double *demand, int m, int n, int p)
{
    double best = -1.0, swap;
    int found = p, c, s;
    for (c = p; c < m; c++) {
        const double size = fieldmap_length(rows + c * n + p, n - p);
        if (size > best) best = size, found = c;
    }
    for (s = 0; s < n; s++) swap = rows[p * n + s], rows[p * n + s] = rows[found * n + s], rows[found * n + s] = swap;
    swap = demand[p], demand[p] = demand[found], demand[found] = swap;
    return fieldmap_length(rows + p * n + p, n - p);
}

/* One Householder step: reflect row p onto its diagonal, and apply the reflection to the basis. v[n]: room. */
static inline void fieldmap_power_reflect(double *rows, double *basis, int m, int n, int p, double size, double *v)
{
    const int left = n - p;
    double twice;
    int c, s, i;
    memcpy(v, rows + p * n + p, (size_t)left * sizeof(double));
    v[0] += v[0] >= 0.0 ? size : -size;
    twice = 2.0 / fieldmap_inner(v, v, left);
    for (c = p; c < m; c++) {
        double *row = rows + c * n + p;
        fieldmap_add_times(row, -twice * fieldmap_inner(v, row, left), v, left);
    }
    for (s = 0; s < n; s++) {
        double total = 0.0;
        for (i = 0; i < left; i++) total += v[i] * basis[(p + i) * n + s];
        for (i = 0; i < left; i++) basis[(p + i) * n + s] -= twice * total * v[i];
    }
}

/* Fill x[n], the shortest solution of rows x = demand; off, the distance of the demand from the range; and an orthonormal basis
 * (n, n), whose vectors after the rank span the null space of the rows (m, n). Returns the rank. The method is Householder's QR
 * of the transposed rows, with pivoting. Rows and demand are overwritten. A pivot below 1e-9 of the largest is rounding and
 * does not count in the rank. */
static inline int fieldmap_power_meet(double *rows, double *demand, int m, int n, double *x, double *basis, double *v, double *off)
{
    double largest = 0.0;
    int rank = 0, c, p, s;
    memset(basis, 0, (size_t)n * (size_t)n * sizeof(double));
    for (s = 0; s < n; s++) basis[s * n + s] = 1.0, x[s] = 0.0;
    for (p = 0; p < (m < n ? m : n); p++) {
        const double size = fieldmap_power_pivot(rows, demand, m, n, p);
        double z;
        largest = fmax(largest, size);
        if (!(size > 1e-9 * largest)) break;
        fieldmap_power_reflect(rows, basis, m, n, p, size, v);
        z = demand[p];
        for (s = 0; s < p; s++) z -= rows[p * n + s] * demand[s];
        demand[p] = z / rows[p * n + p];
        fieldmap_add_times(x, demand[p], basis + p * n, n);
        rank++;
    }
    *off = 0.0;
    for (c = rank; c < m; c++) *off = fmax(*off, fabs(demand[c] - fieldmap_inner(rows + c * n, demand, rank)));
    return rank;
}

/* Largest excess of x[n] over the limits; below 0 within them. */
static inline double fieldmap_power_excess(const double *x, const double *low, const double *high, int n)
{
    double worst = -(double)INFINITY;
    int k;
    for (k = 0; k < n; k++) {
        if (low[k] - x[k] > worst) worst = low[k] - x[k];
        if (x[k] - high[k] > worst) worst = x[k] - high[k];
    }
    return worst;
}

/* Fill x[n] = start + sum_j y_j basis[j] for the shortest y with low <= x <= high; basis (d, n); active[n]: -1, 0 or 1. */
static inline int fieldmap_power_shortest(const double *basis, int d, int n, const double *start, const double *low,
                                          const double *high, double *x, int64_t *active, double *room, int *marks)
{
    const int size = d + 1;
    double *columns = room, *target = columns + (size_t)(2 * n) * (size_t)size, *u = target + size;
    fieldmap_nnls s;
    int j, k, side;
    s.count = 2 * n, s.size = size, s.columns = columns, s.target = target;
    fieldmap_nnls_lay_out(&s, u + 2 * n, marks);
    memset(columns, 0, (size_t)(2 * n) * (size_t)size * sizeof(double));
    for (k = 0; k < n; k++)
        for (side = 0; side < 2; side++) {
            const double sign = side ? -1.0 : 1.0, limit = side ? high[k] : low[k];
            double *row = columns + (size_t)(side * n + k) * (size_t)size, length;
            if (!isfinite(limit)) continue;
            for (j = 0; j < d; j++) row[j] = sign * basis[j * n + k];
            row[d] = sign * (limit - start[k]);
            length = fieldmap_length(row, size);
            for (j = 0; j < size && length > 0.0; j++) row[j] /= length;
        }
    for (j = 0; j < d; j++) target[j] = 0.0;
    target[d] = 1.0;
    if (!fieldmap_nnls_solve(&s, u)) return FIELDMAP_POWER_NO_END;
    fieldmap_nnls_left_over(&s, u);
    for (k = 0; k < n; k++) active[k] = (u[n + k] > 0.0) - (u[k] > 0.0);
    if (!(fabs(s.residual[d]) > 1e-14)) return FIELDMAP_POWER_BEYOND_LIMITS;
    memcpy(x, start, (size_t)n * sizeof(double));
    for (j = 0; j < d; j++) fieldmap_add_times(x, -s.residual[j] / s.residual[d], basis + j * n, n);
    return FIELDMAP_POWER_FOUND;
}

/* Apply the limits. start[n]: x0; basis (d, n): of the null space. A limit may be exceeded by 1e-11 of the largest number
 * before clipping. */
static inline int fieldmap_power_within(const fieldmap_power_demand *of, const double *basis, int d, double *start,
                                        const double *root, double *currents, int64_t *active, double *room, int *marks)
{
    const int n = of->coils;
    double *low = room, *high = low + n, *x = high + n, scale = 0.0, slack;
    int k, status;
    for (k = 0; k < n; k++) {
        low[k] = of->lower[k] * root[k], high[k] = of->upper[k] * root[k], x[k] = start[k];
        if (isfinite(start[k])) scale = fmax(scale, fabs(start[k]));
        if (isfinite(low[k])) scale = fmax(scale, fabs(low[k]));
        if (isfinite(high[k])) scale = fmax(scale, fabs(high[k]));
    }
    /* Numbers are divided by the largest limit or current, because the active-set method has absolute tolerances. */
    if (scale == 0.0) scale = 1.0;
    slack = 1e-11 * scale;
    if (fieldmap_power_excess(x, low, high, n) > slack) {
        if (d == 0) {
            for (k = 0; k < n; k++) active[k] = (start[k] > high[k] + slack) - (start[k] < low[k] - slack);
            return FIELDMAP_POWER_BEYOND_LIMITS;
        }
        for (k = 0; k < n; k++) start[k] /= scale, low[k] /= scale, high[k] /= scale;
        status = fieldmap_power_shortest(basis, d, n, start, low, high, x, active, x + n, marks);
        if (status != FIELDMAP_POWER_FOUND) return status;
        for (k = 0; k < n; k++) x[k] *= scale, low[k] *= scale, high[k] *= scale;
        if (!(fieldmap_power_excess(x, low, high, n) <= slack)) return FIELDMAP_POWER_BEYOND_LIMITS;
    }
    for (k = 0; k < n; k++) currents[k] = fmin(fmax(x[k] / root[k], of->lower[k]), of->upper[k]);
    return FIELDMAP_POWER_FOUND;
}

/* Fill currents[coils], and active[coils], the limits that they lie on: -1 lower, 1 upper, 0 none. If the status is
 * FIELDMAP_POWER_BEYOND_LIMITS, active marks the limits that together exclude the demand, and currents are those without
 * limits. room, marks: see fieldmap_least_power_room and fieldmap_least_power_marks.
 *
 * Rows are scaled to length 1; a row below 1e-7 of the longest is divided by 1e-7 of the longest instead. A demand is out of
 * range if its distance from the range of the matrix exceeds 1e-9 of its largest number. */
static inline int fieldmap_least_power(
    const fieldmap_power_demand *of, double *room, int *marks, double *currents, int64_t *active)
{
    const int m = of->rows, n = of->coils;
    double *rows = room, *rest = rows + m * n, *root = rest + m, *basis = root + n, *start = basis + n * n, *v = start + n;
    double longest = 0.0, size = 0.0, off;
    int rank, r, k;
    for (k = 0; k < n; k++) root[k] = sqrt(of->weight[k]);
    for (r = 0; r < m; r++) {
        for (k = 0; k < n; k++) rows[r * n + k] = of->matrix[r * n + k] / root[k];
        longest = fmax(longest, fieldmap_length(rows + r * n, n));
    }
    for (r = 0; r < m; r++) {
        const double length = fmax(fieldmap_length(rows + r * n, n), 1e-7 * longest);
        rest[r] = length > 0.0 ? of->demand[r] / length : of->demand[r];
        for (k = 0; k < n && length > 0.0; k++) rows[r * n + k] /= length;
        size = fmax(size, fabs(rest[r]));
    }
    rank = fieldmap_power_meet(rows, rest, m, n, start, basis, v, &off);
    for (k = 0; k < n; k++) active[k] = 0, currents[k] = start[k] / root[k];
    if (off > 1e-9 * size) return FIELDMAP_POWER_OUT_OF_RANGE;
    return fieldmap_power_within(of, basis + rank * n, n - rank, start, root, currents, active, v, marks);
}

#endif
