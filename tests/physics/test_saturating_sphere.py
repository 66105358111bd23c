"""A sphere of any isotropic law in a uniform field is uniformly magnetised: B + 2 mu0 H = 3 B0 (Jackson 5.11)."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.optimize import brentq

import fieldmap as fm
from fieldmap.device.model import Body, Froehlich, Marrocco, Sphere
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.potential_form import PotentialForm
from tests.iron.shared import FOOT, dipole, in_uniform_field, iron_of

RADIUS = 0.05
DIRECTION = np.array([0.48, -0.6, 0.64])
OUTSIDE = np.array([[0.06, 0, 0], [0, 0, 0.06], [0.04, 0.03, 0.04], [0.1, 0.02, 0.03], [0, 0.07, -0.02]])


@pytest.fixture(scope="module")
def steel():
    return fm.read_device("drive_unit").materials["steel"]


@pytest.fixture(scope="module")
def form():
    return PotentialForm(iron_of(Body("ball", "iron", Sphere(RADIUS), 0.0105)))


def exact_induction(material, applied):
    """B in the sphere, T, by the scalar equation, with the table's own points joined by straight lines."""
    h, b = np.append(0.0, material.h), np.append(0.0, material.b)

    def curve(x):
        return np.interp(x, h, b) if x <= h[-1] else b[-1] + mu_0 * (x - h[-1])

    field = brentq(lambda x: curve(x) + 2 * mu_0 * x - 3 * applied, 0.0, 3 * applied / (2 * mu_0) + 1)
    return curve(field)


def solved(form, material, applied):
    """State in a field, T, and the mean flux density inside."""
    state = in_uniform_field(form, [material], applied * DIRECTION, 1e-7)
    volume = form.elements.volume
    return state, volume @ state.flux_density[0] / volume.sum()


@pytest.mark.parametrize("applied", [0.1, 0.3, 0.6, 0.7, 0.8, 1.0, 1.5, 3.0])
def test_sphere_from_weak_to_saturated(form, steel, applied):
    """Outside field within 0.2 % of the total. The table is sparse near 0.7 T applied (B about 2 T), where straight
    lines and monotone cubics differ by 0.1 %."""
    state, mean = solved(form, steel, applied)
    induction = exact_induction(steel, applied)
    # B = J + mu0 H and B + 2 mu0 H = 3 B0: J = 3 (B - B0) / 2, moment J R^3 / 3 in units of the dipole.
    exact = dipole(OUTSIDE, 0.5 * (induction - applied) * RADIUS**3 * DIRECTION)
    error = np.linalg.norm(state.faces.field(OUTSIDE, state.density)[0] - exact, axis=1)
    assert (error / np.linalg.norm(exact + applied * DIRECTION, axis=1)).max() < 2e-3
    assert mean == pytest.approx(induction * DIRECTION, rel=2e-3)


def test_polarisation_saturates(form, steel):
    """M -> Ms: doubling a large field leaves the polarisation at the end of the table."""
    ends = steel.b[-1] - mu_0 * steel.h[-1]
    for applied in (3.0, 6.0):
        _, mean = solved(form, steel, applied)
        assert 1.5 * (mean @ DIRECTION - applied) == pytest.approx(ends, rel=2e-3)


def test_tangent_is_the_derivative_of_the_residual(form, steel):
    """Taylor test of the Newton matrix at a saturated state: the remainder falls with the square of the step."""
    field = form.elements.coil_field(lambda p: np.broadcast_to(0.8 * DIRECTION, (1, *p.shape)))
    count = len(form.elements.volume)
    law = Magnetisation(np.zeros(count, np.int64), law_tables([steel]), np.zeros((1, count, 3)))
    phi = form.solve(law, field, 1e-6).potential[:, 0]
    step = np.random.default_rng(0).normal(size=phi.size) * np.abs(phi).max() * 1e-3
    slope = -form.tangent(phi, field, law) @ step
    base = form._residual(phi, field, 0, law)
    remainder = [
        np.linalg.norm(form._residual(phi + a * step, field, 0, law) - base - a * slope)
        for a in (0.1, 0.05, 0.025)
    ]
    assert np.log2(remainder[0] / remainder[1]) > 1.7
    assert np.log2(remainder[1] / remainder[2]) > 1.8


FROEHLICH = Froehlich("froehlich", 3000.0, 2.1)
MARROCCO = Marrocco("marrocco", 2e-4, 1.0, 5.5, 5e4)


def induction_of(material, applied):
    """B in the sphere, T: the law and B + 2 mu0 H = 3 B0; the analytic laws as the literature writes them."""
    if isinstance(material, Marrocco):

        def excess(b):
            power = b ** (2 * material.alpha)
            field = (material.eps + (material.c - material.eps) * power / (power + material.tau)) * b
            return b + 2 * field - 3 * applied

        return brentq(excess, 0.0, 2.16)
    if isinstance(material, Froehlich):

        def law(h):
            return h + (material.mu_r - 1) * h / (1 + (material.mu_r - 1) * h / material.saturation)
    else:
        tables = law_tables([material])

        def law(h):
            return tables.flux_density(np.array([h]), np.zeros(1, int))[0][0]

    return law(brentq(lambda h: law(h) + 2 * h - 3 * applied, 0.0, 3 * applied))


@pytest.mark.parametrize(
    ("material", "applied"),
    [(FROEHLICH, 0.4), (FROEHLICH, 0.9), (FROEHLICH, 3.0), (MARROCCO, 0.4), (MARROCCO, 0.7)]
    + [(FOOT, applied) for applied in (1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 2.0)],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_sphere_of_other_laws(form, material, applied):
    """Formulas, and a table whose permeability rises before it falls: mean B within 0.2 %."""
    state, mean = solved(form, material, applied)
    assert mean == pytest.approx(induction_of(material, applied) * DIRECTION, rel=2e-3)
    assert state.iterations <= 20
