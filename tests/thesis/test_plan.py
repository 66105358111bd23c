"""The announcement of a run, its order of work, and the growing page."""

import threading
import time
import tomllib
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.shipped import shipped_names
from fieldmap.thesis import PartResult, detail, kept, part_names, row_names
from fieldmap.thesis import report as writing
from fieldmap.thesis.computation import attempt_part, compute_part, expected_seconds
from fieldmap.thesis.detail import file_of, maps_in
from fieldmap.thesis.plan import COMPILATION, MAP_SECONDS, Plan, Stage, about, computed, moving, planned
from fieldmap.thesis.printed import PRINTED_NUMBERS, parts_of, read_part, shared_value
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
    """Often, never backwards, and never beyond the part."""
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
    """Total of the times in the row files, including the map."""
    with detail.at(detail.QUICK):
        total = sum(map(expected_seconds, part_names())) + MAP_SECONDS["division_quick"]
    assert total < 300.0
    assert all(compute_part("S6").comparisons)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (3.0, "10 s"),
        (14.0, "10 s"),
        (16.0, "20 s"),
        (54.0, "50 s"),
        (55.0, "1 min"),
        (100.0, "2 min"),
        (1851.0, "31 min"),
    ],
)
def test_times_to_one_or_two_digits(seconds, text):
    assert about(seconds) == text


def test_the_line_of_a_plan():
    """Parts and rows, maps to make and maps missing, and the total time: 200 s for a map, 60 s for an unknown map,
    240 s of compilation."""
    stages = (Stage({"S4_windings": 30.0, "S4_levitation": 40.0}), Stage(recipe="division", target=Path("a.h5")),
              Stage({"S12": 50.0}))  # fmt: skip
    plan = Plan(stages, 2, {Path("b.h5"): 3}, True)
    assert (plan.whole, plan.seconds) == (320.0, 560.0)
    assert plan.text == (
        "3 parts of 2 rows; 2 finished before; makes a.h5 first; 3 left out: they need b.h5 (--make-maps makes it); "
        "about 9 min on two processors, with the kernels to compile"
    )
    with detail.at(detail.QUICK):
        assert Plan((), 0, {}, False).text.startswith("0 parts of 0 rows, quick: coarse meshes; about 10 s")
    assert (Plan((), 0, {}, False).whole, Stage(recipe="other").seconds) == (1.0, 60.0)
    assert [MAP_SECONDS[name] for name in ("division", "division_quick")] == [200.0, 30.0]


def test_shares_of_the_work(monkeypatch):
    """In all 400 s: 30 and 70 of two parts, 200 of the map, then 100."""
    import fieldmap.maps

    told = []
    monkeypatch.setattr(fieldmap.maps, "generate", lambda recipe, target, progress: progress("half", 0.5))
    monkeypatch.setattr(
        "fieldmap.thesis.computation.expected_seconds", {"S3": 30.0, "S6": 70.0, "S12": 25.0}.get
    )
    stages = (
        Stage({"S3": 30.0, "S6": 70.0}),
        Stage(recipe="division", target=Path("a.h5")),
        Stage({"S12": 100.0}),
    )
    parts = list(computed(Plan(stages, 0, {}, False), lambda part: part, lambda *words: told.append(words)))
    assert parts == ["S3", "S6", "S12"]
    assert told == [("S3", 0.0), ("S6", 30 / 400), ("map division: half", 0.5), ("S12", 0.75)]


def test_a_part_that_takes_long_tells_how_long(monkeypatch):
    """After 20 s of 30 on a fake clock the part has 1 - exp(-2/3) of its share of the whole."""
    clock, told = [100.0], []
    monkeypatch.setattr("fieldmap.thesis.plan.time", SimpleNamespace(monotonic=lambda: clock[0]))
    waits = iter([(9.0, False), (10.5, False), (25.0, False), (25.0, True)])

    class Stopped:
        def wait(self, seconds):
            assert seconds == 1.0
            begun.wait(5.0)
            clock[0], over = next(waits)
            clock[0] += 100.0
            return over

        def set(self):
            pass

    begun = threading.Event()
    made = SimpleNamespace(Event=Stopped, Thread=threading.Thread)
    monkeypatch.setattr("fieldmap.thesis.plan.threading", made)
    with moving(lambda *words: told.append(words), {"A": 30.0, "B": 10.0}) as begins:
        begins("A", 0.0)
        begun.set()
    inside = [0.75 * (1 - np.exp(-took / 30)) for took in (10.5, 25.0)]
    assert [text for text, _ in told] == ["A", "A, 10.0 s of about 30.0 s", "A, 20.0 s of about 30.0 s"]
    assert [share for _, share in told] == pytest.approx([0.0, *inside])


@pytest.mark.parametrize("part", part_names())
def test_a_part_is_what_its_file_says(part):
    """The default times are 1 s, and 0.1 s in a quick run."""
    row, _, name = part.partition("_")
    content = tomllib.loads((PRINTED_NUMBERS / f"{row}.toml").read_text(encoding="utf-8"))
    (said,) = (one for one in content["part"] if one.get("name", "") == name)
    found = read_part(part)
    assert (found.title, found.ours, found.map) == (said["title"], said["ours"], said.get("map", ""))
    assert found.seconds == said.get("seconds", 1.0)
    assert found.quick_seconds == said.get("quick_seconds", said.get("seconds", 0.1))
    assert list(found.figures) == said.get("figures", [])
    for entry in said["printed"]:
        numbers = found.numbers[entry["name"]]
        shape = np.shape(entry["value"]) if "value" in entry else None
        if shape is not None:
            assert [n.text for n in numbers] == [
                str(v) for v in np.ravel(np.array(entry["value"], dtype=object))
            ]
            index = ["" if not shape else f"[{','.join(map(str, k))}]" for k in np.ndindex(shape)]
            assert [n.name for n in numbers] == [entry["name"] + k for k in index]
        for key in ("quantity", "unit", "kind"):
            assert {getattr(n, key) for n in numbers} == {entry[key]}
        wrong = {tuple(one.get("index", ())): one["why"] for one in entry.get("misprints", ())}
        told = [n.misprint for n in numbers if n.misprint]
        assert told == list(wrong.values())
        assert {n.half_unit for n in numbers} == {entry["half_unit"]} if "half_unit" in entry else True


@pytest.mark.parametrize(
    ("part", "name", "texts"),
    [
        ("S18_vertical", "overshoot", ["50"]),
        ("S16_map_plant", "product", ["-248.3"] * 5),
        ("S17_recovery", "x_second_order", ["8.764e-4", "-1.9878", "0.98782"]),
        ("S14_x_remanence", "width", None),
    ],
)
def test_what_is_taken_from_the_shared_numbers(part, name, texts):
    """An entry, rows of an entry, some entries; and back less outward of Table 6-4 for each coercive field."""
    found = [n.text for n in read_part(part).numbers[name]]
    back = ["-0.776", "-0.400", "0.01", "0.71", "1.619", "2.804", "4.250", "6.574", "9.329"]
    out = [str(x) for x in shared_value("table_6_4.outward_mm")]
    texts = texts or [str(Decimal(a) - Decimal(b)) for a, b in zip(back, out, strict=True)] * 2
    assert [Decimal(one) for one in found] == [Decimal(one) for one in texts]


def test_refinement_and_counts_of_a_quick_look():
    """Refinement times 0.4, at least 0.25, and never finer than normal; 0.4 of a count, at least three."""
    assert (detail.COARSE, detail.COARSEST) == (0.4, 0.25)
    assert [detail.refinement(1.3), detail.fewer(10)] == [1.3, 10]
    with detail.at(detail.QUICK):
        assert [detail.refinement(one) for one in (2.0, 1.0, 0.625, 0.5, 0.2)] == [0.8, 0.4, 0.25, 0.25, 0.2]
        assert detail.refinement(1.2345678) == 0.493827
        assert [detail.fewer(count) for count in (20, 10, 7, 3, 2)] == [8, 4, 3, 3, 2]


def test_processor_time_of_a_part(monkeypatch):
    """From 100 s to 103.5 s on a fake clock."""
    clock = iter([100.0, 103.5])
    monkeypatch.setattr("fieldmap.thesis.computation.time", SimpleNamespace(process_time=lambda: next(clock)))
    assert compute_part("S6").seconds == 3.5
