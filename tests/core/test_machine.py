"""Machines in the C core: fields that follow the currents, rotations, and refused input.

Motion, losses, contacts and whole runs are tested in tests/dynamics.
"""

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.core.body import CoreBody
from fieldmap.core.iron import CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.core.machine import (
    BodyNumbers,
    CoreMachine,
    InverseMap,
    Plant,
    inverse_along,
    plate_force,
    rotation,
    sensed_point,
)
from fieldmap.lookup.current_solver import compiled_model
from tests.core.iron_cases import CASES, FIELDS, drawn
from tests.core.map_cases import GRID, block_of

DIPOLE = np.array([[0.01, 0.0, -0.02, 0.3, -0.2, 0.5]])
MIDDLE = 0.5 * (GRID.lower + GRID.upper)


def body_numbers(**changed):
    numbers = {
        "mass": 0.1,
        "inertia": np.array([1e-5, 2e-5, 2.5e-5]),
        "gravity": np.zeros(3),
        "force": np.zeros(3),
        "torque": np.zeros(3),
        "drag": np.zeros((5, 3)),
        "plate": np.zeros(8),
        "seen_by_plate": np.zeros(6),
        "walls": np.array([1e3, 1.0, 0.3, 1e-3, -np.inf, np.inf, np.inf, 0.0, 0.0]),
        "skin": np.zeros((0, 3)),
        "magnetic": CoreBody(DIPOLE).body,
    }
    return BodyNumbers(**numbers | changed)


def plant(coils, sets, body=None, **changed):
    parts = {
        "map": CoreMap(block_of("harmonic", sets=sets)[0]).map,
        "body": body_numbers() if body is None else body,
        "seen_at": np.zeros(3),
        "scale": 1.0,
        "iron": None,
        "tolerance": 1e-4,
        "table": None,
        "windings": np.zeros((coils, 4)),
        "drives": np.zeros((coils, 7)),
    }
    return Plant(**parts | changed)


def state_at(place, turn=(1.0, 0.0, 0.0, 0.0)):
    return np.array([*place, 0.0, 0.0, 0.0, *turn, 0.0, 0.0, 0.0])


def test_weights_are_currents_and_a_constant_field_times_a_scale():
    machine = CoreMachine(plant(2, 3, scale=1.5))
    assert machine.follow(np.array([2.0, -4.0]))
    assert machine.weights.tolist() == [3.0, -6.0, 1.5]
    assert CoreMachine(plant(0, 1, scale=2.0)).weights.tolist() == [2.0]
    assert machine.solves == (0, 0, 0, 0)


@pytest.mark.parametrize("name", CASES)
def test_iron_is_solved_as_currents_go_and_counted(name):
    of = CASES[name]
    model, coils = CoreIron(core_numbers(compiled_model(of, checked=True))), of.coil_count
    sets = coils + FIELDS + int(of.fixed.size > 0)
    state, weights = model.state(), np.empty(sets)
    machine = CoreMachine(plant(coils, sets, iron=model.state().state, tolerance=1e-10, scale=1.5))
    inside = drawn(of, 5, 9)
    for currents in inside:
        assert machine.follow(currents)
        assert state.solve(currents, weights, tolerance=1e-10) == 0
        np.testing.assert_allclose(machine.weights, 1.5 * weights, rtol=1e-7, atol=1e-9)
    done = machine.solves
    assert done._replace(newton_steps=0) == (5, 0, 0, 0)
    assert done.newton_steps >= 5
    # Beyond the domain the model continues, and such currents are counted.
    assert not machine.follow(5.0 * of.domain.largest)
    assert machine.solves._replace(newton_steps=0) == (6, 0, 0, 1)
    assert machine.follow(inside[-1])
    held = machine.weights
    # Without a successful solve the iron stays as it was.
    machine = CoreMachine(machine.plant._replace(tolerance=0.0))
    machine.follow(inside[1])
    np.testing.assert_array_equal(machine.weights[:coils], 1.5 * inside[1])
    np.testing.assert_array_equal(machine.weights[coils:], held[coils:])
    machine.follow(np.nan * inside[1])
    assert np.isnan(machine.weights).all()
    assert machine.solves.unsolved == 2


def test_a_rotation_takes_vectors_from_the_body_to_the_map():
    turn = np.array([0.3, -0.5, 0.7, 0.2])
    matrix = rotation(state_at(MIDDLE, turn / np.linalg.norm(turn)))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(matrix) > 0
    quarter = state_at(MIDDLE, np.array([1.0, 0.0, 0.0, 1.0]) / np.sqrt(2))  # about z: x becomes y
    np.testing.assert_allclose(
        sensed_point(quarter, np.array([1.0, 0.0, 0.0])), MIDDLE + [0.0, 1.0, 0.0], atol=1e-15
    )


def test_the_disturbance_is_added_in_the_frames_of_the_load():
    half = np.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])
    state, load, disturbed = state_at(MIDDLE, half), np.empty(6), np.empty(6)
    still = CoreMachine(plant(0, 1))
    assert still.load(state, load) == (0, 0)
    force, torque = np.array([1.0, 2.0, 3.0]), np.array([-3.0, 0.5, 2.0])
    body = body_numbers(force=force, torque=torque, gravity=np.array([0.0, 0.0, -9.0]))
    assert CoreMachine(plant(0, 1, body)).load(state, disturbed) == (0, 0)
    change = np.concatenate([force + [0.0, 0.0, -0.9], rotation(state).T @ torque])
    np.testing.assert_allclose(disturbed - load, change, atol=1e-12)


def test_a_wall_pushes_in_proportion_to_depth_and_speed_and_never_pulls():
    """A skin of one point in the centre: stiffness times depth less damping times outward speed, never below zero."""
    still = CoreMachine(plant(0, 1))
    walls = np.array([1e3, 10.0, 0.0, 1e-3, MIDDLE[2] + 0.01, np.inf, np.inf, 0.0, 0.0])
    machine = CoreMachine(plant(0, 1, body_numbers(walls=walls, skin=np.zeros((1, 3)))))
    free, load = np.empty(6), np.empty(6)
    state = state_at(MIDDLE)
    still.load(state, free)
    for outward, push in ((0.0, 10.0), (-0.5, 15.0), (0.5, 5.0), (1.0, 0.0), (3.0, 0.0)):
        state[5] = outward
        assert machine.load(state, load) == (0, 1)
        np.testing.assert_allclose(load - free, [0.0, 0.0, push, 0.0, 0.0, 0.0], atol=1e-9)


def test_outside_the_map_a_load_stays_and_an_energy_is_unknown():
    machine, load = CoreMachine(plant(0, 1)), np.full(6, 7.0)
    assert machine.load(state_at(GRID.upper + 1.0), load)[0] == 1
    assert machine.load(state_at([np.nan, 0.3, 1.1]), load)[0] == 2
    assert (load == 7.0).all()
    assert machine.energy(state_at(GRID.upper + 1.0)) is None
    assert machine.rates(state_at(GRID.upper + 1.0), np.empty(13)) == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("body", body_numbers(inertia=np.zeros(2))),
        ("body", body_numbers(drag=np.zeros(15))),
        ("body", body_numbers(mass="heavy")),
        ("body", body_numbers(skin=np.zeros((2, 2)))),
        ("body", body_numbers(magnetic=None)),
        ("body", None),
        ("map", None),
        ("windings", np.zeros((2, 3))),
        ("windings", np.zeros((2, 4), np.float32)),
        ("drives", np.zeros((1, 7))),
        ("seen_at", np.zeros(4)),
        ("scale", None),
        ("iron", CoreBody(DIPOLE).body),
    ],
)
def test_parts_that_do_not_fit_are_refused(name, value):
    given = plant(2, 2)._replace(**{name: value})
    with pytest.raises((TypeError, ValueError, AttributeError)):
        CoreMachine(given)


def test_more_coils_than_fields_and_iron_of_other_fields_are_refused():
    with pytest.raises(ValueError, match="fewer fields"):
        CoreMachine(plant(3, 2))
    model = CoreIron(core_numbers(compiled_model(CASES["free"], checked=True)))
    with pytest.raises(ValueError, match="other fields"):
        CoreMachine(plant(3, 4, iron=model.state().state))
    constant = CoreMap(block_of("harmonic")[0], constant=True)
    with pytest.raises(ValueError, match="all sets"):
        CoreMachine(plant(1, 2, map=constant.map))


def test_arrays_that_do_not_fit_are_refused():
    machine = CoreMachine(plant(2, 2))
    state, load = state_at(MIDDLE), np.empty(6)
    locked = state.copy()
    locked.flags.writeable = False
    for refused in (
        lambda: machine.follow(np.zeros(3)),
        lambda: machine.follow([1.0, 2.0]),
        lambda: machine.load(state[:12], load),
        lambda: machine.load(locked, load),
        lambda: machine.load(state, np.empty(5)),
        lambda: machine.rates(state, np.empty(12)),
        lambda: machine.move(state, 1e-3, 1, 2, np.empty((3, 12))),
        lambda: machine.advance(1e-3, 1, np.zeros(3), state, np.zeros(2), load),
        lambda: machine.advance(1e-3, 1, np.zeros(2), state, np.zeros(3), load),
        lambda: machine.advance("s", 1, np.zeros(2), state, np.zeros(2), load),
        lambda: plate_force(np.zeros(7), *np.zeros((4, 3))),
        lambda: plate_force(np.zeros(8), *np.zeros((4, 2))),
        lambda: rotation(state[:7]),
        lambda: inverse_along(
            InverseMap(None, 3, np.zeros((2, 3)), np.zeros(3), state), None, *np.zeros((3, 1, 3)), np.zeros(1)
        ),
    ):
        with pytest.raises((TypeError, ValueError)):
            refused()


@pytest.mark.parametrize("count", [0, 2])
def test_a_call_with_another_number_of_arguments_is_refused(library, count):
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(library.rotation(turn), np.eye(3))
    with pytest.raises(TypeError):
        library.rotation(*[turn] * count)
