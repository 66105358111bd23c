"""A coil with a magnet as core under a thin saturating plate, in the earth's field: its map against fresh solves."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.constants import GRAVITY
from fieldmap.core import CoreMap
from fieldmap.dynamics.field_of_currents import linearised
from fieldmap.errors import InputError
from fieldmap.field import CompletedField
from fieldmap.interop import write_c_map
from fieldmap.iron import NonlinearSolver
from fieldmap.levitation import lift_current
from fieldmap.lookup import iron_weights, magnetic_body, tangent_block
from fieldmap.maps.training.currents import training_signals
from fieldmap.store import MapData, check_map, read_map, write_map
from tests.dynamics.machines import machine_in
from tests.interop.test_c_map import STRICT, ask, build

POINTS = np.random.default_rng(5).uniform([-5e-3, -5e-3, -56e-3], [5e-3, 5e-3, -36e-3], (30, 3))


@pytest.fixture(scope="module")
def device():
    return fm.read_device("magnet_core")


@pytest.fixture(scope="module")
def solver(device):
    return NonlinearSolver(device, tolerance=1e-4)


@pytest.fixture(scope="module")
def path(device, tmp_path_factory):
    target = tmp_path_factory.mktemp("map") / "core.h5"
    currents = {"lower_A": -3.0, "upper_A": 3.0, "held_out": 4}
    return fm.generate(device, target, spacing=2e-3, currents=currents)


@pytest.fixture(scope="module")
def linear(device):
    return fm.solve_linear(device)


@pytest.fixture(scope="module")
def m(path):
    """Without the iron's reaction, which the solver does not know."""
    return fm.open_map(path, reaction=False)


@pytest.mark.parametrize("current", [0.0, -3.0, 1.3, 3.0])
def test_fields_are_those_of_a_fresh_solve_within_what_the_map_states(m, solver, current):
    b, g = solver.field(POINTS, [current]), solver.gradient(POINTS, [current])
    off = np.linalg.norm(m.field(POINTS, [current]) - b, axis=1).max()
    slope = np.linalg.norm((m.gradient(POINTS, [current]) - g).reshape(-1, 9), axis=1).max()
    # The largest error at the tried states, and half as much more for a state that was not tried.
    assert off < m.error_bound.flux_density + 1.5 * m.current_error.flux_density
    assert slope < m.error_bound.gradient + 1.5 * m.current_error.gradient
    assert off < 1e-3 * np.abs(b).max()


def test_zero_currents_give_the_field_of_the_magnet(m, solver):
    off = m.constant_field(POINTS)
    assert off == pytest.approx(solver.field(POINTS, [0.0]), abs=4e-7)
    assert np.abs(off).max() > 1e-3
    assert (m.proportional, m.affine) == (False, False)
    assert m.fixed_sources == ("core", "background")


def test_linear_iron_would_not_do(linear, m):
    far = np.abs(linear.field(POINTS, [3.0]) - m.field(POINTS, [3.0])).max()
    assert far > 20 * m.current_error.flux_density


def test_currents_for_compensates_the_magnet(m, solver, device):
    place, moment, weight = (
        [0.0, 0.0, -41e-3],
        [0.0, 0.0, device.payload.moment],
        device.payload.mass * GRAVITY,
    )
    nan = np.nan
    lift = m.currents_for(place, force=[nan, nan, weight], moment=moment)
    assert m.wrench(place, moment, lift)[2] == pytest.approx(weight, rel=1e-8)
    fresh = solver.wrench([place], moment, lift)[0, 2]
    assert fresh == pytest.approx(weight, rel=2e-4)
    assert abs(lift[0]) < 0.2  # the core carries nearly all of it
    less = m.currents_for([0.0, 0.0, -38e-3], force=[nan, nan, weight], moment=moment)
    assert less[0] < -0.5
    none = m.currents_for(place, field=[nan, nan, 1e-3])
    stated = m.error_bound.flux_density + 1.5 * m.current_error.flux_density
    assert solver.field(place, none)[2] == pytest.approx(1e-3, abs=stated)
    assert stated < 2e-6


def test_lift_current_may_be_zero_or_negative(m, linear, device):
    at = [lift_current(m, device.payload, [0.0, 0.0, z]).current for z in (-38e-3, -41e-3, -44e-3)]
    assert at[0] < 0.0 < at[1] < at[2]
    near = [lift_current(linear, device.payload, [0.0, 0.0, z]).current for z in (-38e-3, -41e-3, -44e-3)]
    assert near == pytest.approx(at, abs=0.1)


def test_it_floats_without_current(m, solver, device):
    found = fm.find_equilibrium(m, [0.0], device.payload)
    force = magnetic_body(device.payload).wrench(solver, found.position, [0.0])
    assert force[2] == pytest.approx(device.payload.mass * GRAVITY, rel=2e-4)


def test_tangents_and_weights_have_the_background(m):
    values, slopes = iron_weights(m, [[1.0], [-2.0]])
    assert values[:, -1].tolist() == [1.0, 1.0]
    assert not slopes[:, -1].any()
    block = linearised(m, [1.0])
    machine = machine_in(block, 1)
    assert machine.follow(np.array([1.0]))
    weights = machine.weights
    assert weights.tolist() == [1.0, 1.0]
    assert block.constant
    flux, slope = np.empty((30, 3)), np.empty((30, 3, 3))
    CoreMap(tangent_block(m, [1.0])).fields(POINTS, weights[None], flux, slope)
    assert flux == pytest.approx(m.field(POINTS, [1.0]), abs=1e-9)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
def test_c_gives_the_numbers_of_python(m, tmp_path):
    program = build("ask.c", tmp_path / "ask", *STRICT, "-O2")
    with pytest.raises(InputError):
        write_c_map(m, tmp_path / "free.fmap")
    for current in (0.0, 2.0):
        fixed = m.at([current])
        written = write_c_map(fixed, tmp_path / "fixed.fmap")
        rows = (np.ones((30, 1)), POINTS, np.ones((30, 3)))
        (flux, slope, second, _, status), _ = ask(program, written, rows, tmp_path)
        assert not status.any()
        expected = *fixed.field_and_gradient(POINTS), fixed.second_gradient(POINTS)
        for ours, python in zip((flux, slope, second), expected, strict=True):
            assert np.abs(ours - python).max() < 1e-13 * np.abs(python).max()


def test_simulation_floats_on_it(path, device):
    opened = fm.open_map(path, outside_currents="evaluate")
    for depth in (41.0, 39.5):
        run = fm.simulate("hold", {"start.depth_mm": depth}, field_map=opened)
        assert run.event is None
        # The scenario steps 1 mm upward.
        assert run.metrics.end_mm[2] == pytest.approx(depth - 1.0, abs=0.1)
    assert run.metrics.end_A[0] < 0.0


def test_simulation_on_linear_iron(linear, device):
    run = fm.simulate("hold", {"start.depth_mm": 41.0}, field_map=linear, device=device)
    assert run.event is None
    assert run.metrics.end_mm[2] == pytest.approx(40.0, abs=0.1)


def test_file_keeps_the_background_of_the_iron(path, m, tmp_path):
    checked = check_map(path)
    assert checked.info.field_names[-1] == "no current"
    data = read_map(path)
    assert data.reduced_model.fixed.size == 3 * len(data.reduced_model.weights)
    again = fm.open_map(write_map(tmp_path / "again.h5", data))
    assert np.array_equal(again.field(POINTS, [1.0]), m.field(POINTS, [1.0]))
    # A background in the air and not in the iron, or the reverse, makes no map.
    other = replace(data.reduced_model, fixed=np.zeros(0))
    with pytest.raises(InputError):
        MapData(**{**vars(data), "reduced_model": other})
    with pytest.raises(InputError):
        MapData(**{**vars(data), "constant_field": False})


def test_magnets_alone_are_in_the_fields_of_the_iron(device, tmp_path):
    bare = device.replace(background=None)
    target = fm.generate(
        bare, tmp_path / "bare.h5", spacing=2.5e-3, currents=(0.0, 3.0), iron={"refinement": 0.5}
    )
    one = fm.open_map(target)
    assert one.info.fixed_sources == ("core",)
    assert not one.info.constant_field
    solver = NonlinearSolver(bare, 0.5, tolerance=1e-4)
    for current in (0.0, 2.2):
        assert one.field(POINTS, [current]) == pytest.approx(solver.field(POINTS, [current]), abs=2e-6)


def test_a_strong_background_magnetises_the_iron(device, tmp_path):
    """A background that magnetises the iron visibly: the model has it at its sample points and in the air."""
    strong = device.replace(background=fm.Background([5e-3, 0.0, -8e-3], [0.05, 0.0, 0.02, 0.05, 0.0]))
    path = fm.generate(strong, tmp_path / "strong.h5", spacing=2.5e-3, currents=(0.0, 3.0))
    opened, solver = fm.open_map(path), NonlinearSolver(strong, tolerance=1e-4)
    bound = opened.error_bound.flux_density + 1.5 * opened.current_error.flux_density
    for current in (0.0, 2.2):
        b = solver.field(POINTS, [current])
        assert np.linalg.norm(opened.field(POINTS, [current]) - b, axis=1).max() < bound
    bare = NonlinearSolver(device.replace(background=None), tolerance=1e-4).field(POINTS, [0.0])
    alone = bare + strong.background.field(POINTS)
    assert np.abs(solver.field(POINTS, [0.0]) - alone).max() > 20 * bound


def test_training_has_the_state_without_currents(path):
    from fieldmap.currents import CurrentDomain, IndependentCurrents

    domain = CurrentDomain(IndependentCurrents(2), np.array([-1.0, -2.0]), np.array([3.0, 2.0]))
    assert not training_signals(domain, 4, (), True)[1].any()
    assert training_signals(domain, 4, ())[1].any()
    known = read_map(path).reduced_model.known_currents
    assert (np.abs(known).max(axis=1) == 0.0).any()


def test_jax_solves_the_same_model(m):
    jax = pytest.importorskip("jax")
    from fieldmap.interop import jax_field

    jax.config.update("jax_enable_x64", True)
    field = jax_field(m)
    for current in (0.0, 1.3):
        assert np.asarray(field.field(POINTS, np.array([current]))) == pytest.approx(
            m.field(POINTS, [current]), abs=1e-8
        )


def test_completed_fields_pass_affinity_on(m):
    wrapped = CompletedField(m)
    assert (wrapped.affine, wrapped.proportional) == (False, False)
    assert wrapped.constant_field(POINTS) == pytest.approx(m.constant_field(POINTS), rel=1e-12)
