"""Progress on stderr without a terminal: a few plain lines, those of the innermost work, and a word on compilation."""

import re
from types import SimpleNamespace

import pytest

from fieldmap.progress import Progress, must_compile


@pytest.fixture(autouse=True)
def shown(monkeypatch):
    monkeypatch.setattr(Progress, "shown", True)


def test_progress_without_a_terminal_is_a_few_plain_lines(capsys):
    with Progress("solving") as progress:
        for step in range(101):
            progress(f"step {step}", step / 100)
    lines = capsys.readouterr().err.splitlines()
    assert 3 <= len(lines) <= 6
    assert lines[0].startswith("solving:   0 % step 0")
    assert lines[-1].startswith("solving: 100 %")
    assert "\x1b" not in "".join(lines)


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
    titles = [line.split(":")[0] for line in capsys.readouterr().err.splitlines()]
    assert titles == ["solving", *["search"] * 5]


def test_solves_one_after_the_other_print_a_line_now_and_then(capsys, monkeypatch):
    """Ten of four seconds each: all of the first, then a line in ten seconds of the 36 that follow."""
    now = [100.0]
    monkeypatch.setattr("fieldmap.progress.time", SimpleNamespace(monotonic=lambda: now[0]))
    with Progress("solving") as progress:
        for _ in range(10):
            for quarter in range(5):
                progress("iteration", quarter / 4)
                now[0] += 0.8
    lines = capsys.readouterr().err.splitlines()
    assert [line.split("%")[0] for line in lines[:5]] == [f"solving: {25 * k:3} " for k in range(5)]
    assert len(lines) == 5 + 3


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


def left_told(monkeypatch, capsys, done, whole, every=0.5):
    """(time, seconds that were told to be left) of a run of `whole` seconds that has done done(t) of its work at t."""
    now = [100.0]
    monkeypatch.setattr("fieldmap.progress.time", SimpleNamespace(monotonic=lambda: now[0]))
    with Progress("map", timed=True) as progress:
        for step in range(int(whole / every) + 1):
            now[0] = 100.0 + step * every
            progress("working", done(step * every))
    lines = capsys.readouterr().err.splitlines()
    found = [re.search(r"\((\d+) s, about (\d+) s left\)", line) for line in lines]
    return [(int(one[1]), int(one[2])) for one in found if one]


def test_the_time_left_of_even_work_is_right(monkeypatch, capsys):
    told = left_told(monkeypatch, capsys, lambda t: t / 60, 60.0)
    assert len(told) >= 4
    assert all(abs(time + left - 60) <= 1 for time, left in told)


def test_no_time_left_is_told_where_it_is_not_known(monkeypatch, capsys):
    """Nine tenths at once and the rest in a minute; shares as the root of the time; a first run; steps of a solve."""
    assert left_told(monkeypatch, capsys, lambda t: min(0.9, t / 2) + max(t - 10, 0) / 600, 70.0) == []
    assert left_told(monkeypatch, capsys, lambda t: (t / 80) ** 0.5, 80.0) == []
    monkeypatch.setattr("fieldmap.progress.must_compile", lambda: True)
    for settings in ({"timed": True, "compiles": True}, {}):
        now = [100.0]
        monkeypatch.setattr("fieldmap.progress.time", SimpleNamespace(monotonic=lambda now=now: now[0]))
        with Progress("solving", **settings) as progress:
            for step in range(101):
                now[0] = 100.0 + step
                progress("step", step / 100)
        assert "left" not in capsys.readouterr().err
