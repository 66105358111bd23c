"""A field that every form of a map represents exactly: an axisymmetric harmonic polynomial given on its axis."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from fieldmap.currents import IndependentCurrents, LiftAndDirections, divide_currents
from fieldmap.dynamics import RigidBody
from fieldmap.lookup import FiniteMagnet, interpolate, open_map
from fieldmap.store import Grid, MapData, ReducedModel


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


def axial_map(*coils, half=0.02, kind="global", linkage=None):
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
        linkage=linkage,
    )
    return interpolate(data, kind=kind)


def dipole(moment):
    return FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, moment]]))


# A top of 20 g carried by the field; its moment is opposite to the field, so only its spin stabilises it.
TOP = {"mass": 0.02, "inertia": [1.2e-6, 1.2e-6, 2.25e-6]}


def floating_field(b0=0.02, b2=0.5):
    """The field in which a downward moment of 1 A m^2 carries 20 g at the origin."""
    return axial_map((b0, -TOP["mass"] * 9.80665, b2)).at([1.0])


@pytest.fixture
def top():
    return RigidBody(**TOP, magnet=dipole(-1.0))


@pytest.fixture(scope="session")
def axial():
    return SimpleNamespace(
        field=axial_field,
        map=axial_map,
        dipole=dipole,
        floating=floating_field,
        inertia=TOP["inertia"],
        mass=TOP["mass"],
    )


def _law():
    """B(H) of iron with mu_r = 30 at first and saturation at 1 T: a table with continuous second derivative."""
    knots = np.linspace(0.0, 3.0, 400)
    b = knots + np.tanh(29.0 * knots)
    coefficients = np.zeros((400, 4))
    spline = CubicSpline(knots, b, bc_type=((1, 30.0), (1, 1.0)))
    coefficients[:-1] = spline.c.T
    coefficients[-1] = 0.0, 0.0, 1.0, b[-1]
    return np.array([0, 400]), knots, coefficients


def saturating_map(kind="harmonic", free=False):
    """The map of `saturating_data`, opened."""
    # Tests also evaluate the model at currents outside the division.
    return interpolate(saturating_data(free), kind=kind, outside_currents="evaluate")


def saturating_data(free=False):
    """Six coils and three fields of a made-up saturating iron, over the division with n = 1.25 or, if `free`, over
    independent currents within 3 A."""
    rng = np.random.default_rng(11)
    fields = rng.uniform([0.001, -0.05, -0.5], [0.01, 0.05, 0.5], (9, 3))
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    points, n_points, modes = grid.points(), 12, 3
    lower, upper = np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3])
    domain = {"lower": lower, "upper": upper, "parametrisation": LiftAndDirections(1.25)}
    if free:
        limit = np.full(6, 3.0)
        domain = {"lower": -limit, "upper": limit, "parametrisation": IndependentCurrents(6)}
    # With free currents the iron contributes a third of the field, and saturates.
    reach, part = (0.05, 10.0) if free else (0.01, 1.0)
    square = rng.normal(size=(modes, modes))
    offset, knots, coefficients = _law()
    known = divide_currents(*np.array([(lower + upper) / 2]).T, 1.25)
    model = ReducedModel(
        gradients=0.3 * rng.normal(size=(3 * n_points, modes)),
        source=reach * rng.uniform(0.5, 1.5, size=(3 * n_points, 6)),
        weights=0.1 + rng.random(n_points),
        law=np.zeros(n_points, np.int64),
        law_offset=offset,
        law_knots=knots,
        law_coefficients=coefficients,
        air=square @ square.T + np.eye(modes),
        constant=np.zeros(modes),
        output=part * rng.normal(size=(3, modes)),
        known_currents=known,
        known_amplitudes=np.zeros((1, modes)),
        reference_weights=np.ones(3),
        **domain,
    )
    return MapData(
        grid,
        tuple("123456"),
        np.ones(6),
        flux_density=np.array([axial_field(points, *c) for c in fields]).reshape(9, 5, 5, 5, 3),
        gradient=np.array([axial_gradient(points, *c) for c in fields]).reshape(9, 5, 5, 5, 3, 3),
        reduced_model=model,
    )


@pytest.fixture(scope="session")
def saturating():
    return saturating_map


@pytest.fixture(scope="session")
def six(six_coils):
    """The map of six dipoles, opened."""
    return open_map(six_coils)
