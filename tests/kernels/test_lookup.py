"""The kernels of a lookup for compiled callers, in all forms, against the C core.

Small, because these tests run without compilation as well: there an index out of range raises.
"""

import math

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.interpolants.form import completed, contract, header
from fieldmap.kernels.map import cell_harmonics, global_harmonics, hermite, lookup
from fieldmap.store import Grid

GRID = Grid([-0.3, 0.2, 1.0], [0.11, 0.07, 0.13], (3, 2, 4))
KINDS = {
    "hermite": hermite.KERNELS,
    "harmonic": cell_harmonics.KERNELS,
    "global": global_harmonics.KERNELS,
}
CURRENTS = np.array([0.7, -1.3])


def block_of(kind, outside="nan"):
    """A block of random coefficients with two sets, and the size of a set."""
    box = Grid(GRID.lower, GRID.upper - GRID.lower, (2, 2, 2)) if kind == "global" else GRID
    degree = 0 if kind == "hermite" else 5
    start = header(KINDS[kind], box, 2, outside, degree, 1.0 if kind == "hermite" else 0.2)
    size = hermite.NODE if kind == "hermite" else 36
    places = math.prod(box.shape) if kind == "hermite" else math.prod(n - 1 for n in box.shape)
    return np.concatenate([start, np.random.default_rng(3).normal(size=places * 2 * size)]), size


POINT = np.array([-0.2, 0.25, 1.1])


@pytest.mark.parametrize("kind", list(KINDS))
def test_doors_for_compiled_callers(kind):
    block, size = block_of(kind)
    expected = CoreMap(block).field_at(POINT, CURRENTS)
    units, slopes = np.empty((1, 2, 3)), np.empty((1, 2, 3, 3))
    assert lookup.evaluate_units(block, POINT[None], units, slopes) == 0
    for flux, slope in (
        lookup.at(completed(contract(block, CURRENTS, size)), *POINT),
        lookup.at_currents(block, CURRENTS, *POINT),
        (CURRENTS @ units[0], np.tensordot(CURRENTS, slopes[0], 1)),
    ):
        np.testing.assert_allclose(flux, expected[0], rtol=1e-12)
        np.testing.assert_allclose(slope, expected[1], rtol=1e-11)
