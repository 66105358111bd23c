"""Fields of which everything is known in closed form."""

import numpy as np
import pytest
from PIL import Image

from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData


def harmonic(points, a, b, c):
    """On the axis Bz = a + b z + c z^2 / 2: B (n, 3) and its gradient (n, 3, 3), round the axis."""
    x, y, z = points.T
    radial = -0.5 * (b + c * z)
    field = np.column_stack([radial * x, radial * y, a + b * z + 0.5 * c * (z**2 - 0.5 * (x**2 + y**2))])
    slope = np.zeros((len(points), 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = radial
    slope[:, 2, 2] = b + c * z
    slope[:, 0, 2] = slope[:, 2, 0] = -0.5 * c * x
    slope[:, 1, 2] = slope[:, 2, 1] = -0.5 * c * y
    return field, slope


def pixels_of(path):
    """Red, green and blue (height, width, 3) of a picture, from 0 to 255."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


@pytest.fixture(scope="session")
def harmonic_map():
    """harmonic_map(NAME=(a, b, c, at)): an opened map of `harmonic` fields per ampere round axes at (x, y)."""

    def make(**coils):
        grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
        pairs = [harmonic(grid.points() - [*at, 0.0], *abc) for *abc, at in coils.values()]
        flux, slope = (np.array(part) for part in zip(*pairs, strict=True))
        arrays = {"flux_density": flux.reshape(-1, 5, 5, 5, 3), "gradient": slope.reshape(-1, 5, 5, 5, 3, 3)}
        return interpolate(MapData(grid, tuple(coils), np.ones(len(coils)), **arrays), kind="global")

    return make
