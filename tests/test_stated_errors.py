"""Stated errors and covariances of made-up numbers, against the textbook: the largest is no mean, n - p is not n."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.control.identification import Orders, least_squares
from fieldmap.interop import Measurements, fit_map, measured_map
from fieldmap.levitation.unknowns import _covariance
from fieldmap.maps import error_bound
from fieldmap.maps.training.model_error import Trial, larger


def test_covariance_of_a_regression_of_six_samples():
    """y_n = -a y_(n-1) + b u_(n-1) + e: five equations, two coefficients, three degrees of freedom."""
    u, y = np.array([1.0, -1.0, 2.0, 1.0, -2.0, 0.5]), np.array([0.0, 0.3, 0.1, 0.9, 1.2, -0.4])
    columns = np.stack([-y[:-1], u[:-1]], axis=1)
    theta = np.linalg.solve(columns.T @ columns, columns.T @ y[1:])
    left = y[1:] - columns @ theta
    variance = left @ left / 3
    found = least_squares(y, u, Orders(poles=1, zeros=0), 1e-3)
    exact = variance * np.linalg.inv(columns.T @ columns)
    np.testing.assert_allclose(found.covariance, exact, rtol=1e-10)
    np.testing.assert_allclose(found.standard_errors, np.sqrt(np.diag(exact)), rtol=1e-10)
    assert found.residual_rms == pytest.approx(np.sqrt(variance), rel=1e-10)


def test_covariance_of_known_deviations_of_six_readings():
    """(J^T J)^-1, slopes over the deviations: no share of what is left."""
    slopes = np.array([[1.0, 0.2], [0.5, -1.0], [2.0, 0.3], [0.1, 0.4], [-1.0, 2.0], [0.7, 0.7]])
    covariance, indistinct, alike = _covariance(slopes, np.array([1.0, 3.0]), ("a", "b"))
    np.testing.assert_allclose(covariance, np.linalg.inv(slopes.T @ slopes), rtol=1e-10)
    assert (indistinct, alike) == ((), ())


QUADRATICS = (
    lambda x, y, z: (y, x, 0 * x),
    lambda x, y, z: (z, 0 * x, x),
    lambda x, y, z: (0 * x, z, y),
    lambda x, y, z: (x, -y, 0 * x),
    lambda x, y, z: (-x, -y, 2 * z),
)


def harmonic_rows(points):
    """B (3 n, 8) of the potentials of degree 1 and 2, one column each."""
    uniform = np.tile(np.eye(3), (len(points), 1))
    linear = [np.stack(one(*points.T), axis=1).ravel() for one in QUADRATICS]
    return np.column_stack([uniform, *linear])


def test_errors_of_a_measured_map(monkeypatch):
    """20 readings of three components, 8 coefficients; the standard error at the node where it is largest."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.01, 0.01, (20, 3))
    rows = harmonic_rows(points)
    values = rows @ rng.normal(size=8) + 0.01 * rng.normal(size=60)
    held_out = np.full((20, 3), 1e-3)
    held_out[7, 1] = -2e-3
    monkeypatch.setattr(measured_map, "_held_out", lambda *_: held_out)
    readings = Measurements(("one",), points, np.full((20, 1), 2.0), values.reshape(20, 3))
    corner = np.full(3, 0.02)
    found = fit_map(readings, 0.01, lower=-corner, upper=corner, degree=2)
    report = found.report
    left = values - rows @ np.linalg.lstsq(rows, values)[0]
    covariance = left @ left / (60 - 8) * np.linalg.inv(rows.T @ rows)
    at_nodes = harmonic_rows(found.data.grid.points()).reshape(-1, 3, 8)
    spread = np.sqrt(np.einsum("nip,pq,niq->n", at_nodes, covariance, at_nodes))
    assert spread.max() > 1.3 * spread.mean()
    assert report.standard_error.flux_density == pytest.approx(spread.max(), rel=1e-6)
    assert report.residual == pytest.approx(np.sqrt(left @ left / 60), rel=1e-6)
    assert report.held_out == pytest.approx(np.sqrt(63 / 60) * 1e-3)
    assert report.held_out_worst == pytest.approx(2e-3)


def test_errors_of_a_model_are_the_largest_of_all_states():
    """Two states at two points: differences of 1 and 4 uT of 1 and 2 mT, gradients ten times these."""
    own = np.array([[[1e-3, 0, 0], [0, 0, 0]], [[0, 2e-3, 0], [1e-3, 0, 0]]])
    off = np.array([[[0, 1e-6, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, -4e-6]]])

    def pair(flux):
        return flux, 10 * np.repeat(flux[..., None], 3, axis=3) / np.sqrt(3)

    solver = SimpleNamespace(charge_density=lambda potentials: "theirs")
    trial = SimpleNamespace(
        _solver=solver,
        _least=(1e-6, 1e-5),
        fields=lambda charge: pair(own if charge == "theirs" else own + off),
        _without_iron=lambda currents, j: 0.0,
    )
    tried = SimpleNamespace(currents=np.zeros((2, 1)), potentials=None, solved=2)
    found = Trial.errors(trial, np.eye(2), "ours", tried)
    assert (found.flux_density, found.gradient) == pytest.approx((4e-6, 4e-5), rel=1e-9)
    assert (found.flux_density_share, found.gradient_share) == pytest.approx((2e-3, 2e-3), rel=1e-9)
    assert (found.largest_flux_density, found.largest_gradient) == pytest.approx((2e-3, 2e-2), rel=1e-9)
    assert larger(np.array([[0.1, 0.0], [0.0, 1.0]])).shape == (2,)


@pytest.mark.parametrize("beyond", [False, True])
def test_a_bound_is_that_of_the_worst_cell(beyond):
    """Cells without any difference beside it change nothing, and the fields' bounds add up by their scales."""
    degree = error_bound.FACE_DEGREE + 3
    terms = (degree + 1) ** 2
    one = np.random.default_rng(1).normal(size=(terms, 1, 2))
    size = np.array([1.0, 0.8, 1.2])
    on_faces = error_bound._faces_matrix(size)
    further = error_bound._BeyondFaces(degree, float(np.linalg.norm(size)) / 2)

    def bound(difference, scale=(1.0, 1.0)):
        scale = np.array(scale)
        if beyond:
            return further.largest(difference, scale)
        return error_bound._largest_sampled(on_faces, difference, scale)

    alone = bound(one)
    assert (alone > 0).all()
    np.testing.assert_allclose(bound(np.concatenate([one, 0 * one, 0.5 * one], axis=1)), alone, rtol=1e-12)
    first, second = bound(one, (3.0, 0.0)), bound(one, (0.0, 2.0))
    both = bound(one, (3.0, 2.0))
    assert (both <= (first + second) * (1 + 1e-12)).all()
    assert (both >= np.maximum(first, second)).all()


def test_a_sampled_error_is_that_of_the_worst_point():
    """Of two fields with scales 1 and 2: 3 + 2 x 1 at the second point."""
    zero = np.zeros((2, 3)), np.zeros((2, 3, 3))
    flux = np.array([[[1.0, 0, 0], [0, 3.0, 0]], [[0, 0, 0], [0, 0, 1.0]]])
    slope = 10 * np.repeat(flux[..., None], 3, axis=3) / np.sqrt(3)
    found = error_bound._largest(zip(flux, slope, strict=True), [zero, zero], np.array([1.0, 2.0]))
    np.testing.assert_allclose(found, [5.0, 50.0], rtol=1e-12)
