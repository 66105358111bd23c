"""Solved states, and the choice of the state that a solve starts from."""

from types import SimpleNamespace

import numpy as np

from fieldmap.maps.training.states import Snapshots, Solved

NO_IMAGES = SimpleNamespace(images=())


def kept(*currents):
    """States at these currents; the potential of each is its number."""
    found = Snapshots(NO_IMAGES)
    for number, values in enumerate(currents):
        found.add(
            np.array(values, float), Solved(np.array([float(number)]), np.zeros((1, 0)), np.zeros((1, 0)))
        )
    return found


def test_the_nearest_state_with_currents_is_the_start():
    found = kept([0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [-3.0, 0.1], [0.5, 2.0])
    for currents, number in {
        (2.9, 0.2): 2,
        (-2.0, 0.0): 3,
        (0.01, 0.0): 1,
        (0.0, 9.0): 4,
        (-0.5, 1.6): 4,
    }.items():
        assert found.nearest(np.array(currents)) == [number]


def test_there_is_no_start_without_currents():
    assert kept().nearest(np.ones(2)) is None
    assert kept([0.0, 0.0]).nearest(np.ones(2)) is None


def test_a_state_is_known_by_its_currents():
    found, other = kept([1.0, 2.0], [2.0, 1.0]), kept([2.0, 1.0], [5.0, 5.0])
    assert [found.number(np.array(values)) for values in ([2.0, 1.0], [1.0, 1.0])] == [1, None]
    assert other.without(found).currents.tolist() == [[5.0, 5.0]]
    assert found.with_earlier(other).currents.tolist() == [[1.0, 2.0], [2.0, 1.0], [5.0, 5.0]]
