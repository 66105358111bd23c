"""The callback for MuJoCo's passive forces, without MuJoCo: its data is three pointers here."""

import ctypes

import numpy as np
import pytest

from fieldmap.constants import MU0
from fieldmap.core import CoreMap
from fieldmap.core.body import CoreBody
from fieldmap.core.mujoco import Layout, Magnet, Task, callback
from tests.core.map_cases import CURRENTS, block_of, no_reaction
from tests.core.test_soft_iron import DIPOLES, POSE, pieces

ORIGIN = np.array([0.5, -0.25, 0.125])
# Places and rotations of three bodies in the world; the first body is the world.
PLACES = ORIGIN + np.array([[9.0, 9.0, 9.0], [-0.2, 0.25, 1.1], [-0.18, 0.26, 1.13]])
TURNS = np.array([np.eye(3), POSE, POSE @ POSE[[1, 2, 0]]])
MODEL = 4096  # an address that is never read
_APPLY = ctypes.CFUNCTYPE(None, *4 * [ctypes.c_void_p], ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)


class Simulator:
    """The parts of MuJoCo: places, rotations, passive forces, and a function that applies a load."""

    def __init__(self):
        self.places, self.turns, self.passive = PLACES.copy(), TURNS.copy(), np.zeros(12)
        arrays = (self.places, self.turns, self.passive)
        self.data = np.array([7, *(array.ctypes.data for array in arrays)], np.uint64)
        self.applied = []
        self.apply = _APPLY(self._apply)
        self.layout = Layout(ctypes.cast(self.apply, ctypes.c_void_p).value, 8, 16, 24)
        self.callback = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(callback())

    def _apply(self, model, data, force, torque, point, body, target):
        three = [np.array((ctypes.c_double * 3).from_address(at)) for at in (force, torque, point)]
        assert (model, data, target) == (MODEL, self.data.ctypes.data, self.passive.ctypes.data)
        self.applied.append((body, *three))

    def call(self, model=MODEL):
        self.passive[:] = 0.0
        self.applied.clear()
        self.callback(model, self.data.ctypes.data)


@pytest.fixture
def simulator(library):
    return Simulator()


def by_map(block, body, points, number, weights=CURRENTS):
    """Wrench in the world of a body's dipoles and soft iron."""
    where = PLACES[number] - ORIGIN + points @ TURNS[number].T
    flux, gradient = np.empty((len(points), 2, 3)), np.empty((len(points), 2, 3, 3))
    CoreMap(block).each_field(where, flux, gradient)
    wrench = np.empty(6)
    body.wrench_slopes(TURNS[number], weights, (flux, gradient), no_reaction(flux), wrench, np.empty((6, 2)))
    return wrench


def test_loads_are_those_of_the_map(simulator):
    block, _ = block_of("harmonic")
    soft, weights = CoreBody(DIPOLES, pieces()), CURRENTS.copy()
    points = np.array([DIPOLES[0, :3], *(piece.centre for piece in pieces())])
    magnets = [Magnet(soft, 1, 3), Magnet(CoreBody(DIPOLES), 2, -1)]
    task = Task(CoreMap(block), weights, magnets, simulator.layout, ORIGIN, False)
    simulator.call()
    assert not simulator.passive.any()
    task.enter()
    # The first call sets the model; calls with another model do nothing.
    for model in (MODEL, MODEL + 8):
        simulator.call(model)
        assert not simulator.passive.any()
    for change in (1.0, -0.5):
        weights[:] = change * CURRENTS
        simulator.call()
        wanted = by_map(block, soft, points, 1, weights)
        np.testing.assert_allclose(simulator.passive[3:6], wanted[:3], rtol=1e-12)
        np.testing.assert_allclose(TURNS[1] @ simulator.passive[6:9], wanted[3:], rtol=1e-12)
        assert not np.delete(simulator.passive, np.arange(3, 9)).any()
        ((body, force, torque, point),) = simulator.applied
        assert body == 2
        np.testing.assert_array_equal(point, PLACES[2])
        wanted = by_map(block, CoreBody(DIPOLES), points[:1], 2, weights)
        np.testing.assert_allclose([*force, *torque], wanted, rtol=1e-12)
    assert task.fault() is None
    task.leave()
    simulator.call()
    assert not simulator.passive.any()


def between(place, moment):
    """Potential energy, in the world, of the dipole of magnet 1 and a dipole at a place."""
    r = place - PLACES[1] - TURNS[1] @ DIPOLES[0, :3]
    source, size = TURNS[1] @ DIPOLES[0, 3:], np.linalg.norm(r)
    return MU0 / (4 * np.pi) * (source @ moment / size**3 - 3 * (source @ r) * (moment @ r) / size**5)


def test_dipoles_on_each_other_lose_what_their_energy_gains(simulator):
    """By differences, in a map without currents."""
    block, _ = block_of("harmonic")
    magnets = [Magnet(CoreBody(DIPOLES), 1, 0), Magnet(CoreBody(DIPOLES), 2, -1)]
    task = Task(CoreMap(block), np.zeros(2), magnets, simulator.layout, ORIGIN, True)
    task.enter()
    simulator.call()
    simulator.call()
    task.leave()
    ((_, force, torque, _),) = simulator.applied
    arm, moment = TURNS[2] @ DIPOLES[0, :3], TURNS[2] @ DIPOLES[0, 3:]

    def slope(energy_at):
        step = 1e-6
        return np.array(
            [(energy_at(-step * unit) - energy_at(step * unit)) / (2 * step) for unit in np.eye(3)]
        )

    by_place = slope(lambda off: between(PLACES[2] + arm + off, moment))
    np.testing.assert_allclose(force, by_place, atol=1e-7 * np.abs(by_place).max())
    by_turn = slope(lambda off: between(PLACES[2] + arm + np.cross(off, arm), moment + np.cross(off, moment)))
    np.testing.assert_allclose(torque, by_turn, atol=1e-7 * np.abs(by_turn).max())
    np.testing.assert_allclose(simulator.passive[:3], -force, rtol=1e-12)


def test_a_magnet_that_leaves_the_map_feels_nothing_from_there_on(simulator):
    block, _ = block_of("harmonic")
    magnets = [Magnet(CoreBody(DIPOLES), 1, 0), Magnet(CoreBody(DIPOLES), 2, 6)]
    task = Task(CoreMap(block), CURRENTS.copy(), magnets, simulator.layout, ORIGIN, False)
    task.enter()
    simulator.call()
    simulator.places[2, 2] += 10.0
    for _ in range(2):
        simulator.call()
        assert not simulator.passive[6:].any()
        status, number, place = task.fault()
        assert (status, number) == (1, 1)
        np.testing.assert_allclose(
            place, simulator.places[2] + TURNS[2] @ DIPOLES[0, :3] - ORIGIN, rtol=1e-14
        )
        simulator.places[2, 2] -= 10.0
        # The other magnets feel nothing either.
        simulator.call()
        assert not simulator.passive.any()
        simulator.places[2, 2] += 10.0
    simulator.places[2, 2] -= 10.0
    task.leave()
    task.enter()
    simulator.call()
    simulator.call()
    assert task.fault() is None
    assert simulator.passive[6:].any()
    task.leave()


def test_tasks_nest(simulator):
    block, _ = block_of("harmonic")
    body = CoreBody(DIPOLES)
    outer, inner = (
        Task(CoreMap(block), scale * CURRENTS, [Magnet(body, 1, 0)], simulator.layout, ORIGIN, False)
        for scale in (1.0, 3.0)
    )
    felt = []
    outer.enter()
    simulator.call()
    simulator.call()
    felt.append(simulator.passive.copy())
    inner.enter()
    simulator.call()
    simulator.call()
    felt.append(simulator.passive.copy())
    inner.leave()
    simulator.call()
    outer.leave()
    np.testing.assert_allclose(felt[1], 3.0 * felt[0], rtol=1e-12)
    np.testing.assert_array_equal(simulator.passive, felt[0])


def test_arguments_that_do_not_fit_are_refused(simulator):
    core, body = CoreMap(block_of("harmonic")[0]), CoreBody(DIPOLES)
    for weights, origin in ((np.zeros(3), ORIGIN), (CURRENTS, np.zeros(2))):
        with pytest.raises(TypeError):
            Task(core, weights, [Magnet(body, 1, 0)], simulator.layout, origin, False)
    with pytest.raises(TypeError):
        Task(core, CURRENTS, [Magnet(body, 1.5, 0)], simulator.layout, ORIGIN, False)
