"""Maps of iron with hysteresis: their model against the full solver along new paths; their memory."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.core.machine import CoreMachine
from fieldmap.currents import CurrentDomain, IndependentCurrents
from fieldmap.dynamics.field_of_currents import modelled, tabled
from fieldmap.errors import InputError, OutsideMapError, RecipeError
from fieldmap.histories import history_of_currents
from fieldmap.interop import jax_field
from fieldmap.iron import HysteresisSolver, NonlinearSolver
from fieldmap.lookup import current_model, interpolate
from fieldmap.maps.training import hysteresis, paths, solved_paths
from fieldmap.maps.training.model_error import Errors
from fieldmap.store import check_map, read_info, read_map
from tests.core.test_machine import body_numbers
from tests.maps.conftest import DEVICES

COERCIVE, LEVEL, REFINEMENT, STEPS = 600.0, 0.4, 0.4, 6
DOMAIN = CurrentDomain(IndependentCurrents(2), np.array([-1.0, -0.5]), np.array([1.0, 1.0]))
CURRENTS = {
    "lower_A": [-1.0, -0.5],
    "upper_A": 1.0,
    "accuracy": 5e-3,
    "modes": 30,
    "points": 200,
    "held_out": 6,
    "states": 90,
}
POINTS = np.array([[0.0, 0.0, -0.01], [5e-3, -3e-3, -0.012], [-6e-3, 4e-3, -8e-3]])
SENSOR = fm.FieldSensor("1", POINTS[1], [0.6, 0.0, -0.8])


@pytest.fixture(scope="module")
def device():
    cores = fm.read_device(DEVICES / "two_cores.toml")
    steel = replace(cores.materials["steel"], coercive_field=COERCIVE)
    return cores.replace(materials={"steel": steel}, sensors=[SENSOR])


@pytest.fixture(scope="module")
def made(device, tmp_path_factory):
    """A map, made in two runs: the first was stopped in the third batch of its paths."""
    path = tmp_path_factory.mktemp("remembering") / "cores.h5"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paths, "STEPS", STEPS)
        patch.setattr(hysteresis, "STEPS", STEPS)
        left = [5]

        def stopping(solver, item):
            left[0] -= 1
            if not left[0]:
                raise KeyboardInterrupt
            return solver.solve(*item)

        patch.setattr(solved_paths, "_solved", stopping)
        with pytest.raises(KeyboardInterrupt):
            generated(device, path)
        solved = []
        patch.setattr(
            solved_paths, "_solved", lambda solver, item: solved.append(item[0]) or solver.solve(*item)
        )
        generated(device, path)
    return path, solved


def generated(device, path):
    fm.generate(
        device,
        path,
        progress=False,
        spacing=2.5e-3,
        currents=CURRENTS,
        iron={"model": "hysteresis", "refinement": REFINEMENT},
        reference_current=LEVEL,
    )


@pytest.fixture(scope="module")
def opened(made):
    return fm.open_map(made[0])


@pytest.fixture(scope="module")
def truth(device):
    """Flux density (s, 3, 3) and gradient (s, 3, 3, 3) at the points, loss (s,) and flux linkages (s, 2), by the full
    solver, along a path of one history."""
    solver, after = HysteresisSolver(device, None, REFINEMENT), {}

    def solved_along(history, path):
        if history not in after:
            after[history] = solver.demagnetised
            for currents in history_of_currents(history, np.full(2, LEVEL)):
                after[history] = solver.step(currents, after[history]).memory
        memory, found = after[history], []
        for currents in path:
            state = solver.step(currents, memory)
            memory = state.memory
            found.append((state.field(POINTS), state.gradient(POINTS), state.loss, state.flux_linkage()))
        return tuple(np.array(part) for part in zip(*found, strict=True))

    return solved_along


def test_a_stopped_run_solves_only_what_is_missing(made, opened):
    solved = made[1]
    report = opened.info.provenance.solver_report
    assert 0 < sum(len(one.currents) for one in solved) < report["states_solved"]
    planned = paths.planned_paths(DOMAIN, np.full(2, LEVEL))
    assert all(one.currents.shape != planned[0].currents.shape for one in solved)
    assert report["states_solved"] == report["states_trained_on"] + STEPS


@pytest.mark.parametrize("number", [1001, 1003])
def test_along_paths_that_no_training_saw_the_model_is_the_solver(opened, truth, number):
    path = paths.random_path(DOMAIN, np.full(2, LEVEL), number)
    flux, slope, loss, linked = truth(path.history, path.currents)
    memory, heat = opened.memory(path.history), []
    error, bound = opened.current_error, opened.error_bound
    stated = opened.info.provenance.solver_report["linkage_error"]["share"]
    assert 0.0 < stated < 1e-2
    for k, currents in enumerate(path.currents):
        before = memory.dissipated
        memory = memory.step(currents)
        heat.append(memory.dissipated - before)
        b, g = memory.field_and_gradient(POINTS, currents)
        assert np.linalg.norm(b - flux[k], axis=1).max() < error.flux_density + bound.flux_density
        assert np.linalg.norm(g - slope[k], axis=(1, 2)).max() < error.gradient + bound.gradient
        read = memory.readings(POINTS[0], np.zeros(3), currents)
        assert abs(read[0] - b[1] @ SENSOR.axis) < bound.flux_density
        off = np.abs(memory.flux_linkage(currents) - linked[k]).max()
        assert off < 2.0 * stated * np.abs(linked).max()
    # The error is small against the effect of the memory: the same currents, each straight from the level.
    straight = np.array([opened.field(POINTS, currents) for currents in path.currents])
    assert np.linalg.norm(straight - flux, axis=2).max() > 5.0 * error.flux_density
    # Sample points are not chosen for the heat.
    assert sum(heat) == pytest.approx(loss.sum(), rel=0.01)
    np.testing.assert_allclose(heat, loss, rtol=0.03, atol=0.005 * loss.sum())


def test_a_sensor_reads_the_iron_s_reaction_to_a_magnet(opened):
    """In the box the reaction is known by other solves: its fields at the sensor and at the magnet."""
    moment = np.array([0.1, -0.2, 0.7])
    (at_sensor, at_magnet), _ = (np.swapaxes(part, 0, 1)[[1, 0]] for part in opened.reaction.fields(POINTS))
    reaction = opened.reaction.signs * (at_magnet @ moment) @ at_sensor @ SENSOR.axis
    r = POINTS[1] - POINTS[0]
    d = np.linalg.norm(r)
    direct = 1e-7 * (3.0 * (moment @ r) * r / d**5 - moment / d**3) @ SENSOR.axis
    still = opened.last_currents
    read = opened.readings(POINTS[0], moment, still) - opened.readings(POINTS[0], np.zeros(3), still)
    assert read[0] - direct == pytest.approx(reaction, rel=5e-3)


@pytest.mark.parametrize("loop", [0.02, 0.3])
def test_slopes_of_loops_are_those_of_the_solver(opened, truth, loop):
    """Against the second of two loops of the left coil about the level, driven in the full solver."""
    turns = np.array([1.0, -1.0, 1.0, -1.0])
    flux, slope, *_ = truth("shaken", LEVEL + loop * turns[:, None] * [1.0, 0.0])
    _, _, by_flux, by_slope = opened.by_currents(POINTS, opened.last_currents, loop=loop)
    for found, ends in ((by_flux[:, 0], flux), (by_slope[:, 0], slope)):
        wanted = (ends[2] - ends[3]) / (2.0 * loop)
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=2e-3 * np.abs(wanted).max())
    reversible = opened.by_currents(POINTS, opened.last_currents)[2][:, 0]
    assert np.abs(by_flux[:, 0] - reversible).max() > 5e-3 * np.abs(reversible).max()


def test_with_its_cells_taken_away_a_map_is_that_of_saturating_iron(made, device, monkeypatch):
    """The model without cells, one with cells that have no pinning, and the solver of iron without hysteresis."""
    # At their usual tolerance lookups agree to about 1e-9 only, because each ends elsewhere within the tolerance.
    monkeypatch.setattr(current_model, "_OF_LOOKUPS", 1e-12)
    data = read_map(made[0])
    model = data.reduced_model
    taken = replace(model, pinning=np.zeros((0, 0)), shares=np.zeros(0))
    bare = interpolate(replace(data, reduced_model=taken))
    free = interpolate(replace(data, reduced_model=replace(model, pinning=0.0 * model.pinning)))
    solver = NonlinearSolver(device, REFINEMENT)
    assert not bare.remembers
    for currents in np.array([[0.9, -0.3], [0.2, 0.6], [-0.8, 0.5]]):
        free = free.step(currents)
        found = free.field(POINTS, currents)
        expected = bare.field(POINTS, currents)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
        off = np.linalg.norm(found - solver.solve(currents).field(POINTS), axis=1).max()
        assert off < 1.5 * data.current_error.flux_density
    assert free.dissipated == 0.0


def test_paths_begin_where_they_say_and_stay_in_the_domain():
    level = np.full(2, LEVEL)
    first, *cycles = paths.planned_paths(DOMAIN, level)
    assert first.history == "demagnetised"
    np.testing.assert_array_equal(first.currents, history_of_currents("shaken", level))
    assert {path.history for path in cycles} == {"shaken"}
    assert len(cycles) == 4
    for k, path in enumerate(cycles[:2]):
        np.testing.assert_array_equal(path.currents[:, 1 - k], LEVEL)
        moved = path.currents[:, k] - LEVEL
        # The distance to the nearer end is 0.6 A on both coils.
        np.testing.assert_allclose([moved[:8].max(), moved[8:16].max(), moved[16:].max()], [0.03, 0.15, 0.6])
        np.testing.assert_allclose(moved.reshape(3, 8).sum(axis=1), 0.0, atol=1e-12)
    for k, path in enumerate(cycles[2:]):
        # The other coil is held 0.4 of that distance higher.
        np.testing.assert_allclose(path.currents[:, 1 - k], LEVEL + 0.24, rtol=1e-12)
        moved = path.currents[:, k] - LEVEL
        np.testing.assert_allclose([moved[:8].max(), moved[8:].max()], [0.45, 0.6])
    random = [paths.random_path(DOMAIN, level, number) for number in range(8)]
    assert [path.history for path in random].count("demagnetised") == 2
    assert all(DOMAIN.holds(currents) for path in random for currents in path.currents)
    np.testing.assert_array_equal(random[5].currents, paths.random_path(DOMAIN, level, 5).currents)
    assert len(random[0].currents) == paths.STEPS == 30
    steps = np.concatenate([np.abs(np.diff(path.currents[:, 0])) for path in random])
    assert np.quantile(steps, 0.1) < 0.02
    assert np.quantile(steps, 0.9) > 0.4


@pytest.mark.parametrize(("history", "turns"), [("shaken", 10), ("demagnetised", 0)])
def test_histories(history, turns):
    path = history_of_currents(history, np.array([0.5, 2.0]))
    assert path.shape == (turns, 2)
    if turns:
        np.testing.assert_allclose(path[:3], [[0.0, 0.0], [1.0, 4.0], [0.15, 0.6]])
        np.testing.assert_array_equal(path[-1], [0.5, 2.0])
    with pytest.raises(InputError):
        history_of_currents("shakn", np.ones(1))


def test_a_map_is_opened_shaken_about_the_level_of_its_training(opened, made):
    assert opened.remembers
    np.testing.assert_array_equal(opened.last_currents, [LEVEL, LEVEL])
    np.testing.assert_array_equal(opened.remembered, opened.memory().remembered)
    led = opened.memory("demagnetised")
    np.testing.assert_array_equal(led.last_currents, [0.0, 0.0])
    free = fm.open_map(made[0], outside_currents="evaluate").memory("demagnetised")
    for currents in history_of_currents("shaken", np.full(2, LEVEL)):
        free = free.step(currents)
    np.testing.assert_array_equal(free.remembered, opened.remembered)
    np.testing.assert_array_equal(
        opened.memory("shaken", {"left": 0.2, "right": 0.3}).last_currents, [0.2, 0.3]
    )


def test_asking_changes_nothing_and_steps_leave_the_map_they_began_at(opened):
    before, there = opened.remembered, np.array([0.9, -0.3])
    asked = opened.field(POINTS, there)
    stepped = opened.step(there)
    np.testing.assert_array_equal(opened.remembered, before)
    # Other questions change nothing either: a solve would start from the last state unless the memory were restored.
    opened.field(POINTS, [0.7, -0.2])
    np.testing.assert_array_equal(opened.field(POINTS, there), asked)
    # The last question is remembered for its own map only.
    here = opened.last_currents
    asked_here, recalled = opened.field(POINTS, here), opened.recalled(opened.step([-0.5, 0.8]).remembered)
    again = opened.step([-0.5, 0.8]).field(POINTS, here)
    np.testing.assert_array_equal(again, recalled.field(POINTS, here))
    assert np.abs(again - asked_here).max() > 0.01 * np.abs(asked_here).max()
    # A straight path gives the same field by a question and by a step.
    np.testing.assert_allclose(stepped.field(POINTS, there), asked, atol=1e-5 * np.abs(asked).max())
    back = stepped.field(POINTS, opened.last_currents) - opened.field(POINTS, opened.last_currents)
    assert np.abs(back).max() > 0.01 * np.abs(asked).max()


def test_a_memory_goes_on_from_its_numbers_to_the_last_bit(opened, made):
    path = paths.random_path(DOMAIN, np.full(2, LEVEL), 1002).currents
    memory = opened
    for currents in path[:10]:
        memory = memory.step(currents)
    other = fm.open_map(made[0]).recalled(memory.remembered.tolist())
    for currents in path[10:]:
        memory, other = memory.step(currents), other.step(currents)
        np.testing.assert_array_equal(other.field(POINTS, currents), memory.field(POINTS, currents))
    np.testing.assert_array_equal(other.remembered, memory.remembered)
    for wrong in (memory.remembered[1:], np.full(memory.remembered.shape, np.nan)):
        with pytest.raises(InputError):
            opened.recalled(wrong)


def test_derivatives_by_the_currents_are_those_with_the_memory_as_it_is(opened):
    memory, at = opened.step([0.8, 0.6]), np.array([0.7, 0.65])
    flux, _, by_current, _ = memory.by_currents(POINTS, at)
    direction = np.array([-0.6, 0.8])
    slope = direction @ by_current
    # Cells that begin to move between two steps bend the field, so the ratio of two steps says little. Measured errors
    # are up to 0.35 t^2 of the slope.
    for t in (0.02, 0.01, 0.005, 0.0025, 0.00125, 0.0006):
        left = np.abs(memory.field(POINTS, at + t * direction) - flux - t * slope).max()
        assert left < t**2 * np.abs(slope).max()


def test_a_simulation_leads_the_iron_and_a_search_does_not(opened):
    of, path = modelled(opened), np.array([[0.9, 0.4], [0.2, 0.4], [0.4, 0.4]])
    none = (np.zeros(3), np.zeros((2, 4)), np.zeros((2, 7)))
    led = CoreMachine(of.plant(body_numbers(), *none))
    tried = CoreMachine(of.plant(body_numbers(), *none, search=True))
    memory = opened
    for currents in path:
        memory = memory.step(currents)
        assert led.follow(currents)
        assert tried.follow(currents)
    expected = memory._model.weights(path[-1])
    untouched = opened._model.weights(path[-1])
    size = np.abs(expected).max()
    np.testing.assert_allclose(led.weights, expected, atol=4e-3 * size)
    np.testing.assert_allclose(tried.weights, untouched, atol=1e-5 * size)
    assert np.abs(expected - untouched).max() > 0.02 * size
    assert "hysteresis" in " ".join(of.assumptions)


def test_currents_beyond_the_domain(opened, made):
    beyond = [1.2, 0.0]
    for ask in (opened.step, lambda i: opened.field(POINTS, i)):
        with pytest.raises(OutsideMapError):
            ask(beyond)
    assert opened.step([1.0, 1.0]).last_currents.tolist() == [1.0, 1.0]
    free = fm.open_map(made[0], outside_currents="evaluate")
    assert free.step(beyond).last_currents.tolist() == beyond


def test_its_file_is_one_that_older_readers_refuse(made):
    with h5py.File(made[0]) as file:
        assert file["/fieldmap"].attrs["format_version"] == 3
        pinning = file["/fieldmap/reduced_model/pinning"][()]
        shares = file["/fieldmap/reduced_model/shares"][()]
    mu0 = 4e-7 * np.pi
    of_steel = mu0 * COERCIVE * np.array([0.0, 0.4, 0.8, 1.2, 1.6, 2.0])
    np.testing.assert_allclose(pinning, np.tile(of_steel, (3, 1)), rtol=1e-9)
    np.testing.assert_allclose(shares, [0.1, 0.2, 0.2, 0.2, 0.2, 0.1])
    assert check_map(made[0]).info.reduced_model.remembers


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("pinning", lambda values: values[:, ::-1]),
        ("pinning", lambda values: values - 1e-3),
        ("shares", lambda values: 2.0 * values),
        ("shares", lambda values: values[:-1]),
    ],
)
def test_cells_that_make_no_sense_are_refused(made, name, change):
    model = read_info(made[0]).reduced_model
    with pytest.raises(InputError):
        replace(model, **{name: change(getattr(model, name))})


def test_what_needs_no_memory_or_cannot_have_one_is_refused(device, opened, rig_map, tmp_path):
    plain = fm.open_map(rig_map)
    assert not plain.remembers
    for ask in (plain.memory, lambda: plain.step(0.0), lambda: plain.remembered, lambda: plain.last_currents):
        with pytest.raises(InputError):
            ask()
    with pytest.raises(InputError):
        tabled(opened)
    soft = device.replace(materials={"steel": replace(device.materials["steel"], coercive_field=0.0)})
    with pytest.raises(RecipeError) as caught:
        generated(soft, tmp_path / "none.h5")
    assert [problem.where.rpartition(": ")[2] for problem in caught.value.problems] == ["iron.model"]
    assert not list(tmp_path.iterdir())


def test_jax_refuses_a_map_with_memory_but_not_its_field_at_currents(opened):
    pytest.importorskip("jax")
    with pytest.raises(InputError):
        jax_field(opened)
    memory = opened.step([0.8, 0.2])
    at = jax_field(memory.at([0.7, 0.3]))
    ours = np.array(at(POINTS[0]))
    np.testing.assert_allclose(ours, memory.field(POINTS[0], [0.7, 0.3]), rtol=1e-4, atol=1e-7)


def test_the_stated_error_is_the_largest_share_at_the_strongest_state():
    some = Errors(3, 3, 1e-6, 2e-4, 2e-3, 1e-3, 5e-3, 0.25)
    others = Errors(4, 4, 3e-6, 1e-4, 1e-3, 4e-3, 2e-3, 0.5)
    found = hysteresis.stated_error([some, others])
    assert found == pytest.approx({"flux_density": 2e-3 * 5e-3, "gradient": 4e-3 * 0.5})
