"""The report of a few quick rows: its links, its numbers, and rows that fail or are interrupted."""

import csv
import hashlib
from dataclasses import replace
from datetime import date
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest

from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.shipped import shipped_folder
from fieldmap.store import Checkpoint
from fieldmap.thesis import Answers, Comparison, Curves, Series, attempt_rows, detail, kept, read_rows
from fieldmap.thesis import report as writing
from fieldmap.thesis.computation import PartResult, agreeing, attempt_part, compared, percent
from fieldmap.thesis.printed import PrintedNumber, PrintedPart
from fieldmap.thesis.report import COLUMNS, Row, minutes, prepare_folder, resting_on, write_report
from tests.computed_parts import computed

QUICK = ["S3", "S6", "S9_constants"]


class Page(HTMLParser):
    """Images, links, anchors and the cells of every table row; unclosed tags are remembered."""

    VOID = ("meta", "link", "img", "br")

    def __init__(self, text):
        super().__init__()
        self.images, self.links, self.anchors, self.rows, self.open = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(given["src"])
        if tag == "a":
            self.links.append(given["href"])
        if "id" in given:
            self.anchors.append(given["id"])
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "td" in self.open or "th" in self.open:
            self.rows[-1][-1] += f"{data} "


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("report")
    assert main(["thesis", *QUICK, "--report", str(target)]) == 0
    return target


@pytest.fixture(scope="module")
def page(folder):
    return Page((folder / "index.html").read_text())


@pytest.fixture(scope="module")
def numbers(folder):
    with (folder / "numbers.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_nothing_is_linked_that_is_not_there(folder, page):
    assert len(page.images) == len(set(page.images)) == 2  # of S9: 4-5 and 4-7
    assert all((folder / image).read_bytes()[:4] == b"\x89PNG" for image in page.images)
    for link in page.links:
        assert link[1:] in page.anchors if link.startswith("#") else (folder / link).is_file()
    assert page.open == []


def test_the_page_asks_nothing_of_the_network(folder):
    assert "://" not in (folder / "index.html").read_text()


def test_the_table_of_numbers_has_every_number(numbers):
    assert tuple(numbers[0]) == COLUMNS
    direct = [n for part in QUICK for n in computed(part).comparisons]
    assert [(n["row"], n["name"]) for n in numbers] == [(n.id, n.name) for n in direct]
    assert [float(n["ours"]) for n in numbers] == pytest.approx([n.ours for n in direct], rel=1e-9)
    assert all(n["place"] and n["unit"] and n["command"] == f"fieldmap thesis {n['row']}" for n in numbers)


def test_every_number_of_the_table_stands_on_the_page(folder, page, numbers):
    shown = [row for row in page.rows if len(row) == 7 and row[0].strip() != "number"]
    assert len(shown) == len(numbers)
    text = (folder / "report.md").read_text()
    for cells, number in zip(shown, numbers, strict=True):
        assert number["name"] in cells[0]
        for column, cell in (("thesis", cells[2]), ("ours", cells[3])):
            assert cell.strip() == f"{float(number[column]):.6g}"
            assert f"| {cell.strip()} |" in text


def test_the_summary_has_a_line_for_each_row(page):
    lines = [row for row in page.rows if len(row) == 8][1:]
    assert [line[0].strip() for line in lines] == ["S3", "S6", "S9"]
    assert [line[6].strip() for line in lines] == ["done"] * 3
    assert lines[0][3].strip() == "6 of 6"


def test_rows_without_numbers_are_listed(folder):
    text = (folder / "report.md").read_text()
    without = {name: row for name, row in read_rows().items() if not row.parts}
    assert without
    for name, row in without.items():
        assert f"- {name}: {row.system}" in text
        assert row.without_numbers in text


def test_explanations_misprints_and_assumptions_are_on_the_page(folder):
    text = (folder / "index.html").read_text()
    for part in ("S6", "S9_constants"):
        result = computed(part)
        for words in result.explanations.values():
            assert words[:40] in text.replace("&#39;", "'")
        for number in result.comparisons:
            assert number.misprint.replace("'", "&#39;") in text


def test_finished_rows_are_taken_from_where_they_are_kept(folder, monkeypatch):
    monkeypatch.setattr(kept, "attempt_part", lambda part, maps: pytest.fail(f"{part} was computed again"))
    # Figures are not drawn again, because other tests look at the first ones.
    monkeypatch.setattr("fieldmap.plot.figures.save_curves", lambda curves, path: drawn.append(path.name))
    drawn: list[str] = []
    before = (folder / "numbers.csv").read_text()
    assert main(["thesis", *QUICK, "--report", str(folder)]) == 0
    assert (folder / "numbers.csv").read_text() == before
    assert len(drawn) == 2


def test_cached_results_come_back_as_they_were(folder):
    attempt = kept.cached_parts(folder)
    fresh, again = computed("S9_constants"), attempt("S9_constants")
    assert again.comparisons == fresh.comparisons
    assert again.explanations == fresh.explanations
    assert [c.title for c in again.curves] == [c.title for c in fresh.curves]
    assert again.curves[1].series[2].y.tolist() == fresh.curves[1].series[2].y.tolist()


def test_a_cached_result_of_other_code_or_a_broken_file_is_not_taken(tmp_path, monkeypatch):
    computed = []

    def counting(part, maps):
        computed.append(part)
        return attempt_part(part, maps)

    monkeypatch.setattr(kept, "attempt_part", counting)
    attempt = kept.cached_parts(tmp_path)
    attempt("S3")
    attempt("S3")
    assert computed == ["S3"]
    path = kept.finished_parts(tmp_path).path
    path.write_bytes(path.read_bytes()[:-100])
    attempt("S3")
    assert computed == ["S3"] * 2
    monkeypatch.setattr(kept.provenance, "_code", lambda packages: "other code")
    attempt("S3")
    assert computed == ["S3"] * 3


def finished(folder):
    with Checkpoint(*vars(kept.finished_parts(folder)).values()) as checkpoint:
        return sorted(checkpoint)


def test_an_interrupted_report_goes_on(tmp_path, monkeypatch, capsys):
    def interrupted(part, maps):
        if part == "S7":
            raise KeyboardInterrupt
        return attempt_part(part, maps)

    monkeypatch.setattr(kept, "attempt_part", interrupted)
    assert main(["thesis", "S3", "S6", "S7", "--report", str(tmp_path)]) == 130
    assert capsys.readouterr().err
    page = Page((tmp_path / "index.html").read_text())
    assert "progress" in page.anchors
    states = {row[0].strip(): row[6].strip() for row in page.rows if len(row) == 8}
    assert states["S7"] == "waiting"
    assert finished(tmp_path) == ["S3", "S6"]
    computed = []

    def counting(part, maps):
        computed.append(part)
        return attempt_part(part, maps)

    monkeypatch.setattr(kept, "attempt_part", counting)
    assert main(["thesis", "S3", "S6", "S7", "--report", str(tmp_path)]) == 0
    assert computed == ["S7"]
    assert "progress" not in Page((tmp_path / "index.html").read_text()).anchors


def test_a_row_that_fails_and_one_without_its_map_are_listed(tmp_path):
    figure = Curves("t", "x (mm)", "y (T)", (Series("<line>", [0.0], [1.0]),))
    results = [
        attempt_part("S3"),
        PartResult("S6", "lumped", problem="ZeroDivisionError: by <nought>"),
        PartResult("S7", "sensors", problem="no map", remedy="fieldmap map division", map="division"),
        PartResult("S8_converter", "cards", curves=(figure,)),
    ]
    prepare_folder(tmp_path)
    drawn = []
    write_report(tmp_path, iter(results), lambda curves, path: drawn.append((curves, path.write_bytes(b""))))
    page = Page((tmp_path / "index.html").read_text())
    states = {row[0].strip(): row[6].strip() for row in page.rows if len(row) == 8}
    assert [states[row] for row in ("S3", "S6", "S7", "S8")] == ["done", "failed", "no map", "done"]
    assert "problems" in page.anchors
    assert "by &lt;nought&gt;" in (tmp_path / "index.html").read_text()
    assert "`fieldmap map division && fieldmap thesis S7`" in (tmp_path / "report.md").read_text()
    assert drawn[0][0] is figure
    assert page.images == ["plots/S8_converter_1.png"]


def test_exit_code_of_a_failing_row(tmp_path, monkeypatch, capsys):
    def failing(part, maps):
        if part == "S6":
            return PartResult(part, "lumped", problem="ZeroDivisionError: by nought")
        return attempt_part(part, maps)

    monkeypatch.setattr(kept, "attempt_part", failing)
    assert main(["thesis", "S3", "S6", "--report", str(tmp_path)]) == 1
    assert "S6: failed: ZeroDivisionError" in capsys.readouterr().err
    assert (tmp_path / "index.html").is_file()
    assert finished(tmp_path) == ["S3"]


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError) as error:
        prepare_folder(tmp_path / "file")
    assert error.value.problems[0].where == str(tmp_path / "file")
    assert main(["thesis", "S3", "--report", str(tmp_path / "file")]) == 2
    assert main(["thesis", "S0", "--report", str(tmp_path / "new")]) == 2
    assert not (tmp_path / "new").exists()


def test_the_fingerprint_covers_code_data_and_map(tmp_path, monkeypatch):
    mark = kept.fingerprint("S3")
    assert mark != kept.fingerprint("S6")
    monkeypatch.setattr(kept.provenance, "_code", lambda rooms: "other code")
    assert kept.fingerprint("S3") != mark


@pytest.mark.parametrize("file", ["geometry/drive_unit.toml", "maps/scenarios/vertical_step.toml"])
def test_the_fingerprint_covers_devices_and_scenarios(file, tmp_path, monkeypatch):
    """After a change of a gain in a scenario the old numbers must not be used."""
    for kind in ("geometry", "maps"):
        for path in shipped_folder(kind).rglob("*.toml"):
            copy = tmp_path / kind / path.relative_to(shipped_folder(kind))
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(kept, "shipped_folder", lambda kind: tmp_path / kind)
    marks = []
    for line in ("", "# a line more\n"):
        kept._shipped.cache_clear()
        with (tmp_path / file).open("a", encoding="utf-8") as changed:
            changed.write(line)
        marks.append(kept.fingerprint("S3"))
    kept._shipped.cache_clear()
    assert marks[0] != marks[1]


def test_progress_knows_how_much_is_done():
    seen = []
    parts = [
        result.part
        for result in attempt_rows(
            ["S3", "S4"], lambda *words: seen.append(words), lambda part: PartResult(part, "")
        )
    ]
    assert [part for part, _ in seen] == parts == ["S3", "S4_windings", "S4_levitation"]
    assert [round(share, 3) for _, share in seen] == [0.0, round(1 / 7, 3), round(2 / 7, 3)]


def test_what_is_far_from_the_thesis_is_explained_in_words():
    """For quick rows only; the report checks the whole table."""
    for part in ("S5_current_ratio", "S5_depth", "S6", "S9_constants", "S9_superposition", "S16_root_locus"):
        result = computed(part)
        for number in result.comparisons:
            far = number.deviation is not None and abs(number.deviation) > 0.1 and not number.misprint
            name = number.name.partition("[")[0]
            assert not far or {"", name} & set(result.explanations), f"{part}: {number.name}"


def number(name="a", thesis=1.0, ours=1.0, kind="measured", misprint="", assumptions=(), row="S7"):
    sharp = kind == "sharp"
    return Comparison(
        id=row, name=name, quantity=f"quantity of {name}", unit="A m2", thesis=thesis, ours=ours,
        deviation=ours / thesis - 1 if thesis else None, kind=kind, agrees=abs(ours - thesis) < 0.01 if sharp else None,
        misprint=misprint, place="here", title="title", assumptions=assumptions,
    )  # fmt: skip


def part(name="S7", numbers=(), **more):
    return PartResult(name, "a part", tuple(numbers), **more)


def test_what_a_row_says_of_its_parts():
    """Two of three sharp numbers agree, misprints apart; the largest deviation is of a number that does not agree."""
    numbers = [
        number("a", 1.0, 1.005, "sharp"), number("b", 2.0, 2.0, "sharp"), number("c", 1.0, 1.3, "sharp"),
        number("d", 1.0, 9.0, "sharp", "a slip"), number("e", 1.0, 0.2), number("f", 0.0, 5.0),
    ]  # fmt: skip
    row = Row(
        "S7",
        "system",
        ((part(numbers=numbers[:4], seconds=2.0), ()), (part(numbers=numbers[4:], seconds=0.5), ())),
    )
    assert [one.name for one in row.numbers] == list("abcdef")
    assert (row.sharp, row.largest.name, row.seconds) == ("2 of 3", "e", 2.5)
    assert (Row("S7", "", ()).sharp, Row("S7", "", ()).largest) == ("", None)
    assert agreeing(numbers) == (2, 3)


@pytest.mark.parametrize(
    ("parts", "waiting", "state"),
    [
        (["done", "done"], (), "done"),
        (["done", "no map"], (), "partly"),
        (["failed", "no map"], (), "failed"),
        (["no map", "no map"], (), "no map"),
        (["done"], ("a title",), "waiting"),
    ],
)
def test_state_of_a_row(parts, waiting, state):
    made = {
        "done": part(), "failed": part(problem="broken"), "no map": part(problem="no map", remedy="make it"),
    }  # fmt: skip
    assert [made[one].state for one in parts] == parts
    assert Row("S7", "", tuple((made[one], ()) for one in parts), waiting).state == state


def test_command_of_a_row():
    """The commands of its maps first, each once; then its own with the option of its parts."""
    parts = [
        part(map="division", option=" --quick"),
        part(map="a_map", option=" --quick"),
        part(map="division"),
    ]
    row = Row("S7", "", tuple((one, ()) for one in parts))
    assert row.command == "fieldmap map a_map && fieldmap map division && fieldmap thesis S7 --quick"
    assert Row("S7", "", ()).command == "fieldmap thesis S7"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.099, "under 0.1 s"), (0.1, "0.1 s"), (59.94, "59.9 s"), (60.0, "1 min 0 s"), (119.6, "2 min 0 s"),
        (3725.0, "62 min 5 s"),
    ],
)  # fmt: skip
def test_times_for_people(seconds, text):
    assert minutes(seconds) == text


def test_assumptions_and_what_rests_on_them():
    numbers = [number("a[0]", assumptions=("all", "some")), number("a[1]", assumptions=("all",)),
               number("b", assumptions=("all", "some")), number("c", assumptions=("all", "one"))]  # fmt: skip
    assert resting_on(numbers) == [("all", ""), ("some", "a, b"), ("one", "c")]


def test_counts_of_the_page_and_the_table(tmp_path):
    """Over all parts, in the order of the rows; the table has every field of a number."""
    first = number("a", 2.0, 3.0, "sharp", "", ("one", "two"), "S3")
    second = number("b", 1.0, 1.0, "sharp", row="S6")
    results = [
        part("S6", [second, number("c", 0.0, 5.0, row="S6")], seconds=70.0),
        part("S3", [first], seconds=5.0),
    ]
    prepare_folder(tmp_path)
    write_report(tmp_path, iter(results), lambda curves, path: None)
    text = (tmp_path / "report.md").read_text()
    assert f", {date.today().isoformat()}. 3 numbers in 2 rows; 1 of 2 sharp numbers agree" in text
    assert "; 1 min 15 s of processor time" in text
    rows = list(csv.DictReader((tmp_path / "numbers.csv").read_text().splitlines()))
    assert [one["row"] for one in rows] == ["S3", "S6", "S6"]
    assert rows[0] == {
        "row": "S3", "name": "a", "quantity": "quantity of a", "unit": "A m2", "thesis": "2.0", "ours": "3.0",
        "deviation": "0.5", "kind": "sharp", "agrees": "false", "misprint": "", "place": "here",
        "assumptions": "one; two", "command": "fieldmap thesis S3",
    }  # fmt: skip
    assert (rows[1]["agrees"], rows[2]["agrees"], rows[2]["deviation"]) == ("true", "", "")


def test_texts_are_written_anew_at_most_every_two_seconds(tmp_path, monkeypatch):
    """Before the first part, at most every 2 s during the run, and at the end."""
    written, now = [], iter([100.0, 101.9, 102.1, 102.1, 104.0, 104.3, 104.3])
    monkeypatch.setattr(
        writing, "_write", lambda folder, drawn, waiting: written.append((len(drawn), tuple(waiting)))
    )
    monkeypatch.setattr(writing, "time", SimpleNamespace(monotonic=lambda: next(now)))
    names = ("S3", "S6", "S7", "S8_converter", "S8_error_budget")
    results = [part(name) for name in names]
    assert write_report(tmp_path, iter(results), lambda curves, path: None, names) == results
    assert written == [(0, names), (2, names[2:]), (4, names[4:]), (5, ())]


@pytest.mark.parametrize(
    ("deviation", "text"),
    [
        (0.0, "+0 %"), (9e-4, "+0.09 %"), (1e-3, "+0.1 %"), (-0.256, "-25.6 %"), (9.99, "+999.0 %"), (10.0, "11 times"),
        (-11.0, "-10 times"), (None, ""),
    ],
)  # fmt: skip
def test_deviations_in_words(deviation, text):
    assert percent(deviation) == text
    about = {"thesis": 1.0, "ours": 2.0, "kind": "measured"}
    assert replace(number(**about), deviation=deviation).verdict == text
    assert number(kind="sharp").verdict == "agrees"


@pytest.mark.parametrize(
    ("ours", "agrees"), [(2.5, True), (2.5000004, True), (2.5000006, False), (1.5, True), (1.4999, False)]
)
def test_sharp_numbers_agree_to_half_a_unit(ours, agrees):
    printed = PrintedNumber("a", "q", "m", "2", "here", "sharp", 0.5)
    zero = PrintedNumber("b", "q", "m", "0.0", "here", "measured", 0.05)
    row = PrintedPart("title", {}, {"a": (printed,), "b": (zero,)})
    one, other = compared("S7", row, Answers({"a": ours, "b": [3.0]}))
    assert (one.agrees, one.thesis, one.deviation) == (agrees, 2.0, pytest.approx(ours / 2 - 1))
    assert (other.agrees, other.deviation, other.ours) == (None, None, 3.0)
    with pytest.raises(LookupError):
        list(compared("S7", row, Answers({"a": ours})))


def test_what_decides_a_part(tmp_path, monkeypatch):
    """The code of all packages except drawing and printing, the detail, and the map; "" without the map."""
    asked = []
    monkeypatch.setattr(
        kept.provenance,
        "fingerprint",
        lambda settings, code: asked.append((settings, code)) or str(len(asked)),
    )
    assert kept.fingerprint("S15", tmp_path) == ""
    (tmp_path / "division.h5").write_bytes(b"a map")
    assert kept.fingerprint("S15", tmp_path) == "1"
    kept.fingerprint("S3", tmp_path)
    with detail.at(detail.QUICK):
        kept.fingerprint("S3", tmp_path)
    (with_map, code), (without, _), (quick, _) = asked
    assert {"iron", "lookup", "thesis", "errors", "curves", "planar"} <= set(code)
    assert not {"plot", "cli", "shipped"} & set(code)
    digest = hashlib.sha256(b"a map").hexdigest()
    assert with_map[-1] == digest
    assert (without[-1], quick[-1]) == ("full", "quick")
    assert without[:-1] == quick[:-1]


def test_a_file_that_another_run_writes_is_waited_for(tmp_path, monkeypatch):
    """Reading and writing both wait for up to 60 s."""
    waits = []

    class Waiting(Checkpoint):
        def __init__(self, path, fingerprint, wait):
            waits.append(wait)
            super().__init__(path, fingerprint)

    monkeypatch.setattr(kept, "Checkpoint", Waiting)
    of = kept.Kept(tmp_path / "runs", "mark")
    of.put("key", about={"a": 1})
    assert of.get("key").about == {"a": 1}
    assert waits == [60.0, 60.0]
    assert not kept.is_finished(tmp_path, "S3")
