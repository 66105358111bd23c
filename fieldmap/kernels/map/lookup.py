"""Room for the coefficients of one cell on the stack.

An array from the heap costs 50 ns, a third of what a lookup at one point computes. Numba has no arrays on the stack, so
this takes the memory with LLVM's alloca and looks at it as an array. It lives as long as the function that called
`cell_scratch`; both decorators below make sure that this is the caller and not a function in between.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, njit, types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from fieldmap.kernels.map import cell_harmonics, global_harmonics, hermite
from fieldmap.kernels.map.cell_harmonics import SIZE
from fieldmap.kernels.map.map_block import (
    CELL_HARMONIC,
    CELLS,
    DEGREE,
    GLOBAL_HARMONIC,
    HEADER,
    INLINED,
    INSIDE,
    KIND,
    LENGTH,
    LOCAL,
    OUTER,
    OUTSIDE,
    PER_LENGTH,
    SETS,
    WRONG_SHAPE,
    cell_number,
    locate,
    node_number,
    superpose,
)
from fieldmap.kernels.map.solid_harmonics import potential_sum, third_derivatives


@intrinsic
def _on_stack(_: Any) -> Any:
    signature = types.CPointer(types.float64)()

    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return cgutils.alloca_once(builder, ir.DoubleType(), size=SIZE)

    return signature, generate


def cell_scratch() -> Any:
    """An array (36,) of anything, not to be returned."""
    return np.empty(SIZE)


@overload(cell_scratch, inline="always")
def _cell_scratch() -> Any:
    return lambda: carray(_on_stack(), (SIZE,))  # type: ignore[call-arg]


NAN = np.nan
NODE = 24  # numbers of one set at a node: three components of eight


@njit(**INLINED)
def _local(block, tx, ty, tz):
    """Coordinates from the middle of the cell, in LENGTHs."""
    return (tx - 0.5) * block[LOCAL], (ty - 0.5) * block[LOCAL + 1], (tz - 0.5) * block[LOCAL + 2]


@njit(**INLINED)
def _symmetric(block, nine):
    """The twelve results from field and the six different entries of the gradient, in SI."""
    bx, by, bz, xx, xy, xz, yy, yz, zz = nine
    s = block[PER_LENGTH]
    xx, xy, xz, yy, yz, zz = s * xx, s * xy, s * xz, s * yy, s * yz, s * zz
    return bx, by, bz, xx, xy, xz, xy, yy, yz, xz, yz, zz


@njit(**INLINED)
def of_cell(block, c, tx, ty, tz):
    """The twelve results from the polynomial c (36,) of a cell, at coordinates 0..1 in it."""
    x, y, z = _local(block, tx, ty, tz)
    return _symmetric(block, cell_harmonics.field_and_gradient(c, x, y, z))


@njit(**INLINED)
def of_table(block, table, work, tx, ty, tz):
    """The twelve results from the table of the polynomial of the whole box; work (degree^2,)."""
    x, y, z = _local(block, tx, ty, tz)
    degree = int(block[DEGREE])
    return _symmetric(block, global_harmonics.field_and_gradient(table, degree, x, y, z, work))


@njit(**INLINED)
def _work(block):
    return np.empty(int(block[DEGREE]) ** 2)


@njit(**INLINED)
def of_nodes(block, nodes, i, j, k, first, tx, ty, tz):
    """Hermite form: channels first, first + 1, first + 2 of the nodes' coefficients (nx, ny, nz, channels, 8)."""
    wx, wy, wz = hermite.basis(tx), hermite.basis(ty), hermite.basis(tz)
    dx = hermite.basis_slope(tx, block[LOCAL])
    dy = hermite.basis_slope(ty, block[LOCAL + 1])
    dz = hermite.basis_slope(tz, block[LOCAL + 2])
    bx, xx, xy, xz = hermite.value_and_slopes(nodes, i, j, k, first, wx, wy, wz, dx, dy, dz)
    by, yx, yy, yz = hermite.value_and_slopes(nodes, i, j, k, first + 1, wx, wy, wz, dx, dy, dz)
    bz, zx, zy, zz = hermite.value_and_slopes(nodes, i, j, k, first + 2, wx, wy, wz, dx, dy, dz)
    return bx, by, bz, xx, xy, xz, yx, yy, yz, zx, zy, zz


@njit(**INLINED)
def _nodes(block, channels):
    """The coefficients of a Hermite block as (nx, ny, nz, channels, 8)."""
    nx, ny, nz = int(block[CELLS]) + 1, int(block[CELLS + 1]) + 1, int(block[CELLS + 2]) + 1
    return block[HEADER:].reshape((nx, ny, nz, channels, 8))


@njit(**INLINED)
def _corners(block, i, j, k, size, currents):
    """Coefficients (2, 2, 2, size / 8, 8) of a cell's corners, superposed."""
    corners = np.empty((8, size))
    for corner in range(8):
        node = node_number(block, i + corner // 4, j + corner // 2 % 2, k + corner % 2)
        superpose(block, node, size, currents, corners[corner])
    return corners.reshape((2, 2, 2, size // 8, 8))


@njit(**INLINED)
def _polynomial(block, i, j, k, currents):
    """Coefficients of the harmonic polynomial of a cell, superposed."""
    size = (int(block[DEGREE]) + 1) ** 2
    c = np.empty(size)
    superpose(block, cell_number(block, i, j, k), size, currents, c)
    return c


@njit(**INLINED)
def contracted_at(block, x, y, z):
    """(status, the three of the field, the nine of its gradient) from a block at given currents."""
    status, i, j, k, tx, ty, tz = locate(block, x, y, z)
    if status != INSIDE:
        return status, (NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    if block[KIND] == CELL_HARMONIC:
        first = HEADER + cell_number(block, i, j, k) * cell_harmonics.SIZE
        return status, of_cell(block, block[first : first + cell_harmonics.SIZE], tx, ty, tz)
    if block[KIND] == GLOBAL_HARMONIC:
        first = HEADER + (int(block[DEGREE]) + 1) ** 2
        return status, of_table(block, block[first:], _work(block), tx, ty, tz)
    return status, of_nodes(block, _nodes(block, 3), i, j, k, 0, tx, ty, tz)


@njit(**INLINED)
def superposed_at(block, currents, x, y, z):
    """As `contracted_at`, from a block with a set per coil and the currents (n_coils,)."""
    status, i, j, k, tx, ty, tz = locate(block, x, y, z)
    if status != INSIDE:
        return status, (NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    if block[KIND] == CELL_HARMONIC:
        c = cell_scratch()
        superpose(block, cell_number(block, i, j, k), cell_harmonics.SIZE, currents, c)
        return status, of_cell(block, c, tx, ty, tz)
    if block[KIND] == GLOBAL_HARMONIC:
        degree = int(block[DEGREE])
        table = np.empty(global_harmonics.ROWS * degree * degree)
        global_harmonics.expand(_polynomial(block, i, j, k, currents), degree, table)
        return status, of_table(block, table, _work(block), tx, ty, tz)
    return status, of_nodes(block, _corners(block, i, j, k, NODE, currents), 0, 0, 0, 0, tx, ty, tz)


@njit(**INLINED)
def _store(values, flux, slope):
    """Write the three and, unless slope is empty, the nine."""
    flux[0], flux[1], flux[2] = values[0], values[1], values[2]
    if slope.shape[0]:
        slope[0, 0], slope[0, 1], slope[0, 2] = values[3], values[4], values[5]
        slope[1, 0], slope[1, 1], slope[1, 2] = values[6], values[7], values[8]
        slope[2, 0], slope[2, 1], slope[2, 2] = values[9], values[10], values[11]


@njit(**OUTER)
def evaluate(block, points, flux, slope):
    """flux (n, 3) and slope (n, 3, 3), or (n, 0, 0) for the field alone. Returns how many points lie outside."""
    outside = 0
    for p in range(points.shape[0]):
        status, values = contracted_at(block, points[p, 0], points[p, 1], points[p, 2])
        outside += status == OUTSIDE
        _store(values, flux[p], slope[p])
    return outside


@njit(**OUTER)
def evaluate_with(block, currents, points, flux, slope):
    """As `evaluate`, with currents (n, n_coils) or (1, n_coils) superposed at every point."""
    outside = 0
    for p in range(points.shape[0]):
        row = currents[p if currents.shape[0] > 1 else 0]
        status, values = superposed_at(block, row, points[p, 0], points[p, 1], points[p, 2])
        outside += status == OUTSIDE
        _store(values, flux[p], slope[p])
    return outside


# To release the interpreter's lock and take it back costs more than others could do in the meantime.
@njit(**{**OUTER, "nogil": False})
def evaluate_one(block, point, flux, slope):
    """Field and gradient at one point (3,); the status."""
    if point.shape[0] != 3 or flux.shape[0] != 3 or slope.shape != (3, 3):
        return WRONG_SHAPE
    status, values = contracted_at(block, point[0], point[1], point[2])
    _store(values, flux, slope)
    return status


@njit(**{**OUTER, "nogil": False})
def evaluate_one_with(block, currents, point, flux, slope):
    """Field and gradient at one point (3,) and currents (n_coils,); the status."""
    if point.shape[0] != 3 or flux.shape[0] != 3 or slope.shape != (3, 3):
        return WRONG_SHAPE
    if currents.shape[0] != int(block[SETS]):
        return WRONG_SHAPE
    status, values = superposed_at(block, currents, point[0], point[1], point[2])
    _store(values, flux, slope)
    return status


@njit(**INLINED)
def _unit_at(block, s, i, j, k, tx, ty, tz):
    """The twelve of set s by itself at a place inside."""
    if block[KIND] == CELL_HARMONIC:
        place = cell_number(block, i, j, k) * int(block[SETS]) + s
        first = HEADER + place * cell_harmonics.SIZE
        return of_cell(block, block[first : first + cell_harmonics.SIZE], tx, ty, tz)
    if block[KIND] == GLOBAL_HARMONIC:
        degree = int(block[DEGREE])
        size = (degree + 1) ** 2
        table = np.empty(global_harmonics.ROWS * degree * degree)
        global_harmonics.expand(block[HEADER + s * size : HEADER + (s + 1) * size], degree, table)
        return of_table(block, table, _work(block), tx, ty, tz)
    return of_nodes(block, _nodes(block, 3 * int(block[SETS])), i, j, k, 3 * s, tx, ty, tz)


@njit(**OUTER)
def evaluate_units(block, points, flux, slope):
    """flux (n, n_coils, 3) and slope (n, n_coils, 3, 3) of every set by itself. Returns how many lie outside."""
    outside = 0
    for p in range(points.shape[0]):
        status, i, j, k, tx, ty, tz = locate(block, points[p, 0], points[p, 1], points[p, 2])
        outside += status == OUTSIDE
        if status != INSIDE:
            flux[p] = NAN
            slope[p] = NAN
            continue
        for s in range(flux.shape[1]):
            _store(_unit_at(block, s, i, j, k, tx, ty, tz), flux[p, s], slope[p, s])
    return outside


@njit(**OUTER)
def second_gradient(block, currents, points, second):
    """second (n, 3, 3, 3), currents as for `evaluate_with`. Returns how many points lie outside."""
    outside = 0
    work = np.empty(4 * (int(block[DEGREE]) + 1) ** 2)
    square = block[PER_LENGTH] * block[PER_LENGTH]
    for p in range(points.shape[0]):
        row = currents[p if currents.shape[0] > 1 else 0]
        status, i, j, k, tx, ty, tz = locate(block, points[p, 0], points[p, 1], points[p, 2])
        outside += status == OUTSIDE
        if status != INSIDE:
            second[p] = NAN
        elif block[KIND] == CELL_HARMONIC or block[KIND] == GLOBAL_HARMONIC:
            x, y, z = _local(block, tx, ty, tz)
            c = _polynomial(block, i, j, k, row)
            third_derivatives(c, int(block[DEGREE]), x, y, z, work, second[p])
            second[p] *= square
        else:
            _bends(block, _corners(block, i, j, k, NODE, row), tx, ty, tz, second[p])
    return outside


@njit(**INLINED)
def _bends(block, corners, tx, ty, tz, second):
    """second (3, 3, 3): second derivatives of the Hermite form."""
    sx, sy, sz = block[LOCAL], block[LOCAL + 1], block[LOCAL + 2]
    x = (hermite.basis(tx), hermite.basis_slope(tx, sx), hermite.basis_bend(tx, sx))
    y = (hermite.basis(ty), hermite.basis_slope(ty, sy), hermite.basis_bend(ty, sy))
    z = (hermite.basis(tz), hermite.basis_slope(tz, sz), hermite.basis_bend(tz, sz))
    for c in range(3):
        xx, yy, zz, xy, xz, yz = hermite.bends(corners, 0, 0, 0, c, x, y, z)
        second[c, 0, 0], second[c, 1, 1], second[c, 2, 2] = xx, yy, zz
        second[c, 0, 1], second[c, 1, 0] = xy, xy
        second[c, 0, 2], second[c, 2, 0] = xz, xz
        second[c, 1, 2], second[c, 2, 1] = yz, yz


@njit(**OUTER)
def potential(block, currents, points, values):
    """values (n,): the potential U with B = -grad U. A Hermite block holds its eight numbers a node (one channel).

    Returns how many points lie outside.
    """
    outside = 0
    work = np.empty((int(block[DEGREE]) + 1) ** 2)
    for p in range(points.shape[0]):
        row = currents[p if currents.shape[0] > 1 else 0]
        status, i, j, k, tx, ty, tz = locate(block, points[p, 0], points[p, 1], points[p, 2])
        outside += status == OUTSIDE
        if status != INSIDE:
            values[p] = NAN
        elif block[KIND] == CELL_HARMONIC or block[KIND] == GLOBAL_HARMONIC:
            x, y, z = _local(block, tx, ty, tz)
            c = _polynomial(block, i, j, k, row)
            values[p] = -block[LENGTH] * potential_sum(c, int(block[DEGREE]), x, y, z, work)
        else:
            corners = _corners(block, i, j, k, 8, row)
            wx, wy, wz = hermite.basis(tx), hermite.basis(ty), hermite.basis(tz)
            values[p] = -hermite.value(corners, 0, 0, 0, 0, wx, wy, wz)
    return outside


@njit(**OUTER)
def at(data, x, y, z):
    """((Bx, By, Bz), ((dBx/dx, dBx/dy, dBx/dz), ...)) at one point: the door for compiled callers."""
    v = contracted_at(data, x, y, z)[1]
    return (v[0], v[1], v[2]), ((v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]))


@njit(**OUTER)
def at_currents(data, currents, x, y, z):
    """As `at`, for currents (n_coils,) that change from call to call."""
    v = superposed_at(data, currents, x, y, z)[1]
    return (v[0], v[1], v[2]), ((v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]))
