"""Progress on stderr: lines without a terminal, a bar on a terminal; and the forecast of a run, on a fake clock."""

import re
import sys
from functools import partial
from io import StringIO
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from rich.console import Console

from fieldmap.progress import Forecast, Progress, memory, must_compile, peak_memory


@pytest.fixture(autouse=True)
def shown(monkeypatch):
    monkeypatch.setattr(Progress, "shown", True)


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now=100.0)
    made = SimpleNamespace(monotonic=lambda: clock.now, strftime=lambda form: "2026-11-28 21:58:26")
    monkeypatch.setattr("fieldmap.progress.time", made)
    return clock


def test_progress_without_a_terminal_is_a_line_with_its_time_now_and_then(capsys, clock):
    """Work of 35 s gives a line every ten seconds and a last one; each begins with date and time."""
    with Progress("solving") as progress:
        for step in range(36):
            progress(f"step {step}", step / 35)
            clock.now += 1.0
    err = capsys.readouterr().err
    lines = err.splitlines()
    assert [line.split(" (")[0] for line in lines] == [
        f"2026-11-28 21:58:26 solving: {share:3} % step {step}"
        for share, step in ((0, 0), (29, 10), (57, 20), (86, 30), (100, 35))
    ]
    assert "\x1b" not in err
    assert "\r" not in err


def test_the_log_of_a_night_has_a_line_for_each_hundredth_of_the_time(capsys, clock):
    with Progress("map") as progress:
        for step in range(36000):
            progress("working", step / 36000)
            clock.now += 1.0
    # From 1000 s on lines come at a factor of 1.01 in time: log(36) / log(1.01) lines after the first hundred.
    assert len(capsys.readouterr().err.splitlines()) == pytest.approx(100 + 360, abs=10)


def test_a_run_that_is_stopped_tells_how_far_it_was(capsys, clock):
    def stopped():
        with Progress("map") as progress:
            for step in range(8):
                clock.now += 1.0
                progress(f"step {step}", step / 10)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert " map:  70 % step 7 (8 s" in capsys.readouterr().err.splitlines()[-1]


def test_memory_of_this_process_and_its_peak_are_told(capsys, clock):
    """Against psutil, and after an array of 0.3 GB that is freed again."""
    have = psutil.Process().memory_info().rss / 1e9
    np.ones(40_000_000).sum()
    with Progress("map") as progress:
        progress("working", 0.5)
    (line,) = capsys.readouterr().err.splitlines()
    now, most = map(float, re.search(r"([\d.]+) GB, at most ([\d.]+) GB\)$", line).groups())
    assert now == pytest.approx(have, abs=0.15)
    assert most > have + 0.2


@pytest.mark.parametrize(("platform", "unit"), [("linux", 1024), ("darwin", 1)])
def test_peak_memory_is_in_bytes(monkeypatch, platform, unit):
    monkeypatch.setattr(sys, "platform", platform)
    asked = SimpleNamespace(
        RUSAGE_SELF="own", getrusage=lambda who: SimpleNamespace(ru_maxrss={"own": 5000}[who])
    )
    monkeypatch.setitem(sys.modules, "resource", asked)
    assert peak_memory() == 5000 * unit
    monkeypatch.setitem(sys.modules, "resource", None)
    assert peak_memory() is None
    monkeypatch.setitem(sys.modules, "psutil", None)
    assert memory() == ""


def test_solves_within_a_search_print_no_lines_of_their_own(capsys):
    with Progress("solving") as each:
        each("assembled", 1.0)
        with Progress("search") as search:
            for step in range(5):
                each("iteration", 0.5)
                each("solved", 1.0)
                search("searching", step / 4)
        each("solved", 1.0)
        each("again", 0.5)
    titles = [line.split()[2] for line in capsys.readouterr().err.splitlines()]
    assert titles == ["solving:", "search:", "search:", "solving:"]


def test_a_first_run_says_that_it_compiles(monkeypatch, capsys, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    package = tmp_path / "fieldmap"
    (package / "kernels" / "__pycache__").mkdir(parents=True)
    monkeypatch.setattr("fieldmap.progress.__file__", str(package / "progress.py"))
    assert must_compile()
    with Progress("map", compiles=True):
        pass
    assert "first run" in capsys.readouterr().err
    compiled = package / "kernels" / "coils" / "__pycache__"
    compiled.mkdir(parents=True)
    (compiled / "loop.f-1.py311.nbi").touch()
    assert not must_compile()


def left_told(clock, capsys, done, whole, every=0.5, **settings):
    """(time, seconds left as printed) of a run of `whole` seconds that has done the share done(t) at time t."""
    begin = clock.now
    with Progress("map", **({"timed": True} | settings)) as progress:
        for step in range(int(whole / every) + 1):
            clock.now = begin + step * every
            progress("working", done(step * every))
    lines = capsys.readouterr().err.splitlines()
    found = [re.search(r"\((\d+) s, about (\d+) s left", line) for line in lines]
    return [(int(one[1]), int(one[2])) for one in found if one]


def test_the_time_left_of_even_work_is_right(clock, capsys):
    told = left_told(clock, capsys, lambda t: t / 60, 60.0)
    assert [time for time, _ in told] == [10, 20, 30, 40, 50]
    assert all(abs(time + left - 60) <= 1 for time, left in told)


def test_time_in_which_nothing_could_be_done_is_no_work(clock, capsys):
    """20 s before the work is known, then 60 s of even work."""
    told = left_told(clock, capsys, lambda t: max(t - 20.0, 0.0) / 60, 80.0)
    assert len(told) == 5
    assert all(abs(time + left - 80) <= 1 for time, left in told)


def test_no_time_left_is_told_at_the_very_beginning_and_of_what_has_none(clock, capsys, monkeypatch):
    assert left_told(clock, capsys, lambda t: t / 1000, 49.0) == []
    assert left_told(clock, capsys, lambda t: t / 60, 60.0, timed=False) == []
    monkeypatch.setattr("fieldmap.progress.must_compile", lambda: True)
    assert left_told(clock, capsys, lambda t: t / 60, 60.0, compiles=True) == []


def test_a_bar_shows_the_same(monkeypatch, clock):
    """Stage, rate, share, time left and memory, in a terminal of 80 columns."""
    out = StringIO()
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    console = partial(Console, file=out, force_terminal=True, width=80)
    monkeypatch.setattr("rich.console.Console", lambda stderr: console())
    with Progress("map", timed=True) as progress:
        progress("state 1 of 40", 0.0)
        clock.now += 30.0
        progress("state 16 of 40, 1.9 s a state, 4 workers", 0.25)
        progress._bar.refresh()
    shown = out.getvalue()
    for words in ("map: state 16 of 40, 1.9 s a state, 4 workers", "25%", "about 90 s left", " GB, at most "):
        assert words in shown


class Run:
    """A run of known stages, with the output of its forecast: (time, share)."""

    def __init__(self, clock, work, workers=lambda: 1):
        self.clock, self.begin, self.told = clock, clock.now, []
        self.forecast = Forecast(
            lambda message, share: self.told.append((clock.now - self.begin, share)), work, workers
        )

    def stage(self, name, pieces, seconds):
        for k, each in enumerate(np.broadcast_to(seconds, pieces)):
            self.forecast.at(name, "", k, pieces)
            self.clock.now += each

    @property
    def shares(self):
        return np.array([*self.told, (self.clock.now - self.begin, 1.0)])


def test_work_that_is_as_expected_gives_the_share_of_the_time(clock):
    run = Run(clock, {"a": 40.0, "b": 10.0})
    run.stage("a", 8, 5.0)
    run.stage("b", 2, 5.0)
    assert run.shares[:, 1] == pytest.approx(run.shares[:, 0] / 50.0)


def test_a_machine_of_another_pace_is_known_after_one_piece(clock):
    """Three times as slow: in the stage itself, in a later one, and in one whose work changes on the way."""
    run = Run(clock, {"a": 40.0, "b": 10.0, "c": 1.0})
    run.stage("a", 8, 15.0)
    run.forecast.expect("c", 20.0)
    run.stage("b", 2, 15.0)
    run.stage("c", 4, 15.0)
    told = run.shares[run.shares[:, 0] > 0]
    before = told[:, 0] < 120.0
    assert told[before, 1] == pytest.approx(told[before, 0] / 153.0)
    assert told[~before, 1] == pytest.approx(told[~before, 0] / 210.0)


def test_a_pace_can_be_found_afresh(clock):
    """After `afresh` a stage that took ten times as long as expected does not affect later stages."""
    run = Run(clock, {"a": 10.0, "b": 50.0})
    run.stage("a", 2, 50.0)
    run.forecast.at("a", "", 2, 2)
    run.forecast.afresh(0.0)
    run.stage("b", 5, 10.0)
    late = run.shares[3:]
    assert late[:, 1] == pytest.approx(late[:, 0] / 150.0)


def test_a_first_piece_that_waits_counts_less_beside_what_is_assumed(clock):
    """With 10 s that count as expected, the pace after the first second of work is 2, not 11."""
    run = Run(clock, {"a": 1.0, "b": 100.0})
    run.stage("a", 1, 9.0)
    run.forecast.at("a", "", 1, 1)
    run.forecast.afresh(10.0)
    run.stage("b", 100, [11.0] + 99 * [1.0])
    assert run.told[3][1] == pytest.approx(20.0 / (20.0 + 99.0 * 21.0 / 11.0))
    assert run.told[52][1] == pytest.approx(69.0 / (69.0 + 50.0 * 70.0 / 60.0))


def test_what_a_stage_has_done_when_it_begins_says_nothing_of_the_pace(clock):
    """In a resumed run 60 of 80 pieces of one second are done at the start; the remaining 20 take two seconds each."""
    run = Run(clock, {"a": 10.0, "b": 80.0})
    run.stage("a", 10, 2.0)
    for done in range(60, 80):
        run.forecast.at("b", "", done, 80)
        clock.now += 2.0
    assert run.shares[11:, 1] == pytest.approx(run.shares[11:, 0] / 60.0)


def test_more_work_than_was_expected_is_told_as_soon_as_it_is_known(clock):
    run = Run(clock, {"a": 10.0, "b": 10.0})
    run.stage("a", 2, 5.0)
    run.forecast.expect("b", 200.0)
    run.stage("b", 40, 5.0)
    late = run.shares[2:]
    assert late[:, 1] == pytest.approx(late[:, 0] / 210.0)


def test_a_run_that_goes_back_tells_the_time_of_what_comes_again(clock):
    """Two stages, and both again: after the return the share is that of the whole run."""
    run = Run(clock, {"a": 40.0, "b": 10.0})
    for _ in range(2):
        run.stage("a", 8, 5.0)
        run.stage("b", 2, 5.0)
    before, after = run.shares[run.shares[:, 0] < 50.0], run.shares[run.shares[:, 0] >= 50.0]
    assert before[:, 1] == pytest.approx(before[:, 0] / 50.0)
    assert after[:, 1] == pytest.approx(after[:, 0] / 100.0)


def test_a_stage_that_comes_out_of_turn_is_not_done_twice(clock):
    """A later stage first, then an earlier one, which begins for the first time."""
    run = Run(clock, {"a": 40.0, "b": 10.0})
    run.stage("b", 2, 5.0)
    run.stage("a", 8, 5.0)
    assert run.shares[:, 1] == pytest.approx(run.shares[:, 0] / 50.0)


def test_a_stage_without_pieces_that_takes_longer_has_a_tenth_of_that_left(clock):
    """Expected are 10 s and 20 s; a remark also prints the time."""
    run = Run(clock, {"a": 10.0, "b": 20.0})
    for now, tell in ((0.0, "at"), (4.0, "at"), (40.0, "at"), (60.0, "note")):
        clock.now = run.begin + now
        getattr(run.forecast, tell)(*(("a", "text") if tell == "at" else ("text",)))
    shares = [0.0, 4.0 / 30.0, 40.0 / 64.0, 60.0 / 86.0]
    assert [share for _, share in run.told] == pytest.approx(shares)


def test_of_stages_of_which_nothing_is_expected_nothing_is_known(clock):
    run = Run(clock, {"a": 0.0, "b": 0.0})
    run.forecast.note("before the first")
    run.forecast.at("a", "")
    clock.now += 5.0
    run.forecast.at("a", "")
    run.forecast.expect("b", 5.0)
    run.forecast.at("a", "")
    assert [share for _, share in run.told] == [0.0, 0.0, 0.0, pytest.approx(5.0 / 10.5)]


def test_the_number_of_workers_is_told_where_there_is_more_than_one():
    counts, told = iter([1, 2, 40]), []
    forecast = Forecast(lambda message, share: told.append(message), {"maps": 3.0}, lambda: next(counts))
    for done in range(3):
        forecast.at("maps", "a map", done, 3)
    assert told == ["a map", "a map, 2 workers", "a map, 40 workers"]
