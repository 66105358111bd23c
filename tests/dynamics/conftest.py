"""A field that every form of a map holds exactly: an axisymmetric harmonic polynomial, given on its axis."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.dynamics import RigidBody
from fieldmap.lookup import FiniteMagnet, interpolate
from fieldmap.store import Grid, MapData


def axial_field(points, b0, b1, b2):
    """B (n, 3) with B_z = b0 + b1 z + b2 z^2 / 2 on the axis: the gradient of the solid harmonics of degree 1 to 3."""
    x, y, z = points.T
    radial = -0.5 * (b1 + b2 * z)
    return np.column_stack([radial * x, radial * y, b0 + b1 * z + 0.5 * b2 * (z**2 - 0.5 * (x**2 + y**2))])


def axial_gradient(points, b0, b1, b2):
    """dB_i/dx_j (n, 3, 3) of the same."""
    x, y, z = points.T
    slope = np.zeros((len(points), 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = -0.5 * (b1 + b2 * z)
    slope[:, 2, 2] = b1 + b2 * z
    slope[:, 0, 2] = slope[:, 2, 0] = -0.5 * b2 * x
    slope[:, 1, 2] = slope[:, 2, 1] = -0.5 * b2 * y
    return slope


def axial_map(*coils, half=0.02, kind="global"):
    """An opened map of coils with the given (b0, b1, b2) per ampere, in a cube about the origin."""
    grid = Grid([-half] * 3, [half / 2] * 3, (5, 5, 5))
    points = grid.points()
    n = len(coils)
    data = MapData(
        grid,
        tuple("abcdefg"[:n]),
        np.ones(n),
        flux_density=np.array([axial_field(points, *c) for c in coils]).reshape(n, 5, 5, 5, 3),
        gradient=np.array([axial_gradient(points, *c) for c in coils]).reshape(n, 5, 5, 5, 3, 3),
    )
    return interpolate(data, kind=kind)


def dipole(moment):
    return FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, moment]]))


# A top of 20 g that a field carries, held by nothing but its spin: its moment stands against the field.
TOP = {"mass": 0.02, "inertia": [1.2e-6, 1.2e-6, 2.25e-6]}


def floating_field(b0=0.02, b2=0.5):
    """The field in which a downward moment of 1 A m^2 carries 20 g at the origin."""
    return axial_map((b0, -TOP["mass"] * 9.80665, b2)).at([1.0])


@pytest.fixture
def top():
    return RigidBody(**TOP, magnet=dipole(-1.0))


@pytest.fixture
def axial():
    return SimpleNamespace(
        field=axial_field,
        map=axial_map,
        dipole=dipole,
        floating=floating_field,
        inertia=TOP["inertia"],
        mass=TOP["mass"],
    )
