"""Inductances in air against published formulas and independent integrals; rules against exact moments and areas."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.special import ellipe, ellipk

from fieldmap.device.model import CircularCoil, PathCoil, Placement, RoundedRectangleCoil
from fieldmap.sources import unit_flux_density
from fieldmap.sources.inductance import bare_inductance
from fieldmap.sources.winding_rules import current_elements, flux_elements

L_SHAPE = np.array([[0, 0], [0.06, 0], [0.06, 0.03], [0.03, 0.03], [0.03, 0.06], [0, 0.06]])


def at(x, y, z, axis=2):
    return Placement(np.array([x, y, z], float), np.roll(np.eye(3), axis - 2, axis=0))


def tilted(position, angle):
    c, s = np.cos(angle), np.sin(angle)
    return Placement(np.asarray(position, float), np.array([[1, 0, 0], [0, c, -s], [0, s, c]]))


def test_brooks_coil():
    """Grover, Inductance Calculations (1946), p. 94: L = 1.6994e-6 a N^2 for mean radius a = 1.5 x side."""
    coil = CircularCoil("brooks", 0.02, 0.04, 0.02, 1000.0)
    assert bare_inductance([coil])[0, 0] == pytest.approx(1.6994e-6 * 0.03 * 1e6, rel=3e-5)


def test_thin_solenoid():
    """Lorenz's exact formula for a cylindrical current sheet (Grover, p. 142), here 2 um thick."""
    a, length, turns = 0.02, 0.05, 300.0
    k2 = 4 * a * a / (4 * a * a + length**2)
    k = np.sqrt(k2)
    exact = (
        8
        / 3
        * mu_0
        * turns**2
        * a**3
        / length**2
        * ((2 * k2 - 1) / k**3 * ellipe(k2) + (1 - k2) / k**3 * ellipk(k2) - 1)
    )
    coil = CircularCoil("sheet", a - 1e-6, a + 1e-6, length, turns)
    assert bare_inductance([coil])[0, 0] == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(
    ("one", "two"),
    [
        (
            CircularCoil("one", 0.02, 0.03, 0.01, 100.0),
            CircularCoil("two", 0.015, 0.035, 0.02, 50.0, -1, placement=at(0, 0, 0.03)),
        ),
        (
            CircularCoil("thin", 0.1, 0.101, 0.001, 1.0),
            CircularCoil("close", 0.1, 0.101, 0.001, 1.0, placement=at(0, 0, 0.003)),
        ),
        (
            CircularCoil("outer", 0.03, 0.04, 0.02, 10.0),
            CircularCoil("inner", 0.02, 0.028, 0.01, 10.0),
        ),
    ],
)
def test_mutual_inductance_of_coaxial_coils(one, two):
    """Maxwell's formula for two coaxial circles, integrated over both sections."""
    x, w = np.polynomial.legendre.leggauss(12)
    (a, da, ha), (b, db, hb) = (
        (c.inner_radius + c.outer_radius, c.outer_radius - c.inner_radius, c.height) for c in (one, two)
    )
    z = two.placement.position[2]
    r1, z1, r2, z2 = np.meshgrid(
        (a + da * x) / 2, ha * x / 2, (b + db * x) / 2, z + hb * x / 2, indexing="ij"
    )
    weight = np.einsum("i,j,k,l->ijkl", w, w, w, w) / 16
    k2 = 4 * r1 * r2 / ((r1 + r2) ** 2 + (z1 - z2) ** 2)
    k = np.sqrt(k2)
    maxwell = mu_0 * np.sqrt(r1 * r2) * ((2 / k - k) * ellipk(k2) - 2 / k * ellipe(k2))
    exact = one.turns * two.turns * two.polarity * np.sum(weight * maxwell)
    matrix = bare_inductance([one, two])
    assert matrix[0, 1] == pytest.approx(exact, rel=1e-5)
    assert (matrix == matrix.T).all()


@pytest.mark.parametrize("reverse", [False, True])
def test_a_path_that_is_a_circle_is_a_circular_coil(reverse):
    square = 0.03 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    path = PathCoil("path", square[::-1] if reverse else square, 0.03, 0.02, 0.02, 500.0)
    circle = CircularCoil("circle", 0.02, 0.04, 0.02, 500.0)
    assert bare_inductance([path])[0, 0] == pytest.approx(bare_inductance([circle])[0, 0], rel=1e-9)


def test_thin_rectangle():
    """Grover, p. 60: a rectangle of square wire of side c, with the geometric mean distance 0.44705 c."""
    a, b, side = 0.3, 0.2, 1e-3
    coil = RoundedRectangleCoil("frame", a / 2, b / 2, side / 2, side, side, 1.0)
    diagonal, gmd = np.hypot(a, b), 0.44705 * side
    lines = a * np.log(2 * a / gmd) + b * np.log(2 * b / gmd)
    corners = -a * np.arcsinh(a / b) - b * np.arcsinh(b / a) + 2 * diagonal - 2 * (a + b) + gmd
    assert bare_inductance([coil])[0, 0] == pytest.approx(mu_0 / np.pi * (lines + corners), rel=2e-3)


@pytest.mark.parametrize("reverse", [False, True])
def test_one_winding_is_the_sum_of_its_halves(reverse):
    """A path with a re-entrant corner, cut in two along its height: L = (L1 + L2 + 2 M) / 4 at equal turns."""
    corners = L_SHAPE[::-1] if reverse else L_SHAPE
    whole = PathCoil("whole", corners, 0.006, 0.008, 0.03, 10.0)
    low, high = (
        PathCoil("half", corners, 0.006, 0.008, 0.015, 10.0, placement=at(0, 0, z)) for z in (0, 0.015)
    )
    halves = bare_inductance([low, high])
    assert bare_inductance([whole])[0, 0] == pytest.approx(halves.sum() / 4, rel=2e-3)


@pytest.mark.parametrize(
    "coil",
    [
        CircularCoil("c", 0.01, 0.02, 0.03, 80.0, -1, placement=tilted([0.01, 0.02, 0.0], 0.7)),
        RoundedRectangleCoil(
            "r", 0.02, 0.03, 0.012, 0.01, 0.02, 50.0, placement=tilted([0.0, 0.02, 0.01], 1.9)
        ),
        PathCoil("p", L_SHAPE, 0.006, 0.008, 0.02, 30.0, placement=tilted([0.0, 0.0, 0.03], -0.4)),
    ],
)
def test_rules_agree_with_each_other_and_with_the_field(coil):
    """Linked area = magnetic moment per ampere; flux of another coil through the turns = Neumann's integral."""
    currents, fluxes = current_elements(coil), flux_elements(coil)
    moment = 0.5 * np.cross(currents.points, currents.vectors).sum(axis=0)
    assert currents.vectors.sum(axis=0) == pytest.approx(
        np.zeros(3), abs=1e-9 * np.abs(currents.vectors).sum()
    )
    assert fluxes.vectors.sum(axis=0) == pytest.approx(moment, abs=1e-7 * np.abs(moment).max())
    # The far field is the moment's.
    axis = coil.placement.rotation[:, 2]
    far = unit_flux_density(coil, coil.placement.position + 20.0 * axis)[0]
    assert far == pytest.approx(2e-7 * moment / 20.0**3, rel=0.02, abs=5e-3 * np.linalg.norm(far))
    other = CircularCoil("other", 0.02, 0.03, 0.01, 10.0, placement=at(0.02, 0.01, 0.15))
    through = np.sum(unit_flux_density(other, fluxes.points) * fluxes.vectors)
    assert bare_inductance([coil, other])[0, 1] == pytest.approx(through, rel=1e-6)


def test_circular_moment():
    """Mean area of the turns: pi (r1^2 + r1 r2 + r2^2) / 3."""
    rule = flux_elements(CircularCoil("c", 0.01, 0.02, 0.03, 80.0))
    assert rule.vectors.sum(axis=0)[2] == pytest.approx(80 * np.pi * 7e-4 / 3, rel=1e-12)
