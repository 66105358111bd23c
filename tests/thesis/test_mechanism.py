"""The table of printed numbers: its files, the comparison, and the command."""

import json
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fieldmap import thesis
from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.thesis import Answers, Curves, Ours, Series, compare, part_names, read_rows, row_names
from fieldmap.thesis import printed as table
from fieldmap.thesis.computation import attempt_part, compute_part, function_of
from fieldmap.thesis.detail import MapMissing
from fieldmap.thesis.printed import PRINTED_NUMBERS, PrintedPart, read_part, row_of, shared_value
from fieldmap.thesis.vertical_sensor import thesis_lift_current

PARTS = part_names()
SHARP = [
    part
    for part in PARTS
    if not read_part(part).map
    and any(n.kind == "sharp" for group in read_part(part).numbers.values() for n in group)
]


def test_rows_are_those_of_the_thesis():
    assert list(read_rows()) == [f"S{n}" for n in range(1, 22)]
    assert {name for name, row in read_rows().items() if not row.parts} == {"S1", "S2", "S21"}


@pytest.mark.parametrize("part", PARTS)
def test_every_part_names_the_function_that_computes_it(part):
    assert callable(function_of(part))


@pytest.mark.parametrize("part", PARTS)
def test_texts_of_a_part_speak_of_its_own_numbers(part):
    printed = read_part(part)
    assert {*printed.explanations, *printed.assumptions} <= {"", *printed.numbers}


def test_no_number_of_the_thesis_is_written_twice():
    """Lists of three or more numbers, and inputs of equal name and place, stand once, in numbers.toml."""
    found = Counter()
    for path in sorted(PRINTED_NUMBERS.glob("*.toml")):
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        found.update(spelled(content))
    assert [value for value, count in found.items() if count > 1] == []


def spelled(content):
    """Lists of three or more different numbers, and inputs with name, value and place, that a file contains itself."""
    if isinstance(content, dict):
        for name, entry in content.items():
            if (
                isinstance(entry, dict)
                and {"value", "place"} <= set(entry)
                and not isinstance(entry["value"], list)
            ):
                yield name, float(entry["value"]), entry["place"]
            yield from spelled(entry)
    elif isinstance(content, list):
        numbers = [float(v) for v in content if isinstance(v, float) or (isinstance(v, str) and is_number(v))]
        if len(set(numbers)) >= 3:
            yield tuple(numbers)
        for entry in content:
            yield from spelled(entry)


def is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def test_the_levitation_currents_are_those_of_the_printed_line():
    depths, currents = shared_value("eq_7_18.depths_mm"), shared_value("eq_7_18.current_A")
    line = [thesis_lift_current(depth) for depth in depths]
    assert currents == pytest.approx(line, abs=5.001e-4)


def test_every_shared_number_and_sentence_is_used():
    folder = PRINTED_NUMBERS
    rows = "".join(path.read_text(encoding="utf-8") for path in folder.glob("S*.toml"))
    numbers = tomllib.loads((folder / "numbers.toml").read_text(encoding="utf-8"))
    texts = tomllib.loads((folder / "texts.toml").read_text(encoding="utf-8"))
    modules = "".join(path.read_text(encoding="utf-8") for path in Path(thesis.__file__).parent.glob("*.py"))
    shared = [f'"{part}.{name}"' for part, entries in numbers.items() for name in entries if name != "place"]
    assert [name for name in shared if name not in rows + modules] == []
    assert [name for name in texts if f"{{{name}}}" not in rows] == []


@pytest.mark.parametrize("part", PARTS)
def test_every_printed_number_has_its_place_and_kind(part):
    numbers = [number for group in read_part(part).numbers.values() for number in group]
    assert numbers
    assert all(
        n.place and n.quantity and n.unit and n.kind in ("sharp", "model", "measured") for n in numbers
    )


@pytest.mark.parametrize("part", SHARP)
def test_sharp_numbers_agree_to_the_printed_digits(part):
    """Misprints disagree; only sharp numbers are judged. None of these parts needs a map."""
    numbers = compute_part(part, Path("no maps here")).comparisons
    wrong = [
        f"{n.name}: {n.thesis} printed, {n.ours} computed"
        for n in numbers
        if n.agrees != (not n.misprint if n.kind == "sharp" else None)
    ]
    assert not wrong


@pytest.mark.parametrize(
    ("text", "half"), [("0.00706", 5e-6), ("-0.03", 5e-3), ("1.942e-6", 5e-10), ("2306", 0.5), ("0", 0.5)]
)
def test_half_a_unit_of_the_last_digit(text, half):
    assert table.half_unit(text) == half


def test_unknown_row():
    with pytest.raises(InputError) as error:
        compare(["S7", "S99"])
    assert [problem.received for problem in error.value.problems] == ["S99"]


def test_rows_by_name_in_either_case():
    assert {c.id for c in compare(["s7"])} == {"S7"}


def test_json_has_the_fields_that_others_read(capsys):
    assert main(["thesis", "S7", "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    fields = {"id", "quantity", "unit", "thesis", "ours", "deviation", "kind", "assumptions"}
    assert numbers
    assert all(fields <= set(number) for number in numbers)
    assert {number["id"] for number in numbers} == {"S7"}


# Other tests compute the remaining parts without map; here all their numbers are 1.
COMPUTED = {"S16_closed_loop", "S20_closed_loop"}


def stand_in(printed):
    title = f"Figs {', '.join(printed.figures)}: nothing"
    return Answers(ones(printed), (Curves(title, "x (mm)", "y (T)", ()),) if printed.figures else ())


def test_table_names_every_row(capsys, monkeypatch, tmp_path):
    def function(part):
        costly = not read_part(part).map and part not in COMPUTED
        return (lambda inputs: stand_in(read_part(part))) if costly else function_of(part)

    monkeypatch.setattr("fieldmap.thesis.computation.function_of", function)
    # The unfilled texts: the facts of these parts are missing.
    monkeypatch.setattr("fieldmap.thesis.computation.filled", lambda text, values: text)
    monkeypatch.chdir(tmp_path)
    assert main(["thesis"]) == 0
    told = capsys.readouterr()
    printed = told.out
    without_map = {row_of(part) for part in PARTS if not read_part(part).map}
    assert all(f"\n{row} " in f"\n{printed}" for row in without_map)
    assert all(f"{part}: no map" in told.err for part in PARTS if read_part(part).map)
    assert {row_of(part) for part in PARTS} == set(row_names())


def test_bad_row_on_the_command_line(capsys):
    assert main(["thesis", "S0"]) == 2
    assert "S0" in capsys.readouterr().err


@pytest.fixture
def replaced(monkeypatch):
    """Replace S7's function and its data."""

    def replace(function, **data):
        printed = read_part("S7")
        changed = PrintedPart(**{**vars(printed), **data})
        monkeypatch.setattr("fieldmap.thesis.computation.function_of", lambda part: function)
        monkeypatch.setattr("fieldmap.thesis.computation.read_part", lambda part: changed)
        return printed

    return replace


def ones(printed):
    return {name: [1.0] * len(numbers) for name, numbers in printed.numbers.items()}


def test_explanations_and_assumptions_are_filled_with_inputs_and_facts(replaced):
    figure = Curves("title", "x (mm)", "y (T)", (Series("line", [0.0, 1.0], [2.0, 3.0]),))
    first, *others = names = list(read_part("S7").numbers)
    numbers = ones(read_part("S7"))
    numbers[first] = Ours(numbers[first], ("a solver's report",))
    replaced(
        lambda inputs: Answers(numbers, (figure,), {"share": 0.25}),
        explanations={first: "A share of {share:.0%} at {angle_deg:g} deg.", "": "All of it."},
        assumptions={"": ("for {angle_deg:g}",), first: ("{share:.2f}",)},
    )
    result = compute_part("S7")
    assert len(result.comparisons) == sum(map(len, read_part("S7").numbers.values()))
    assert result.curves == (figure,)
    assert result.explanations == {first: "A share of 25 % at 45 deg.", "": "All of it."}
    rests = {c.name.partition("[")[0]: c.assumptions for c in result.comparisons}
    assert rests == {first: ("a solver's report", "for 45", "0.25"), **dict.fromkeys(others, ("for 45",))}
    assert list(rests) == names


def test_a_text_that_names_what_is_not_known_is_refused(replaced):
    replaced(lambda inputs: Answers(ones(read_part("S7"))), explanations={"": "{nothing}"})
    with pytest.raises(KeyError, match="nothing"):
        compute_part("S7")


def test_a_shared_sentence_stands_where_it_is_named():
    text = table.filled("{lumped_constants}; {x:.1f}", {"x": [1.0, 2.0]})
    assert text.endswith("; 1.0, 2.0")
    assert "{" not in text


def test_a_missing_map_is_named_with_the_command_that_makes_it(replaced, tmp_path):
    replaced(lambda inputs: {}, map="quick")
    with pytest.raises(MapMissing) as missing:
        compare(["S7"], tmp_path)
    assert missing.value.command == "fieldmap map quick"
    result = attempt_part("S7", tmp_path)
    assert (result.state, result.remedy) == ("no map", "fieldmap map quick")
    assert compare((), tmp_path) == []


def test_a_part_that_fails_says_why_and_takes_nothing_with_it(replaced, capsys):
    def failing(inputs):
        raise ZeroDivisionError("by nought")

    replaced(failing)
    assert attempt_part("S7").state == "failed"
    assert main(["thesis", "S7", "S3"]) == 1
    assert "ZeroDivisionError" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("series", "message"),
    [(([0, 1], [0]), "must be"), (([[0.0]], [[0.0]]), "must be"), (([0], [0], "mine"), "kind")],
)
def test_a_series_that_cannot_be_drawn(series, message):
    with pytest.raises(ValueError, match=message):
        Series("line", *series)


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{a:.1f} and {b:g}", "0.5 and 1, 2"),
        ("{a:.0%}, {c:.1%}", "50 %, 50.0 %, 25.0 %"),
        ("{d} {e:.2g}", "words 3"),
        ("{c[1]:.2f}", "0.25"),
    ],
)
def test_how_values_stand_in_a_text(template, text):
    values = {"a": np.array(0.5), "b": (1.0, 2.0), "c": np.array([0.5, 0.25]), "d": "words", "e": 3.0}
    assert table.filled(template, values) == text


def test_files_that_decide_a_part():
    names = [path.name for path in table.data_files("S14_table_6_2")]
    assert names == ["S14.toml", "numbers.toml", "texts.toml"]
