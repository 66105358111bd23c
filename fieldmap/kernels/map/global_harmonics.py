"""Field and gradient of one harmonic polynomial of any degree: a map in a few kilobytes.

The three components of the field and five of its gradient are harmonic polynomials themselves. `expand` takes the
coefficients down the ladder (solid_harmonics) once; what is left at a point is the recurrence of the harmonics,
all orders m of a degree side by side, and eight dot products.

Table of 10 rows, degree^2 numbers each, in the order of solid_harmonics: two rows of factors of the recurrence, then
the coefficients of Bx, By, Bz, Gxx, Gxy, Gxz, Gyy, Gyz.
"""

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map import solid_harmonics
from fieldmap.kernels.map.map_block import (
    DEGREE,
    INLINED,
    WHOLE,
    InterpolantKernels,
    cell_number,
    in_si,
    local,
    superpose,
)
from fieldmap.kernels.map.solid_harmonics import differentiate

ROWS = 10


@njit(**INLINED)
def expand(c, degree, table):
    """table (10 degree^2,) from the coefficients c ((degree + 1)^2,) of the potential."""
    n = degree * degree
    rows = table.reshape((ROWS, n))
    for i in range(table.size):
        table[i] = 0.0
    for l in range(1, degree):
        for t in range(2 * l - 1):
            m = (t + 1) // 2
            rows[0, l * l + t] = (2 * l - 1) / (l * l - m * m)
            rows[1, l * l + t] = 1.0 / (l * l - m * m)
    for i in range(3):
        differentiate(c, degree, i, rows[2 + i])
    for i in range(3):
        differentiate(rows[2], degree - 1, i, rows[5 + i])
    for i in range(1, 3):
        differentiate(rows[3], degree - 1, i, rows[7 + i])


@inlined(**INLINED)
def _harmonics(up, down, degree, x, y, z, out):
    """out (degree^2,): the harmonics of degree 0 to degree - 1, each degree from the two below it."""
    r2 = x * x + y * y + z * z
    out[0] = 1.0
    sector, sector_imaginary = 1.0, 0.0
    for l in range(1, degree):
        one, two, here = (l - 1) * (l - 1), (l - 2) * (l - 2), l * l
        both = max(2 * l - 3, 0)
        for t in range(both):
            out[here + t] = up[here + t] * z * out[one + t] - down[here + t] * r2 * out[two + t]
        for t in range(both, 2 * l - 1):
            out[here + t] = z * out[one + t]
        half = 0.5 / l
        sector, sector_imaginary = (
            half * (x * sector - y * sector_imaginary),
            half * (x * sector_imaginary + y * sector),
        )
        out[here + 2 * l - 1] = sector
        out[here + 2 * l] = sector_imaginary


# "reassoc" lets the sum run in several lanes; unlike the rest of fast-math it assumes nothing about NaN.
@inlined(fastmath={"contract", "reassoc"})
def _dot(row, harmonics, n):
    total = 0.0
    for i in range(n):
        total += row[i] * harmonics[i]
    return total


@njit(**INLINED, forceinline=True)
def field_and_gradient(table, degree, x, y, z, work):
    """Bx, By, Bz, Gxx, Gxy, Gxz, Gyy, Gyz, Gzz of the polynomial behind a table; work (degree^2,)."""
    n = degree * degree
    _harmonics(table[:n], table[n : 2 * n], degree, x, y, z, work)
    bx = _dot(table[2 * n : 3 * n], work, n)
    by = _dot(table[3 * n : 4 * n], work, n)
    bz = _dot(table[4 * n : 5 * n], work, n)
    # The coefficients of the gradient end one degree earlier.
    short = (degree - 1) * (degree - 1)
    xx = _dot(table[5 * n : 6 * n], work, short)
    xy = _dot(table[6 * n : 7 * n], work, short)
    xz = _dot(table[7 * n : 8 * n], work, short)
    yy = _dot(table[8 * n : 9 * n], work, short)
    yz = _dot(table[9 * n :], work, short)
    return bx, by, bz, xx, xy, xz, yy, yz, -xx - yy


@inlined(**INLINED)
def of_table(block, table, work, tx, ty, tz):
    """The twelve results from the table of the polynomial of the whole box; work (degree^2,)."""
    x, y, z = local(block, tx, ty, tz)
    degree = int(block[DEGREE])
    return in_si(block, field_and_gradient(table, degree, x, y, z, work))


@inlined(**INLINED)
def _cell_size(block):
    return ROWS * int(block[DEGREE]) ** 2 + (int(block[DEGREE]) + 1) ** 2


@njit(**WHOLE)
def _gather(block, weights, i, j, k, out):
    """The table, and room to work in."""
    degree = int(block[DEGREE])
    size, table = (degree + 1) ** 2, ROWS * degree**2
    superpose(block, cell_number(block, i, j, k), size, weights, out[table:])
    expand(out[table:], degree, out[:table])


@inlined(**INLINED)
def _gathered(block, numbers, tx, ty, tz):
    table = ROWS * int(block[DEGREE]) ** 2
    return of_table(block, numbers[:table], numbers[table:], tx, ty, tz)


KERNELS = InterpolantKernels(
    _cell_size,
    _gather,
    _gathered,
    solid_harmonics.coefficient_count,
)
