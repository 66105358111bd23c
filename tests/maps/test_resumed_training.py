"""A training that stopped and continues: it solves the missing states, and trains on the states of an unbroken run."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import CurrentDomain, IndependentCurrents
from fieldmap.device.model import CircularCoil
from fieldmap.iron.solvers.nonlinear import StateImage
from fieldmap.maps.training import states as of_states
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.sequence import Training
from fieldmap.maps.training.states import SolvedStates, Stored
from fieldmap.parallel import Common, Workers
from fieldmap.progress import Forecast
from fieldmap.store import Checkpoint

POTENTIALS = np.array([[1.0, 2.0], [-3.0, 0.5], [0.0, 4.0], [2.5, -1.0]])
TRIED = np.array([[1.5, -0.5], [0.7, 0.9]])
PLAN = Plan(states=4, held_out=2)
COILS = [CircularCoil(name, 6e-3, 8e-3, 10e-3, 100) for name in "ab"]


class LinearIron:
    """Nodal potentials are `POTENTIALS` times the currents. The solve of number `stops` is interrupted."""

    device = SimpleNamespace(coils=COILS, background=None, fixed_sources=())
    images, unknowns, matrix_bytes = (), 4, 0

    def __init__(self, stops=None):
        self.solved, self.stops = [], stops

    def solve_potential(self, currents, tolerance, start=None):
        if len(self.solved) == self.stops:
            raise KeyboardInterrupt
        self.solved.append(currents.tolist())
        potential = POTENTIALS @ currents
        return potential, self.air(potential)

    def sensitivities(self, currents, potential, directions):
        return POTENTIALS @ directions

    def air(self, potentials):
        return 2.0 * potentials


def train(path, solver, tried=TRIED, fingerprint="one"):
    """The training after its first three states, and the states that it was tried on."""
    domain = CurrentDomain(IndependentCurrents(2), np.array([-1.0, 0.0]), np.array([2.0, 1.0]))
    forecast = Forecast(lambda text, share: None, dict.fromkeys(("training", "random", "points"), 1.0))
    with Checkpoint(path, fingerprint) as checkpoint:
        states = SolvedStates(checkpoint, Common.of(solver), Workers())
        training = Training(solver, domain, PLAN, np.zeros((1, 3)), states, forecast)
        found = training.solve_tried(lambda i: POTENTIALS @ i, tried, PLAN.states, "at random", "random")
    return training, found


@pytest.fixture
def stopped(tmp_path):
    """The file of a run that was stopped at its last trial state."""
    path = tmp_path / "map.kept"
    with pytest.raises(KeyboardInterrupt):
        train(path, LinearIron(stops=4))
    return path


def test_it_trains_on_no_state_that_it_is_tried_on(stopped, tmp_path):
    whole, tried = train(tmp_path / "other.kept", first := LinearIron())
    assert len(first.solved) == 5
    again, tried_again = train(stopped, rest := LinearIron())
    assert rest.solved == [TRIED[1].tolist()]
    for one, known in ((whole, tried), (again, tried_again)):
        np.testing.assert_array_equal(one.known.currents, one.currents[:3])
        np.testing.assert_allclose(one.known.potentials, POTENTIALS @ one.currents[:3].T, rtol=1e-14)
        np.testing.assert_array_equal(known.currents, TRIED)
        np.testing.assert_allclose(known.potentials, POTENTIALS @ TRIED.T, rtol=1e-14)
        # Each state is counted once, whichever run solved it.
        assert (one.states.count, one.states.failed) == (5, {})
        assert all(state.tangents.shape == (4, 2) for state in one.known.states)
    assert (whole.states.computed, again.states.computed) == (5, 1)


def test_it_takes_no_state_of_other_currents_or_of_another_map(stopped):
    other = TRIED[::-1] + 0.01
    _, tried = train(stopped, solver := LinearIron(), other)
    assert solver.solved == other.tolist()
    np.testing.assert_allclose(tried.potentials, POTENTIALS @ other.T, rtol=1e-14)
    train(stopped, solver := LinearIron(), fingerprint="two")
    assert len(solver.solved) == 5


@pytest.mark.parametrize("stops", [None, 4])
def test_large_tangents_stay_on_the_disk_and_change_no_number(tmp_path, monkeypatch, stops):
    """States that were just solved, and states that an earlier run solved."""
    monkeypatch.setattr(of_states, "_LARGE", 0)
    path = tmp_path / "map.kept"
    if stops is not None:
        with pytest.raises(KeyboardInterrupt):
            train(path, LinearIron(stops))
    domain = CurrentDomain(IndependentCurrents(2), np.array([-1.0, 0.0]), np.array([2.0, 1.0]))
    forecast = Forecast(lambda text, share: None, dict.fromkeys(("training", "random", "points"), 1.0))
    with Checkpoint(path, "one") as checkpoint:
        states = SolvedStates(checkpoint, Common.of(LinearIron()), Workers())
        known = Training(LinearIron(), domain, PLAN, np.zeros((1, 3)), states, forecast).known
        for number, values in enumerate(known.currents):
            held, whole = known.held(number), known.state(number)
            assert isinstance(held, Stored)
            np.testing.assert_array_equal(held.potential, POTENTIALS @ values)
            # Steps of an eighth of the ranges.
            steps = POTENTIALS @ np.diag([3.0, 1.0]) / 8.0
            np.testing.assert_allclose(whole.tangents, steps, rtol=1e-14)
            both = np.column_stack([held.potential, whole.tangents])
            np.testing.assert_array_equal(whole.air, 2.0 * both)
            turned = StateImage(np.array([1, 0]), np.ones(2), np.array([3, 2, 1, 0]), -1.0)
            np.testing.assert_array_equal(held.image(turned).tangents, -whole.tangents[::-1])
        # Tangents for later training stay on the disk.
        again = known.some([0, 1])
        again.add(known.currents[2], known.held(2))
        assert all(isinstance(again.held(number), Stored) for number in range(3))
        np.testing.assert_array_equal(again.nearest(known.currents[2]), known.held(2).potential)
