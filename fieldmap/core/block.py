"""Where things lie in a block, the array in which a map's coefficients lie (fieldmap/core/block.h).

A header comes first; whole numbers are stored as floats. Set s of place n begins at HEADER + (n SETS + s) size, places
in C order of x, y, z: cells, or nodes of a Hermite form.
"""

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

KIND: int = LIBRARY.KIND
"""What the coefficients are of: HERMITE, HARMONIC or GLOBAL."""
RULE: int = LIBRARY.CLAMPS
"""What a point outside gives: NAN_OUTSIDE, or CLAMP, the value at the nearest point of the box."""
SETS: int = LIBRARY.SETS
"""How many fields there are."""
DEGREE: int = LIBRARY.DEGREE
"""Of the potential, if it is a polynomial."""
LOWER: int = LIBRARY.LOWER
"""Lower corner of the box, 3 numbers, m."""
INVERSE: int = LIBRARY.INVERSE
"""1 / spacing, 3 numbers, 1/m."""
CELLS: int = LIBRARY.CELLS
"""Number of cells along each axis."""
LOCAL: int = LIBRARY.LOCAL
"""Spacing over LENGTH, 3 numbers."""
LENGTH: int = LIBRARY.LENGTH
"""Unit of length of the polynomials, m; 1 where there is none."""
PER_LENGTH: int = LIBRARY.PER_LENGTH
"""1 / LENGTH, 1/m."""
HEADER: int = LIBRARY.HEADER
"""Where the coefficients begin."""
HERMITE: int = LIBRARY.HERMITE
HARMONIC: int = LIBRARY.HARMONIC
GLOBAL: int = LIBRARY.GLOBAL
NAN_OUTSIDE, CLAMP = 0, 1
EDGE: float = LIBRARY.EDGE
"""A point this far outside, in cells, still counts as inside: the rounding of upper = lower + (n - 1) spacing."""


def set_size(block: Array) -> int:
    """How many numbers a set of a block of a field has at one place.

    Parameters
    ----------
    block
        Coefficients behind their header.

    Returns
    -------
    int
        The number.
    """
    return int(LIBRARY.NODE) if block[KIND] == HERMITE else (int(block[DEGREE]) + 1) ** 2
