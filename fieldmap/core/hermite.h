/* hermite.h: tricubic Hermite interpolation (docs/theory/lookup.md (1)), after C. de Boor, Bicubic spline interpolation, J.
 * Math. Phys. 41 (1962) 212, extended to three variables.
 *
 * A node holds eight numbers for each component: number 4 a + 2 b + c is the derivative of order a, b, c (0 or 1) in x, y, z,
 * times the spacing along each of these axes. A cell has eight corners, corner 4 i + 2 j + k.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_HERMITE_H
#define FIELDMAP_HERMITE_H

#include "real.h"

/* The basis along one axis at t in 0..1, and its first and second derivatives with respect to position. */
typedef struct fieldmap_basis {
    fm_real value[4], slope[4], bend[4];
} fieldmap_basis;

static inline void fieldmap_hermite_basis(fm_real t, fm_real spacing, fieldmap_basis *out)
{
    const fm_real s = FM(1) - t, i = FM(1) / spacing, ii = i * i;
    out->value[0] = (FM(1) + FM(2) * t) * s * s, out->value[1] = t * s * s;
    out->value[2] = t * t * (FM(3) - FM(2) * t), out->value[3] = -t * t * s;
    out->slope[0] = FM(-6) * t * s * i, out->slope[1] = s * (FM(1) - FM(3) * t) * i;
    out->slope[2] = FM(6) * t * s * i, out->slope[3] = t * (FM(3) * t - FM(2)) * i;
    out->bend[0] = (FM(12) * t - FM(6)) * ii, out->bend[1] = (FM(6) * t - FM(4)) * ii;
    out->bend[2] = (FM(6) - FM(12) * t) * ii, out->bend[3] = (FM(6) * t - FM(2)) * ii;
}

/* Interpolation along z between both ends of an edge; m: number of a node's derivative in x and y. */
static inline fm_real fieldmap_hermite_edge(const fm_real *w, const fm_real *near, const fm_real *far, int m)
{
    return w[0] * near[m] + w[1] * near[m + 1] + w[2] * far[m] + w[3] * far[m + 1];
}

/* f, f_x, f_y, f_z of one component, from the eight numbers at each corner. */
static inline void fieldmap_hermite_slopes(const fm_real *const corners[8], const fieldmap_basis axes[3], fm_real out[4])
{
    const fieldmap_basis *x = axes, *y = axes + 1, *z = axes + 2;
    int a, b, d, e;
    out[0] = out[1] = out[2] = out[3] = FM(0);
    for (a = 0; a < 2; a++)
        for (d = 0; d < 2; d++) {
            fm_real s = FM(0), sy = FM(0), sz = FM(0);
            for (b = 0; b < 2; b++) {
                const fm_real *near = corners[4 * a + 2 * b], *far = corners[4 * a + 2 * b + 1];
                for (e = 0; e < 2; e++) {
                    const fm_real v = fieldmap_hermite_edge(z->value, near, far, 4 * d + 2 * e);
                    s += y->value[2 * b + e] * v;
                    sy += y->slope[2 * b + e] * v;
                    sz += y->value[2 * b + e] * fieldmap_hermite_edge(z->slope, near, far, 4 * d + 2 * e);
                }
            }
            out[0] += x->value[2 * a + d] * s;
            out[1] += x->slope[2 * a + d] * s;
            out[2] += x->value[2 * a + d] * sy;
            out[3] += x->value[2 * a + d] * sz;
        }
}

/* f_xx, f_yy, f_zz, f_xy, f_xz, f_yz of one component. */
static inline void fieldmap_hermite_bends(const fm_real *const corners[8], const fieldmap_basis axes[3], fm_real out[6])
{
    const fieldmap_basis *x = axes, *y = axes + 1, *z = axes + 2;
    int a, b, d, e, i;
    for (i = 0; i < 6; i++) out[i] = FM(0);
    for (a = 0; a < 2; a++)
        for (b = 0; b < 2; b++) {
            const fm_real *near = corners[4 * a + 2 * b], *far = corners[4 * a + 2 * b + 1];
            for (d = 0; d < 2; d++)
                for (e = 0; e < 2; e++) {
                    const int m = 4 * d + 2 * e, p = 2 * a + d, q = 2 * b + e;
                    const fm_real v = fieldmap_hermite_edge(z->value, near, far, m);
                    const fm_real vz = fieldmap_hermite_edge(z->slope, near, far, m);
                    out[0] += x->bend[p] * y->value[q] * v;
                    out[1] += x->value[p] * y->bend[q] * v;
                    out[2] += x->value[p] * y->value[q] * fieldmap_hermite_edge(z->bend, near, far, m);
                    out[3] += x->slope[p] * y->slope[q] * v;
                    out[4] += x->slope[p] * y->value[q] * vz;
                    out[5] += x->value[p] * y->slope[q] * vz;
                }
        }
}

#endif
