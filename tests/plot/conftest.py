"""Fields in closed form."""

import numpy as np
import pytest
from PIL import Image

import fieldmap as fm
from fieldmap.field import Field
from fieldmap.lookup import interpolate
from fieldmap.plot.rendering import can_render
from fieldmap.store import Grid, MapData

needs_opengl = pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")


def harmonic(points, a, b, c):
    """Axisymmetric, on the axis Bz = a + b z + c z^2 / 2: B (..., 3) and its gradient (..., 3, 3)."""
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
    """A field of one coil, `harmonic` per ampere."""

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
    """Red, green and blue (height, width, 3) of a picture, 0 to 255."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


@pytest.fixture(scope="session")
def harmonic_map():
    """harmonic_map(NAME=(a, b, c, at)): an opened map of `harmonic` fields per ampere about axes at (x, y); `lower`
    (3,), m, of its box of 40 mm, `reference` (n,), A, and a `constant` field of the same form."""

    def make(lower=(-0.02, -0.02, -0.02), reference=None, constant=None, **coils):
        grid = Grid(list(lower), [0.01] * 3, (5, 5, 5))
        every = [*coils.values(), *([] if constant is None else [constant])]
        pairs = [harmonic(grid.points() - [*at, 0.0], *abc) for *abc, at in every]
        flux, slope = (np.array(part) for part in zip(*pairs, strict=True))
        arrays = {"flux_density": flux.reshape(-1, 5, 5, 5, 3), "gradient": slope.reshape(-1, 5, 5, 5, 3, 3)}
        fixed = {} if constant is None else {"fixed_sources": ("magnet",), "constant_field": True}
        amperes = np.ones(len(coils)) if reference is None else reference
        return interpolate(MapData(grid, tuple(coils), amperes, **arrays, **fixed), kind="global")

    return make


@pytest.fixture
def rig(valid_text):
    """rig(mass_g, moment_A_m2): text of a device with one coil, and this payload if given."""
    coil = valid_text[valid_text.index("[[coil]]") :]
    coil = coil[: coil.index("[[coil]]", 1)]

    def text(**payload):
        lines = "".join(f"{key} = {value}\n" for key, value in payload.items())
        carried = f"[payload]\n{lines}" if payload else ""
        return f'format = 1\nname = "rig"\ntitle = "Six dipoles"\n{coil}{carried}'

    return text


class Crooked(Field):
    """Two coils, each with its own affine field per ampere, B = slope x + flux, in a box off the axis.

    There is no symmetry: all components, sides and middles differ.
    """

    coil_names, proportional = ("ring", "frame"), True
    SLOPES = np.array(
        [
            [[1.0, 0.5, 0.4], [0.5, -3.0, -0.2], [0.4, -0.2, 2.0]],
            [[-2.0, 0.3, 0.6], [0.3, 0.5, 0.7], [0.6, 0.7, 1.5]],
        ]
    )
    FLUX = np.array([[0.1, 0.2, -0.3], [0.05, -0.02, 0.04]])
    lower, upper = np.array([-0.004, -0.006, -0.03]), np.array([0.005, 0.002, -0.01])

    @property
    def bounds(self):
        return self.lower, self.upper

    def field(self, points, currents):
        slope, flux = np.tensordot(currents, self.SLOPES, 1), np.tensordot(currents, self.FLUX, 1)
        return np.asarray(points) @ slope.T + flux

    def gradient(self, points, currents):
        shape = np.shape(points)[:-1]
        return np.broadcast_to(np.tensordot(currents, self.SLOPES, 1), (*shape, 3, 3))


def crooked_device(**other):
    """A ring and an upright frame, a bar and a ball, a workspace and a magnet, all with different centres."""
    return fm.Device(
        "crooked",
        "A crooked machine",
        coils=[
            fm.CircularCoil("ring", 0.006, 0.010, 0.008, 100).moved([0.03, 0.01, 0.02]),
            fm.RoundedRectangleCoil("frame", 0.009, 0.006, 0.004, 0.002, 0.012, 50).moved(
                [-0.025, 0.02, 0.03]
            ),
        ],
        bodies=[
            fm.Body("bar", "iron", fm.Box((0.04, 0.006, 0.01)), 0.004).moved([0.01, 0.03, 0.04]),
            fm.Body("ball", "iron", fm.Sphere(0.005), 0.003).moved([-0.03, -0.01, 0.05]),
        ],
        materials={"iron": fm.LinearMaterial("iron", 1000.0)},
        workspace=fm.WorkspaceBox(Crooked.lower, Crooked.upper),
        payload=fm.Payload(0.01, magnet=fm.MagnetCylinder(0.004, 0.01, 1.2)),
    ).replace(**other)
