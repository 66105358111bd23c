"""Maps from readings against the field that was read, with and without noise; their files."""

import tracemalloc

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.interop import Measurements, fit_map, measured_map, read_measurements
from fieldmap.lookup import interpolate, open_map
from fieldmap.store import write_map

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
    """Largest differences from the true field and gradient, and the largest of these."""
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
    # The numbers of the map themselves, at its nodes.
    data = measured.data
    _, exact = ring.fields(data.grid.points())
    assert np.abs(data.gradient.reshape(exact.shape) - exact).max() < 5e-3 * np.abs(exact).max()


def test_many_nodes_take_little_more_memory_than_their_map(ring, monkeypatch):
    """Whatever the parts in which they are evaluated, fields and errors are the same."""
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
    # Standard errors hold with all coils at their reference currents, here 2 A: six coils at 1 A err by less.
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
    # A file holds the field at the reference currents, which are those of the readings and no round numbers.
    np.testing.assert_allclose(
        opened.field([0, 0, -0.1], np.ones(6)), there, rtol=0, atol=1e-15 * np.abs(there).max()
    )
    record = opened.info.provenance
    assert record.solver_report["held_out_T"] == measured.report.held_out
    assert any("no iron" in text for text in record.assumptions)


def test_coils_that_cannot_be_told_apart(ring):
    some = readings(ring, 400, 0.0)
    same = Measurements(NAMES, some.points, np.ones((400, 6)), some.flux_density)
    # All six coils carry the same: one of the six shares of the 24 harmonics each is determined.
    with pytest.raises(InputError, match="rank 24 of 144"):
        fit_map(same, 0.01, degree=4)
    with pytest.raises(InputError, match="9 readings"):
        fit_map(Measurements(NAMES, some.points[:9], some.currents[:9], some.flux_density[:9]), 0.01)
    with pytest.raises(InputError, match="spacing > 0"):
        fit_map(some, 0.0)
    with pytest.raises(InputError, match=r"flux_density.*NaN"):
        Measurements(NAMES, some.points, some.currents, np.full((400, 3), np.nan))


HEADER = "Bz_mT,x_mm,y_mm,z_m,Bx_uT,By_T,I_left_A,I_the right one_A\n"


def test_units_and_columns_of_a_file(tmp_path):
    (tmp_path / "read.csv").write_text(HEADER + "1.5, 10, -20, 0.03, 7, 2e-3, 1, -2\n\n2,0,0,0,0,0,0.5,0\n")
    found = read_measurements(tmp_path / "read.csv")
    assert found.coil_names == ("left", "the right one")
    np.testing.assert_allclose(found.points[0], [0.01, -0.02, 0.03])
    np.testing.assert_allclose(found.flux_density[0], [7e-6, 2e-3, 1.5e-3])
    np.testing.assert_array_equal(found.currents, [[1, -2], [0.5, 0]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty file"]),
        ("x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT\n1,2,3,4,5,6\n", ["missing: I_NAME_A"]),
        (HEADER.replace("Bz_mT", "Bz_G"), ["unknown: Bz_G", "missing: Bz"]),
        (HEADER.replace("y_mm", "x_m"), ["twice: x_m", "missing: y"]),
        (
            HEADER + "1,2,3\n1,2,3,4,five,6,nan,8\n",
            [":2: must have 8 cells", ":3.*Bx_uT.*'five'", ":3.*I_left_A"],
        ),
    ],
)
def test_every_mistake_of_a_file_is_named(tmp_path, text, words):
    (tmp_path / "read.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_measurements(tmp_path / "read.csv")
    for word in words:
        with pytest.raises(InputError, match=word):
            raise caught.value
    with pytest.raises(InputError, match="can be read"):
        read_measurements(tmp_path / "none.csv")
