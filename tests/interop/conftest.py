"""Six loops on a ring above a box: a field with a closed form, for everything that leaves or enters a map."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData

ANGLES = np.arange(6) * np.pi / 3
CENTRES = np.stack([0.044 * np.cos(ANGLES), 0.044 * np.sin(ANGLES), np.full(6, 0.026)], axis=1)
GRID = Grid([-0.02, -0.02, -0.12], [0.005, 0.005, 0.005], (9, 9, 13))
TURNS = 1e4


def fields(points):
    """B (6, n, 3) and G (6, n, 3, 3) per ampere."""
    parts = [loop_flux_density_and_gradient(points - centre, 0.016) for centre in CENTRES]
    return tuple(TURNS * np.stack(part) for part in zip(*parts, strict=True))


@pytest.fixture(scope="session")
def ring():
    """`fields`, a map of them, and that opened."""
    flux, slope = fields(GRID.points())
    shape = (6, *GRID.shape, 3)
    data = MapData(
        GRID, tuple("123456"), np.ones(6), flux_density=flux.reshape(shape), gradient=slope.reshape(*shape, 3)
    )
    return SimpleNamespace(fields=fields, data=data, map=interpolate(data), grid=GRID)
