from types import MappingProxyType

import numpy as np
import pytest

from fieldmap.device.model import LinearMaterial
from fieldmap.planar import PlanarBody, PlanarCoil, PlanarDevice, RoundWire


def make(polygons, wires, mu_r=1000.0, walls=None, wire=None, materials=None):
    """A device: polygons by name, one coil for each (into the page, out of the page) pair of lists."""
    wire = RoundWire(1e-3) if wire is None else wire
    coils = tuple(
        PlanarCoil(
            f"c{k}", wire, np.reshape(into, (-1, 2)).astype(float), np.reshape(out, (-1, 2)).astype(float)
        )
        for k, (into, out) in enumerate(wires)
    )
    materials = materials or {"iron": LinearMaterial("iron", mu_r)}
    names = list(materials)
    bodies = tuple(
        PlanarBody(name, names[min(k, len(names) - 1)], np.asarray(corners, dtype=float))
        for k, (name, corners) in enumerate(polygons.items())
    )
    return PlanarDevice("test", "test", coils, bodies, MappingProxyType(materials), walls)


def regular(count, radius, centre=(0.0, 0.0)):
    """Polygon with the area of a circle."""
    t = 2 * np.pi / count
    angle = t * np.arange(count)
    radius = radius * np.sqrt(t / np.sin(t))
    return np.column_stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)])


def box(x1, z1, x2, z2):
    return np.array([[x1, z1], [x2, z1], [x2, z2], [x1, z2]])


@pytest.fixture
def build():
    return make


@pytest.fixture
def circle():
    return regular


@pytest.fixture
def rectangle():
    return box
