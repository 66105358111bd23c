"""Maps from readings against the field that was read, with and without noise; their files."""

import json
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.errors import InputError
from fieldmap.interop import Measurements, fit_map, measured_map
from fieldmap.lookup import interpolate, open_map
from fieldmap.store import write_map
from tests.refusals import refused

NAMES = tuple("123456")


def readings(ring, n, noise, seed=0):
    rng = np.random.default_rng(seed)
    points = ring.map.lower + rng.random((n, 3)) * (ring.map.upper - ring.map.lower)
    points[:8] = np.stack(np.meshgrid(*zip(ring.map.lower, ring.map.upper, strict=True)), axis=-1).reshape(
        -1, 3
    )
    currents = rng.uniform(-2, 2, (n, 6))
    flux = np.einsum("cni,nc->ni", ring.fields(points)[0], currents)
    return Measurements(NAMES, points, currents, flux + noise * rng.normal(size=(n, 3)))


def errors(ring, measured, currents, n=500):
    """Largest errors of field and gradient, and the largest values of both."""
    rng = np.random.default_rng(9)
    points = ring.map.lower + rng.random((n, 3)) * (ring.map.upper - ring.map.lower)
    m = interpolate(measured.data)
    exact = [np.einsum("c...,c->...", part, currents) for part in ring.fields(points)]
    ours = m.field_and_gradient(points, currents)
    return [np.abs(a - b).max() for a, b in zip(ours, exact, strict=True)], [np.abs(b).max() for b in exact]


def test_without_noise_the_field_is_found(ring):
    measured = fit_map(readings(ring, 800, 0.0), 0.005)
    (flux, slope), (largest, steepest) = errors(ring, measured, np.ones(6))
    assert flux < 4e-5 * largest
    assert slope < 1e-3 * steepest
    assert measured.report.degree >= 8
    # The map's own numbers, at its nodes.
    data = measured.data
    _, exact = ring.fields(data.grid.points())
    assert np.abs(data.gradient.reshape(exact.shape) - exact).max() < 5e-3 * np.abs(exact).max()


def test_many_nodes_take_little_more_memory_than_their_map(ring, monkeypatch):
    """Fields and errors do not depend on the parts in which they are evaluated."""
    taken = readings(ring, 400, 20e-6)
    whole = fit_map(taken, 0.005, degree=4)
    monkeypatch.setattr(measured_map, "_NODES_AT_ONCE", 7)
    parts = fit_map(taken, 0.005, degree=4)
    np.testing.assert_allclose(parts.data.flux_density, whole.data.flux_density, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(parts.data.gradient, whole.data.gradient, rtol=1e-12, atol=1e-12)
    for error in ("flux_density", "gradient"):
        stated = [getattr(one.report.standard_error, error) for one in (parts, whole)]
        assert stated[0] == pytest.approx(stated[1], rel=1e-12)
    monkeypatch.undo()
    tracemalloc.start()
    fine = fit_map(taken, 0.0015, degree=4)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 4 * (fine.data.flux_density.nbytes + fine.data.gradient.nbytes)


def test_noise_is_taken_out_and_stated(ring):
    noise = 20e-6
    measured = fit_map(readings(ring, 2000, noise), 0.005)
    report = measured.report
    assert report.residual == pytest.approx(noise, rel=0.1)
    assert noise < report.held_out < 1.3 * noise
    assert report.held_out < report.held_out_worst < 7 * noise
    (flux, slope), _ = errors(ring, measured, np.ones(6))
    # Standard errors hold with all coils at their reference currents, here 2 A; those above are at 1 A, and smaller.
    assert flux < report.standard_error.flux_density < 20 * flux
    assert slope < report.standard_error.gradient < 40 * slope
    # Four times the readings, half the error.
    better = fit_map(readings(ring, 8000, noise, seed=1), 0.005, degree=report.degree)
    ratio = report.standard_error.flux_density / better.report.standard_error.flux_density
    assert ratio == pytest.approx(2.0, rel=0.2)


def test_a_measured_map_goes_through_the_file_and_says_what_it_is(ring, tmp_path):
    measured = fit_map(readings(ring, 500, 1e-6), 0.01)
    opened = open_map(write_map(tmp_path / "measured.h5", measured.data))
    there = interpolate(measured.data).field([0, 0, -0.1], np.ones(6))
    # The file holds the field at the reference currents, which come from the readings and are no round numbers.
    np.testing.assert_allclose(
        opened.field([0, 0, -0.1], np.ones(6)), there, rtol=0, atol=1e-15 * np.abs(there).max()
    )
    record = opened.info.provenance
    assert record.solver_report["held_out_T"] == measured.report.held_out
    assert any("no iron" in text for text in record.assumptions)


def test_coils_that_cannot_be_told_apart(ring):
    some = readings(ring, 400, 0.0)
    same = Measurements(NAMES, some.points, np.ones((400, 6)), some.flux_density)
    # All six coils carry the same current: of 6 x 24 shares of harmonics only 24 sums are determined.
    with pytest.raises(InputError, match="rank 24 of 144"):
        fit_map(same, 0.01, degree=4)
    with pytest.raises(InputError, match="9 readings"):
        fit_map(Measurements(NAMES, some.points[:9], some.currents[:9], some.flux_density[:9]), 0.01)
    with pytest.raises(InputError, match="spacing > 0"):
        fit_map(some, 0.0)
    with pytest.raises(InputError, match=r"flux_density.*NaN"):
        Measurements(NAMES, some.points, some.currents, np.full((400, 3), np.nan))


# Symmetric and free of trace: the gradients that a field in air can have.
SLOPES = np.array(
    [
        *(np.diag(one) for one in ([1.0, 0.0, -1.0], [0.0, 1.0, -1.0])),
        *(
            [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
            [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
            [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        ),
    ]
)
LOWER, UPPER = np.array([-0.01, -0.02, -0.12]), np.array([0.02, 0.01, -0.08])


def parts_of_field(points):
    """B (n, 3, 8) of the fields of degree 2: three uniform ones and five with a gradient each."""
    every = [np.broadcast_to(np.eye(3), (len(points), 3, 3)), np.einsum("kij,nj->nik", SLOPES, points)]
    return np.concatenate(every, axis=-1)


def some_readings(n=60, noise=1e-3, coils=2, seed=0):
    """Of fields of degree 2, T, with noise, in two corners of a box of unequal sides and inside."""
    rng = np.random.default_rng(seed)
    points = LOWER + rng.random((n, 3)) * (UPPER - LOWER)
    points[:2] = LOWER, UPPER
    currents = rng.uniform(-2, 2, (n, coils))
    design = np.einsum("nik,nc->nick", parts_of_field(points), currents).reshape(3 * n, -1)
    true = rng.normal(size=8 * coils)
    flux = (design @ true).reshape(n, 3) + noise * rng.normal(size=(n, 3))
    return Measurements(NAMES[:coils], points, currents, flux), design, true


def test_a_fit_is_that_of_the_textbook():
    """Against least squares by hand, of two coils whose largest currents differ."""
    given, design, _ = some_readings()
    given = Measurements(NAMES[:2], given.points, given.currents * [1.0, 2.0], given.flux_density)
    design = design * np.repeat([1.0, 2.0], 8)
    fit = fit_map(given, 0.009, degree=2)
    values = given.flux_density.ravel()
    found, (rest,), _, _ = np.linalg.lstsq(design, values)
    report, data = fit.report, fit.data
    assert (report.degree, report.readings) == (2, 60)
    assert report.residual == pytest.approx(np.sqrt(rest / 180), rel=1e-9)
    assert data.grid.shape == (5, 5, 6)
    np.testing.assert_allclose([data.grid.lower, data.grid.upper], [LOWER, UPPER], atol=1e-15)
    np.testing.assert_allclose(data.reference_current, np.abs(given.currents).max(axis=0))
    nodes = data.grid.points()
    basis = parts_of_field(nodes)
    covariance = rest / (180 - 16) * np.linalg.inv(design.T @ design)
    errors = [0.0, 0.0]
    for c, ampere in enumerate(data.reference_current):
        some = slice(8 * c, 8 * c + 8)
        flux = basis @ found[some]
        np.testing.assert_allclose(data.flux_density[c].reshape(-1, 3), flux, atol=1e-9)
        slope = np.einsum("kij,k->ij", SLOPES, found[some][3:])
        np.testing.assert_allclose(
            data.gradient[c].reshape(-1, 3, 3), np.tile(slope, (len(nodes), 1, 1)), atol=1e-8
        )
        of_coil = covariance[some, some]
        errors[0] += ampere * np.sqrt(np.einsum("nik,kl,nil->n", basis, of_coil, basis))
        errors[1] += ampere * np.sqrt(np.einsum("kij,kl,lij->", SLOPES, of_coil[3:, 3:], SLOPES))
    assert report.standard_error.flux_density == pytest.approx(errors[0].max(), rel=1e-6)
    assert report.standard_error.gradient == pytest.approx(errors[1], rel=1e-6)
    stated = data.provenance.solver_report
    same = {
        "residual_T": report.residual,
        "held_out_T": report.held_out,
        "held_out_worst_T": report.held_out_worst,
    }
    same |= {
        "standard_error_T": errors[0].max(),
        "standard_error_T_per_m": errors[1],
        "degree": 2,
        "readings": 60,
    }
    assert {key: stated[key] for key in same} == pytest.approx(same, rel=1e-6)
    assert f"to {report.held_out:.2g} T" in data.provenance.assumptions[-1]
    assert fit.to_dict()["report"]["held_out"] == report.held_out


def test_readings_are_predicted_by_fits_without_them():
    """Each fifth by a whole fit to the other four."""
    given, _, _ = some_readings()
    report = fit_map(given, 0.01, degree=3).report
    fold = np.random.default_rng(20250321).permutation(60) % 5
    missed = np.empty((60, 3))
    for out in range(5):
        rest, others = fold == out, fold != out
        part = Measurements(
            NAMES[:2], *(of[others] for of in (given.points, given.currents, given.flux_density))
        )
        field = interpolate(fit_map(part, 0.01, LOWER, UPPER, degree=3).data)
        missed[rest] = given.flux_density[rest] - field.field(given.points[rest], given.currents[rest])
    assert report.held_out == pytest.approx(np.sqrt(np.mean(missed**2)), rel=1e-5)
    assert report.held_out_worst == pytest.approx(np.abs(missed).max(), rel=1e-5)


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_the_degree_is_that_of_the_field(degree):
    """The field is a sum of the gradients of Re (x + i z)^l, from degree 1 to this one."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (200, 3))
    w = points[:, 0] + 1j * points[:, 2]
    powers = sum(l * w ** (l - 1) for l in range(1, degree + 1))
    flux = np.stack([powers.real, 0 * powers.real, -powers.imag], axis=1) + 1e-3 * rng.normal(size=(200, 3))
    given = Measurements(("coil",), points, np.ones((200, 1)), flux)
    assert fit_map(given, 0.5).report.degree == degree
    assert fit_map(given, 0.5, degree=6).report.degree == 6


def test_readings_are_enough_or_too_few():
    for count in (5, 6):
        given, _, _ = some_readings(count, 1e-6, coils=1)
        if count == 6:
            assert fit_map(given, 0.01).report.degree == 2
            continue
        with refused(InputError, where="fit_map", received="5 readings for 1 coils"):
            fit_map(given, 0.01)


@pytest.mark.parametrize(
    ("spacing", "shape"),
    [
        (0.01, (4, 4, 5)),
        (0.0099, (5, 5, 6)),
        (0.0101, (4, 4, 5)),
        (0.01 / (1 + 1e-12), (4, 4, 5)),
        (1.0, (2, 2, 2)),
    ],
)
def test_nodes_lie_no_farther_apart_than_asked(spacing, shape):
    given, _, _ = some_readings(20, coils=1)
    assert fit_map(given, spacing, degree=2).data.grid.shape == shape


def test_what_a_fit_may_take(monkeypatch):
    """Nodes and bytes, just within their limits and just beyond."""
    given, _, _ = some_readings(20, coils=1)
    assert (measured_map.MOST_NODES, measured_map.MOST_BYTES, measured_map.HIGHEST_DEGREE) == (
        2_000_000,
        4e9,
        10,
    )
    for nodes, fits in ((80, True), (79, False)):
        monkeypatch.setattr(measured_map, "MOST_NODES", nodes)
        if fits:
            fit_map(given, 0.01, degree=2)
            continue
        with refused(
            InputError,
            where="fit_map",
            must_hold="at most 79 nodes",
            received="80, by a spacing of 0.01 m in a box from [-0.01 -0.02 -0.12] to [ 0.02  0.01 -0.08] m",
        ):
            fit_map(given, 0.01, degree=2)
    monkeypatch.undo()
    # 8 bytes for each unknown and each of the three components of a reading.
    for most, fits in ((24 * 15 * 20, True), (24 * 15 * 20 - 1, False)):
        monkeypatch.setattr(measured_map, "MOST_BYTES", most)
        if fits:
            fit_map(given, 0.01, degree=3)
            continue
        with refused(InputError, where="fit_map", received="7.2e-06 GB for 20 readings at degree 3"):
            fit_map(given, 0.01, degree=3)
        assert fit_map(given, 0.01).report.degree == 2
    for wrong in ((0.0, LOWER, UPPER), (-0.01, None, None), (np.inf, None, None), (np.nan, None, None)):
        with refused(InputError, where="fit_map", must_hold="spacing > 0"):
            fit_map(given, *wrong, degree=2)
    with refused(InputError, where="fit_map", must_hold="a box with a volume"):
        fit_map(given, 0.01, LOWER, [*UPPER[:2], LOWER[2]], degree=2)


def signed(n=60, size=0.05):
    """Readings of one coil whose components all differ by the same amount, T, up or down, from a field of degree 2; the
    field is 1 T in the root mean square."""
    given, design, true = some_readings(n, 0.0, coils=1)
    flux = (design @ true).reshape(-1, 3)
    flux /= np.sqrt(np.mean(flux**2))
    return given, flux + size * np.sign(np.random.default_rng(1).normal(size=(n, 3))), design


def limits(flux, design, k):
    """What a reading must differ from the prediction of the others to be wild: 20 of its standard errors, and 5 times
    the largest such difference among the others; then that prediction."""
    rows = np.arange(3 * k, 3 * k + 3)
    others = np.delete(np.arange(design.shape[0]), rows)
    found = np.linalg.lstsq(design[others], flux.ravel()[others])[0]
    missed = np.abs((flux.ravel() - design @ found).reshape(-1, 3)).max(axis=1)
    missed = np.delete(missed, k)
    scatter = np.sqrt(np.sum(missed**2) / (len(others) - design.shape[1]))
    spread = (
        1 + np.diag(design[rows] @ np.linalg.inv(design[others].T @ design[others]) @ design[rows].T).max()
    )
    return 20 * scatter * np.sqrt(spread), 5 * missed.max(), design[rows] @ found


@pytest.mark.parametrize(("beyond", "wild"), [(0.97, False), (1.03, True)])
@pytest.mark.parametrize("which", ["errors", "others", "field"])
def test_a_reading_is_wild_beyond_three_limits(which, beyond, wild):
    """Each limit where it is the largest of the three."""
    size = {"errors": 0.05, "others": 0.02, "field": 1e-4}[which]
    given, flux, design = signed(size=size)
    if which == "others":
        flux[30, 0] += 0.1
    k = 7
    by_errors, by_others, there = limits(flux, design, k)
    assert {"errors": by_errors, "others": by_others, "field": 0.2}[which] >= max(by_errors, by_others, 0.2)
    flux[k] = there
    limit = 0.2 * np.sqrt(np.mean(flux**2)) if which == "field" else max(by_errors, by_others)
    flux[k, 2] += beyond * limit
    given = Measurements(given.coil_names, given.points, given.currents, flux)
    if not wild:
        assert fit_map(given, 0.01, degree=2).report.held_out_worst > 0.5 * limit
        return
    with pytest.raises(InputError) as caught:
        fit_map(given, 0.01, degree=2)
    (problem,) = caught.value.problems
    assert problem.where == "Measurements, row 7"
    off = float(problem.received.split("] T, ")[1].split()[0])
    assert off == pytest.approx(limit * beyond, rel=0.1)
    assert problem.received.startswith(str(flux[k].tolist()))
    if which == "errors":
        assert float(problem.must_hold.split("about ")[1].split()[0]) == pytest.approx(size, rel=0.2)


@pytest.mark.parametrize(
    ("count", "spoilt", "named"),
    [(19, 1, True), (39, 2, False), (40, 2, True), (60, 3, True), (59, 3, False)],
)
def test_a_twentieth_of_the_readings_may_be_wild(count, spoilt, named):
    given, flux, _ = signed(count, 1e-4)
    rows = [3, 11, 17][:spoilt]
    flux[rows, 1] += np.array([7.0, -6.0, 5.0])[:spoilt]
    with pytest.raises(InputError) as caught:
        fit_map(Measurements(given.coil_names, given.points, given.currents, flux), 0.01, degree=2)
    where = [problem.where for problem in caught.value.problems]
    assert where == ([f"Measurements, row {k}" for k in rows] if named else ["fit_map"])
    if not named:
        assert caught.value.problems[0].received.endswith("row 3")
        share = float(caught.value.problems[0].received.split()[0])
        assert 50.0 < share < 150.0


def test_twenty_wild_readings_are_named_and_no_more():
    given, flux, _ = signed(500, 1e-4)
    for spoilt in (20, 21):
        wrong = flux.copy()
        wrong[:spoilt, 1] += np.linspace(3.0, 9.0, spoilt)
        with pytest.raises(InputError) as caught:
            fit_map(Measurements(given.coil_names, given.points, given.currents, wrong), 0.01, degree=2)
        assert len(caught.value.problems) == (20 if spoilt == 20 else 1)


@pytest.mark.parametrize(("noise", "fits"), [(0.45, True), (0.7, False)])
def test_readings_that_are_half_noise_are_no_field(noise, fits):
    """By the root mean square of what is not predicted, over that of the readings."""
    given, flux, _ = signed(200, noise)
    flux *= 1e-3
    given = Measurements(given.coil_names, given.points, given.currents, flux)
    if fits:
        report = fit_map(given, 0.01, degree=2).report
        assert report.held_out < 0.5 * np.sqrt(np.mean(flux**2))
        return
    with pytest.raises(InputError) as caught:
        fit_map(given, 0.01, degree=2)
    share = float(caught.value.problems[0].received.split()[0])
    assert share == pytest.approx(100 * noise / np.sqrt(1 + noise**2), rel=0.1)


@pytest.mark.parametrize("turn", [None, [0.3, -0.4, 0.2]])
@pytest.mark.parametrize(("thick", "flat"), [(0.9e-3, True), (1.1e-3, False)])
def test_readings_lie_in_a_plane_if_they_are_thinner_than_a_thousandth(turn, thick, flat):
    """A thousandth of the second of their three extents; the first is ten times the second."""
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(np.column_stack([np.ones(60), rng.normal(size=(60, 3))]))[0][:, 1:]
    local = axes * [1.0, 0.1, 0.1 * thick]
    points = local if turn is None else Rotation.from_rotvec(turn).apply(local)
    given = Measurements(("coil",), points + [0.0, 0.0, 0.25], np.ones((60, 1)), np.ones((60, 3)), "log.csv")
    if not flat:
        with pytest.raises(InputError) as caught:
            fit_map(given, 0.0)
        assert "spacing" in caught.value.problems[0].must_hold
        return
    with pytest.raises(InputError) as caught:
        fit_map(given, 0.0)
    (problem,) = caught.value.problems
    assert (problem.where, problem.received.split(" in ")[0]) == ("log.csv", "60 readings")
    told = problem.received.split("plane ")[1]
    if turn is None:
        assert told == "z = 0.25 m"
        return
    normal = np.array(json.loads(told.removeprefix("one across ")))
    assert abs(normal @ Rotation.from_rotvec(turn).apply([0, 0, 1])) == pytest.approx(1.0, abs=1e-4)
