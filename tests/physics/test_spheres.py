"""Spheres, shells and pairs of spheres in a uniform field: closed forms and exact series (Jackson, ch. 4 and 5)."""

from functools import cache
from math import comb

import numpy as np
import pytest
from numpy.polynomial.legendre import Legendre

import fieldmap as fm
from fieldmap.device.model import Background, Body, Device, LinearMaterial, Part, Sphere, placed
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.mesh.mesh import volumes
from tests.iron.shared import dipole, in_uniform_field, iron_of

RADIUS = 0.05
UP = np.array([0.0, 0.0, 1.0])
OUTSIDE = np.array([[0.06, 0, 0], [0, 0, 0.06], [0.04, 0.03, 0.04], [0.1, 0.02, 0.03], [0, 0.07, -0.02]])


FORMS = {"flux": FluxForm, "potential": PotentialForm}


@cache
def problem_of(iron, form):
    return FORMS[form](iron)


def solved(iron, form, mu_by_body, direction=UP, tolerance=1e-8):
    """State of the iron in a uniform field of 1 T."""
    laws = [LinearMaterial("iron", float(value)) for value in mu_by_body]
    return in_uniform_field(problem_of(iron, form), laws, direction, tolerance)


def sphere(name, radius, height=0.0, size=0.012, cut=None):
    at = placed((0.0, 0.0, height))
    parts = (Part(Sphere(radius), at),) + ((Part(Sphere(cut), at, "cut"),) if cut else ())
    return Body(name, name, parts, size)


def off(state, exact, applied=UP, places=OUTSIDE):
    """Largest error of the field of the iron, as a share of the whole field."""
    error = np.linalg.norm(state.faces.field(places, state.density)[0] - exact, axis=1)
    return (error / np.linalg.norm(exact + applied, axis=1)).max()


@pytest.fixture(scope="module")
def one_sphere():
    return iron_of(sphere("ball", RADIUS, size=0.011))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mu_r", [10.0, 1e3, 1e6])
@pytest.mark.parametrize("direction", [UP, [0.6, 0.0, 0.8]])
def test_sphere_outside_field(one_sphere, form, mu_r, direction):
    """Within 0.2 % of the total field at no more than 2 000 faces."""
    direction = np.asarray(direction)
    assert len(one_sphere.surface.areas) <= 2000
    state = solved(one_sphere, form, [mu_r], direction)
    exact = dipole(OUTSIDE, (mu_r - 1) / (mu_r + 2) * RADIUS**3 * direction)
    assert off(state, exact, direction) < 2e-3


@pytest.mark.parametrize(
    ("form", "mu_r"),
    [("flux", 1e-4), ("flux", 0.5), ("flux", 2.0), ("flux", 1e3), ("potential", 2.0), ("potential", 1e3)],
)
def test_sphere_inside_field(one_sphere, form, mu_r):
    """Uniform inside: B = 3 mu_r / (mu_r + 2) B0, also for weakly magnetic bodies and flux barriers."""
    state = solved(one_sphere, form, [mu_r])
    inside = state.flux_density[0] / (3 * mu_r / (mu_r + 2))
    volume = volumes(one_sphere.mesh.points, one_sphere.mesh.tets)
    assert volume @ inside / volume.sum() == pytest.approx(UP, abs=1e-3)
    spread = np.sqrt(volume @ ((inside - UP) ** 2).sum(axis=1) / volume.sum())
    assert spread < 0.04


@pytest.mark.parametrize("mu_r", [0.1, 1e-4])
def test_weak_sphere_outside_field(one_sphere, mu_r):
    """As accurate as iron: the small flux inside is not a difference of large terms."""
    state = solved(one_sphere, "flux", [mu_r], tolerance=1e-7)
    exact = dipole(OUTSIDE, (mu_r - 1) / (mu_r + 2) * RADIUS**3 * UP)
    assert off(state, exact) < 5e-4


@pytest.mark.parametrize("form", FORMS)
def test_air_is_not_magnetised(one_sphere, form):
    assert np.abs(solved(one_sphere, form, [1.0]).density).max() < 1e-6


@pytest.mark.parametrize("form", FORMS)
def test_sphere_converges(form):
    """The error of the outside field falls at least with the square of the element size."""
    errors, sizes = [], (0.02, 0.014, 0.009)
    for size in sizes:
        state = solved(iron_of(sphere("ball", RADIUS, size=size)), form, [1000.0])
        exact = dipole(OUTSIDE, 999 / 1002 * RADIUS**3 * UP)
        errors.append(np.abs(state.faces.field(OUTSIDE, state.density)[0] - exact).max())
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert slope > 2.0
    assert errors[-1] < 6e-4


@pytest.mark.parametrize("form", FORMS)
def test_shielding_of_a_shell(form):
    """a/b = 0.8, mu_r = 1000: the field in the hollow within 1 % (Jackson 5.121)."""
    mu, ratio, size, bound = 1000.0, 0.8, 0.012, 0.01
    iron = iron_of(sphere("shell", RADIUS, size=size, cut=ratio * RADIUS))
    state = solved(iron, form, [mu], tolerance=1e-9)
    hollow = np.array([[0, 0, 0.0], [0.02, 0, 0], [0, 0.01, 0.02], [-0.01, 0.02, -0.01]])
    exact = 9 * mu / ((2 * mu + 1) * (mu + 2) - 2 * ratio**3 * (mu - 1) ** 2)
    field = state.faces.field(hollow, state.density)[0] + UP
    assert field == pytest.approx(np.outer(np.ones(4), exact * UP), abs=bound * exact)


@pytest.mark.parametrize("form", FORMS)
def test_coated_sphere_of_two_materials(form):
    """An inner sphere of mu_r 5 in a coat of mu_r 50: the exact polarisability, with flux through their common face."""
    inner, outer, mu_i, mu_o = 0.03, RADIUS, 5.0, 50.0
    iron = iron_of(sphere("inner", inner, size=0.01), sphere("coat", outer, size=0.01, cut=inner))
    state = solved(iron, form, [mu_i, mu_o])
    fill = (inner / outer) ** 3
    factor = ((mu_o - 1) * (mu_i + 2 * mu_o) + fill * (mu_i - mu_o) * (1 + 2 * mu_o)) / (
        (mu_o + 2) * (mu_i + 2 * mu_o) + 2 * fill * (mu_i - mu_o) * (mu_o - 1)
    )
    exact = dipole(OUTSIDE, factor * outer**3 * UP)
    assert off(state, exact) < 2e-3


def two_sphere_field(points, radius, distance, mu, terms=40):
    """Two equal spheres on the z axis in a field along z: multipoles of both, exact as terms grows.

    Potential of a sphere: sum_l A_l P_l / r^(l+1); the other's potential re-expanded about its centre
    (Jackson 3.70); sphere response A_k = -a^(2k+1) k (mu - 1) / (k (mu + 1) + 1) times the exciting
    coefficient. In units of the radius, for numbers of moderate size; B does not depend on the unit.
    """
    points, distance = points / radius, distance / radius
    order = np.arange(1, terms + 1)
    response = -order * (mu - 1) / (order * (mu + 1) + 1)
    couple = np.array([[comb(el + k, k) / distance ** (el + k + 1.0) for el in order] for k in order])
    from_above, from_below = couple * (-1.0) ** order, couple * ((-1.0) ** order)[:, None]
    eye = np.eye(terms)
    matrix = np.block([[eye, -response[:, None] * from_above], [-response[:, None] * from_below, eye]])
    right = np.zeros(2 * terms)
    right[[0, terms]] = -response[0]
    below, above = np.split(np.linalg.solve(matrix, right), 2)

    def potential(x):
        total = np.zeros(len(x))
        for coefficients, height in ((below, 0.0), (above, distance)):
            r = np.linalg.norm(x - [0, 0, height], axis=1)
            for k, a in enumerate(coefficients, 1):
                total += a / r ** (k + 1.0) * Legendre.basis(k)((x[:, 2] - height) / r)
        return total

    steps = 1e-5 * np.eye(3)
    return np.column_stack([potential(points - e) - potential(points + e) for e in steps]) / 2e-5


def between(gap):
    """Points in the middle between the spheres and around the lower one."""
    middle = RADIUS + gap / 2
    return np.array([[0, 0, middle], [0.03, 0, middle], [0.06, 0.02, 0.0], [0, 0.03, -0.06]])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("gap", [0.02, 0.05])
def test_two_spheres(form, gap):
    """Separate magnetic bodies act on each other; each keeps its own net flux at zero."""
    distance, mu = 2 * RADIUS + gap, 1000.0
    iron = iron_of(sphere("low", RADIUS, size=0.013), sphere("high", RADIUS, height=distance, size=0.013))
    assert iron.magnetic_bodies == 2
    state = solved(iron, form, [mu, mu])
    places = between(gap)
    exact = two_sphere_field(places, RADIUS, distance, mu)
    assert off(state, exact, places=places) < 4e-3
    charge = state.density[0] * state.faces.areas
    for body in range(2):
        mine = iron.topology.group_of_surface == body
        assert abs(charge[mine].sum()) < 1e-5 * np.abs(charge[mine]).sum()


def test_two_spheres_by_their_surfaces():
    """The surface form on the closer pair, as a device in a background field."""
    distance, mu = 2 * RADIUS + 0.02, 1000.0
    bodies = sphere("low", RADIUS, size=0.013), sphere("high", RADIUS, height=distance, size=0.013)
    materials = {body.name: LinearMaterial(body.name, mu) for body in bodies}
    device = Device("d", "", (), bodies, materials, background=Background(UP))
    solution = fm.solve_linear(device, form="surface")
    places = between(0.02)
    exact = two_sphere_field(places, RADIUS, distance, mu) + UP
    error = np.linalg.norm(solution.field(places, []) - exact, axis=1)
    assert (error / np.linalg.norm(exact, axis=1)).max() < 2e-3
    charge = solution.state.density[0] * solution.state.faces.areas
    for height in (0.0, distance):
        mine = np.abs(solution.state.faces.centres[:, 2] - height) < 1.05 * RADIUS
        assert abs(charge[mine].sum()) < 1e-5 * np.abs(charge[mine]).sum()


@pytest.mark.parametrize("mu_r", [1.0, 1.05, 3.0])
@pytest.mark.parametrize("form", FORMS)
def test_magnetised_sphere(one_sphere, form, mu_r):
    """Remanence Br and recoil permeability: polarisation 3 Br / (mu_r + 2), a dipole outside."""
    laws = [LinearMaterial("magnet", mu_r)]
    state = in_uniform_field(problem_of(one_sphere, form), laws, 0 * UP, remanence=1.2 * UP)
    assert off(state, dipole(OUTSIDE, 1.2 / (mu_r + 2) * RADIUS**3 * UP), 0 * UP) < 3e-3
