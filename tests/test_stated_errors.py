"""Stated errors and covariances of made-up numbers, against textbook formulas; largest is not mean, n - p is not n."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.cli.scenario import _axes, _steps
from fieldmap.control import StepMetrics
from fieldmap.control.identification import (
    Orders,
    armax,
    fit_first_order,
    generalised_least_squares,
    identify_indirect,
    least_squares,
    modified_least_squares,
)
from fieldmap.control.linear_models import filter_response
from fieldmap.dynamics.scenario import batches
from fieldmap.dynamics.scenario.measured_log import LaidSignal
from fieldmap.dynamics.scenario.metrics import over_runs, run_metrics
from fieldmap.errors import MapErrorTooLarge
from fieldmap.interop import Measurements, fit_map, measured_map
from fieldmap.iron.sensitivity.quantities import Derivatives
from fieldmap.levitation.unknowns import Unknown, _covariance, find_unknowns
from fieldmap.maps import error_bound
from fieldmap.maps.acceptance import require_accuracy, shortfall
from fieldmap.maps.training.model_error import Trial, larger
from fieldmap.maps.training.plan import Plan
from fieldmap.store.stated_accuracy import missed_accuracy
from fieldmap.studies.tolerances import _sampled


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


def record(a, b, noise, count):
    """Output and input of y_n = -a y_(n-1) + b u_(n-1), and noise of deviation `noise` on the output."""
    rng = np.random.default_rng(5)
    u, y = rng.choice([-1.0, 1.0], count), np.zeros(count)
    for n in range(1, count):
        y[n] = -a * y[n - 1] + b * u[n - 1]
    return y + noise * rng.normal(size=count), u


def assert_textbook(found, columns, left, known=2):
    """Covariance s^2 (X^T X)^-1 of the first `known`, with s^2 = sum of squares / (n - p)."""
    degrees = len(left) - columns.shape[1]
    variance = left @ left / degrees
    exact = variance * np.linalg.inv(columns.T @ columns)[:known, :known]
    np.testing.assert_allclose(found.covariance, exact, rtol=2e-4, atol=2e-4 * np.abs(exact).max())
    np.testing.assert_allclose(found.standard_errors[:known], np.sqrt(np.diag(exact)), rtol=2e-4)
    assert found.residual_rms == pytest.approx(np.sqrt(variance), rel=1e-4)
    # n instead of n - p would be noticed.
    assert degrees < 0.97 * len(left)


def test_covariance_of_the_modified_least_squares_of_eight_samples():
    """The regression of both records filtered by 1/A, with A the result: seven equations, two coefficients."""
    y, u = record(-0.6, 1.0, 0.01, 8)
    found = modified_least_squares(y, u, Orders(poles=1, zeros=0), 1e-3, tolerance=1e-10)
    b, a = found.model.numerator, found.model.denominator
    through_y, through_u = (filter_response([1.0], a, one) for one in (y, u))
    columns = np.stack([-through_y[:-1], through_u[:-1]], axis=1)
    assert_textbook(found, columns, through_y[1:] - columns @ [a[1], b[0]])


def test_covariance_of_the_generalised_least_squares():
    """The regression of both records filtered by D, the autoregression of the residuals."""
    y, u = record(-0.6, 1.0, 0.05, 14)
    found = generalised_least_squares(y, u, Orders(poles=1, zeros=0), 1e-3, noise_order=1, tolerance=1e-10)
    theta = np.array([found.model.denominator[1], found.model.numerator[0]])
    left = y[1:] + theta[0] * y[:-1] - theta[1] * u[:-1]
    d = -(left[1:] @ left[:-1]) / (left[:-1] @ left[:-1])
    whitened_y, whitened_u = (np.append(one[0], one[1:] + d * one[:-1]) for one in (y, u))
    columns = np.stack([-whitened_y[:-1], whitened_u[:-1]], axis=1)
    assert_textbook(found, columns, whitened_y[1:] - columns @ theta)


def test_covariance_of_armax():
    """Slopes of the errors e_n = y_n + a y_(n-1) - b u_(n-1) - c e_(n-1), by differences; three coefficients."""
    y, u = record(-0.6, 1.0, 0.05, 52)
    found = armax(y, u, Orders(poles=1, zeros=0), 1e-3)

    def errors(theta):
        a, b, c = theta
        e, past = np.zeros(len(y)), (0.0, 0.0, 0.0)
        for n in range(len(y)):
            e[n] = y[n] + a * past[0] - b * past[1] - c * past[2]
            past = y[n], u[n], e[n]
        return e

    theta = np.array([found.model.denominator[1], found.model.numerator[0], found.noise[1]])
    steps = 1e-6 * np.eye(3)
    slopes = np.stack([(errors(theta + one) - errors(theta - one)) / 2e-6 for one in steps], axis=1)
    assert np.abs(slopes.T @ errors(theta)).max() < 1e-4 * np.abs(slopes).sum() * np.abs(errors(theta)).max()
    assert_textbook(found, slopes, errors(theta))


def test_covariance_of_the_indirect_way():
    """u = K (r - y): with instruments, the model's response to r, filtered by 1 / (A + K B)."""
    gain, a, b = 0.5, -0.6, 1.0
    rng = np.random.default_rng(2)
    r, y, seen = rng.choice([-1.0, 1.0], 16), np.zeros(16), np.zeros(16)
    for n in range(16):
        y[n] = -a * y[n - 1] + b * gain * (r[n - 1] - seen[n - 1]) if n else 0.0
        seen[n] = y[n] + 0.02 * rng.normal()
    found = identify_indirect(seen, r, ([gain], [1.0]), Orders(poles=1, zeros=0), 1e-3, tolerance=1e-10)
    theta = np.array([found.model.denominator[1], found.model.numerator[0]])
    closed = [1.0, theta[0] + gain * theta[1]]
    free = filter_response([0.0, gain * theta[1]], closed, r)

    def through(of):
        w, v = filter_response([1.0], closed, of), filter_response([gain], closed, r - of)
        return w[1:], np.stack([-w[:-1], v[:-1]], axis=1)

    target, columns = through(seen)
    left = target - columns @ theta
    np.testing.assert_allclose(through(free)[1].T @ left, 0.0, atol=1e-8)
    assert_textbook(found, through(free)[1], left)


def test_deviations_of_a_fitted_step_response():
    """Gain and time constant of eight readings: six degrees of freedom."""
    t = 0.01 * np.arange(8)
    y = 3.0 * (1.0 - np.exp(-t / 0.02)) + 0.02 * np.array([0, 1, -2, 1, 0, 2, -1, -1])
    found = fit_first_order(t, y, 1.0)
    gain, tau = (found.parameters[name] for name in ("gain", "time_constant"))
    slopes = np.stack([1 - np.exp(-t / tau), -gain * t / tau**2 * np.exp(-t / tau)], axis=1)
    left = y - gain * (1.0 - np.exp(-t / tau))
    exact = np.sqrt(left @ left / 6 * np.diag(np.linalg.inv(slopes.T @ slopes)))
    assert [found.errors[name] for name in ("gain", "time_constant")] == pytest.approx(exact, rel=1e-4)
    assert found.residual_rms == pytest.approx(np.sqrt(left @ left / 6), rel=1e-5)


def test_a_fit_of_two_tables_predicts_a_third():
    """Straight lines p + q t: a deviation for each reading, a missing reading, a prior of q."""
    first, second, third = np.array([0.0, 1.0, 2.0, 3.0]), np.array([4.0, 6.0]), np.array([10.0, 20.0])
    read = np.array([1.0, np.nan, 3.5, 3.9])
    tables = [
        SimpleNamespace(name="a", at=first, measured=read, deviation=[0.1, 0.1, 0.2, 0.4]),
        SimpleNamespace(name="b", at=second, measured=[5.2, 6.8], deviation=0.5),
        SimpleNamespace(name="c", at=third, measured=[12.0, 20.0], deviation=2.0),
    ]

    def compute(values, asked):
        return [values["p"] + values["q"] * table.at for table in asked]

    unknowns = [Unknown("p", 0.5), Unknown("q", 1.5, prior=(0.8, 0.3))]
    found = find_unknowns("here", unknowns, tables, 2, compute)
    t, y = np.array([0.0, 2.0, 3.0, 4.0, 6.0]), np.array([1.0, 3.5, 3.9, 5.2, 6.8])
    weight = 1 / np.array([0.1, 0.2, 0.4, 0.5, 0.5])
    rows = np.stack([np.append(weight, 0.0), np.append(weight * t, 1 / 0.3)], axis=1)
    covariance = np.linalg.inv(rows.T @ rows)
    p, q = covariance @ rows.T @ np.append(weight * y, 0.8 / 0.3)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6)
    assert list(found.values.values()) == pytest.approx([p, q], rel=1e-6)
    left = weight * (p + q * t - y)
    before = weight * (0.5 + 1.5 * t - y)
    assert found.misfit == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    assert found.misfit_before == pytest.approx(np.sqrt(np.mean(before**2)), rel=1e-9)
    assert [one.misfit for one in found.tables[:2]] == pytest.approx(
        [np.sqrt(np.mean(part**2)) for part in (left[:3], left[3:])], rel=1e-6
    )
    predicted = found.tables[2]
    assert predicted.misfit == pytest.approx(
        np.sqrt(np.mean(((p + q * third - [12.0, 20.0]) / 2.0) ** 2)), rel=1e-6
    )
    spread = np.sqrt([[1, at] @ covariance @ [1, at] for at in third])
    np.testing.assert_allclose(predicted.uncertainty, spread, rtol=1e-6)


def test_tolerances_add_up_by_their_squares():
    found = Derivatives(
        np.array(1.0), {"a": np.array(2.0), "b": np.array(-3.0), "c": np.array(0.0)}, 0
    ).spread({"a": 1.5, "b": 4 / 3, "c": 7.0})
    assert float(found.deviation) == pytest.approx(5.0)
    assert {key: float(share) for key, share in found.shares.items()} == pytest.approx(
        {"a": 0.36, "b": 0.64, "c": 0.0}
    )


def test_statistics_of_six_random_devices():
    """1, 2, 3, 5, 8, 11: sum of squares about the mean of 5 is 74, with five degrees of freedom."""
    found = _sampled(np.array([5.0, 1.0, 8.0, 2.0, 11.0, 3.0]))
    deviation = np.sqrt(74 / 5)
    assert (found.count, found.mean) == (6, 5.0)
    assert found.deviation == pytest.approx(deviation)
    assert found.mean_error == pytest.approx(deviation / np.sqrt(6))
    assert found.deviation_error == pytest.approx(deviation / np.sqrt(10))
    # Linear between the order statistics: 0.125 and 4.875 steps from the lowest.
    assert found.range == pytest.approx((1.125, 10.625))


def test_differences_of_a_log_and_a_run():
    """Measured less simulated: 1, -4, 1, 0."""
    told = LaidSignal("mm", np.array([2.0, 0.0, 4.0, 5.0]), np.array([1.0, 4.0, 3.0, 5.0])).to_dict()
    assert told == {"unit": "mm", "rms": pytest.approx(np.sqrt(18 / 4)), "mean": -0.5, "largest": 4.0}


def test_metrics_of_a_run_of_four_samples():
    """Depth is read downward from 50 mm; the measured position is 1 mm farther off than the true one."""
    true = np.array([[2.0, 0, -52.0], [-1.0, 0, -55.0], [-4.0, 3, -49.0], [1.0, 0, -48.0]])
    currents = np.array([[0.5, -3.0], [1.0, 0.0], [2.0, -1.0], [0.0, 1.0]])
    run = SimpleNamespace(
        time=0.1 * np.arange(4),
        sensed=1e-3 * true,
        seen=1e-3 * (true + [1.0, 0.0, -1.0]),
        references=1e-3 * np.tile([0.0, 0.0, -50.0], (4, 1)),
        rows=np.tile(np.r_[0.001, 0.0, -0.048, 0.2, 0.3, -0.4, 1.0, np.zeros(6)], (4, 1)),
        seen_at=np.zeros(3),
        currents=currents,
        tilt=np.deg2rad([1.0, 5.0, 2.0, 0.0]),
        event=None,
        touched=("floor",),
        iron=None,
        windings=None,
    )
    scenario = SimpleNamespace(zero_depth_mm=50.0, settings=SimpleNamespace(reference=()))
    found = run_metrics(scenario, run)
    x, _, depth = found.axes
    assert (x.rms_error_mm, x.rms_seen_mm) == pytest.approx((np.sqrt(22 / 4), np.sqrt(22 / 4 - 1 + 1)))
    assert (depth.rms_error_mm, depth.rms_seen_mm) == pytest.approx((np.sqrt(34 / 4), np.sqrt(46 / 4)))
    assert [(one.largest_error_mm, one.travel_mm) for one in found.axes] == [
        pytest.approx(pair) for pair in ((4.0, 6.0), (3.0, 3.0), (5.0, 7.0))
    ]
    assert found.largest_lean_deg == pytest.approx(5.0)
    assert found.largest_current_A == 3.0
    assert (found.end_s, found.event, found.touched) == (pytest.approx(0.3), "", ("floor",))
    assert found.end_mm == pytest.approx((1.0, 0.0, -2.0))
    assert found.end_mm_per_s == pytest.approx((200.0, 300.0, 400.0))
    assert found.end_A == (0.0, 1.0)


def test_a_root_mean_square_over_runs_is_that_of_all_samples():
    """3 and 4 in runs of equal length: the root of 25 / 2, not 3.5."""
    assert over_runs([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    unsettled = [SimpleNamespace(steady_rms=left, settling_time=np.inf) for left in (3.0, 4.0)]
    runs = [SimpleNamespace(event="", axes=[SimpleNamespace(step=step)] * 3) for step in unsettled]
    assert all("3.54 mm RMS" in line for line in batches._not_settled(runs))
    parts = [
        SimpleNamespace(
            axis="x",
            rms_error_mm=of,
            rms_seen_mm=2 * of,
            largest_error_mm=of,
            travel_mm=of,
            step=StepMetrics(0.0, 0.0, np.inf, 0.0, of),
        )
        for of in (3.0, 4.0)
    ]
    batch = SimpleNamespace(
        label="", runs=[SimpleNamespace(metrics=SimpleNamespace(axes=[part])) for part in parts]
    )
    cells = [[str(next(iter(column.cells))) for column in table(batch).columns] for table in (_axes, _steps)]
    assert cells[0][1:] == ["3.53553", "7.07107", "4.0000", "4.0000"]
    assert cells[1][-1] == "3.53553"


@pytest.mark.parametrize(("flux", "gradient", "asked"), [(0.0262, 0.01, 0.014), (0.0262, 0.0724, 0.019)])
def test_the_accuracy_that_a_refused_map_may_ask_for_is_reached(tmp_path, flux, gradient, asked):
    """Twice the accuracy of B, four times that of the gradient are allowed; the smallest value of two digits."""
    tried = {"at random": {"flux_density_share": flux, "gradient_share": gradient, "states": 6}}
    about = {"states_tried": tried, "held_out_within": 2e-3}
    plan = Plan(accuracy=1e-3, states=4096, modes=20, points=60, fields=4, held_out=2, tolerance=1e-3)
    with pytest.raises(MapErrorTooLarge) as caught:
        require_accuracy(about, plan, tmp_path / "map.h5", False)
    assert f"accuracy = {asked:g}," in caught.value.problems[0].remedy
    assert missed_accuracy(about | {"held_out_within": 2 * asked}) is None
    assert missed_accuracy(about | {"held_out_within": 2 * (asked - 1e-3)}) is not None


def test_the_part_to_blame_is_the_largest_and_the_fields_take_what_is_left():
    """The largest error is 0.05 of B; states, points and condensation are 0.02, 0.004, 0.003, so 0.023 is left."""
    tried = {
        "at random": {"flux_density_share": 0.01, "gradient_share": 0.02, "states": 2},
        "at extremes": {"flux_density_share": 0.03, "gradient_share": 0.1, "states": 4},
    }
    shares = {"states": 0.02, "points": 0.004, "condensation": 0.003}
    taken = {"states": 41, "modes": 201, "points": 431, "fields": 101}
    plan = Plan(accuracy=1e-3, states=40, modes=20, points=60, fields=4, held_out=2, tolerance=1e-3)
    for part, states in (("fields", 0.02), ("states", 0.0235)):
        parts = shares | {"states": states, "limits": ["fields"], "taken": taken}
        found = shortfall({"held_out_within": 2e-3, "states_tried": tried, "error_parts": parts}, plan)
        assert found.part == part


def test_covariance_of_known_deviations_of_six_readings():
    """(J^T J)^-1 with slopes over deviations, not scaled by the residuals."""
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
    """20 readings of three components, 8 coefficients; the standard error at the worst node."""
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
    """Two states at two points: differences of 1 and 4 uT from 1 and 2 mT, gradients ten times these."""
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
    """Cells with smaller differences change nothing; the bounds of the fields add up with their scales."""
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
    """Two fields with scales 1 and 2: 3 + 2 x 1 at the second point."""
    zero = np.zeros((2, 3)), np.zeros((2, 3, 3))
    flux = np.array([[[1.0, 0, 0], [0, 3.0, 0]], [[0, 0, 0], [0, 0, 1.0]]])
    slope = 10 * np.repeat(flux[..., None], 3, axis=3) / np.sqrt(3)
    found = error_bound._largest(zip(flux, slope, strict=True), [zero, zero], np.array([1.0, 2.0]))
    np.testing.assert_allclose(found, [5.0, 50.0], rtol=1e-12)
