"""The field on the surface of iron and magnets is the limit from the air."""

import magpylib
import numpy as np
import pytest

import fieldmap as fm
from tests.iron.shared import at

HALF = np.array([0.01, 0.008, 0.006])
REMANENCE = np.array([0.2, 0.3, 1.0])
# On four faces; then on an edge, and on a corner.
ON_FACES = np.array(
    [[0.0021, -0.0013, 0.006], [0.01, 0.001, 0.002], [-0.0033, -0.008, 0.001], [0.0, 0.0, -0.006]]
)
OUTWARD = np.array([[0, 0, 1.0], [1, 0, 0], [0, -1, 0], [0, 0, -1]])
ON_EDGES = np.array([[0.01, 0.008, 0.001], HALF])


@pytest.fixture(scope="module")
def magnet():
    """A box of mu_r 1: its charges are the same all over a face, on every mesh."""
    body = fm.Body("magnet", "magnet", (fm.Part(fm.Box(tuple(2 * HALF)), at(0, 0, -HALF[2])),), 0.006)
    coil = fm.CircularCoil("far", 0.02, 0.021, 0.001, 1.0, placement=at(0, 0, 0.5))
    materials = {"magnet": fm.PermanentMagnet("magnet", REMANENCE, 1.0)}
    return fm.solve_linear(fm.Device("d", "", (coil,), (body,), materials))


def closed_form(points):
    """B (n, 3) of the box."""
    return magpylib.magnet.Cuboid(dimension=2 * HALF, polarization=REMANENCE).getB(points)


def test_limit_from_the_air(magnet):
    """Along a face B jumps by the remanence, up to 1 T; the gradient, not defined inside, is the outer one."""
    state, limit = magnet.at([0.0]), closed_form(ON_FACES + 1e-9 * OUTWARD)
    assert np.abs(closed_form(ON_FACES - 1e-9 * OUTWARD) - limit).max(axis=1) == pytest.approx(
        [0.3, 1, 1, 0.3]
    )
    assert state.field(ON_FACES) == pytest.approx(limit, abs=2e-4)
    flux, gradient = state.field_and_gradient(ON_FACES)
    assert flux == pytest.approx(limit, abs=2e-4)
    assert magnet.source_fields(ON_FACES)[0][1] == pytest.approx(limit, abs=2e-4)
    near, step = ON_FACES + 2e-6 * OUTWARD, 1e-6
    slopes = [
        (closed_form(near + step * one) - closed_form(near - step * one)) / (2 * step) for one in np.eye(3)
    ]
    assert gradient == pytest.approx(np.moveaxis(slopes, 0, 2), rel=0.01, abs=0.1)


def test_edges_are_in_the_air(magnet):
    """On an edge, where the field grows with the logarithm of the distance, it is the field less than 1 um away."""
    out = np.array([[1.0, 1, 0], [1, 1, 1]]) / np.sqrt([[2.0], [3.0]])
    near, far = (closed_form(ON_EDGES + distance * out) for distance in (1e-7, 1e-6))
    found = magnet.at([0.0]).field(ON_EDGES)
    assert ((found - near) * (found - far) <= 1e-9).all()
    assert np.isfinite(magnet.source_fields(ON_EDGES)[1]).all()
