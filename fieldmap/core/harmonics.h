/* harmonics.h: polynomials that solve Laplace's equation, and their derivatives (docs/theory/lookup.md (3) to (6)).
 *
 * A polynomial of degree L has (L + 1)^2 coefficients, in the order a_00; a_10, a_11, b_11; a_20, a_21, b_21, a_22, ...: a_lm
 * at l^2 + 2 m - 1 (l^2 for m = 0), followed by b_lm. It is the sum of a_lm Re R_l^m + b_lm Im R_l^m with the regular solid
 * harmonics R_l^m = r^l P_l^m(cos theta) e^(i m phi) / (l + m)!. In this normalisation (M. A. Epton and B. Dembart, SIAM J.
 * Sci. Comput. 16 (1995) 865) a derivative takes a coefficient to its neighbours, without factors.
 *
 * Successive numbers of a point are `step` apart: 1 for one point, FIELDMAP_LANES for points side by side.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_HARMONICS_H
#define FIELDMAP_HARMONICS_H

#include "real.h"

/* The largest degree of a map bounds the stack. */
#ifndef FIELDMAP_MAX_DEGREE
#define FIELDMAP_MAX_DEGREE 20
#endif
enum { FIELDMAP_MAX_SIZE = (FIELDMAP_MAX_DEGREE + 1) * (FIELDMAP_MAX_DEGREE + 1), FIELDMAP_NINE = 9 };

/* Field and gradient are nine numbers: Bx, By, Bz, Gxx, Gxy, Gxz, Gyy, Gyz, Gzz, in units of the polynomial. */

/* The nine at a point from the coefficients of a polynomial of degree 5, written out.
 *
 * The five different second derivatives are polynomials of degree 3; their coefficients are differences of neighbours. The
 * field follows by Euler's theorem on homogeneous functions: B = B(0) + sum_l [second derivatives of degree l] x / (l + 1).
 * This takes about 230 operations on 36 coefficients. */
FIELDMAP_INLINE void fieldmap_polynomial_5(
    const fm_real *FIELDMAP_RESTRICT c, size_t step, fm_real x, fm_real y, fm_real z, fm_real *FIELDMAP_RESTRICT nine)
{
    const fm_real rho2 = x * x + y * y, r2 = rho2 + z * z, third = FM(1.0 / 3.0);
    /* Harmonics: p the real, q the imaginary parts. */
    const fm_real p11 = FM(0.5) * x, q11 = FM(0.5) * y;
    const fm_real p20 = FM(0.5) * z * z - FM(0.25) * rho2, p21 = z * p11, q21 = z * q11;
    const fm_real p22 = FM(0.25) * (p11 * x - q11 * y), q22 = FM(0.25) * (p11 * y + q11 * x);
    const fm_real p30 = z * (FM(5) * p20 - r2) * FM(1.0 / 9.0);
    const fm_real p31 = FM(0.125) * (FM(5) * z * p21 - r2 * p11), q31 = FM(0.125) * (FM(5) * z * q21 - r2 * q11);
    const fm_real p32 = z * p22, q32 = z * q22;
    const fm_real p33 = FM(1.0 / 6.0) * (p22 * x - q22 * y), q33 = FM(1.0 / 6.0) * (p22 * y + q22 * x);
    /* zz, 2 xz, 2 yz, 2 (xx - yy), 4 xy; and Euler's sums of the same, over l + 1. */
    fm_real zz = c[4 * step], xz = c[5 * step], yz = c[6 * step], dd = c[7 * step], xy = c[8 * step];
    fm_real ezz = zz, exz = xz, eyz = yz, edd = dd, exy = xy, s, xx, yy, exx, eyy;
    fm_real a0 = c[9 * step], a1 = c[10 * step], b1 = c[11 * step], a2 = c[12 * step], b2 = c[13 * step];
    fm_real a3 = c[14 * step], b3 = c[15 * step], a4, b4, a5, b5;

    s = a0 * z + a1 * p11 + b1 * q11;
    zz += s, ezz += FM(0.5) * s;
    s = a1 * z + (a2 - FM(2) * a0) * p11 + b2 * q11;
    xz += s, exz += FM(0.5) * s;
    s = b1 * z + b2 * p11 - (a2 + FM(2) * a0) * q11;
    yz += s, eyz += FM(0.5) * s;
    s = a2 * z + (a3 - a1) * p11 + (b3 + b1) * q11;
    dd += s, edd += FM(0.5) * s;
    s = b2 * z + (b3 - b1) * p11 - (a3 + a1) * q11;
    xy += s, exy += FM(0.5) * s;

    a0 = c[16 * step], a1 = c[17 * step], b1 = c[18 * step], a2 = c[19 * step], b2 = c[20 * step];
    a3 = c[21 * step], b3 = c[22 * step], a4 = c[23 * step], b4 = c[24 * step];
    s = a0 * p20 + a1 * p21 + b1 * q21 + a2 * p22 + b2 * q22;
    zz += s, ezz += third * s;
    s = a1 * p20 + (a2 - FM(2) * a0) * p21 + b2 * q21 + (a3 - a1) * p22 + (b3 - b1) * q22;
    xz += s, exz += third * s;
    s = b1 * p20 + b2 * p21 - (a2 + FM(2) * a0) * q21 + (b3 + b1) * p22 - (a3 + a1) * q22;
    yz += s, eyz += third * s;
    s = a2 * p20 + (a3 - a1) * p21 + (b3 + b1) * q21 + (a4 + FM(2) * a0) * p22 + b4 * q22;
    dd += s, edd += third * s;
    s = b2 * p20 + (b3 - b1) * p21 - (a3 + a1) * q21 + b4 * p22 - (a4 - FM(2) * a0) * q22;
    xy += s, exy += third * s;

    a0 = c[25 * step], a1 = c[26 * step], b1 = c[27 * step], a2 = c[28 * step], b2 = c[29 * step];
    a3 = c[30 * step], b3 = c[31 * step], a4 = c[32 * step], b4 = c[33 * step], a5 = c[34 * step], b5 = c[35 * step];
    s = a0 * p30 + a1 * p31 + b1 * q31 + a2 * p32 + b2 * q32 + a3 * p33 + b3 * q33;
    zz += s, ezz += FM(0.25) * s;
    s = a1 * p30 + (a2 - FM(2) * a0) * p31 + b2 * q31 + (a3 - a1) * p32 + (b3 - b1) * q32 + (a4 - a2) * p33
        + (b4 - b2) * q33;
    xz += s, exz += FM(0.25) * s;
    s = b1 * p30 + b2 * p31 - (a2 + FM(2) * a0) * q31 + (b3 + b1) * p32 - (a3 + a1) * q32 + (b4 + b2) * p33
        - (a4 + a2) * q33;
    yz += s, eyz += FM(0.25) * s;
    s = a2 * p30 + (a3 - a1) * p31 + (b3 + b1) * q31 + (a4 + FM(2) * a0) * p32 + b4 * q32 + (a5 + a1) * p33
        + (b5 + b1) * q33;
    dd += s, edd += FM(0.25) * s;
    s = b2 * p30 + (b3 - b1) * p31 - (a3 + a1) * q31 + b4 * p32 - (a4 - FM(2) * a0) * q32 + (b5 - b1) * p33
        - (a5 - a1) * q33;
    xy += s, exy += FM(0.25) * s;

    xz *= FM(0.5), yz *= FM(0.5), xy *= FM(0.25), exz *= FM(0.5), eyz *= FM(0.5), exy *= FM(0.25);
    xx = FM(0.25) * dd - FM(0.5) * zz, exx = FM(0.25) * edd - FM(0.5) * ezz;
    yy = -zz - xx, eyy = -ezz - exx;
    nine[0] = FM(0.5) * c[2 * step] + exx * x + exy * y + exz * z;
    nine[step] = FM(0.5) * c[3 * step] + exy * x + eyy * y + eyz * z;
    nine[2 * step] = c[step] + exz * x + eyz * y + ezz * z;
    nine[3 * step] = xx, nine[4 * step] = xy, nine[5 * step] = xz;
    nine[6 * step] = yy, nine[7 * step] = yz, nine[8 * step] = zz;
}

/* Index of a_lm; b_lm follows it. */
static inline int fieldmap_place(int l, int m)
{
    return m > 0 ? l * l + 2 * m - 1 : l * l;
}

/* Regular solid harmonics of degree 0 to `degree` at `lanes` points: out[place * lanes + lane]. */
FIELDMAP_INLINE void fieldmap_harmonics(
    int degree, int lanes, const fm_real *FIELDMAP_RESTRICT x, const fm_real *FIELDMAP_RESTRICT y, const fm_real *FIELDMAP_RESTRICT z, fm_real *FIELDMAP_RESTRICT out)
{
    fm_real r2[FIELDMAP_LANES], sector[FIELDMAP_LANES], sector_b[FIELDMAP_LANES];
    fm_real here[FIELDMAP_LANES], here_b[FIELDMAP_LANES], before[FIELDMAP_LANES], before_b[FIELDMAP_LANES];
    fm_real rise[FIELDMAP_LANES], fall[FIELDMAP_LANES];
    int l, m, i;
    for (i = 0; i < lanes; i++) {
        r2[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i];
        sector[i] = FM(1), sector_b[i] = FM(0);
    }
    for (m = 0; m <= degree; m++) {
        const fm_real half = FM(0.5) / (fm_real)(m + 1);
        for (i = 0; i < lanes; i++) {
            here[i] = sector[i], here_b[i] = sector_b[i];
            before[i] = before_b[i] = FM(0);
        }
        for (l = m; l <= degree; l++) {
            const fm_real scale = FM(1) / (fm_real)((l + 1) * (l + 1) - m * m), up = (fm_real)(2 * l + 1) * scale;
            fm_real *to = out + fieldmap_place(l, m) * lanes;
            for (i = 0; i < lanes; i++) {
                fm_real next;
                rise[i] = up * z[i], fall[i] = scale * r2[i];
                next = rise[i] * here[i] - fall[i] * before[i];
                to[i] = here[i];
                before[i] = here[i];
                here[i] = next;
            }
            if (m == 0) continue;
            to += lanes;
            for (i = 0; i < lanes; i++) {
                const fm_real next = rise[i] * here_b[i] - fall[i] * before_b[i];
                to[i] = here_b[i];
                before_b[i] = here_b[i];
                here_b[i] = next;
            }
        }
        for (i = 0; i < lanes; i++) {
            const fm_real a = half * (x[i] * sector[i] - y[i] * sector_b[i]);
            sector_b[i] = half * (x[i] * sector_b[i] + y[i] * sector[i]);
            sector[i] = a;
        }
    }
}

/* As fieldmap_harmonics for degree 4 at one point, written out. */
FIELDMAP_INLINE void fieldmap_harmonics_4(const fm_real *point, fm_real *FIELDMAP_RESTRICT out)
{
    const fm_real x = point[0], y = point[1], z = point[2], r2 = x * x + y * y + z * z;
    out[0] = FM(1);
    out[1] = z, out[2] = FM(0.5) * x, out[3] = FM(0.5) * y;
    out[4] = FM(0.25) * (FM(3) * z * z - r2), out[5] = z * out[2], out[6] = z * out[3];
    out[7] = FM(0.25) * (x * out[2] - y * out[3]), out[8] = FM(0.25) * (x * out[3] + y * out[2]);
    out[9] = FM(1.0 / 9.0) * (FM(5) * z * out[4] - r2 * z);
    out[10] = FM(0.125) * (FM(5) * z * out[5] - r2 * out[2]), out[11] = FM(0.125) * (FM(5) * z * out[6] - r2 * out[3]);
    out[12] = z * out[7], out[13] = z * out[8];
    out[14] = FM(1.0 / 6.0) * (x * out[7] - y * out[8]), out[15] = FM(1.0 / 6.0) * (x * out[8] + y * out[7]);
    out[16] = FM(1.0 / 16.0) * (FM(7) * z * out[9] - r2 * out[4]);
    out[17] = FM(1.0 / 15.0) * (FM(7) * z * out[10] - r2 * out[5]);
    out[18] = FM(1.0 / 15.0) * (FM(7) * z * out[11] - r2 * out[6]);
    out[19] = FM(1.0 / 12.0) * (FM(7) * z * out[12] - r2 * out[7]);
    out[20] = FM(1.0 / 12.0) * (FM(7) * z * out[13] - r2 * out[8]);
    out[21] = z * out[14], out[22] = z * out[15];
    out[23] = FM(0.125) * (x * out[14] - y * out[15]), out[24] = FM(0.125) * (x * out[15] + y * out[14]);
}

/* Add a harmonic at `lanes` points, times its coefficient in each sum, to five sums. */
FIELDMAP_INLINE void fieldmap_add_harmonic(
    int lanes, const fm_real *FIELDMAP_RESTRICT harmonic, fm_real zz, fm_real xz, fm_real yz, fm_real dd, fm_real xy,
    fm_real *FIELDMAP_RESTRICT sums)
{
    int i;
    for (i = 0; i < lanes; i++) sums[i] += zz * harmonic[i];
    for (i = 0; i < lanes; i++) sums[lanes + i] += xz * harmonic[i];
    for (i = 0; i < lanes; i++) sums[2 * lanes + i] += yz * harmonic[i];
    for (i = 0; i < lanes; i++) sums[3 * lanes + i] += dd * harmonic[i];
    for (i = 0; i < lanes; i++) sums[4 * lanes + i] += xy * harmonic[i];
}

/* The nine of one polynomial c at `lanes` points side by side: see fieldmap_polynomial_5.
 *
 * a[m + 2] and b[m + 2]: coefficients of one degree for m = -2 to degree + 2, with R^(-m) = (-1)^m conj R^m; a[2] is doubled,
 * because terms of m = 0 are halved. */
FIELDMAP_INLINE void fieldmap_polynomial(
    const fm_real *FIELDMAP_RESTRICT c, int degree, int lanes, const fm_real *FIELDMAP_RESTRICT x, const fm_real *FIELDMAP_RESTRICT y,
    const fm_real *FIELDMAP_RESTRICT z, fm_real *FIELDMAP_RESTRICT nine)
{
    fm_real harmonics[(FIELDMAP_MAX_DEGREE - 1) * (FIELDMAP_MAX_DEGREE - 1) * FIELDMAP_LANES];
    fm_real sum[5 * FIELDMAP_LANES], euler[5 * FIELDMAP_LANES];
    int l, m, i;
    for (i = 0; i < 5 * lanes; i++) sum[i] = euler[i] = FM(0);
    fieldmap_harmonics(degree - 2, lanes, x, y, z, harmonics);
    for (l = 0; l <= degree - 2; l++) {
        const fm_real *row = c + (l + 2) * (l + 2), share = FM(1) / (fm_real)(l + 1);
        fm_real a[FIELDMAP_MAX_DEGREE + 5], b[FIELDMAP_MAX_DEGREE + 5], part[5 * FIELDMAP_LANES];
        a[2] = FM(2) * row[0];
        b[2] = FM(0);
        for (m = 1; m <= l + 2; m++) {
            a[m + 2] = row[2 * m - 1];
            b[m + 2] = row[2 * m];
        }
        a[1] = -a[3], b[1] = b[3], a[0] = a[4], b[0] = -b[4];
        for (i = 0; i < 5 * lanes; i++) part[i] = FM(0);
        /* Half of the term that the loop would add for m = 0. */
        fieldmap_add_harmonic(lanes, harmonics + l * l * lanes, row[0], a[3], b[3], a[4], b[4], part);
        for (m = 1; m <= l; m++) {
            const fm_real *here = harmonics + fieldmap_place(l, m) * lanes;
            fieldmap_add_harmonic(
                lanes, here, a[m + 2], a[m + 3] - a[m + 1], b[m + 3] + b[m + 1], a[m + 4] + a[m], b[m + 4] - b[m], part);
            fieldmap_add_harmonic(
                lanes, here + lanes, b[m + 2], b[m + 3] - b[m + 1], -a[m + 3] - a[m + 1], b[m + 4] + b[m], a[m] - a[m + 4], part);
        }
        for (i = 0; i < 5 * lanes; i++) {
            sum[i] += part[i];
            euler[i] += share * part[i];
        }
    }
    for (i = 0; i < lanes; i++) {
        const fm_real ezz = euler[i], exz = FM(0.5) * euler[lanes + i], eyz = FM(0.5) * euler[2 * lanes + i];
        const fm_real exy = FM(0.25) * euler[4 * lanes + i], exx = FM(0.25) * euler[3 * lanes + i] - FM(0.5) * ezz;
        const fm_real zz = sum[i], xx = FM(0.25) * sum[3 * lanes + i] - FM(0.5) * zz;
        nine[i] = FM(0.5) * c[2] + exx * x[i] + exy * y[i] + exz * z[i];
        nine[lanes + i] = FM(0.5) * c[3] + exy * x[i] - (ezz + exx) * y[i] + eyz * z[i];
        nine[2 * lanes + i] = c[1] + exz * x[i] + eyz * y[i] + ezz * z[i];
        nine[3 * lanes + i] = xx;
        nine[4 * lanes + i] = FM(0.25) * sum[4 * lanes + i];
        nine[5 * lanes + i] = FM(0.5) * sum[lanes + i];
        nine[6 * lanes + i] = -zz - xx;
        nine[7 * lanes + i] = FM(0.5) * sum[2 * lanes + i];
        nine[8 * lanes + i] = zz;
    }
}

/* out (degree^2 numbers): coefficients of the derivative along an axis of the polynomial c. */
static inline void fieldmap_differentiate(const fm_real *c, int degree, int axis, fm_real *out)
{
    int l, m;
    for (l = 0; l < degree; l++) {
        const fm_real *row = c + (l + 1) * (l + 1);
        for (m = 0; m <= l; m++) {
            const int at = fieldmap_place(l, m);
            /* m = 1 receives from m = 0 twice: R^(-1) is minus the conjugate of R^1. */
            const fm_real fold = m == 1 ? FM(1) : FM(0.5);
            fm_real a = row[m > 0 ? 2 * m - 1 : 0], b = m > 0 ? row[2 * m] : FM(0);
            if (axis != 2) {
                const fm_real below = m > 0 ? fold * row[m > 1 ? 2 * m - 3 : 0] : FM(0);
                const fm_real below_b = m > 1 ? fold * row[2 * m - 2] : FM(0);
                a = axis == 0 ? FM(0.5) * row[2 * m + 1] - below : FM(0.5) * row[2 * m + 2] + below_b;
                b = axis == 0 ? FM(0.5) * row[2 * m + 2] - below_b : FM(-0.5) * row[2 * m + 1] - below;
            }
            out[at] = a;
            if (m > 0) out[at + 1] = b;
        }
    }
}

/* Value of the polynomial c at a point. */
static inline fm_real fieldmap_value(const fm_real *c, int degree, const fm_real *point)
{
    fm_real harmonics[FIELDMAP_MAX_SIZE], total = FM(0);
    int i;
    fieldmap_harmonics(degree, 1, point, point + 1, point + 2, harmonics);
    for (i = 0; i < (degree + 1) * (degree + 1); i++) total += c[i] * harmonics[i];
    return total;
}

/* third[9 * i + 3 * j + k]: the third derivatives of the polynomial c, of degree 3 at least, at a point. */
static inline void fieldmap_third_derivatives(const fm_real *c, int degree, const fm_real *point, fm_real *third)
{
    fm_real one[FIELDMAP_MAX_SIZE], two[FIELDMAP_MAX_SIZE], three[FIELDMAP_MAX_SIZE], harmonics[FIELDMAP_MAX_SIZE];
    const int size = (degree - 2) * (degree - 2);
    int i, j, k, s;
    fieldmap_harmonics(degree - 3, 1, point, point + 1, point + 2, harmonics);
    for (i = 0; i < 3; i++) {
        fieldmap_differentiate(c, degree, i, one);
        for (j = i; j < 3; j++) {
            fieldmap_differentiate(one, degree - 1, j, two);
            for (k = j; k < 3; k++) {
                fm_real total = FM(0);
                fieldmap_differentiate(two, degree - 2, k, three);
                for (s = 0; s < size; s++) total += three[s] * harmonics[s];
                third[9 * i + 3 * j + k] = third[9 * i + 3 * k + j] = third[9 * j + 3 * i + k] = total;
                third[9 * j + 3 * k + i] = third[9 * k + 3 * i + j] = third[9 * k + 3 * j + i] = total;
            }
        }
    }
}

#endif
