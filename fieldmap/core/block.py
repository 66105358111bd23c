"""Layout of a block, the array that holds the coefficients of a map (fieldmap/core/block.h).

A header comes first; integers are stored as floats. The coefficients of set s in cell n, or at node n of a Hermite
form, begin at HEADER + (n SETS + s) size. Cells and nodes are in C order of x, y, z.
"""

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

KIND: int = LIBRARY.KIND
"""Form of the map: HERMITE, HARMONIC or GLOBAL."""
RULE: int = LIBRARY.CLAMPS
"""Result at a point outside: NAN_OUTSIDE, or CLAMP, the value at the nearest point of the box."""
SETS: int = LIBRARY.SETS
"""Number of fields."""
DEGREE: int = LIBRARY.DEGREE
"""Degree of the potential, if it is a polynomial."""
LOWER: int = LIBRARY.LOWER
"""Lower corner of the box, 3 numbers, m."""
INVERSE: int = LIBRARY.INVERSE
"""1 / spacing, 3 numbers, 1/m."""
CELLS: int = LIBRARY.CELLS
"""Number of cells along each axis."""
LOCAL: int = LIBRARY.LOCAL
"""Spacing divided by LENGTH, 3 numbers."""
LENGTH: int = LIBRARY.LENGTH
"""Unit of length of the polynomials, m; 1 for other forms."""
PER_LENGTH: int = LIBRARY.PER_LENGTH
"""1 / LENGTH, 1/m."""
HEADER: int = LIBRARY.HEADER
"""Index of the first coefficient."""
HERMITE: int = LIBRARY.HERMITE
HARMONIC: int = LIBRARY.HARMONIC
GLOBAL: int = LIBRARY.GLOBAL
NAN_OUTSIDE, CLAMP = 0, 1
EDGE: float = LIBRARY.EDGE
"""A point outside by up to this many cells counts as inside, because upper = lower + (n - 1) spacing is rounded."""


def set_size(block: Array) -> int:
    """Number of coefficients that a field has in one cell, or at one node of a Hermite form.

    Parameters
    ----------
    block
        Header and coefficients of a map.

    Returns
    -------
    int
        The number.
    """
    return int(LIBRARY.NODE) if block[KIND] == HERMITE else (int(block[DEGREE]) + 1) ** 2
