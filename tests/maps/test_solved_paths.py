"""Kept paths are used again for the same currents after the same history, and solved anew for any other."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.maps.training.paths import CurrentPath
from fieldmap.maps.training.solved_paths import SolvedPaths
from fieldmap.parallel import Common, Workers
from fieldmap.progress import Forecast
from fieldmap.store import Checkpoint

SOME, OTHER = np.array([[1.0], [2.0]]), np.array([[1.0], [3.0], [4.0]])


class Doubling:
    """Nodal potentials that are twice and three times the currents."""

    def __init__(self):
        self.solved = []

    def solve(self, path, tolerance):
        self.solved.append((path.history, path.currents.ravel().tolist(), tolerance))
        return path.currents * [2.0, 3.0], {"steps": len(path.currents)}


def run(path, *asked):
    """The potentials and reports of paths, what was solved now, and the states that were counted."""
    solver, told = Doubling(), []
    forecast = Forecast(lambda text, share: told.append(text), {"training": 1.0})
    with Checkpoint(path, {"one": "1"}) as checkpoint, Workers() as workers:
        paths = SolvedPaths(checkpoint, Common.of(solver), workers, 1e-3, forecast)
        found = [paths.solve([CurrentPath(*each) for each in some], "training", 5) for some in asked]
    return SimpleNamespace(found=found, solved=solver.solved, paths=paths, told=told)


def test_paths_are_solved_once(tmp_path):
    kept = tmp_path / "map.partial"
    first = run(kept, [("shaken", SOME), ("demagnetised", OTHER)])
    assert first.solved == [("shaken", [1.0, 2.0], 1e-3), ("demagnetised", [1.0, 3.0, 4.0], 1e-3)]
    again = run(kept, [("shaken", SOME)], [("demagnetised", OTHER)])
    assert not again.solved
    assert again.paths.count == first.paths.count == 5
    assert first.paths.earlier_seconds == 0.0 < again.paths.earlier_seconds
    for one in (first.found[0], [*again.found[0], *again.found[1]]):
        np.testing.assert_array_equal(one[0].potentials, SOME * [2.0, 3.0])
        np.testing.assert_array_equal(one[1].potentials, OTHER * [2.0, 3.0])
        assert [solved.report for solved in one] == [{"steps": 2}, {"steps": 3}]
    assert [text.split(",")[0] for text in first.told] == ["state 1 on", "state 3 on"]
    assert first.told[1].endswith(" states/s")


@pytest.mark.parametrize("other", [("demagnetised", SOME), ("shaken", 1.5 * SOME), ("shaken", OTHER)])
def test_another_path_in_its_place_is_solved_anew(tmp_path, other):
    kept = tmp_path / "map.partial"
    run(kept, [("shaken", SOME)])
    assert [(history, currents) for history, currents, _ in run(kept, [other]).solved] == [
        (other[0], other[1].ravel().tolist())
    ]
