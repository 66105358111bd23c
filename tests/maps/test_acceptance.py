"""A map that misses the accuracy of its recipe is written only if accepted, and each use of it says so."""

import io
import json
import re
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import fieldmap as fm
from fieldmap.cli import main
from fieldmap.errors import MapAccuracyWarning, MapErrorTooLarge
from fieldmap.io.map_summary import summarise_map
from fieldmap.iron import NonlinearSolver
from fieldmap.maps import generation
from fieldmap.maps.acceptance import require_accuracy, shortfall
from fieldmap.maps.training import condensation, sampling, sequence, training
from fieldmap.maps.training.currents import is_among
from fieldmap.maps.training.plan import Plan
from fieldmap.store import MissedAccuracy, check_map, checkpoint_path, missed_accuracy, read_map, write_map
from tests.maps.conftest import with_little_care, write_few_states

ASKED = 1e-9
PLAN = Plan(states=40, accuracy=1e-3, modes=30, points=200, fields=10, held_out=12, tolerance=1e-3)


def ran(*words):
    """Exit code, stdout and stderr of a command."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main([str(word) for word in words])
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The same command without --accept-error, with it, without it and with it; and the files after each run."""
    folder = tmp_path_factory.mktemp("accepted")
    recipe, target = write_few_states(folder), folder / "map.h5"
    solves, solve = [], NonlinearSolver.solve_potential

    def counted(*arguments, **named):
        solves.append(arguments)
        return solve(*arguments, **named)

    def run(*words):
        solves.clear()
        done = ran("map", recipe, "-o", target, "--json", *words)
        done.solves, done.error = len(solves), json.loads(done.out) if done.code else None
        done.bytes = target.read_bytes() if target.exists() else None
        done.kept = checkpoint_path(target).exists()
        return done

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NonlinearSolver, "solve_potential", counted)
        with_little_care(patch)
        patch.setattr(generation, "certified_bounds", lambda *_: {})
        made = [run(), run("--accept-error"), run(), run("--accept-error")]
    return SimpleNamespace(recipe=recipe, target=target, made=made)


@pytest.fixture(scope="module")
def data(runs):
    return read_map(runs.target)


def largest(report):
    tried = report["states_tried"].values()
    return [max(found[name] for found in tried) for name in ("flux_density_share", "gradient_share")]


def test_it_is_not_written_and_what_was_solved_is_kept(runs, data):
    first = runs.made[0]
    assert (first.code, first.bytes, first.kept) == (1, None, True)
    assert first.solves > 10
    error = first.error
    assert (error["error"], error["exit_code"]) == ("MapErrorTooLarge", 1)
    # All parts are used up here; the training decides which part leaves most.
    assert error["part"] in ("states", "modes", "points", "fields")
    (problem,) = error["problems"]
    line = runs.recipe.read_text().splitlines().index("accuracy = 1e-9") + 1
    assert problem["where"] == f"{runs.recipe}:{line}: currents.accuracy"
    # The remedy names the limit to raise and the option that writes the map as it is.
    assert re.search(rf"currents\.{error['part']} from \d+ to \d+", problem["remedy"])
    assert "--accept-error" in problem["remedy"]
    reached, report = error["reached"], data.provenance.solver_report
    assert [reached["flux_density_share"], reached["gradient_share"]] == largest(report)
    assert reached["asked"] == pytest.approx(ASKED)
    assert reached["states"] == sum(found["states"] for found in report["states_tried"].values())


def test_accepted_it_is_written_without_solving_again(runs, data):
    second = runs.made[1]
    assert (second.code, second.solves, second.kept) == (0, 0, False)
    report = data.provenance.solver_report
    flux, gradient = largest(report)
    assert flux > 2 * ASKED
    assert report["accepted_error"] == {
        "flux_density_share": flux,
        "gradient_share": gradient,
        "asked": pytest.approx(ASKED),
    }
    assert 5e7 < report["generation_peak_memory_bytes"] < 1e11
    assert missed_accuracy(report).text in data.provenance.assumptions[-1]
    assert data.provenance.assumptions[-1] in json.loads(second.out)["assumptions"]
    # One line, although the summary opens it too.
    lines = [line for line in second.err.splitlines() if line.startswith("warning: ")]
    assert len(lines) == 1


def test_without_the_option_it_goes_on_to_fail_and_the_map_stays(runs):
    _, second, third, last = runs.made
    assert (third.code, third.solves, third.kept) == (1, 0, False)
    assert third.error["reached"] == runs.made[0].error["reached"]
    assert (last.code, last.solves) == (0, 0)
    assert second.bytes == third.bytes == last.bytes


@pytest.mark.parametrize(
    "words",
    [
        ("info", "MAP"),
        ("check", "MAP"),
        ("probe", "MAP", "--at-mm", "0 0 -11", "--currents", "1"),
        ("currents", "MAP", "--at-mm", "0 0 -11", "--field", "nan nan 1e-3", "--limit", "2"),
        ("export", "MAP", "--to", "csv", "--currents", "1", "-o", "CSV"),
        ("export", "MAP", "--to", "csv", "--currents", "1", "-o", "CSV", "--log", "LOG"),
    ],
    ids=lambda words: " ".join((words[0], *words[-2:-1])),
)
def test_every_command_that_opens_it_says_so_in_one_line(runs, tmp_path, words):
    named = {"MAP": runs.target, "CSV": tmp_path / "map.csv", "LOG": tmp_path / "run.log"}
    # As with -W error: a map's warning does not end a command.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = ran(*(named.get(word, word) for word in words))
    assert done.code == 0, done.err
    told = [line for line in done.err.splitlines() if line.startswith("warning: ")]
    assert len(told) == 1
    assert str(runs.target) in told[0] or runs.target.name in told[0]
    if "LOG" in words:
        assert told[0].removeprefix("warning: ") in named["LOG"].read_text()


def test_check_does_not_call_it_free_of_problems(runs, data):
    assert "no problem found" not in ran("check", runs.target).out
    checked = check_map(runs.target)
    assert checked.missed_accuracy == missed_accuracy(data.provenance.solver_report)
    assert checked.notes[-1] == checked.missed_accuracy.text
    assert json.loads(ran("check", runs.target, "--json").out)["missed_accuracy"]["states"] > 0


def test_opening_it_warns_each_time(runs):
    """In a process of its own, with Python's own warning rules."""
    code = "import sys, fieldmap as fm\nfor _ in range(3): fm.open_map(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", code, runs.target], capture_output=True, text=True, check=True
    )
    assert done.stderr.count("MapAccuracyWarning") == 3
    with pytest.warns(MapAccuracyWarning) as caught:
        fm.open_map(runs.target)
    # The warning is at the line that opens the map.
    assert caught[0].filename == __file__


def rewritten(data, path, **changes):
    """The map with other entries in its report; None takes one out."""
    report = {**data.provenance.solver_report, **changes}
    report = {name: value for name, value in report.items() if value is not None}
    return write_map(path, replace(data, provenance=replace(data.provenance, solver_report=report)))


def test_maps_of_earlier_versions_warn_and_say_that_extremes_were_not_searched(data, tmp_path):
    old = rewritten(data, tmp_path / "old.h5", accepted_error=None, extremes=None)
    with pytest.warns(MapAccuracyWarning, match=r"old\.h5"):
        summary = summarise_map(old)
    assert (summary.missed_accuracy.flux_density_share, summary.missed_accuracy.gradient_share) == tuple(
        largest(data.provenance.solver_report)
    )
    # A report without these entries is older: no missed accuracy is known.
    older = rewritten(data, tmp_path / "older.h5", held_out_within=None, extremes=None)
    fm.open_map(older)
    for path in (old, older):
        assert "extremes of the currents were not searched" in " ".join(ran("info", path).out.split())
    extremes = {
        "corners": 4,
        "looked_at": 77,
        "different": 33,
        "solved": 21,
        "trained_on": 5,
        "searched": 4321,
        "by_residual": True,
    }
    new = rewritten(data, tmp_path / "new.h5", extremes=extremes)
    text = " ".join(ran("info", new).out.split())
    assert "not searched" not in text
    assert "77, 33 without mirror images, 21 solved" in text
    assert "among 4321 further currents" in text


def test_a_map_within_its_accuracy_is_written_and_opened_without_a_word(data, tmp_path):
    flux, gradient = largest(data.provenance.solver_report)
    within = rewritten(data, tmp_path / "good.h5", held_out_within=1.001 * max(flux, gradient / 2))
    fm.open_map(within)
    done = ran("check", within)
    assert (done.code, done.err) == (0, "")
    assert "no problem found" in done.out
    assert check_map(within).missed_accuracy is None
    fm.open_map("sample")


def test_what_is_asked_of_the_accuracy():
    """B within twice the requested accuracy, the gradient within four times, at states of every kind."""

    def report(*errors, **more):
        names = ("flux_density_share", "gradient_share", "states")
        kinds = ("at random", "at extremes", "searched for")
        tried = {kind: dict(zip(names, one, strict=True)) for kind, one in zip(kinds, errors, strict=False)}
        return {"held_out_within": 2e-3, "states_tried": tried, **more}

    assert missed_accuracy(report((2e-3, 4e-3, 12))) is None
    found = missed_accuracy(report((1e-3, 1e-3, 12), (2.1e-3, 1e-3, 20), (1e-3, 3e-3, 4)))
    assert found == MissedAccuracy(2.1e-3, 3e-3, 1e-3, 36)
    assert missed_accuracy(report((1e-3, 4.1e-3, 12))) == MissedAccuracy(1e-3, 4.1e-3, 1e-3, 12)
    assert missed_accuracy({"states_tried": report((1.0, 1.0, 3))["states_tried"]}) is None
    assert missed_accuracy({"held_out_within": 2e-3, "states_tried": {}}) is None
    assert missed_accuracy({}) is None
    # A file may contain anything.
    for tried in (
        [],
        "none",
        {"at random": 3},
        {"at random": {}},
        {"at random": {"flux_density_share": "big"}},
    ):
        assert missed_accuracy({"held_out_within": 2e-3, "states_tried": tried}) is None


def rounds(*shares):
    """Errors after 3, 7, 11, ... states."""
    errors = ({"flux_density_share": share, "gradient_share": share} for share in shares)
    return [{"solved": 3 + 4 * k, "errors": one} for k, one in enumerate(errors)]


def parts(states, points, condensation, limits, in_vain=False):
    """A training's report of the parts of its error, with these limits reached."""
    return {
        "states": states,
        "points": points,
        "condensation": condensation,
        "taken": {"states": 41, "modes": 201, "points": 431, "fields": 101},
        "limits": limits,
        "modes_leave": 0.0123,
        "in_vain": in_vain,
    }


@pytest.mark.parametrize(
    ("found", "part", "states"),
    [
        (parts(0.1, 0.002, 0.001, ["states"]), "states", 80),
        (parts(0.1, 0.002, 0.001, ["states", "modes"]), "states", 80),
        (parts(0.1, 0.002, 0.001, ["modes", "points"]), "modes", None),
        (parts(0.1, 0.002, 0.001, ["points"]), "states", None),
        (parts(0.001, 0.2, 0.001, ["states", "points"]), "points", None),
        (parts(0.001, 0.2, 0.001, []), "points", None),
        (parts(0.001, 0.002, 0.01, ["points"]), "condensation", None),
        (parts(0.001, 0.2, 0.001, ["states", "modes"], in_vain=True), "modes", None),
    ],
)
def test_what_falls_short_is_the_largest_part_and_only_states_can_be_raised(found, part, states):
    short = shortfall({"error_parts": found}, PLAN)
    assert (short.part, short.states, short.seconds) == (part, states, None)
    for key, taken in found["taken"].items():
        assert (f"{taken} {key}" in short.text) == (key in found["limits"])
    assert ("1.2 %" in short.text) == (part == "modes")


@pytest.mark.parametrize(("reached", "part"), [(0.02, "fields"), (0.006, "states")])
def test_what_no_other_part_accounts_for_is_left_to_the_fields(reached, part):
    tried = {"at random": {"flux_density_share": 0.001, "gradient_share": 2.0 * reached, "states": 3}}
    shares = parts(0.003, 0.001, 0.0, ["fields"])
    found = shortfall({"held_out_within": 2e-3, "states_tried": tried, "error_parts": shares}, PLAN)
    assert (found.part, found.states) == (part, None)


def test_without_parts_no_part_is_known():
    assert (shortfall({}, PLAN).part, shortfall({}, PLAN).states) == ("", None)


def test_where_modes_cannot_hold_the_states_points_are_not_tried_in_vain(tmp_path, monkeypatch):
    """Six modes for ten states and their tangents, which two hundred modes would hold."""
    for module in (sequence, training):
        monkeypatch.setattr(module, "most_modes_of", lambda domain: 6)
    monkeypatch.setattr(condensation, "_STATES", 60)
    chosen = []

    def counted(*arguments):
        chosen.append(arguments[-1])
        return sampling.sampled(*arguments)

    monkeypatch.setattr(sequence, "sampled", counted)
    recipe = write_few_states(tmp_path)
    recipe.write_text(recipe.read_text().replace("modes = 12", "modes = 6").replace("1e-9", "1e-5"))
    with pytest.raises(MapErrorTooLarge) as raised:
        fm.generate(recipe, tmp_path / "map.h5")
    assert raised.value.part == "modes"
    assert max(chosen) < sampling.ROUNDS
    assert not (tmp_path / "map.h5").exists()


def test_what_the_search_of_the_condensed_model_finds_is_trained_on_and_counted(tmp_path, monkeypatch):
    """One state of the first search is made to fall short; of the last search the modes are made to leave a quarter."""
    monkeypatch.setattr(condensation, "_STATES", 60)
    condense, measure = training._condensed_and_tried, training._error_parts
    searches, trained_on, measured = [], [], []

    def condensed(*about):
        found = condense(*about)
        searches.append(found.tried["searched for"].currents)
        return found

    def fall_short(training, reduction, tried):
        if searches and not trained_on:
            trained_on.append((tried[0].currents[0], tried[0].state(0)))
            return trained_on
        return []

    def of_modes(self, modes, tried, number):
        return 0.25 if is_among(tried.currents[0], searches[-1]).any() else 0.0

    def error_parts(trained, *about):
        measured.append((trained.known, measure(trained, *about)))
        return measured[0][1]

    monkeypatch.setattr(training, "_condensed_and_tried", condensed)
    monkeypatch.setattr(training, "_fall_short", fall_short)
    monkeypatch.setattr(sequence.Training, "off_of_modes", of_modes)
    monkeypatch.setattr(training, "_error_parts", error_parts)
    recipe = write_few_states(tmp_path)
    recipe.write_text(recipe.read_text().replace("1e-9", "3e-2"))
    fm.generate(recipe, tmp_path / "map.h5")
    assert len(searches) == 2
    (currents, _), (snapshots, parts_of_it) = trained_on[0], measured[0]
    assert snapshots.own[snapshots.number(currents)]
    assert not is_among(currents, searches[1]).any()
    assert parts_of_it["states"] == 0.25


def test_the_states_that_are_needed_follow_from_the_rounds_and_cost_what_states_cost():
    used = {"error_parts": parts(0.1, 0.0, 0.0, ["states"])}
    # An error of 0.1 after 3 states falls to a tenth for every 16 states more: to 1e-3 after 35.
    few = Plan(**{**vars(PLAN), "states": 15})
    about = used | {"rounds": rounds(*(0.1 * 10 ** (-k / 4) for k in range(3)))}
    found = shortfall(about | {"states_solved": 50, "generation_seconds": 100.0}, few)
    assert found.states == 35
    assert found.seconds == pytest.approx(100.0 * (50 + 20) / 50)
    # Rounds without progress, and rounds that were good while other states were not: twice as many states.
    for shares in ((0.1, 0.1, 0.2), (0.1, 1e-4), (0.1,)):
        assert shortfall(used | {"rounds": rounds(*shares)}, few).states == 30
    # A recipe allows no more than 4096.
    most = Plan(**{**vars(PLAN), "states": 4096})
    assert shortfall(used, most).states is None


def missed(flux, gradient, **more):
    """A report of these largest shares at 3 and 4 states, with 20 of 40 states used up, 100 s for 50 solves."""
    tried = {"at random": (flux, 1e-4, 3), "at extremes": (1e-4, gradient, 4)}
    names = ("flux_density_share", "gradient_share", "states")
    return {
        "held_out_within": 2e-3,
        "states_tried": {kind: dict(zip(names, one, strict=True)) for kind, one in tried.items()},
        "error_parts": parts(0.1, 0.002, 0.001, ["states"]),
        **more,
    }


def test_the_refusal_of_a_map_states_its_errors_and_what_would_do():
    with pytest.raises(MapErrorTooLarge) as caught:
        require_accuracy(missed(0.0123, 0.034), PLAN, Path("there.h5"), False)
    (problem,) = caught.value.problems
    assert "0.2 % of B and 0.4 % of the gradient" in problem.must_hold
    assert problem.received == (
        "1.2 % of B and 3.4 % of the gradient at 7 states, against the solver on the same mesh; the states fall short, "
        "states and modes leave 10 %, sample points change 0.2 %, fewer modes and points change 0.1 %, "
        "used up: all 41 states"
    )
    assert "raise currents.states from 40 to 80 (all states are solved anew), or" in problem.remedy
    assert "there.h5 is not written" in problem.remedy
    assert (caught.value.part, caught.value.reached.states) == ("states", 7)
    # A map passes if it is accepted, made without a plan, or within the requested accuracy.
    assert require_accuracy(missed(0.0123, 0.034), PLAN, Path("there.h5"), True) == caught.value.reached
    assert require_accuracy(missed(0.0123, 0.034), None, Path("there.h5"), False) == caught.value.reached
    assert require_accuracy(missed(0.002, 0.004), PLAN, Path("there.h5"), False) is None
    with pytest.raises(MapErrorTooLarge, match=r"there\.h5 is there, its error accepted"):
        require_accuracy(missed(0.1, 0.1, accepted_error={}), PLAN, Path("there.h5"), False)


@pytest.mark.parametrize(
    ("spent", "words"),
    # 40 states more than the 50 solved take 1.8 times as long.
    [
        (49.7, "about 89 s,"),
        (50.0, "about 2 minutes,"),
        (1500.0, "about 45 minutes,"),
        (2999.9, "about 90 minutes,"),
        (3000.0, "about 1.5 hours,"),
        (6000.0, "about 3.0 hours,"),
    ],
)
def test_what_more_states_cost_is_told_in_a_rough_unit(spent, words):
    about = missed(0.1, 0.1, states_solved=50, generation_seconds=spent)
    with pytest.raises(MapErrorTooLarge) as caught:
        require_accuracy(about, PLAN, Path("there.h5"), False)
    assert words in caught.value.problems[0].remedy


@pytest.mark.parametrize(
    ("flux", "gradient", "words"),
    [
        # Half of the largest error, rounded up to two digits; the gradient's error counts half.
        (0.01234, 0.001, "accuracy = 0.0062,"),
        (0.0124, 0.0248, "accuracy = 0.0062,"),
        (0.001, 0.4961, "accuracy = 0.13,"),
        (1.98, 0.1, "accuracy = 0.99,"),
        (1.999, 0.1, "make the range"),
        (float("inf"), 0.1, "make the range"),
    ],
)
def test_where_states_do_not_help_the_accuracy_that_was_reached_is_offered(flux, gradient, words):
    about = missed(flux, gradient, error_parts=parts(0.001, 0.2, 0.001, ["points"]))
    with pytest.raises(MapErrorTooLarge) as caught:
        require_accuracy(about, PLAN, Path("there.h5"), False)
    assert caught.value.problems[0].remedy.startswith(("ask for less, " if "acc" in words else "") + words)
