"""Field and gradient of one harmonic polynomial of degree 5: the 35 coefficients of a cell, written out.

The five independent second derivatives of the polynomial are harmonic polynomials of degree 3 (16 terms each);
their coefficients are differences of neighbours on the ladder of solid_harmonics, taken on the way. The field
follows from them by Euler's theorem on homogeneous functions, degree by degree (docs/theory/lookup.md (6)):

    B(x) = B(0) + sum_l [second derivatives of degree l at x] x / (l + 1)

About 230 operations for field and gradient, and 36 numbers to fetch. Any other way of writing it (Horner on the
monomials of three components, one table of eight sums a cell) needs more of one or the other.
"""

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map import solid_harmonics
from fieldmap.kernels.map.map_block import (
    INLINED,
    WHOLE,
    InterpolantKernels,
    cell_number,
    in_si,
    local,
    superpose,
)

DEGREE = 5
SIZE = (DEGREE + 1) * (DEGREE + 1)


@njit(**INLINED, forceinline=True)
def field_and_gradient(c, x, y, z):
    """Bx, By, Bz, Gxx, Gxy, Gxz, Gyy, Gyz, Gzz: first and second derivatives of the polynomial c (36,)."""
    # Harmonics of degree 1 to 3: p for the real, q for the imaginary parts.
    rho2 = x * x + y * y
    r2 = rho2 + z * z
    p11, q11 = 0.5 * x, 0.5 * y
    p20 = 0.5 * z * z - 0.25 * rho2
    p21, q21 = z * p11, z * q11
    p22, q22 = 0.25 * (p11 * x - q11 * y), 0.25 * (p11 * y + q11 * x)
    p30 = z * (5.0 * p20 - r2) * (1.0 / 9.0)
    p31, q31 = 0.125 * (5.0 * z * p21 - r2 * p11), 0.125 * (5.0 * z * q21 - r2 * q11)
    p32, q32 = z * p22, z * q22
    p33, q33 = (1.0 / 6.0) * (p22 * x - q22 * y), (1.0 / 6.0) * (p22 * y + q22 * x)

    # Of every degree: zz, 2 xz, 2 yz, 2 (xx - yy), 4 xy. Euler's sums hold the same over degree + 1.
    zz, xz, yz, dd, xy = c[4], c[5], c[6], c[7], c[8]
    ezz, exz, eyz, edd, exy = zz, xz, yz, dd, xy

    a0, a1, b1, a2, b2, a3, b3 = c[9], c[10], c[11], c[12], c[13], c[14], c[15]
    s = a0 * z + a1 * p11 + b1 * q11
    zz += s
    ezz += 0.5 * s
    s = a1 * z + (a2 - 2.0 * a0) * p11 + b2 * q11
    xz += s
    exz += 0.5 * s
    s = b1 * z + b2 * p11 - (a2 + 2.0 * a0) * q11
    yz += s
    eyz += 0.5 * s
    s = a2 * z + (a3 - a1) * p11 + (b3 + b1) * q11
    dd += s
    edd += 0.5 * s
    s = b2 * z + (b3 - b1) * p11 - (a3 + a1) * q11
    xy += s
    exy += 0.5 * s

    third = 1.0 / 3.0
    a0, a1, b1, a2, b2, a3, b3, a4, b4 = c[16], c[17], c[18], c[19], c[20], c[21], c[22], c[23], c[24]
    s = a0 * p20 + a1 * p21 + b1 * q21 + a2 * p22 + b2 * q22
    zz += s
    ezz += third * s
    s = a1 * p20 + (a2 - 2.0 * a0) * p21 + b2 * q21 + (a3 - a1) * p22 + (b3 - b1) * q22
    xz += s
    exz += third * s
    s = b1 * p20 + b2 * p21 - (a2 + 2.0 * a0) * q21 + (b3 + b1) * p22 - (a3 + a1) * q22
    yz += s
    eyz += third * s
    s = a2 * p20 + (a3 - a1) * p21 + (b3 + b1) * q21 + (a4 + 2.0 * a0) * p22 + b4 * q22
    dd += s
    edd += third * s
    s = b2 * p20 + (b3 - b1) * p21 - (a3 + a1) * q21 + b4 * p22 - (a4 - 2.0 * a0) * q22
    xy += s
    exy += third * s

    a0, a1, b1, a2, b2, a3, b3, a4, b4 = c[25], c[26], c[27], c[28], c[29], c[30], c[31], c[32], c[33]
    a5, b5 = c[34], c[35]
    s = a0 * p30 + a1 * p31 + b1 * q31 + a2 * p32 + b2 * q32 + a3 * p33 + b3 * q33
    zz += s
    ezz += 0.25 * s
    s = a1 * p30 + (a2 - 2.0 * a0) * p31 + b2 * q31 + (a3 - a1) * p32 + (b3 - b1) * q32
    s += (a4 - a2) * p33 + (b4 - b2) * q33
    xz += s
    exz += 0.25 * s
    s = b1 * p30 + b2 * p31 - (a2 + 2.0 * a0) * q31 + (b3 + b1) * p32 - (a3 + a1) * q32
    s += (b4 + b2) * p33 - (a4 + a2) * q33
    yz += s
    eyz += 0.25 * s
    s = a2 * p30 + (a3 - a1) * p31 + (b3 + b1) * q31 + (a4 + 2.0 * a0) * p32 + b4 * q32
    s += (a5 + a1) * p33 + (b5 + b1) * q33
    dd += s
    edd += 0.25 * s
    s = b2 * p30 + (b3 - b1) * p31 - (a3 + a1) * q31 + b4 * p32 - (a4 - 2.0 * a0) * q32
    s += (b5 - b1) * p33 - (a5 - a1) * q33
    xy += s
    exy += 0.25 * s

    xz, yz, xy = 0.5 * xz, 0.5 * yz, 0.25 * xy
    exz, eyz, exy = 0.5 * exz, 0.5 * eyz, 0.25 * exy
    xx, exx = 0.25 * dd - 0.5 * zz, 0.25 * edd - 0.5 * ezz
    yy, eyy = -zz - xx, -ezz - exx
    bx = 0.5 * c[2] + exx * x + exy * y + exz * z
    by = 0.5 * c[3] + exy * x + eyy * y + eyz * z
    bz = c[1] + exz * x + eyz * y + ezz * z
    return bx, by, bz, xx, xy, xz, yy, yz, zz


@inlined(**INLINED)
def of_cell(block, c, tx, ty, tz):
    """The twelve results from the polynomial c (36,) of a cell, at coordinates 0..1 in it."""
    x, y, z = local(block, tx, ty, tz)
    return in_si(block, field_and_gradient(c, x, y, z))


@inlined(**INLINED)
def _cell_size(block):
    return SIZE


@njit(**WHOLE)
def _gather(block, weights, i, j, k, out):
    superpose(block, cell_number(block, i, j, k), SIZE, weights, out)


KERNELS = InterpolantKernels(
    _cell_size,
    _gather,
    of_cell,
    solid_harmonics.coefficient_count,
)
