"""Where a map's coefficients lie: one flat array of float64 numbers, a header and the coefficients after it.

One array holds all that an evaluation reads, so a compiled caller passes one argument, a pickle or a file holds
one object, and no kernel knows a class. The header (positions below, whole numbers stored as floats):

    KIND       position of the interpolant in `fieldmap.kernels.map.lookup.KERNELS`
    RULE       what a point outside gives: 0 NaN, 1 the value at the nearest point of the box
    SETS       how many sets of coefficients: one a coil in A^-1, or a single one at given currents
    DEGREE     of the potential, if it is a polynomial
    LOWER      lower corner of the box, 3 numbers, m
    INVERSE    1 / spacing, 3 numbers, 1/m
    CELLS      number of cells along each axis
    LOCAL      spacing / LENGTH, 3 numbers
    LENGTH     unit of length of the polynomials, m (1 where there is none)
    PER_LENGTH 1 / LENGTH, 1/m

Behind it lie the coefficients: set s of place n at HEADER + (n SETS + s) size, places in C order of x, y, z. The
interpolant decides what a place is, a cell or a node, and how many numbers a set has there (`InterpolantKernels`).
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fieldmap.kernels.compilation import inlined

KIND, RULE, SETS, DEGREE = 0, 1, 2, 3
LOWER, INVERSE, CELLS, LOCAL = 4, 7, 10, 13
LENGTH, PER_LENGTH = 16, 17
HEADER = 24

NAN_OUTSIDE, CLAMP = 0, 1
INSIDE, OUTSIDE, NOT_FINITE = 0, 1, 2

_ONE, _TWO, _THREE, _FOUR = (np.uint64(n) for n in range(1, 5))

# A point this far outside, in cells, still counts as inside: the rounding of upper = lower + (n - 1) spacing.
EDGE = 1e-9

# Fused multiply-add only. The rest of fast-math would let the compiler assume that there is no NaN.
INLINED: dict[str, Any] = {"fastmath": {"contract"}}
# Inlined before types are known, not as a function that was optimised by itself: what takes memory on the stack.
INLINED_EARLY: dict[str, Any] = {**INLINED, "inline": "always"}
OUTER: dict[str, Any] = {**INLINED, "nogil": True}
# Without counts of references, for functions that neither make arrays nor copy slices: a count is an atomic operation,
# and a loop over small functions spends half of its time on them. A function takes this from the first that calls it
# unless it says for itself, as WHOLE does.
PLAIN: dict[str, Any] = {**OUTER, "_nrt": False}
PLAIN_INLINED: dict[str, Any] = {**INLINED, "_nrt": False}
WHOLE: dict[str, Any] = {**OUTER, "_nrt": True}


@inlined(**INLINED)
def locate(block, x, y, z):
    """Status, cell (i, j, k) of a point, and its coordinates 0..1 in the cell.

    Unless the status is INSIDE the rest means nothing. The comparison is written so that NaN fails it.
    """
    nx, ny, nz = block[CELLS], block[CELLS + 1], block[CELLS + 2]
    ux = (x - block[LOWER]) * block[INVERSE]
    uy = (y - block[LOWER + 1]) * block[INVERSE + 1]
    uz = (z - block[LOWER + 2]) * block[INVERSE + 2]
    low = ux >= -EDGE and uy >= -EDGE and uz >= -EDGE
    if not (low and ux <= nx + EDGE and uy <= ny + EDGE and uz <= nz + EDGE):
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            return NOT_FINITE, 0, 0, 0, 0.0, 0.0, 0.0
        if block[RULE] != CLAMP:
            return OUTSIDE, 0, 0, 0, 0.0, 0.0, 0.0
        ux, uy, uz = min(max(ux, 0.0), nx), min(max(uy, 0.0), ny), min(max(uz, 0.0), nz)
    i = max(min(int(ux), int(nx) - 1), 0)
    j = max(min(int(uy), int(ny) - 1), 0)
    k = max(min(int(uz), int(nz) - 1), 0)
    return INSIDE, i, j, k, ux - i, uy - j, uz - k


@inlined(**INLINED)
def cell_number(block, i, j, k):
    """Position of cell (i, j, k) in C order."""
    return (i * int(block[CELLS + 1]) + j) * int(block[CELLS + 2]) + k


@inlined(**INLINED)
def node_number(block, i, j, k):
    """Position of node (i, j, k) in C order."""
    return (i * (int(block[CELLS + 1]) + 1) + j) * (int(block[CELLS + 2]) + 1) + k


@inlined(**INLINED)
def superpose(block, place, size, currents, out):
    """out (size,) = sum over the sets of current times the set's numbers at a cell or node."""
    # Four numbers at a time, whose sums stay in a register. Positions are unsigned: numba asks of others whether they
    # count from the end.
    n_sets, row = currents.shape[0], np.uint64(size)
    first = np.uint64(HEADER + place * n_sets * size)
    m = np.uint64(0)
    while m + _FOUR <= row:
        here, current = first + m, currents[0]
        a, b = current * block[here], current * block[here + _ONE]
        c, d = current * block[here + _TWO], current * block[here + _THREE]
        for s in range(1, n_sets):
            here, current = here + row, currents[s]
            a += current * block[here]
            b += current * block[here + _ONE]
            c += current * block[here + _TWO]
            d += current * block[here + _THREE]
        out[m], out[m + _ONE], out[m + _TWO], out[m + _THREE] = a, b, c, d
        m += _FOUR
    while m < row:
        here = first + m
        a = currents[0] * block[here]
        for s in range(1, n_sets):
            here += row
            a += currents[s] * block[here]
        out[m] = a
        m += _ONE


@inlined(**INLINED)
def local(block, tx, ty, tz):
    """Coordinates from the middle of the cell, in LENGTHs."""
    return (tx - 0.5) * block[LOCAL], (ty - 0.5) * block[LOCAL + 1], (tz - 0.5) * block[LOCAL + 2]


@inlined(**INLINED)
def in_si(block, nine):
    """The twelve results from field and the six different entries of the gradient, in SI."""
    bx, by, bz, xx, xy, xz, yy, yz, zz = nine
    s = block[PER_LENGTH]
    xx, xy, xz, yy, yz, zz = s * xx, s * xy, s * xz, s * yy, s * yz, s * zz
    return bx, by, bz, xx, xy, xz, xy, yy, yz, xz, yz, zz


class InterpolantKernels(NamedTuple):
    """Compiled evaluation of one kind of block, for a point inside, in cell (i, j, k) at tx, ty, tz.

    cell_size(block): how many numbers a cell takes when they are kept; gather(block, weights, i, j, k, out): them, out
    (cell_size,), of the sum of the sets at weights (n,); gathered(block, numbers, tx, ty, tz): from them the three of
    the field and the nine of its gradient, in SI. set_size(degree), for Python: how many numbers a set has at a place.
    """

    cell_size: Callable[..., Any]
    gather: Callable[..., Any]
    gathered: Callable[..., Any]
    set_size: Callable[[int], int]
