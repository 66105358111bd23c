"""H of B: the laws of `fieldmap.iron.elements.bh_law` turned around, with their energy density and slope."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.elements.bh_law import LawTables, law_slopes, law_values
from fieldmap.typing import Array

Indices = NDArray[np.int64]
_BISECTIONS = 20
_NEWTON_STEPS = 6


def field_strength(tables: LawTables, law: Indices, b: Array) -> tuple[Array, Array, Array]:
    """h = mu0 H (n,), the integral of h over b from 0 (n,), and dh/db (n,), at b (n,) >= 0; all with h and b in T.

    Bisection on 0 <= h <= b / smallest chord, then Newton's method, kept in the bracket. b(h) rises everywhere.
    """
    low, high = np.zeros_like(b), b.copy()
    while np.any(short := law_values(tables, law, high)[0] < b):
        high[short] *= 2.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = law_values(tables, law, middle)[0] < b
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    h = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        value, slope = law_values(tables, law, h)[0], law_slopes(tables, law, h)[1]
        h = np.clip(h - (value - b) / slope, low, high)
    stored = law_values(tables, law, h)[1]
    return h, h * b - stored, 1.0 / law_slopes(tables, law, h)[1]
