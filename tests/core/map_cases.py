"""Small blocks of maps in all forms, with random coefficients."""

import math

import numpy as np

from fieldmap.core.block import GLOBAL, HARMONIC, HERMITE, set_size
from fieldmap.interpolants.form import header
from fieldmap.store import Grid

GRID = Grid([-0.3, 0.2, 1.0], [0.11, 0.07, 0.13], (3, 2, 4))
KINDS = {"hermite": HERMITE, "harmonic": HARMONIC, "global": GLOBAL}
CURRENTS = np.array([0.7, -1.3])


def block_of(kind, outside="nan", degree=5, sets=2):
    """A block of random coefficients with this many sets, and the size of a set; NaN on both sides of it."""
    box = Grid(GRID.lower, GRID.upper - GRID.lower, (2, 2, 2)) if kind == "global" else GRID
    start = header(
        KINDS[kind], box, sets, outside, 0 if kind == "hermite" else degree, 1.0 if kind == "hermite" else 0.2
    )
    size = set_size(start)
    places = math.prod(box.shape) if kind == "hermite" else math.prod(n - 1 for n in box.shape)
    numbers = np.random.default_rng(3).normal(size=places * sets * size)
    nothing = np.full(1000, np.nan)
    whole = np.concatenate([nothing, start, numbers, nothing])
    return whole[1000:-1000], size


def no_reaction(flux):
    """An empty reaction for a map without iron, at the points of flux (points, k, 3)."""
    nothing = np.zeros((len(flux), 0, 3, 3))
    return 0, nothing[..., 0], nothing
