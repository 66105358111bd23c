"""What a run says before it begins, in what order it works, and that the page grows with it."""

import time
from pathlib import Path

import pytest

from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.shipped import shipped_names
from fieldmap.thesis import PartResult, detail, kept, part_names, row_names
from fieldmap.thesis import report as writing
from fieldmap.thesis.computation import attempt_part, compute_part, expected_seconds
from fieldmap.thesis.detail import file_of, maps_in
from fieldmap.thesis.plan import COMPILATION, MAP_SECONDS, moving, planned
from fieldmap.thesis.printed import parts_of, read_part
from fieldmap.thesis.report import prepare_folder, write_report

ROOT = Path(__file__).parents[2]


def test_every_part_is_asked_for_by_its_name():
    for part in set(part_names()) - set(row_names()):
        assert parts_of([part]) == parts_of([part.lower()]) == [part]
    assert parts_of(["S14_table_6_2", "S4"]) == ["S4_windings", "S4_levitation", "S14_table_6_2"]


def test_a_part_that_is_not_there_is_told_beside_those_of_its_row():
    with pytest.raises(InputError) as error:
        parts_of(["S4_nothing", "S99"])
    first, second = error.value.problems
    assert first.received == "S4_nothing"
    assert "S4_windings" in first.must_hold
    assert second.received == "S99"
    assert "S21" not in second.must_hold


def test_one_part_on_the_command_line(capsys):
    assert main(["thesis", "S4_windings", "--json"]) == 0
    assert '"S4"' in capsys.readouterr().out


def test_parts_without_a_map_come_first_then_the_map_then_the_others(tmp_path):
    parts = parts_of(["S12", "S3", "S14_fits", "S6"])
    plan = planned(parts, tmp_path, make_maps=True)
    assert [stage.recipe or tuple(stage.expected) for stage in plan.stages] == [
        ("S3", "S6"), "division", ("S12", "S14_fits"),
    ]  # fmt: skip
    assert plan.stages[1].target == tmp_path / "division.h5"
    assert plan.left_out == {}
    assert plan.seconds == sum(read_part(part).seconds for part in parts) + MAP_SECONDS["division"]
    assert planned(parts, tmp_path, True, compiles=True).seconds == plan.seconds + COMPILATION


def test_parts_that_lack_their_map_are_counted_and_take_no_time(tmp_path):
    plan = planned(parts_of(["S12", "S3", "S14_fits"]), tmp_path, make_maps=False)
    assert plan.left_out == {tmp_path / "division.h5": 2}
    assert plan.seconds < 2.0
    assert "--make-maps" in plan.text
    assert "\n" not in plan.text


def test_finished_parts_take_no_time(tmp_path):
    attempt = kept.cached_parts(tmp_path)
    attempt("S4_levitation")
    plan = planned(parts_of(["S4"]), tmp_path, False, report=tmp_path)
    assert plan.finished == 1
    assert plan.seconds < read_part("S4_levitation").seconds


def test_every_map_that_parts_need_has_a_quick_recipe_and_a_time():
    recipes = {read_part(part).map for part in part_names()} - {""}
    for recipe in recipes:
        assert {recipe, detail.QUICK.map_name(recipe)} <= set(shipped_names("maps")) & MAP_SECONDS.keys()


def test_the_line_comes_first(tmp_path, capsys):
    assert main(["thesis", "S3", "S12", "--report", str(tmp_path), "--maps", str(tmp_path)]) == 1
    first, *_ = capsys.readouterr().err.splitlines()
    assert str(tmp_path / "division.h5") in first
    assert "2 parts of 2 rows" in first


def test_maps_are_made_where_they_are_asked_for(tmp_path, monkeypatch):
    made = []

    def generate(recipe, target, progress):
        made.append((recipe, target))
        progress("solving", 0.5)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(b"")

    import fieldmap.maps

    monkeypatch.setattr(fieldmap.maps, "generate", generate)
    monkeypatch.setattr(kept, "attempt_part", lambda part, maps: PartResult(part, ""))
    folder = tmp_path / "maps"
    for option, recipe in (((), "division"), (("--quick",), "division_quick")):
        words = ["thesis", "S3", "S12", "--make-maps", "--report", str(tmp_path), "--maps", str(folder)]
        assert main([*words, *option]) == 0
        assert made.pop() == (recipe, folder / f"{recipe}.h5")
        assert made == []


def test_the_page_is_there_before_the_first_part_and_grows(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "OFTEN", 0.0)
    prepare_folder(tmp_path)
    seen = []

    def results():
        for part in ("S6", "S3", "S7"):
            text = (tmp_path / "report.md").read_text()
            seen.append(
                [
                    line.split("|")[1].strip()
                    for line in text.splitlines()
                    if line.endswith("|") and "waiting" in line
                ]
            )
            yield attempt_part(part)

    write_report(tmp_path, results(), lambda curves, path: path.write_bytes(b""), ("S6", "S3", "S7"))
    assert seen == [["S3", "S6", "S7"], ["S3", "S7"], ["S7"]]
    page = (tmp_path / "report.md").read_text()
    assert [line for line in page.splitlines() if line.startswith("## S")] == sorted(
        line for line in page.splitlines() if line.startswith("## S")
    )
    assert "waiting" not in page
    assert "http-equiv" not in (tmp_path / "index.html").read_text()


def test_progress_moves_while_a_part_is_at_work(monkeypatch):
    """Every moment or so, never backwards, and never beyond the part."""
    monkeypatch.setattr("fieldmap.thesis.plan.MOVED_EVERY", 0.1)
    monkeypatch.setattr("fieldmap.thesis.plan.TOLD_EVERY", 0.05)
    seen = []
    with moving(lambda message, share: seen.append(share), {"A": 0.6, "B": 0.2}) as begins:
        begins("A", 0.0)
        time.sleep(0.7)
    assert len(set(seen)) >= 3
    assert seen == sorted(seen)
    assert max(seen) < 0.75


def test_quick_results_are_said_and_kept_apart(tmp_path):
    attempt = kept.cached_parts(tmp_path)
    full = attempt("S3")
    with detail.at(detail.QUICK):
        assert not kept.is_finished(tmp_path, "S3")
        assert attempt("S3").option == " --quick"
        assert kept.is_finished(tmp_path, "S3")
        prepare_folder(tmp_path)
        write_report(tmp_path, [attempt("S3")], lambda curves, path: path.write_bytes(b""))
        assert "`fieldmap thesis S3 --quick`" in (tmp_path / "report.md").read_text()
        assert 'id="quick"' in (tmp_path / "index.html").read_text()
    assert kept.is_finished(tmp_path, "S3")
    assert full.option == ""
    assert attempt("S3").option == ""


def test_what_is_remembered_is_of_one_detail():
    calls = []

    @detail.cached
    def meshed(name):
        calls.append(name)
        return detail.refinement(1.0)

    assert [meshed("a"), meshed("a")] == [1.0, 1.0]
    with detail.at(detail.QUICK):
        assert [meshed("a"), meshed("a")] == [detail.COARSE] * 2
    assert meshed("a") == 1.0
    assert calls == ["a", "a"]


def test_maps_are_looked_for_in_the_folder_that_is_given(tmp_path):
    assert file_of("division") == Path("maps/out/division.h5")
    with maps_in(tmp_path), detail.at(detail.QUICK):
        assert file_of("division") == tmp_path / "division_quick.h5"
    assert attempt_part("S15", tmp_path).remedy == "fieldmap map division"


def test_quick_takes_less_than_five_minutes():
    """By the times that the row files state; the map included."""
    with detail.at(detail.QUICK):
        total = sum(map(expected_seconds, part_names())) + MAP_SECONDS["division_quick"]
    assert total < 300.0
    assert all(compute_part("S6").comparisons)
