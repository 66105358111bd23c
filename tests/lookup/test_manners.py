"""An opened map with odd arguments, threads and pickles, and the modules that it loads."""

import importlib
import os
import pickle
import pkgutil
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import is_dataclass, replace

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.field import Field, FieldAtCurrents, as_field
from fieldmap.lookup import interpolate, iron_weights, open_map, saturates, tangent_block
from fieldmap.lookup.evaluation import outside_error
from fieldmap.records import Record
from fieldmap.store import FieldError, MapData, Provenance
from fieldmap.threads import most_threads
from tests.dynamics.conftest import saturating_data

CURRENTS = np.array([1.0, 1.0, 1.0])


@pytest.mark.parametrize("method", ["field", "gradient", "second_gradient"])
@pytest.mark.parametrize("n_inside", [2, 2000])
def test_outside_is_an_error_that_names_the_box_and_the_point(coarse, dipoles, method, n_inside):
    points = np.concatenate([dipoles.points(n_inside), [[0.021, 0.0, 0.0], [0.0, 0.0, 0.5]]])
    with pytest.raises(OutsideMapError) as caught:
        getattr(coarse, method)(points, CURRENTS)
    problem = caught.value.problems[0]
    assert "(-20.0, -15.0, -30.0)" in problem.must_hold
    assert problem.received.startswith(f"2 of {n_inside + 2} ")
    assert "(0.0, 0.0, 500.0)" in problem.received
    assert caught.value.exit_code == 2


def test_outside_gives_nan_on_request(dipoles):
    opened = interpolate(dipoles.map((6, 5, 6)), outside="nan")
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    flux = opened.field(points, CURRENTS)
    assert np.isfinite(flux[0]).all()
    assert np.isnan(flux[1]).all()
    assert np.isnan(opened.wrench(points, [0, 0, 1], CURRENTS)[1]).all()


def test_corners_of_the_box_are_inside(coarse):
    for corner in (coarse.lower, coarse.upper):
        assert np.isfinite(coarse.field(corner, CURRENTS)).all()


@pytest.mark.parametrize("n", [3, 2000])
def test_nan_gives_nan_in_its_row_only(coarse, dipoles, n):
    points = dipoles.points(n)
    points[1, 2] = np.nan
    flux, slope = coarse.field_and_gradient(points, CURRENTS)
    assert np.isnan(flux[1]).all()
    assert np.isnan(slope[1]).all()
    assert np.isfinite(np.delete(flux, 1, axis=0)).all()
    currents = np.tile(CURRENTS, (3, 1))
    currents[2, 0] = np.nan
    flux = coarse.field(dipoles.points(3), currents)
    assert np.isnan(flux[2]).all()
    assert np.isfinite(flux[:2]).all()


def test_no_points_give_no_rows(coarse):
    assert coarse.field(np.empty((0, 3)), CURRENTS).shape == (0, 3)
    assert coarse.wrench(np.empty((0, 3)), [0, 0, 1], CURRENTS).shape == (0, 6)


@pytest.mark.parametrize(
    ("points", "currents", "where"),
    [
        ([0, 0], CURRENTS, "points"),
        (np.zeros((2, 2, 2)), CURRENTS, "points"),
        ("middle", CURRENTS, "points"),
        ([0, 0, 0], [1, 2], "currents"),
        ([0, 0, 0], "one", "currents"),
        (np.zeros((4, 3)), np.ones((2, 3)), "currents"),
        ([0, 0, 0], {"a": 1, "up": 1}, "currents"),
    ],
)
def test_arguments_of_the_wrong_shape(coarse, points, currents, where):
    with pytest.raises(InputError) as caught:
        coarse.field(points, currents)
    assert caught.value.problems[0].where == where


def test_currents_by_name_and_as_one_number(coarse, dipoles):
    points = dipoles.points(20)
    for where in (points, points[0]):
        expected = coarse.gradient(where, CURRENTS)
        for given in (1.0, {"c": 1, "a": 1, "b": 1}):
            np.testing.assert_array_equal(coarse.gradient(where, given), expected)
            np.testing.assert_array_equal(
                coarse.at(given).gradient(where), coarse.at(CURRENTS).gradient(where)
            )


@pytest.mark.parametrize("what", ["field", "gradient", "second_gradient", "potential"])
def test_points_of_any_leading_shape(coarse, dipoles, what):
    grid = dipoles.points(20).reshape(4, 5, 3)
    named, all_of_them = {"b": 1.5}, np.array([0.0, 1.5, 0.0])
    for at in (coarse, coarse.at(named)):
        given = (named,) if at is coarse else ()
        found = getattr(at, what)(grid, *given)
        expected = getattr(at, what)(grid.reshape(20, 3), *((all_of_them,) if given else ()))
        assert found.shape[:2] == (4, 5)
        np.testing.assert_array_equal(found.reshape(expected.shape), expected)
    assert coarse.field(grid.tolist(), named).shape == (4, 5, 3)
    flux, slope = np.empty((4, 5, 3)), np.empty((4, 5, 3, 3))
    coarse.field_and_gradient(grid, np.ones((4, 5, 3)), out=(flux, slope))
    np.testing.assert_array_equal(flux, coarse.field(grid, np.ones((4, 5, 3))))
    assert coarse.wrench(grid, [0, 0, 1], CURRENTS).shape == (4, 5, 6)


def test_a_map_is_a_field_and_at_currents_a_field_at_currents(coarse):
    assert isinstance(coarse, Field)
    assert isinstance(coarse.at(1.0), FieldAtCurrents)
    assert as_field(coarse) is coarse
    assert coarse.proportional
    np.testing.assert_array_equal(coarse.bounds, (coarse.lower, coarse.upper))
    np.testing.assert_array_equal(coarse.at(2.0).currents, 2.0 * CURRENTS)
    assert coarse.gradient_jump(2.0 * CURRENTS) == pytest.approx(2.0 * coarse.jump().gradient_bound)


def test_unknown_kind_and_outside_rule(dipoles, tmp_path):
    with pytest.raises(InputError) as caught:
        open_map(tmp_path / "any.h5", kind="linear")
    assert [problem.received for problem in caught.value.problems] == ["'linear'"]
    with pytest.raises(InputError) as caught:
        interpolate(dipoles.map((6, 5, 6)), kind="linear", outside="zero")
    assert [problem.received for problem in caught.value.problems] == ["'linear'", "'zero'"]


def test_clamp_gives_the_nearest_point_of_the_box(dipoles):
    opened = interpolate(dipoles.map((6, 5, 6)), outside="clamp")
    points = np.array([[0.1, 0.0, 0.0], [0.0, -1.0, 0.5], [0.0, 0.0, -0.01]])
    nearest = np.clip(points, opened.lower, opened.upper)
    for ask in (opened.field, opened.gradient, opened.second_gradient, opened.potential):
        np.testing.assert_allclose(ask(points, CURRENTS), ask(nearest, CURRENTS), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("outside", ["raise", "nan", "clamp"])
def test_infinity_gives_nan_in_its_row_whatever_the_rule(dipoles, outside):
    opened = interpolate(dipoles.map((6, 5, 6)), outside=outside)
    flux, slope = opened.field_and_gradient([[0, 0, 0], [np.inf, 0, 0], [0, -np.inf, 0]], CURRENTS)
    assert np.isfinite(flux[0]).all()
    assert np.isnan(flux[1:]).all()
    assert np.isnan(slope[1:]).all()
    one, _ = opened.field_and_gradient(np.array([0.0, 0.0, np.inf]), CURRENTS)
    assert np.isnan(one).all()


def test_results_into_given_arrays(coarse, dipoles):
    points = dipoles.points(400)
    flux, slope = np.empty((400, 3)), np.empty((400, 3, 3))
    given = coarse.field_and_gradient(points, CURRENTS, out=(flux, slope))
    assert given[0] is flux
    assert given[1] is slope
    np.testing.assert_array_equal(flux, coarse.field(points, CURRENTS))
    one = np.empty(3)
    assert coarse.field(points[0], CURRENTS, out=one) is one
    np.testing.assert_allclose(one, flux[0], rtol=1e-12)
    pair = np.empty(3), np.empty((3, 3))
    assert coarse.field_and_gradient(points[0], CURRENTS, out=pair)[0] is pair[0]
    np.testing.assert_allclose(pair[1], slope[0], rtol=1e-12)
    for wrong_pair in ((np.empty(2), pair[1]), (pair[0], np.empty((2, 3))), (pair[0], np.empty(9))):
        with pytest.raises(InputError, match="lookup, out"):
            coarse.field_and_gradient(points[0], CURRENTS, out=wrong_pair)
    for wrong in (np.empty((399, 3)), np.empty((400, 3), np.float32), np.empty((3, 400)).T, [0.0]):
        with pytest.raises(InputError, match="out"):
            coarse.field(points, CURRENTS, out=wrong)


def test_one_point_in_every_dress(coarse, dipoles):
    point = dipoles.points(1)[0]
    expected = coarse.field_and_gradient(point, CURRENTS)
    frozen = point.copy()
    frozen.flags.writeable = False
    for dressed in (list(point), tuple(point), point[None], np.repeat(point, 2)[::2], frozen):
        flux, slope = coarse.field_and_gradient(dressed, list(CURRENTS))
        np.testing.assert_allclose(np.ravel(flux), expected[0], rtol=1e-13)
        np.testing.assert_allclose(np.ravel(slope), expected[1].ravel(), rtol=1e-13)
        np.testing.assert_allclose(np.ravel(coarse.at(CURRENTS).field(dressed)), expected[0], rtol=1e-12)
    moment = np.array([0.3, -0.7, 1.1])
    expected, frozen = coarse.wrench(point, moment, CURRENTS), moment.copy()
    frozen.flags.writeable = False
    for dressed in (list(moment), moment[None], np.repeat(moment, 2)[::2], frozen):
        np.testing.assert_allclose(coarse.wrench(point, dressed, CURRENTS), expected, rtol=1e-13)
        np.testing.assert_allclose(coarse.at(CURRENTS).wrench(list(point), dressed), expected, rtol=1e-12)
    for wrong in (np.zeros(2), np.zeros((2, 3))):
        with pytest.raises(InputError, match="moments"):
            coarse.wrench(point, wrong, CURRENTS)
    with pytest.raises(InputError, match="points"):
        coarse.field_and_gradient(np.zeros(2), CURRENTS)
    with pytest.raises(InputError, match="currents"):
        coarse.field_and_gradient(point, np.zeros(7))
    for of in (coarse.field_and_gradient, lambda x, i: coarse.wrench(x, moment, i)):
        with pytest.raises(OutsideMapError):
            of(np.array([1.0, 0.0, 0.0]), CURRENTS)


def test_wrench_of_one_dipole_is_that_of_many(coarse, dipoles):
    points, moment = dipoles.points(40), np.array([0.3, -0.7, 1.1])
    at = coarse.at(CURRENTS)
    many, summed = coarse.wrench(points, moment, CURRENTS), at.wrench(points, moment)
    close = {"rtol": 1e-13, "atol": 1e-15 * np.abs(many).max()}
    np.testing.assert_allclose([coarse.wrench(p, moment, CURRENTS) for p in points], many, **close)
    np.testing.assert_allclose([at.wrench(p, moment) for p in points], summed, **close)
    # By hand: F_j = m_i G_ij and T = m x B.
    flux, slope = coarse.field_and_gradient(points[0], CURRENTS)
    np.testing.assert_allclose(many[0, :3], moment @ slope, rtol=1e-13)
    np.testing.assert_allclose(many[0, 3:], np.cross(moment, flux), rtol=1e-12)


@pytest.mark.parametrize("kind", ["hermite", "harmonic", "global"])
@pytest.mark.parametrize("fixed", [(), ("magnet",)])
def test_wrench_of_one_dipole_beside_a_field_that_no_current_drives(dipoles, kind, fixed):
    """The third field is the field of 0.7 A that no current drives, or is driven by the currents like the others."""
    given = dipoles.map((6, 5, 6))
    names, one = (given.coil_names[:2], np.ones(2)) if fixed else (given.coil_names, np.ones(3))
    weights = np.array([1.2, -0.4, 0.7 if fixed else 0.3])
    flux, slope = given.flux_density.copy(), given.gradient.copy()
    if fixed:
        flux[2], slope[2] = 0.7 * flux[2], 0.7 * slope[2]
    data = MapData(
        given.grid,
        names,
        one,
        flux_density=flux,
        gradient=slope,
        fixed_sources=fixed,
        constant_field=bool(fixed),
    )
    m, plain = interpolate(data, kind), interpolate(given, kind)
    currents, moment = weights[: len(names)].copy(), np.array([0.3, -0.7, 1.1])
    for point in dipoles.points(5):
        expected = plain.wrench(point[None], moment, weights)[0]
        np.testing.assert_allclose(m.wrench(point, moment, currents), expected, rtol=1e-12, atol=1e-16)
        many = m.wrench(point[None], moment, currents)[0]
        np.testing.assert_allclose(m.wrench(point, moment, currents), many, rtol=1e-12, atol=1e-16)
    for wrong in (currents[:-1], np.append(currents, 1.0)):
        with pytest.raises(InputError, match="currents"):
            m.wrench(point, moment, wrong)


def test_orientations_of_a_point_dipole_are_refused_whatever_its_dress(coarse, dipoles):
    point, moment = dipoles.points(1)[0], np.array([0.3, -0.7, 1.1])
    for given in (moment, list(moment)):
        with pytest.raises(InputError, match="wrench, orientations"):
            coarse.wrench(point, given, CURRENTS, np.eye(3))
        with pytest.raises(InputError, match="wrench, orientations"):
            coarse.at(CURRENTS).wrench(point, given, np.eye(3))


@pytest.mark.parametrize("kind", ["hermite", "harmonic", "global"])
def test_threads_give_the_same_bits(dipoles, kind):
    points = dipoles.points(70_000)
    data = dipoles.map((6, 5, 6))
    single, several = (interpolate(data, kind, threads=n) for n in (1, 3))
    for currents in (CURRENTS, np.random.default_rng(3).normal(size=(70_000, 3))):
        pairs = (m.field_and_gradient(points, currents) for m in (single, several))
        for ours, theirs in zip(*pairs, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    points[69_000] = 1.0
    with pytest.raises(OutsideMapError, match="1 of 70000"):
        several.field(points, CURRENTS)


@pytest.fixture(scope="module")
def another_process():
    """Output of a process that opens a map: its loaded modules; and, where the system forks, whether a large batch
    gives the same numbers in a forked process and afterwards in its parent."""
    program = (
        "import os, sys, numpy as np, fieldmap as fm\n"
        "m = fm.open_map('sample', threads=2)\n"
        "m.at([1.0] * 6)\n"
        "print(*sys.modules, flush=True)\n"
        "if not hasattr(os, 'fork'):\n"
        "    sys.exit()\n"
        "points = np.random.default_rng(1).uniform(m.lower, m.upper, (70_000, 3))\n"
        "before = m.field(points, [1.0] * 6)\n"
        "child = os.fork()\n"
        "same = np.array_equal(m.field(points, [1.0] * 6), before)\n"
        "if child == 0:\n"
        "    os._exit(0 if same else 1)\n"
        "print('child', os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 'parent', same)"
    )
    command = [sys.executable, "-W", "ignore", "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return done.stdout.splitlines()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_has_threads_of_its_own(another_process):
    """The parent's threads do not exist in the child: a large batch must neither hang nor give other numbers."""
    assert another_process[1:] == ["child 0 parent True"]


def test_several_processes_read_one_file(dipoles, tmp_path):
    from fieldmap.store import write_map

    path = tmp_path / "map.h5"
    write_map(path, dipoles.map((6, 5, 6)))
    program = (
        "import sys, fieldmap as fm\n"
        "m = fm.open_map(sys.argv[1], kind='harmonic')\n"
        "print(m.field([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]).tolist())"
    )
    command = [sys.executable, "-c", program, str(path)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    answers = [process.communicate(timeout=300)[0] for process in running]
    expected = open_map(path, kind="harmonic").field([0.0, 0.0, 0.0], CURRENTS).tolist()
    assert answers == [f"{expected}\n"] * 2


def test_survives_a_pickle(coarse, dipoles):
    points = dipoles.points(500)
    expected = coarse.gradient(points, CURRENTS)
    again = pickle.loads(pickle.dumps(coarse))
    np.testing.assert_array_equal(again.gradient(points, CURRENTS), expected)
    fixed = pickle.loads(pickle.dumps(coarse.at(CURRENTS)))
    np.testing.assert_array_equal(fixed.gradient(points), expected)
    assert again.coil_names == coarse.coil_names


def test_threads_with_different_currents_do_not_mix(coarse, dipoles):
    points = dipoles.points(1000)
    currents = np.random.default_rng(3).normal(size=(16, 3))
    expected = [coarse.field(points, row) for row in currents]

    def ask(k):
        return [np.array_equal(coarse.field(points, currents[k % 16]), expected[k % 16]) for _ in range(30)]

    with ThreadPoolExecutor(8) as pool:
        assert all(all(same) for same in pool.map(ask, range(32)))


def test_says_what_it_is(coarse, dipoles):
    assert all(part in repr(coarse) for part in ("harmonic", "3 coils", "-15 to 20", "294"))
    assert "294 nodes" in coarse._repr_html_()
    assert coarse.error_bound is None
    assert interpolate(dipoles.map((6, 5, 6)), "hermite").interpolation_error is None


def test_opening_a_map_loads_nothing_that_a_lookup_does_not_need(another_process):
    """They take seconds to load, and the schema of devices a fifth of a second; no lookup needs them."""
    loaded = another_process[0].split()
    assert "fieldmap.lookup" in loaded
    parts = ("fieldmap.iron", "fieldmap.maps", "fieldmap.sources")
    single = ("fieldmap.device.schema", "fieldmap.device.model")
    packages = ("magpylib", "netgen", "pyvista", "numba", "scipy", "pydantic")
    assert not [n for n in loaded if n.split(".")[0] in packages or n.startswith(parts) or n in single]


def text_of(card):
    """The words of an HTML card."""
    return re.sub(r"<[^>]*>", " ", card).split()


def test_what_it_is_in_numbers(dipoles):
    """Box in mm, nodes, coefficients and errors: each is a different number."""
    data = replace(
        dipoles.map((6, 5, 7), 2),
        provenance=Provenance(title="two dipoles", device_name="rig", assumptions=("no iron",)),
        error_bounds={"harmonic": FieldError(1.4e-6, 3.5e-4)},
        reference_current=np.array([2.0, 0.5]),
    )
    m = interpolate(data)
    text = " ".join(text_of(m._repr_html_()))
    for words in (
        "FieldMap, harmonic", "two dipoles", "a, b", "linear: any currents", "no field",
        "-20 x -15 x -30 to 20 x 20 x 10 mm", f"336 nodes, {m.nbytes / 1e6:.1f} MB of coefficients",
        "at most 1.4e-06 T and 0.00035 T/m against the solver",
    ):  # fmt: skip
        assert words in text
    assert m.nbytes == pytest.approx(6 * 5 * 7 * 2 * 36 * 8, rel=0.02)
    assert "not certified" in " ".join(text_of(interpolate(data, "hermite")._repr_html_()))
    assert repr(m) == "FieldMap(harmonic, 2 coils, box -20 to 20, -15 to 20, -30 to 10 mm, 336 nodes)"
    one = interpolate(dipoles.map((6, 5, 7), 1))
    assert "1 coil," in repr(one)
    assert m.assumptions == ("no iron",)
    assert (m.error_bound.flux_density, m.error_bound.gradient) == (1.4e-6, 3.5e-4)
    # The gradient's step grows with the largest current over its reference, and is at least the step at the reference.
    step = m.jump().gradient_bound
    for currents, share in (([4.0, 0.5], 2.0), ([-1.0, -2.0], 4.0), ([0.2, 0.1], 1.0)):
        assert m.gradient_jump(np.array(currents)) == pytest.approx(share * step)
    error, jump, misfit = m.interpolation_error, m.jump(), m._form.misfit
    assert error.flux_density == max(jump.flux_density, misfit.flux_density)
    assert error.gradient == max(jump.gradient, misfit.gradient)


def test_of_saturating_iron_both_errors_are_told():
    data = replace(
        saturating_data(),
        error_bounds={"harmonic": FieldError(1e-6, 2e-4)},
        current_error=FieldError(3e-5, 4e-3),
    )
    m = interpolate(data)
    text = " ".join(text_of(m._repr_html_()))
    for words in (
        "saturating: the currents of its domain", "error of the interpolation at most 1e-06 T and 0.0002 T/m",
        "error of the current model up to 3e-05 T and 0.004 T/m found at solved states",
    ):  # fmt: skip
        assert words in text
    assert (m.proportional, m.affine) == (False, False)
    assert saturates(m)
    free = interpolate(saturating_data(free=True))
    # Lookups by rows of currents, the last set and other sets agree; derivatives are those of the model.
    random = np.random.default_rng(9)
    points, rows = random.uniform(-0.015, 0.015, (3, 3)), random.uniform(-2.0, 2.0, (3, 6))
    apart = np.array([free.field(point, row) for point, row in zip(points, rows, strict=True)])
    np.testing.assert_allclose(free.field(points, rows), apart, rtol=1e-5, atol=1e-9)
    flux, slope, by_flux, by_slope = free.by_currents(points, rows[0])
    weights, slopes = iron_weights(free, rows)
    assert (weights.shape, slopes.shape) == ((3, 3), (3, 3, 6))
    for k in range(6):
        step = 1e-4 * np.eye(6)[k]
        ahead, behind = (free.field_and_gradient(points, rows[0] + sign * step) for sign in (1, -1))
        for found, one, other in (
            (by_flux[:, k], ahead[0], behind[0]),
            (by_slope[:, k], ahead[1], behind[1]),
        ):
            exact = (one - other) / 2e-4
            np.testing.assert_allclose(found, exact, atol=2e-2 * np.abs(exact).max() + 1e-9)
    np.testing.assert_allclose(flux, free.field(points, rows[0]), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(slope, free.gradient(points, rows[0]), rtol=1e-5, atol=1e-8)
    # The tangent agrees with the map at its currents, where the weights are these currents and 1.
    block = tangent_block(free, rows[0])
    core = CoreMap(block)
    found, steep = np.empty((3, 3)), np.empty((3, 3, 3))
    core.fields(points, np.append(rows[0], 1.0)[None], found, steep)
    np.testing.assert_allclose(found, flux, rtol=1e-6, atol=1e-10)
    core.fields(points, np.append(np.eye(6)[2], 0.0)[None], found, steep)
    np.testing.assert_allclose(found, by_flux[:, 2], rtol=1e-6, atol=1e-10)


def test_points_outside_are_counted_and_the_farthest_told_in_mm(coarse):
    points = np.array(
        [
            [0.0, 0.0, 0.0],
            [-0.0205, 0.0, 0.0],
            [0.0, 0.020000123, 0.0],
            [np.nan, 0.0, 0.0],
            [0.0, 0.0, 0.0123],
        ]
    )
    with pytest.raises(OutsideMapError) as caught:
        coarse.field(points, CURRENTS)
    problem = caught.value.problems[0]
    assert "(-20.0, -15.0, -30.0) to (20.0, 20.0, 10.0) mm" in problem.must_hold
    assert problem.received == "3 of 5 points outside, the farthest at (0.0, 0.0, 12.3) mm"


def test_places_are_told_to_the_nanometre():
    lower, upper = np.array([-1.0, -0.0123456789, 0.0]), np.array([1.0, 1.0, 0.01])
    points = np.array([[0.0, 0.0, 0.005], [0.0, -0.0987654321, 0.0], [0.0, 0.0, 0.02]])
    problem = outside_error(points, 2, lower, upper).problems[0]
    assert "(-1000.0, -12.345679, 0.0) to (1000.0, 1000.0, 10.0) mm" in problem.must_hold
    assert problem.received == "2 of 3 points outside, the farthest at (0.0, -98.765432, 0.0) mm"


def test_at_fixed_currents_results_go_into_given_arrays_too(coarse, dipoles):
    at, points = coarse.at(CURRENTS), dipoles.points(6)
    for where in (points, points[0], points.reshape(2, 3, 3), points[0].tolist()):
        flux, slope = at.field_and_gradient(where)
        shape = np.shape(where)[:-1]
        assert (flux.shape, slope.shape) == ((*shape, 3), (*shape, 3, 3))
        out = np.empty(flux.shape), np.empty(slope.shape)
        given = at.field_and_gradient(where, out=out)
        assert all(np.shares_memory(one, other) for one, other in zip(given, out, strict=True))
        np.testing.assert_array_equal(out[0], flux)
        np.testing.assert_array_equal(out[1], slope)
        np.testing.assert_array_equal(at.field(where), flux)
        np.testing.assert_array_equal(at.gradient(where), slope)


def test_what_an_array_for_results_must_be_is_told(coarse):
    for out, received in (
        (np.empty((1, 3), complex), "complex128 (1, 3)"),
        (np.empty((1, 3), np.longdouble), f"{np.dtype(np.longdouble)} (1, 3)"),
        (np.empty((1, 3), np.float32), "float32 (1, 3)"),
        ([0.0], "list"),
    ):
        with pytest.raises(InputError) as caught:
            coarse.field([[0, 0, 0]], CURRENTS, out=out)
        assert caught.value.problems[0].received == received
        assert "shape (1, 3)" in caught.value.problems[0].must_hold
    frozen = np.empty((1, 3))
    frozen.flags.writeable = False
    with pytest.raises(InputError):
        coarse.field([[0, 0, 0]], CURRENTS, out=frozen)


@pytest.mark.parametrize(("asked", "threads"), [(None, most_threads()), (3, 3), (0, 1), (-2, 1), (2.9, 2)])
def test_threads_are_at_least_one(dipoles, asked, threads):
    assert interpolate(dipoles.map((4, 3, 4), 1), threads=asked)._box.threads == threads


# These records are equal if their numbers are; all other records hold arrays and are equal to themselves only.
OF_NUMBERS = {"Shortfall", "IronModel", "IronOfMap", "MapOutput", "Errors", "ExtremesTried", "Round", "Needs"}


@pytest.mark.parametrize("package", ["fieldmap.lookup", "fieldmap.maps"])
def test_records_do_not_change_and_show_themselves_in_the_way_of_records(package):
    there = importlib.import_module(package)
    modules = [
        importlib.import_module(one.name) for one in pkgutil.walk_packages(there.__path__, f"{package}.")
    ]
    kinds = {kind for module in modules for kind in vars(module).values() if isinstance(kind, type)}
    own = {kind for kind in kinds if is_dataclass(kind) and kind.__module__.startswith(package)}
    assert len(own) > 10
    for kind in own:
        how = kind.__dataclass_params__
        assert how.frozen == issubclass(kind, Record), kind
        assert how.eq == (kind.__name__ in OF_NUMBERS), kind
        assert how.repr == (kind.__name__ in {"Errors", "ExtremesTried"} or not issubclass(kind, Record)), (
            kind
        )
