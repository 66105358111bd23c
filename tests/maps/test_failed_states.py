"""States that cannot be solved are left out and named, as long as enough remain; the file records them."""

import re

import numpy as np
import pytest

from fieldmap.cli.application import application
from fieldmap.errors import NotConverged, Problem
from fieldmap.iron import NonlinearSolver
from fieldmap.maps import generate, generation
from fieldmap.maps.training import condensation
from fieldmap.parallel import WorkerDied, workers
from fieldmap.store import checkpoint_path, read_info, read_map
from tests.maps.conftest import with_little_care


@pytest.fixture
def failing(monkeypatch):
    """failing(fails): from now on a solve fails if fails(its number) is an error. States are solved one at a time, so
    that they have numbers. Later stages are made with little care."""
    monkeypatch.setattr(workers, "threads_of_kernels", lambda: 1)
    monkeypatch.setattr(generation, "certified_bounds", lambda *_: {})
    with_little_care(monkeypatch)
    monkeypatch.setattr(condensation, "_STATES", 20)
    monkeypatch.setattr(condensation, "_TRIED", 10)
    solve = NonlinearSolver.solve_potential

    def make(error_of):
        solves = []

        def attempt(self, currents, tolerance=1e-3, start=None):
            solves.append(np.array(currents))
            error = error_of(len(solves))
            if error is not None:
                raise error
            return solve(self, currents, tolerance, start)

        monkeypatch.setattr(NonlinearSolver, "solve_potential", attempt)
        return solves

    return make


OURS = "a mistake of ours"
NOT_CONVERGED = NotConverged(Problem("iron solver", "the residual must fall", "1e-2", "refine"))


def test_some_are_left_out_and_named(few_states, few_states_map, failing, tmp_path, capsys):
    # The third state of the training fails, and the first at random, after ten states and the extremes.
    extremes = read_info(few_states_map.path).provenance.solver_report["extremes"]
    failing({3: NOT_CONVERGED, 10 + extremes["solved"] + 1: ZeroDivisionError(OURS)}.get)
    command = ["map", str(few_states), "-o", str(tmp_path / "map.h5"), "--accept-error"]
    assert application()(command, standalone_mode=False) is None
    report = read_info(tmp_path / "map.h5").provenance.solver_report
    first_at_random = str(10 + extremes["looked_at"])
    assert report["states_failed"] == {"2": str(NOT_CONVERGED), first_at_random: f"ZeroDivisionError: {OURS}"}
    assert report["states_trained_on_solved"] - report["corners_trained_on"] == 9
    assert report["states_tried"]["at random"]["states"] == 1
    printed = capsys.readouterr()
    assert printed.out.strip() == str(tmp_path / "map.h5")
    named = re.findall(r"^state (\d+) .*: (.*)$", printed.err, re.MULTILINE)
    assert [number for number, _ in named] == ["2", first_at_random]
    assert str(NOT_CONVERGED) in printed.err
    assert OURS in printed.err


def test_states_are_numbered_from_the_first_to_the_last(few_states_map):
    """The progress of each stage counts its states without a gap."""
    stages = {}
    for text in few_states_map.told:
        if found := re.match(r"state (\d+) of (?:at most )?(\d+)([^:;,(]*)", text):
            numbers = stages.setdefault((found[3].strip(), int(found[2])), [])
            numbers.append(int(found[1]))
    assert len(stages) > 2
    for (_, most), numbers in stages.items():
        assert numbers[0] == 1
        assert set(np.diff(numbers).tolist()) <= {0, 1}
        assert numbers[-1] <= most
    assert stages["", 10][-1] == 10


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (2, "at least half of the states must be solved; received 9 of 10 failed; the first: iron solver"),
        (25, "a state that the model is tried on must be solved"),
    ],
    ids=["too many", "none to try"],
)
def test_too_few_are_an_error_that_says_so(few_states, failing, tmp_path, first, words):
    failing(lambda number: NOT_CONVERGED if number >= first else None)
    target = tmp_path / "map.h5"
    if first > 10:
        # More than half of all states must be solved.
        few_states.write_text(few_states.read_text().replace("states = 10", "states = 24"))
    with pytest.raises(NotConverged, match=words):
        generate(few_states, target)
    assert not target.exists()


@pytest.mark.parametrize("error", [MemoryError(), WorkerDied(Problem("a", "b", "c", "d"))], ids=type)
def test_what_is_not_the_fault_of_a_state_stops_the_run_and_is_tried_again(
    few_states, failing, tmp_path, error
):
    solves = failing(lambda number: error if number == 4 else None)
    target = tmp_path / "map.h5"
    with pytest.raises(type(error)):
        generate(few_states, target)
    assert checkpoint_path(target).exists()
    generate(few_states, target, accept_error=True)
    assert read_info(target).provenance.solver_report["states_failed"] == {}
    np.testing.assert_array_equal(solves[3], solves[4])


def test_a_state_that_stops_the_run_leaves_those_before_it_and_the_same_map_comes_out(
    few_states, tmp_path, monkeypatch
):
    """Several states at a time: the failing state is known by its currents."""
    solve, solved = NonlinearSolver.solve_potential, []
    monkeypatch.setattr(NonlinearSolver, "solve_potential", counted(solve, solved))
    whole = generate(few_states, tmp_path / "whole.h5", accept_error=True)
    stopped = tmp_path / "stopped.h5"
    at = solved[4][1]

    def attempt(self, currents, tolerance=1e-3, start=None):
        if broken and np.allclose(currents, at):
            raise MemoryError
        return solve(self, currents, tolerance, start)

    monkeypatch.setattr(NonlinearSolver, "solve_potential", attempt)
    broken = True
    with pytest.raises(MemoryError):
        generate(few_states, stopped)
    broken = False
    solved = []
    monkeypatch.setattr(NonlinearSolver, "sensitivities", counted(NonlinearSolver.sensitivities, solved))
    generate(few_states, stopped, accept_error=True)
    assert 0 < len(solved) < read_info(stopped).provenance.solver_report["states_solved"]
    np.testing.assert_array_equal(read_map(stopped).flux_density, read_map(whole).flux_density)


def counted(function, calls):
    def call(*arguments, **named):
        calls.append(arguments)
        return function(*arguments, **named)

    return call
