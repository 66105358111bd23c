"""Regular solid harmonics: every polynomial that solves Laplace's equation, and its derivatives.

    R_l^m = r^l P_l^m(cos theta) e^(i m phi) / (l + m)!                     docs/theory/lookup.md (3)

with the sign of P_l^m that makes R_m^m = (x + i y)^m / (2^m m!). In this normalisation (Epton and Dembart, SIAM J.
Sci. Comput. 16, 1995) a derivative is a step on a ladder, with no factors to carry:

    d/dz R_l^m = R_(l-1)^m     (d/dx - i d/dy) R_l^m = R_(l-1)^(m-1)     (d/dx + i d/dy) R_l^m = -R_(l-1)^(m+1)

A real harmonic polynomial of degree L is sum_l [a_l0 R_l^0 + sum_(m > 0) (a_lm Re R_l^m + b_lm Im R_l^m)], its
(L + 1)^2 coefficients in the order a_00; a_10, a_11, b_11; a_20, a_21, b_21, a_22, b_22; ...: a_lm at l^2 + 2 m - 1
(l^2 for m = 0), b_lm one further.
"""

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.map_block import (
    DEGREE,
    INLINED,
    LENGTH,
    OUTER,
    PER_LENGTH,
    cell_number,
    local,
    superpose,
)


@inlined(**INLINED)
def regular(degree, x, y, z, out):
    """out ((degree + 1)^2,): Re R_l^m and Im R_l^m at (x, y, z), in the order of the coefficients."""
    r2 = x * x + y * y + z * z
    sector, sector_imaginary = 1.0, 0.0
    for m in range(degree + 1):
        before, before_imaginary = 0.0, 0.0
        here, here_imaginary = sector, sector_imaginary
        for l in range(m, degree + 1):
            at = l * l + 2 * m - 1 if m > 0 else l * l
            out[at] = here
            if m > 0:
                out[at + 1] = here_imaginary
            scale = 1.0 / ((l + 1) * (l + 1) - m * m)
            up, down = (2 * l + 1) * z * scale, r2 * scale
            before, here = here, up * here - down * before
            before_imaginary, here_imaginary = (
                here_imaginary,
                up * here_imaginary - down * before_imaginary,
            )
        half = 0.5 / (m + 1)
        sector, sector_imaginary = (
            half * (x * sector - y * sector_imaginary),
            half * (x * sector_imaginary + y * sector),
        )


@inlined(**INLINED)
def _cosine(c, l, m):
    return c[l * l + 2 * m - 1] if m > 0 else c[l * l]


@inlined(**INLINED)
def _sine(c, l, m):
    return c[l * l + 2 * m] if m > 0 else 0.0


# Not inlined: its callers take it up to six times, at a compiler's cost of seconds.
@njit(**OUTER)
def differentiate(c, degree, axis, out):
    """out (degree^2,): coefficients of the derivative along axis 0, 1, 2 of a polynomial c of this degree."""
    for l in range(degree):
        n = l + 1
        for m in range(l + 1):
            at = l * l + 2 * m - 1 if m > 0 else l * l
            # m = 1 receives from m = 0 twice: R^(-1) is minus the conjugate of R^1.
            fold = 2.0 if m == 1 else 1.0
            if axis == 2:
                first, second = _cosine(c, n, m), _sine(c, n, m)
            elif axis == 0:
                first = 0.5 * _cosine(c, n, m + 1)
                second = 0.5 * _sine(c, n, m + 1)
                if m > 0:
                    first -= 0.5 * fold * _cosine(c, n, m - 1)
                    second -= 0.5 * fold * _sine(c, n, m - 1)
            else:
                first = 0.5 * _sine(c, n, m + 1)
                second = -0.5 * _cosine(c, n, m + 1)
                if m > 0:
                    first += 0.5 * fold * _sine(c, n, m - 1)
                    second -= 0.5 * fold * _cosine(c, n, m - 1)
            out[at] = first
            if m > 0:
                out[at + 1] = second


@njit
def derivative_matrix(degree, axis):
    """Matrix (degree^2, (degree + 1)^2) that takes coefficients to those of the derivative."""
    n = (degree + 1) * (degree + 1)
    matrix = np.empty((degree * degree, n))
    unit, column = np.zeros(n), np.empty(degree * degree)
    for i in range(n):
        unit[i] = 1.0
        differentiate(unit, degree, axis, column)
        for k in range(column.size):
            matrix[k, i] = column[k]
        unit[i] = 0.0
    return matrix


@njit
def regular_table(degree, points):
    """(n, (degree + 1)^2): the harmonics at points (n, 3)."""
    table = np.empty((points.shape[0], (degree + 1) * (degree + 1)))
    for p in range(points.shape[0]):
        regular(degree, points[p, 0], points[p, 1], points[p, 2], table[p])
    return table


@inlined(**INLINED)
def potential_sum(c, degree, x, y, z, work):
    """Value of the polynomial; work ((degree + 1)^2,)."""
    regular(degree, x, y, z, work)
    total = 0.0
    for i in range((degree + 1) * (degree + 1)):
        total += c[i] * work[i]
    return total


@njit(**INLINED, forceinline=True)
def third_derivatives(c, degree, x, y, z, work, out):
    """out (3, 3, 3) = all third derivatives of the polynomial; work (4 (degree + 1)^2,), degree at least 3."""
    n = (degree + 1) * (degree + 1)
    first, second, third, harmonics = work[:n], work[n : 2 * n], work[2 * n : 3 * n], work[3 * n : 4 * n]
    size = (degree - 2) * (degree - 2)
    regular(degree - 3, x, y, z, harmonics)
    for i in range(3):
        differentiate(c, degree, i, first)
        for j in range(i, 3):
            differentiate(first, degree - 1, j, second)
            for k in range(j, 3):
                differentiate(second, degree - 2, k, third)
                total = 0.0
                for s in range(size):
                    total += third[s] * harmonics[s]
                out[i, j, k] = out[i, k, j] = out[j, i, k] = total
                out[j, k, i] = out[k, i, j] = out[k, j, i] = total


@inlined(**INLINED)
def polynomial(block, i, j, k, weights):
    """Coefficients of the harmonic polynomial of a cell, superposed."""
    size = (int(block[DEGREE]) + 1) ** 2
    c = np.empty(size)
    superpose(block, cell_number(block, i, j, k), size, weights, c)
    return c


@inlined(**INLINED)
def second_gradient(block, weights, i, j, k, tx, ty, tz, work, out):
    """See `fieldmap.kernels.map.map_block.InterpolantKernels`: of a block of harmonic polynomials."""
    x, y, z = local(block, tx, ty, tz)
    third_derivatives(polynomial(block, i, j, k, weights), int(block[DEGREE]), x, y, z, work, out)
    scale = block[PER_LENGTH] * block[PER_LENGTH]
    for a in range(3):
        for b in range(3):
            for c in range(3):
                out[a, b, c] *= scale


@inlined(**INLINED)
def potential(block, weights, i, j, k, tx, ty, tz, work):
    """See `fieldmap.kernels.map.map_block.InterpolantKernels`: of a block of harmonic polynomials."""
    x, y, z = local(block, tx, ty, tz)
    c = polynomial(block, i, j, k, weights)
    return -block[LENGTH] * potential_sum(c, int(block[DEGREE]), x, y, z, work)


def coefficient_count(degree: int) -> int:
    """Number of coefficients of a harmonic polynomial."""
    return (degree + 1) ** 2
