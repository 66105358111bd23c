/* soft_iron.h: the moment that a field induces in a small ellipsoid of soft iron (docs/theory/wrench.md (5) to (8)).
 *
 * A uniform field b0, T, magnetises an ellipsoid uniformly. Along its axes i, with h = mu0 H and the polarisation J in it,
 *
 *     h_i = b0_i - N_i J_i,   J_i = chi(s) h_i,   s = |h|,   chi = J(s) / s
 *
 * The only unknown is the scalar s, from sum_i b0_i^2 / (s + N_i J(s))^2 = 1, whose left side falls with s. The knots of the
 * law bracket the solution. Newton's method within the bracket ends after a bounded number of steps.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_SOFT_IRON_H
#define FIELDMAP_SOFT_IRON_H

#include "rotation.h"

/* An ellipsoid in a body. centre: m, in the frame of the body; axes[9]: the rotation, row by row, from its own axes to those of
 * the body; factors: demagnetising factors along its axes, with the sum 1; volume: divided by mu0. reluctance: 1 / (mu_r - 1)
 * of a constant permeability, 0 of an infinite one. law: for other iron, 4 * knots numbers: h, J, dJ/dh, T, and the integral of
 * J dh, T^2, at knots; J is constant beyond the last knot. */
typedef struct fieldmap_soft {
    double centre[3], axes[9], factors[3], volume, reluctance;
    int knots;
    const double *law;
} fieldmap_soft;

enum { FIELDMAP_SOFT_STEPS = 60 };

/* State inside a piece: J_i / b0_i along the axes, and, with a law, s, J(s), dJ/dh and the integral of J dh. */
typedef struct fieldmap_inside {
    double by_axis[3], s, j, slope, work;
} fieldmap_inside;

/* (sum_i b0_i^2 / (s + N_i J)^2)^-1/2, which is below 1 if s is too small; squares: of b0. */
static inline double fieldmap_soft_level(const fieldmap_soft *piece, const double *squares, double s, double j)
{
    double sum = 0.0;
    int i;
    for (i = 0; i < 3; i++) {
        const double x = s + piece->factors[i] * j;
        if (x <= 0.0) return 0.0;
        sum += squares[i] / (x * x);
    }
    return 1.0 / sqrt(sum);
}

/* The derivative of fieldmap_soft_level with respect to s. */
static inline double fieldmap_soft_level_slope(
    const fieldmap_soft *piece, const double *squares, const fieldmap_inside *in, double level)
{
    double sum = 0.0;
    int i;
    for (i = 0; i < 3; i++) {
        const double x = in->s + piece->factors[i] * in->j;
        sum += squares[i] * (1.0 + piece->factors[i] * in->slope) / (x * x * x);
    }
    return level * level * level * sum;
}

/* Fill J, dJ/dh and the integral at s, on the piece of the law that begins at knot k. */
static inline void fieldmap_soft_law(const fieldmap_soft *piece, int k, double s, fieldmap_inside *in)
{
    const int n = piece->knots;
    const double *h = piece->law + k, *j = h + n, *slope = j + n, *work = slope + n;
    const double t = s - h[0];
    double width, rise, c2, c3;
    in->s = s;
    if (k == n - 1) {
        in->j = j[0], in->slope = 0.0, in->work = work[0] + j[0] * t;
        return;
    }
    width = h[1] - h[0];
    rise = (j[1] - j[0]) / width;
    c2 = (3.0 * rise - 2.0 * slope[0] - slope[1]) / width;
    c3 = (slope[0] + slope[1] - 2.0 * rise) / (width * width);
    in->j = j[0] + t * (slope[0] + t * (c2 + t * c3));
    in->slope = slope[0] + t * (2.0 * c2 + 3.0 * c3 * t);
    in->work = work[0] + t * (j[0] + t * (slope[0] / 2.0 + t * (c2 / 3.0 + t * c3 / 4.0)));
}

/* Find s, J, dJ/dh and the integral in a piece with a law; b0[3]: field along its axes. */
static inline void fieldmap_soft_solve(const fieldmap_soft *piece, const double *b0, fieldmap_inside *in)
{
    const double rounding = 4e-16, squares[3] = {b0[0] * b0[0], b0[1] * b0[1], b0[2] * b0[2]};
    const int n = piece->knots;
    double most = sqrt(squares[0] + squares[1] + squares[2]), least, s;
    int low = 0, high = n, step;
    in->s = in->j = in->work = 0.0, in->slope = piece->law[2 * n];
    if (most == 0.0) return;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (fieldmap_soft_level(piece, squares, piece->law[middle], piece->law[n + middle]) < 1.0) low = middle;
        else high = middle;
    }
    least = piece->law[low];
    if (low < n - 1) most = fmin(most, piece->law[low + 1]);
    s = low < n - 1 ? 0.5 * (least + most) : most;
    fieldmap_soft_law(piece, low, s, in);
    for (step = 0; step < FIELDMAP_SOFT_STEPS; step++) {
        const double level = fieldmap_soft_level(piece, squares, s, in->j);
        double next, moved;
        if (level < 1.0) least = s;
        else most = s;
        next = s + (1.0 - level) / fieldmap_soft_level_slope(piece, squares, in, level);
        if (!(least <= next && next <= most)) next = 0.5 * (least + most);
        moved = fabs(next - s);
        s = next;
        fieldmap_soft_law(piece, low, s, in);
        if (moved <= rounding * most) break;
    }
}

static inline void fieldmap_soft_inside(const fieldmap_soft *piece, const double *b0, fieldmap_inside *in)
{
    int i;
    in->s = in->j = in->slope = in->work = 0.0;
    if (piece->knots > 0) fieldmap_soft_solve(piece, b0, in);
    for (i = 0; i < 3; i++) {
        const double factor = piece->factors[i];
        if (piece->knots == 0) in->by_axis[i] = 1.0 / (piece->reluctance + factor);
        else if (in->s > 0.0) in->by_axis[i] = in->j / (in->s + factor * in->j);
        else in->by_axis[i] = in->slope / (1.0 + factor * in->slope);
    }
}

/* Fill moment[3], A m^2, in flux[3], T, both in the frame of the body. Returns the energy -integral of m dB, J. */
static inline double fieldmap_induced_moment(const fieldmap_soft *piece, const double *flux, double *moment)
{
    double b0[3], j[3], energy = 0.0;
    fieldmap_inside in;
    int i;
    fieldmap_to_body(piece->axes, flux, b0);
    fieldmap_soft_inside(piece, b0, &in);
    for (i = 0; i < 3; i++) j[i] = in.by_axis[i] * b0[i];
    if (piece->knots == 0) {
        energy = -0.5 * fieldmap_dot(j, b0);
    } else {
        for (i = 0; i < 3; i++) energy += piece->factors[i] * j[i] * j[i];
        energy = -(in.work + 0.5 * energy);
    }
    fieldmap_to_map(piece->axes, j, moment);
    for (i = 0; i < 3; i++) moment[i] *= piece->volume;
    return piece->volume * energy;
}

/* out[9] = r a r^T, all row by row; out is another array. */
static inline void fieldmap_turned_matrix(const double *r, const double *a, double *out)
{
    double half[9];
    int i, k;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++)
            half[3 * i + k] = r[3 * i] * a[k] + r[3 * i + 1] * a[3 + k] + r[3 * i + 2] * a[6 + k];
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) out[3 * i + k] = fieldmap_dot(half + 3 * i, r + 3 * k);
}

/* out[9] = A^-1, both row by row. */
static inline void fieldmap_inverse(const double *A, double *out)
{
    double determinant;
    int i;
    for (i = 0; i < 9; i++) {
        /* Cofactor of the transposed entry. */
        const int row = i % 3, column = i / 3, r1 = (row + 1) % 3, r2 = (row + 2) % 3;
        const int c1 = (column + 1) % 3, c2 = (column + 2) % 3;
        out[i] = A[3 * r1 + c1] * A[3 * r2 + c2] - A[3 * r1 + c2] * A[3 * r2 + c1];
    }
    determinant = A[0] * out[0] + A[1] * out[3] + A[2] * out[6];
    for (i = 0; i < 9; i++) out[i] /= determinant;
}

/* out[9]: dm_i/dB_k, A m^2/T, symmetric, in the frame of the body.
 *
 * From h + N J(h) = b0: dJ/db0 = D (1 + N D)^-1 with D = dJ/dh = chi (1 - u u) + dJ/ds u u, u = h/s. */
static inline void fieldmap_moment_slope(const fieldmap_soft *piece, const double *flux, double *out)
{
    double b0[3], D[9] = {0.0}, A[9], inverse[9];
    fieldmap_inside in;
    int i, k;
    fieldmap_to_body(piece->axes, flux, b0);
    fieldmap_soft_inside(piece, b0, &in);
    if (in.s > 0.0) {
        const double chi = in.j / in.s, turned = in.slope - chi;
        double u[3], product[9];
        for (i = 0; i < 3; i++) u[i] = b0[i] / (in.s + piece->factors[i] * in.j);
        for (i = 0; i < 3; i++)
            for (k = 0; k < 3; k++) {
                D[3 * i + k] = turned * u[i] * u[k] + (i == k ? chi : 0.0);
                A[3 * i + k] = piece->factors[i] * D[3 * i + k] + (i == k ? 1.0 : 0.0);
            }
        fieldmap_inverse(A, inverse);
        for (i = 0; i < 3; i++)
            for (k = 0; k < 3; k++)
                product[3 * i + k] = D[3 * i] * inverse[k] + D[3 * i + 1] * inverse[3 + k] + D[3 * i + 2] * inverse[6 + k];
        for (i = 0; i < 3; i++)
            for (k = 0; k < 3; k++) D[3 * i + k] = 0.5 * (product[3 * i + k] + product[3 * k + i]);
    } else {
        for (i = 0; i < 3; i++) D[4 * i] = in.by_axis[i];
    }
    fieldmap_turned_matrix(piece->axes, D, out);
    for (i = 0; i < 9; i++) out[i] *= piece->volume;
}

#endif
