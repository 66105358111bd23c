"""Optima against closed forms; runs that are killed, designs that fail, and limits that no design meets."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron import FieldFunction
from fieldmap.studies import Carrying, Limit, Linked, NoFeasibleDesign, Number, Variable, optimisation
from fieldmap.studies.design import Search
from fieldmap.studies.design_checks import design_problem
from fieldmap.studies.search import SearchEnded, searching
from tests.conftest import DEVICES
from tests.levitation.conftest import slope_on_axis
from tests.refusals import refused
from tests.studies.conftest import SPHERE

PAIR = """
format = 1
name = "pair"
title = "Two thin coils"

[parameters]
spacing = 60.0

[defaults.coil]
kind = "circular"
inner_radius_mm = 49.9
outer_radius_mm = 50.1
height_mm = 0.2
turns = 100

[[coil]]
name = "upper"
position_mm = [0.0, 0.0, "= spacing / 2"]

[[coil]]
name = "lower"
position_mm = [0.0, 0.0, "= -spacing / 2"]
"""
LOOP = DEVICES / "thin_loop_with_driver.toml"
DEPTH = 0.06
# The lift of a thin loop per ampere is largest at a radius of sqrt(2/3) of the depth; the winding is 1 mm wide.
RADIUS = Variable(
    "coil.loop.inner_radius_mm", 30.0, 70.0, linked=(Linked(("coil.loop.outer_radius_mm",), 1.0, 1.0),)
)
BEST_RADIUS = 1e3 * DEPTH * np.sqrt(2 / 3) - 0.5


# N per ampere on the payload, below the loop with the largest lift.
LIFT_PER_AMPERE = 0.8 * slope_on_axis(-DEPTH, DEPTH * np.sqrt(2 / 3))
CARRIES = Carrying([0, 0, -DEPTH])
BOX = ([-1e-3] * 3, [1e-3] * 3)
BELOW = {"saturating": False, "points": [[0, 0, -0.014]]}


@pytest.mark.parametrize("start", [35.0, 60.0, 85.0])
def test_coils_a_radius_apart_are_the_most_homogeneous(start):
    """Helmholtz pair: in a small box the most homogeneous spacing is the radius."""
    spacing = Variable("parameters.spacing", 30, 90, start)
    best = fm.optimise(PAIR, [spacing], "inhomogeneity", box=BOX, tolerance=1e-8)
    assert best.values["parameters.spacing"] == pytest.approx(50.0, abs=0.02)
    assert best.derivatives == {"inhomogeneity": {"parameters.spacing": "exact"}}
    assert best.value < 2e-3 * best.start_value
    assert best.verified is None


@pytest.mark.parametrize("method", ["SLSQP", "trust-constr", "COBYQA", "optuna"])
def test_the_loop_that_lifts_with_the_least_current(method):
    if method == "optuna":
        pytest.importorskip("optuna")
    how = {"method": method, "tolerance": 1e-6, "solves": 40}
    best = fm.optimise(LOOP, [RADIUS], "common_current", currents=CARRIES, **how)
    assert best.values[RADIUS.key] == pytest.approx(BEST_RADIUS, abs=2.0 if method == "optuna" else 0.1)
    assert best.value == pytest.approx(0.01 * 9.80665 / LIFT_PER_AMPERE, rel=1e-3)
    kind = "exact" if method in ("SLSQP", "trust-constr") else "none"
    assert best.derivatives["common_current"] == {RADIUS.key: kind}


def test_a_limit_that_is_active():
    """The strongest gradient at 8 W in 2 ohm: 2 A at any radius, and the best radius on the axis."""
    text = LOOP.read_text().replace("turns = 1000", "turns = 1000\nresistance_ohm = 2.0")
    best = fm.optimise(
        text,
        [Variable("current.loop", 0.5, 5.0), RADIUS],
        Number("gradient 1 z z"),
        [Limit("power", upper=8.0)],
        maximise=True,
        points=[[0, 0, -DEPTH]],
        tolerance=1e-7,
    )
    assert best.values["current.loop"] == pytest.approx(2.0, rel=1e-5)
    assert best.values[RADIUS.key] == pytest.approx(BEST_RADIUS, abs=0.1)
    (power,) = best.limits
    assert (power.active, power.holds, power.value) == (True, True, pytest.approx(8.0, rel=1e-5))
    # In closed form, at the current of the limit.
    assert best.value == pytest.approx(2.0 * LIFT_PER_AMPERE / 0.8, rel=1e-3)


def test_the_permeability_that_a_measured_field_tells():
    """A sphere in a uniform field: B on the axis from its dipole, (mu_r - 1) / (mu_r + 2)."""
    flux, radius, place, mu_r = 0.01, 0.01, 0.02, 5.0
    wanted = flux * (1 + 2 * (mu_r - 1) / (mu_r + 2) * (radius / place) ** 3)
    law = 'kind = "froehlich"\nmu_r = 1000.0\nsaturation_polarisation_T = 1.5'
    text = SPHERE.replace(law, 'kind = "linear"\nmu_r = 2.0')
    text = text.replace("mesh_size_mm = 4.0", "mesh_size_mm = 2.0")
    text += f"\n[background]\nflux_density_mT = [0.0, 0.0, {1e3 * flux}]\n"
    misfit = FieldFunction(lambda field: 1e6 * (field.field([0.0, 0.0, -place])[2] - wanted) ** 2)
    limits = [Limit("common_current", upper=2e-6)]
    unknown, asked = Variable("material.iron.mu_r", 1.5, 20.0), Number("misfit", of=misfit)
    best = fm.optimise(text, [unknown], asked, limits, currents=1e-6, tolerance=1e-9)
    assert best.values["material.iron.mu_r"] == pytest.approx(mu_r, rel=0.02)
    assert best.derivatives["misfit"] == {"material.iron.mu_r": "exact"}


RUN = """
import os, signal, sys, types
# Ours: extras of other programs bring a package of this name, too.
sys.modules["tests"] = types.ModuleType("tests")
sys.modules["tests"].__path__ = ["tests"]
from tests.studies.test_optimise import lighter

def tell(text, share):
    if text.startswith("design 6,"):
        os.kill(os.getpid(), signal.SIGKILL)

lighter(sys.argv[1], tell)
"""


def lighter(target, progress=None):
    """A search whose payload mass has no exact derivative, so that designs for differences are stored as well."""
    mass = Variable("payload.mass_g", 5.0, 20.0)
    limits, how = [Limit("common_current", lower=0.9)], {"output": target, "progress": progress}
    return fm.optimise(LOOP, [RADIUS, mass], "common_current", limits, currents=CARRIES, **how)


def test_a_run_that_was_killed_goes_on(tmp_path):
    """It solves no design twice and gives the results of an uninterrupted run."""
    whole = lighter(tmp_path / "whole.nc")
    assert whole.kept == 0
    assert whole.solves == len(whole.path) > 8
    command = [sys.executable, "-c", RUN, str(tmp_path / "killed.nc")]
    killed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not (tmp_path / "killed.nc").exists()
    resumed = lighter(tmp_path / "killed.nc")
    assert (resumed.solves, resumed.kept) == (whole.solves - 6, 6)
    assert resumed.values == whole.values
    again = lighter(tmp_path / "killed.nc")
    assert (again.solves, again.kept) == (0, whole.solves)
    assert (tmp_path / "killed.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    with xarray.open_dataset(tmp_path / "killed.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data[RADIUS.key], [step.values[RADIUS.key] for step in whole.path])


def test_a_design_that_fails_is_recorded_and_the_search_goes_on():
    """The best sphere fills the workspace; spheres beyond the workspace's upper end, 12 mm, are refused."""
    linked = (Linked(("body.sphere.mesh_size_mm",), 0.4),)
    radius = Variable("body.sphere.radius_mm", 8.0, 16.0, 9.0, linked)
    how = {"maximise": True, "saturating": False, "points": [[0, 0, -0.02]], "check_refinement": None}
    best = fm.optimise(SPHERE, [radius], Number("flux_density 1 z"), **how)
    assert best.failed
    assert all("GeometryError" in why for why in best.failed.values())
    # Overlaps below 1 um count as rounding.
    assert 11.0 < best.values[radius.key] < 12.001
    failed = [step for step in best.path if step.failure]
    assert all(step.values[radius.key] > 11.9 and not step.feasible for step in failed)
    assert len(best.data.design) == len(best.path)
    assert np.isnan(best.data["flux_density 1 z"].values[[bool(step.failure) for step in best.path]]).all()


def test_a_design_that_cannot_lift_is_recorded_and_the_search_goes_on():
    """The first step, a quarter of the range, puts the loop around the payload, where no current lifts it; the least
    current is half a radius above it. No design is solved twice."""
    place = Variable("coil.loop.position_mm.3", -90.1, 20.3, -32.4)
    limits, how = [Limit("common_current", upper=3.0)], {"method": "COBYQA", "tolerance": 1e-6}
    best = fm.optimise(LOOP, [place], "common_current", limits, currents=CARRIES, **how)
    ((words, why),) = best.failed.items()
    assert words == "coil.loop.position_mm.3 = -60"
    assert "Infeasible" in why
    places = [step.values[place.key] for step in best.path]
    (number,) = np.flatnonzero(np.isclose(places, -60.0, atol=1e-9))
    assert 0 < number < len(best.path) - 3
    assert best.values[place.key] == pytest.approx(-38.0, abs=0.1)
    # Optimisers evaluate the start again, after scaling it there and back.
    assert np.diff(np.sort(places)).min() > 1e-9


def test_a_start_that_fails_ends_at_once():
    radius = Variable("body.sphere.radius_mm", 8.0, 16.0, 15.0)
    with pytest.raises(InputError) as caught:
        fm.optimise(SPHERE, [radius], "common_current", saturating=False)
    assert "GeometryError" in caught.value.problems[0].received


def test_an_infeasible_demand_names_the_limit():
    """No loop of these radii lifts the payload with 10 mA; `off by` is the excess of the best loop."""
    limits = [Limit("common_current", upper=0.01), Limit("flux_density 1 z", upper=1.0)]
    how = {"currents": CARRIES, "points": [[0, 0, -DEPTH]], "tolerance": 1e-6}
    with pytest.raises(NoFeasibleDesign) as caught:
        fm.optimise(LOOP, [RADIUS], "power", limits, **how)
    (problem,) = caught.value.problems
    assert "common_current" in problem.where
    least = 0.01 * 9.80665 / LIFT_PER_AMPERE
    nearest, off_by = (float(text.split()[0].rstrip(",")) for text in problem.received.split("off by "))
    assert nearest == pytest.approx(least, rel=1e-3)
    assert off_by == pytest.approx(least - 0.01, rel=5e-3)
    assert caught.value.nearest[RADIUS.key] == pytest.approx(BEST_RADIUS, abs=0.5)
    assert caught.value.path


def at_the_side(device, state):
    """B_z off the axis, mT."""
    return 1e3 * state.field([0.006, 0, -0.013])[2]


def test_limits_hold_on_the_finer_mesh():
    """The sphere's strongest field under a limit; the coarse mesh has another value, which is corrected."""
    side = Limit(Number("field at the side", of=at_the_side), upper=1.5)
    how = {"maximise": True, "check_refinement": 2.0, **BELOW}
    best = fm.optimise(SPHERE, [Variable("current.loop", 0.5, 5.0)], "flux_density 1 z", [side], **how)
    (limit,) = best.limits
    assert (best.verified.times_finer, best.verified.holds) == (2.0, True)
    assert [step.feasible for step in best.path if step.role == "check"] == [False, True]
    assert limit.holds
    assert limit.active
    assert limit.finer == pytest.approx(1.5, rel=2e-4)
    # Iron is linear: the current that reaches the limit, on a mesh solved separately.
    state = fm.solve_linear(fm.read_device(SPHERE), refinement=2.0).at([1.0])
    assert best.values["current.loop"] == pytest.approx(1.5 / at_the_side(None, state), rel=3e-4)
    assert best.derivatives["field at the side"]["current.loop"] == "differences"


def test_a_limit_is_corrected_twice_at_most():
    """A first-order correction never brings this number below its limit, because the finer mesh always gives 2.5."""
    meshes = []

    def stubborn(device, state):
        if state.report.tetrahedra not in meshes:
            meshes.append(state.report.tetrahedra)
        return 2.5 if meshes.index(state.report.tetrahedra) else float(state.currents[0])

    current, limit = (
        Variable("current.loop", 0.4, 5.0, 3.0),
        Limit(Number("stubborn", of=stubborn), upper=2.0),
    )
    how = {"maximise": True, "refinement": 0.5, "check_refinement": 2.0, **BELOW}
    best = fm.optimise(SPHERE, [current], "flux_density 1 z", [limit], **how)
    checks = [step for step in best.path if step.role == "check"]
    np.testing.assert_allclose([step.values["current.loop"] for step in checks], [2.0, 1.5, 1.0], rtol=1e-3)
    assert not any(step.feasible for step in checks)
    assert not best.verified.holds
    assert not best.limits[0].holds


def test_workers_find_the_same(tmp_path):
    pytest.importorskip("distributed")
    variables, how = [RADIUS, Variable("payload.mass_g", 5.0, 20.0)], {"currents": CARRIES, "tolerance": 1e-3}
    one, two = (fm.optimise(LOOP, variables, "common_current", workers=n, **how) for n in (1, 2))
    assert one.values == two.values
    assert one.derivatives["common_current"] == {RADIUS.key: "exact", "payload.mass_g": "differences"}


def test_all_mistakes_at_once():
    keys = {"coil.loop.turn": (1, 2), "coil.loop.turns": (5, 4), "current.coil": (0, 1)}
    limits = {"inhomogeneity": (0.0, 1.0), "power": (3.0, 2.0), "largest_flux_density": (0.0, 1.0)}
    how = {"method": "simplex", "solves": 0, "tolerance": 2.0, "check_refinement": 0.5, "refinement": -1.0}
    variables = [Variable(key, *ends) for key, ends in keys.items()]
    limited = [Limit(name, *ends) for name, ends in limits.items()]
    with pytest.raises(InputError) as caught:
        fm.optimise(LOOP, variables, "equilibrium_areas", limited, **how)
    where = [problem.where for problem in caught.value.problems]
    for part in (*keys, *limits, "equilibrium_areas", *(f"({name})" for name in how)):
        assert any(text.endswith(part) for text in where), part
    assert 'did you mean "equilibrium_area"' in str(caught.value)


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("solves", [1], [0, -1]),
        ("tolerance", [1e-12, 0.999], [0.0, 1.0, -0.1]),
        ("check_refinement", [None, 1.001], [1.0, 0.0]),
        ("refinement", [1e-3], [0.0, -1.0]),
        ("step", [None, 1e-6], [0.0, -1e-6]),
        ("upper", [1.001], [1.0, 0.5, np.inf, np.nan]),
    ],
)
def test_settings_are_taken_within_their_limits(name, inside, outside):
    """A number that does not exist makes each call fail before a solve."""
    for value in [*inside, *outside]:
        of_variable = {"upper": 60.0, name: value} if name in ("step", "upper") else {"upper": 60.0}
        if name == "upper":
            of_variable["lower"] = 1.0
        variable = Variable(RADIUS.key, **{"lower": 30.0, **of_variable})
        how = {} if name in ("step", "upper") else {name: value}
        with pytest.raises(InputError) as caught:
            fm.optimise(LOOP, [variable], "no such number", **how)
        told = [f"{problem.where} {problem.must_hold}" for problem in caught.value.problems]
        assert sum(name in text for text in told) == (value in outside), value
        assert len(told) == 1 + (value in outside)


def test_a_loose_tolerance_is_no_more_than_the_first_step():
    """COBYQA refuses a final radius larger than the first one."""
    how = {"method": "COBYQA", "tolerance": 0.9}
    best = fm.optimise(LOOP, [RADIUS], "common_current", currents=CARRIES, **how)
    assert best.value <= best.start_value
    assert len(best.path) > 2


@pytest.mark.parametrize(
    ("lower", "upper", "must_hold"), [(-1.0, 2.0, "greater than 0"), (2.0, 3.0, "start")]
)
def test_bounds_that_the_device_refuses(lower, upper, must_hold):
    with refused(InputError, where="coil.loop.height_mm", must_hold=must_hold):
        fm.optimise(LOOP, [Variable("coil.loop.height_mm", lower, upper)], "power")


APART = PAIR.replace("spacing = 60.0", "spacing = 60.0\nmiddle = 0.0").replace(
    '"= spacing / 2"', '"= middle + spacing / 2"'
)
APART_BY, MIDDLE = (Variable(f"parameters.{name}", -9.0, 90.0) for name in ("spacing", "middle"))


def test_a_key_that_follows_two_variables():
    """A variable of a key that another variable already determines, by its name or through an expression."""
    text, spacing, middle = APART, APART_BY, MIDDLE
    others = [Variable("coil.upper.position_mm.3", 10.0, 60.0)]
    others += [Variable(f"coil.{name}.turns", 50.0, 150.0) for name in ("*", "lower")]
    with pytest.raises(InputError) as caught:
        fm.optimise(text, [spacing, middle, *others], "power")
    told = [(problem.where, problem.received.split()[0]) for problem in caught.value.problems]
    assert told == [
        ("optimise, coil.upper.position_mm.3", "coil.upper.position_mm.3"),
        ("optimise, coil.upper.position_mm.3", "coil.upper.position_mm.3"),
        ("optimise, coil.*.turns", "coil.lower.turns"),
    ]
    currents = [Variable(f"current.{name}", 0.0, 2.0, 1.0) for name in ("*", "upper")]
    with pytest.raises(InputError) as caught:
        fm.optimise(text, currents, "flux_density 1 z", currents={"one": 1.0}, points=np.zeros((1, 3)))
    assert ["current.upper" in problem.received for problem in caught.value.problems] == [True]


def test_two_variables_that_meet_in_one_expression():
    best = fm.optimise(APART, [APART_BY, MIDDLE], "inhomogeneity", box=BOX)
    assert best.values["parameters.spacing"] == pytest.approx(50.0, abs=1.0)


def searched(problem):
    """A search over the designs of a problem, solved in this process."""
    return searching(problem, None, True, 1, None)


def looped(**how):
    """The thin loop: current, radius and payload mass as variables, the gradient as objective, and limits."""
    mass = Variable("payload.mass_g", 5.0, 20.0, step=0.02)
    variables = (Variable("current.loop", 0.5, 3.0, 1.25), RADIUS, mass)
    limits = (
        Limit(Number("flux_density 1 z"), 0.004, 0.01),
        Limit(Number("weight", of=lambda device, state: 9.80665 * device.payload.mass), upper=0.08),
    )
    asked = {"objective": Number("gradient 1 z z"), "sign": -1.0, "variables": variables, "limits": limits}
    about = (LOOP, None, False, 1.0, [[0.002, 0.001, -DEPTH]], None, 0.01)
    return design_problem("optimise", Search(**asked | how), *about)


SCALED = np.array([0.6, 0.7, 0.3])


def test_what_optimisers_get_is_scaled():
    """Variables by their bounds, the objective by its size at the start, limits by the largest of their bounds."""
    with searched(looped()) as search:
        first = search.begin()
        values = search.values(SCALED)
        np.testing.assert_allclose(values, [0.5 + 0.6 * 2.5, 30 + 0.7 * 40, 5 + 0.3 * 15])
        np.testing.assert_allclose(search.values(np.array([-0.5, 1.5, 0.5])), [0.5, 70.0, 12.5])
        found = search.at(values)
        np.testing.assert_allclose(search.scaled(found), SCALED)
        slope, flux = (found.numbers[name] for name in ("gradient 1 z z", "flux_density 1 z"))
        assert search.objective(SCALED) == pytest.approx(-slope / abs(first.numbers["gradient 1 z z"]))
        weight = 9.80665e-3 * 9.5
        rooms = [(flux - 0.004) / 0.01, (0.01 - flux) / 0.01, (0.08 - weight) / 0.08]
        np.testing.assert_allclose(search.limits(SCALED), rooms)
        assert min(rooms) == rooms[2] < 0.0
        assert search.violation(found) == pytest.approx(-rooms[2])
        assert search.violations(SCALED) == pytest.approx(sum(min(room, 0.0) ** 2 for room in rooms))
        # With the corrections of the finer mesh, if known.
        search.shift = {"weight": -0.5 * weight, "gradient 1 z z": 0.25 * slope}
        assert search.violation(found) == pytest.approx(max(0.0, -rooms[0], -rooms[1]))
        assert search.objective(SCALED) == pytest.approx(-1.25 * slope / abs(first.numbers["gradient 1 z z"]))
        assert search.number(replace(found, refinement=2.0), Number("gradient 1 z z")) == slope


def test_slopes_of_what_is_scaled_are_its_derivatives():
    """With limits violated or not; a Python function has differences."""
    with searched(looped()) as search:
        search.begin()

        def differences(function):
            sides = [[function(SCALED + sign * step) for sign in (1, -1)] for step in 1e-4 * np.eye(3)]
            return np.array([(ahead - behind) / 2e-4 for ahead, behind in sides]).T

        for value, its in (
            (search.objective, search.objective_slopes),
            (search.limits, search.limit_slopes),
            (search.violations, search.violation_slopes),
        ):
            exact = differences(value)
            assert np.abs(exact).max() > 1e-3
            np.testing.assert_allclose(its(SCALED), exact, rtol=2e-4, atol=2e-5 * np.abs(exact).max())
        assert not search.violation_slopes(np.array([0.5, 0.7, 0.1])).any()
        assert search.kinds["weight"] == dict.fromkeys(
            ("current.loop", RADIUS.key, "payload.mass_g"), "differences"
        )
        kinds = {"current.loop": "exact", RADIUS.key: "exact", "payload.mass_g": "differences"}
        assert search.kinds["gradient 1 z z"] == kinds


def test_differences_stay_within_the_bounds():
    """At a bound, or where one side fails, the difference is one-sided; 0 if both sides fail."""
    seen = []

    def own(device, state):
        seen.append(1e3 * device.payload.mass)
        if device.payload.mass < 5.5e-3 or 0.0123 < device.payload.mass < 0.0129:
            raise ValueError("no number")
        return 7.0 * device.payload.mass

    variables = (Variable("payload.mass_g", 5.0, 20.0, 10.0, step=0.5),)
    problem = looped(objective=Number("own", of=own), sign=1.0, variables=variables, limits=())
    with searched(problem) as search:
        for mass, sides, slope in (
            (10.0, [9.5, 10.5], 7e-3),
            (19.8, [19.3, 20.0], 7e-3),
            (20.0, [19.5, 20.0], 7e-3),
            (5.9, [5.4, 6.4], 7e-3),
            (12.2, [11.7, 12.7], 7e-3),
            (5.0, [5.0, 5.5], 0.0),
        ):
            search.at(np.array([mass]))
            seen.clear()
            assert search.slopes(np.array([mass]), problem.objective) == pytest.approx(slope)
            assert set(np.round(seen, 9)) <= {*sides}
        assert all(step.role in ("step", "difference") for step in search.steps)
        # A failed design counts as the worst one plus the objective's size at the start.
        search.begin()
        worst = max(search.objective(np.array([z])) for z in (0.2, 0.9, 0.6))
        assert worst == pytest.approx((5 + 0.9 * 15) / 10.0)
        assert search.objective(np.array([0.0])) == pytest.approx(worst + 1.0)
        assert search.limits(np.array([0.0])).shape == (0,)
        assert search.violations(np.array([0.0])) == 1e3
        best = search.best()
        assert best.values["payload.mass_g"] == 5.5


def test_designs_that_hardly_differ_end_a_search():
    """Eight in a row within the tolerance."""
    for far, ends in ((0.9e-3, True), (1.1e-3, False)):
        with searched(looped(tolerance=1e-3)) as search:
            for k in range(8):
                design = search.values(SCALED + [far if k == 3 else 1e-5 * k, 0.0, 0.0])
                if ends and k == 7:
                    with pytest.raises(SearchEnded, match="8 designs in a row"):
                        search.at(design)
                    continue
                search.at(design)
            # Then the count begins again.
            search.at(search.values(SCALED + 1e-4))


def test_no_more_designs_are_solved_than_allowed():
    problem, told = looped(solves=3), []
    with searching(
        problem, None, True, 1, lambda text, share: told.append((text.split(":")[0], share))
    ) as search:
        for k in range(3):
            search.at(search.values(SCALED + 0.1 * k))
        with pytest.raises(SearchEnded, match="3 designs were solved"):
            search.at(search.values(SCALED - 0.1))
        # Known designs, and checks on a finer mesh, do not count as new designs.
        search.at(search.values(SCALED))
        search.checked(search.values(SCALED), 1.4)
        assert (search.solves, search.kept) == (4, 0)
        assert [step.refinement for step in search.steps] == [1.0, 1.0, 1.0, 1.4]
    steps = ["design 1, step", "design 2, step", "design 3, step", "design 4, check"]
    assert [text for text, _ in told] == steps
    shares = [share for _, share in told]
    # After the first design, two of the same time remain.
    assert shares[0] == pytest.approx(1 / 3)
    assert shares[0] < shares[1] < shares[2] == shares[3] == 1.0


def test_which_design_is_best():
    """The largest or smallest objective that meets the limits within the tolerance; otherwise the nearest to them."""
    own = Number("own", of=lambda device, state: 1e3 * device.payload.mass)
    how = {"variables": (Variable("payload.mass_g", 1.0, 21.0, 10.0),), "limits": (Limit(own, 5.0, 16.0),)}
    for sign, tolerance, best in ((-1.0, 1e-3, 15.0), (1.0, 1e-3, 6.0), (-1.0, 0.32, 21.0)):
        with searched(looped(objective=own, sign=sign, tolerance=tolerance, **how)) as search:
            for mass in (3.0, 21.0):
                search.at(np.array([mass]))
            if tolerance == 1e-3:
                assert search.best() is None
            assert search.nearest().values["payload.mass_g"] == 3.0
            for mass in (11.0, 15.0, 6.0):
                search.at(np.array([mass]))
            # A design on another mesh does not belong to the search.
            search.checked(np.array([10.5 - 5 * sign]), 2.0)
            assert search.best().values["payload.mass_g"] == best
            assert [step.feasible for step in search.steps] == [tolerance == 0.32] * 2 + [True] * 4


def test_what_an_optimum_tells(tmp_path):
    """File, table and plain numbers agree with the path; limits are those at the best design."""
    variables = [Variable("current.loop", 0.5, 5.0, 1.0)]
    limits = [Limit("power", upper=8.0), Limit("flux_density 1 z", -0.1, 0.5)]
    limits += [Limit("common_current", upper=2.01), Limit("current loop", 1.9, 2.1)]
    text = LOOP.read_text().replace("turns = 1000", "turns = 1000\nresistance_ohm = 2.0")
    how = {"maximise": True, "points": [[0, 0, -DEPTH]], "output": tmp_path / "best.nc", "tolerance": 1e-6}
    best = fm.optimise(text, variables, Number("gradient 1 z z"), limits, **how)
    slope, flux = slope_on_axis(-DEPTH, 0.044, 1000.0), best.limits[1].value
    assert best.value == pytest.approx(2.0 * slope, rel=1e-3)
    assert best.start_value == pytest.approx(slope, rel=1e-3)
    stated = [(one.number, one.lower, one.upper, one.finer, one.active, one.holds) for one in best.limits]
    # A limit is active within a hundredth of its scale.
    assert 0.0 < flux < 0.4
    assert stated == [
        ("power", -np.inf, 8.0, None, True, True),
        ("flux_density 1 z", -0.1, 0.5, None, False, True),
        ("common_current", -np.inf, 2.01, None, True, True),
        ("current loop", 1.9, 2.1, None, False, True),
    ]
    assert (best.settings, best.maximise, best.method, best.kept) == ({}, True, "SLSQP", 0)
    assert best.written == (tmp_path / "best.nc", tmp_path / "best.csv")
    rows = [line.split(",") for line in best.written[1].read_text().splitlines()]
    numbers = ["gradient 1 z z", *(limit.number for limit in limits)]
    assert rows[0] == ["design", "role", "current.loop", *numbers, "refinement", "feasible", "failure"]
    assert best.start_device.coils[0].resistance == 2.0
    with xarray.open_dataset(best.written[0], engine="h5netcdf") as data:
        for k, (row, step) in enumerate(zip(rows[1:], best.path, strict=True)):
            current = float(row[2])
            assert (int(row[0]), row[1], row[-3:]) == (
                k,
                "step",
                ["1.0", str(1.9 <= current <= 2.0 * (1 + 5e-7)), ""],
            )
            assert float(row[4]) == pytest.approx(2 * current**2)
            assert float(row[3]) == pytest.approx(current * slope, rel=1e-3)
            for name in numbers:
                assert float(data[name][k]) == step.numbers[name] == float(row[rows[0].index(name)])
        assert (data.attrs["objective"], data.attrs["method"]) == ("gradient 1 z z", "SLSQP")
        assert data.attrs["assumptions"] == "\n".join(best.assumptions)
        assert data.design.values.tolist() == list(range(len(best.path)))
    told = best.to_dict()
    assert told["objective"] == {
        "number": "gradient 1 z z",
        "value": best.value,
        "at_start": best.start_value,
    }
    assert (told["solves"], len(told["path"]), told["values"]) == (len(best.path), best.solves, best.values)
    assert told["limits"][0]["active"] is True
    assert "current.loop" in best.assumptions[0]


@pytest.mark.parametrize(
    ("given", "fits"),
    [
        (1.0, True),
        ([2.0], True),
        ([0.0], False),
        (0.0, False),
        ([1.0, 2.0], False),
        (np.inf, False),
        ("x", False),
    ],
)
def test_currents_of_a_design(given, fits):
    """One coil; a number that does not exist makes each call fail before a solve."""
    for currents in (given, {"a": given}, Carrying([0, 0, -DEPTH], given)):
        if given == "x":
            continue
        asked = Number("no such number", "a" if isinstance(currents, dict) else "")
        with pytest.raises(InputError) as caught:
            fm.optimise(LOOP, [RADIUS], asked, currents=currents)
        where = [problem.where for problem in caught.value.problems]
        assert ("optimise(currents)" in where) == (not fits)
        assert len(where) == 1 + (not fits)


@pytest.mark.parametrize("missing", ["[payload]", "[workspace]"])
def test_currents_that_carry_need_a_payload_and_a_workspace(missing):
    text = "\n\n".join(part for part in LOOP.read_text().split("\n\n") if missing not in part)
    with refused(InputError, where="optimise(currents)", must_hold="[payload] and a [workspace]"):
        fm.optimise(text, [RADIUS], "common_current", currents=CARRIES)


@pytest.mark.parametrize(
    ("variables", "limits", "where"),
    [
        ([], [], "optimise(variables)"),
        ([RADIUS, RADIUS], [], "optimise(variables)"),
        ([Variable("current.loop", 0.0, 1.0)], [], ""),
        ([Variable("current.*", 0.0, 1.0)], [], ""),
        ([Variable("current.lop", 0.0, 1.0)], [], "optimise, current.lop"),
        ([Variable("coil.loop.name", 0.0, 1.0)], [], "optimise, coil.loop.name"),
        ([RADIUS], [Limit("power", 1.0, 1.0)], "optimise, power"),
        ([RADIUS], [Limit("power", 1.0, 1.001)], ""),
        ([RADIUS], [Limit("power")], "optimise, power"),
        ([RADIUS], [Limit("power", 1.0)], ""),
        ([RADIUS], [Limit(Number("power", "other"), 1.0)], "optimise, power, other"),
        ([RADIUS], [Limit(Number("power", minus="other"), 1.0)], "optimise, power, other"),
    ],
)
def test_variables_and_limits_of_a_design(variables, limits, where):
    with pytest.raises(InputError) as caught:
        fm.optimise(LOOP, variables, "no such number", limits)
    others = [problem.where for problem in caught.value.problems if "no such number" not in problem.where]
    assert others == ([where] if where else [])
    # Currents that carry the payload cannot be variables.
    if variables and variables[0].is_current and not where:
        with refused(
            InputError, where=f"optimise, {variables[0].key}", received="currents that carry the payload"
        ):
            fm.optimise(LOOP, variables, "no such number", limits, currents=CARRIES)


@pytest.mark.parametrize("method", ["SLSQP", "COBYQA"])
@pytest.mark.parametrize(("share", "found"), [(1.02, True), (0.5, False)])
def test_limits_are_looked_for_where_a_search_has_met_none(monkeypatch, method, share, found):
    """With a limit near the least lifting current, or below it; the search itself is skipped."""
    monkeypatch.setattr(optimisation, "_minimised", lambda search, z: "left out")
    least = 0.01 * 9.80665 / LIFT_PER_AMPERE
    radius, limits = replace(RADIUS, start=32.0), [Limit("common_current", upper=share * least)]
    how = {"currents": CARRIES, "method": method, "tolerance": 1e-5}
    if found:
        best = fm.optimise(LOOP, [radius], "power", limits, **how)
        assert best.limits[0].holds
        assert best.value > best.start_value or best.ended == "left out"
        return
    with pytest.raises(NoFeasibleDesign) as caught:
        fm.optimise(LOOP, [radius], "power", limits, **how)
    (problem,) = caught.value.problems
    assert caught.value.nearest[RADIUS.key] == pytest.approx(BEST_RADIUS, abs=1.0)
    assert (problem.where, problem.must_hold) == (
        "optimise, common_current",
        f"must be at most {0.5 * least:g}",
    )
    # The value is twice the limit, so it is off by 100 %.
    value, off = float(problem.received.split()[0]), problem.received.split("off by ")[1].split(", ")
    assert value == pytest.approx(least, rel=2e-3)
    assert float(off[0]) == pytest.approx(0.5 * least, rel=5e-3)
    assert float(off[1].removesuffix(" %")) == pytest.approx(100.0, rel=5e-3)


@pytest.mark.parametrize(
    ("finer", "checks", "holds"), [(lambda i: i, 1, True), (None, 1, False), (lambda i: i + 0.5, 2, True)]
)
def test_a_design_is_checked_on_a_finer_mesh(finer, checks, holds):
    """With the same values there, with a failure there, and with a correction."""
    meshes = []

    def own(device, state):
        if state.report.tetrahedra not in meshes:
            meshes.append(state.report.tetrahedra)
        if meshes.index(state.report.tetrahedra) == 0:
            return float(state.currents[0])
        if finer is None:
            raise ValueError("no number")
        return finer(float(state.currents[0]))

    current, limit = Variable("current.loop", 0.4, 5.0, 1.0), Limit(Number("own", of=own), upper=2.0)
    how = {"maximise": True, "refinement": 0.4, "check_refinement": 1.5, "tolerance": 1e-5, **BELOW}
    best = fm.optimise(SPHERE, [current], "flux_density 1 z", [limit], **how)
    finest = pytest.approx(0.6)
    assert [step.refinement for step in best.path if step.role == "check"] == [finest] * checks
    assert (best.verified.refinement, best.verified.times_finer, best.verified.holds) == (finest, 1.5, holds)
    assert best.values["current.loop"] == pytest.approx(2.0 if checks == 1 else 1.5, rel=1e-4)
    (limit,) = best.limits
    assert (limit.active, limit.holds) == (True, True)
    assert limit.value == pytest.approx(best.values["current.loop"])
    if finer is None:
        assert "no number" in best.verified.failure
        assert np.isnan(best.verified.objective)
        assert limit.finer is None
        return
    assert best.verified.failure == ""
    state = fm.solve_linear(fm.read_device(SPHERE), refinement=0.6).at([best.values["current.loop"]])
    assert best.verified.objective == pytest.approx(state.field([0, 0, -0.014])[2], rel=1e-6)
    assert limit.finer == pytest.approx(2.0, rel=1e-4)
    assert len(best.assumptions) == 2 + (checks == 2)
    assert "of constant permeability" in best.assumptions[1]
    assert best.assumptions[1].endswith("divided by 0.4")


def test_designs_of_an_earlier_search_are_marked(tmp_path):
    found = []
    for designs in (1, 2):
        with searching(looped(), tmp_path / "best.nc", True, 1, None) as search:
            for k in range(designs):
                search.at(search.values(SCALED + 0.1 * k))
            found.append(([step.kept for step in search.steps], search.solves, search.kept))
    assert found == [([False], 1, 0), ([True, False], 1, 1)]
