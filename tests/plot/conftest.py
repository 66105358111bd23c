"""Fields of which everything is known in closed form."""

import numpy as np
import pytest
from PIL import Image

from fieldmap.field import Field
from fieldmap.lookup import interpolate
from fieldmap.plot.rendering import can_render
from fieldmap.store import Grid, MapData

needs_opengl = pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")


def harmonic(points, a, b, c):
    """On the axis Bz = a + b z + c z^2 / 2: B (..., 3) and its gradient (..., 3, 3), round the axis."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    radial, zero = -0.5 * (b + c * z), 0.0 * x
    field = np.stack([radial * x, radial * y, a + b * z + 0.5 * c * (z**2 - 0.5 * (x**2 + y**2))], axis=-1)
    rows = [
        [radial, zero, -0.5 * c * x],
        [zero, radial, -0.5 * c * y],
        [-0.5 * c * x, -0.5 * c * y, b + c * z],
    ]
    return field, np.moveaxis(np.array(rows), (0, 1), (-2, -1))


class Harmonic(Field):
    """A field of one coil: `harmonic` per ampere."""

    coil_names = ("coil",)

    def __init__(self, a, b, c, bounds=None):
        self.abc, self.box = (a, b, c), bounds

    @property
    def bounds(self):
        return self.box

    def field(self, points, currents):
        return currents[0] * harmonic(points, *self.abc)[0]

    def gradient(self, points, currents):
        return currents[0] * harmonic(points, *self.abc)[1]


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


@pytest.fixture
def rig(valid_text):
    """rig(mass_g, moment_A_m2): text of a device with one coil and this payload, or without one."""
    coil = valid_text[valid_text.index("[[coil]]") :]
    coil = coil[: coil.index("[[coil]]", 1)]

    def text(**payload):
        lines = "".join(f"{key} = {value}\n" for key, value in payload.items())
        carried = f"[payload]\n{lines}" if payload else ""
        return f'format = 1\nname = "rig"\ntitle = "Six dipoles"\n{coil}{carried}'

    return text
