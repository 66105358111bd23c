"""The table of printed numbers: its files, what is compared, and what the command does with them."""

import json
from pathlib import Path

import pytest

from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.shipped import shipped_names
from fieldmap.thesis import PARTS, ROWS, Answers, Curves, Series, compare, row_names
from fieldmap.thesis.available_maps import MapMissing
from fieldmap.thesis.computation import attempt_part, compute_part
from fieldmap.thesis.printed import KINDS, PrintedPart, half_unit, read_part
from fieldmap.thesis.rows import function_of, row_of

SHARP = [
    part
    for part in PARTS
    if not read_part(part).map
    and any(n.kind == "sharp" for group in read_part(part).numbers.values() for n in group)
]


def test_files_and_functions_belong_together():
    assert sorted(PARTS) == shipped_names("thesis")


def test_every_part_belongs_to_a_system_of_the_thesis():
    assert {row_of(part) for part in PARTS} <= set(ROWS)


@pytest.mark.parametrize("part", PARTS)
def test_every_printed_number_has_its_place_and_kind(part):
    numbers = [number for group in read_part(part).numbers.values() for number in group]
    assert numbers
    assert all(n.place and n.quantity and n.unit and n.kind in KINDS for n in numbers)


@pytest.mark.parametrize("part", SHARP)
def test_sharp_numbers_agree_to_the_printed_digits(part):
    """And a number that is called a misprint is one; only sharp numbers are judged. No part of these needs a map."""
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
    assert half_unit(text) == half


def test_unknown_row():
    with pytest.raises(InputError, match="must be a row of"):
        compare(["S7", "S99"])


def test_rows_by_name_in_either_case():
    assert {c.id for c in compare(["s7"])} == {"S7"}


def test_json_has_the_fields_that_others_read(capsys):
    assert main(["thesis", "S7", "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    fields = {"id", "quantity", "unit", "thesis", "ours", "deviation", "kind", "assumptions"}
    assert numbers
    assert all(fields <= set(number) for number in numbers)
    assert {number["id"] for number in numbers} == {"S7"}


# Their own tests compute them (test_map_plants, test_force_rows, test_report): here ones stand for their numbers.
COSTLY = {"S4_levitation", "S5_current_ratio", "S10", "S16_map_plant", "S17_map_plant"}


def stand_in(printed):
    title = f"Figs {', '.join(printed.figures)}: nothing"
    return Answers(ones(printed), (Curves(title, "x (mm)", "y (T)", ()),) if printed.figures else ())


def test_table_names_every_row(capsys, monkeypatch, tmp_path):
    def function(part):
        return (lambda inputs: stand_in(read_part(part))) if part in COSTLY else function_of(part)

    assert COSTLY.isdisjoint(SHARP)
    monkeypatch.setattr("fieldmap.thesis.computation.function_of", function)
    monkeypatch.chdir(tmp_path)
    assert main(["thesis"]) == 0
    told = capsys.readouterr()
    printed = told.out
    without_map = {row_of(part) for part in PARTS if not read_part(part).map}
    assert all(f"\n{row} " in f"\n{printed}" for row in without_map)
    assert all(f"{part}: no map" in told.err for part in PARTS if read_part(part).map)
    assert {row_of(part) for part in PARTS} == set(row_names())
    assert "sharp numbers agree to the printed digits" in printed


def test_bad_row_on_the_command_line(capsys):
    assert main(["thesis", "S0"]) == 2
    assert "S0" in capsys.readouterr().err


@pytest.fixture
def replaced(monkeypatch):
    """Put another function, and another data file, in the place of S7's."""

    def replace(function, **data):
        printed = read_part("S7")
        changed = PrintedPart(**{**vars(printed), **data})
        monkeypatch.setattr("fieldmap.thesis.computation.function_of", lambda part: function)
        monkeypatch.setattr("fieldmap.thesis.computation.read_part", lambda part: changed)
        return printed

    return replace


def ones(printed):
    return {name: [1.0] * len(numbers) for name, numbers in printed.numbers.items()}


def test_answers_bring_figures_and_explanations(replaced):
    figure = Curves("title", "x (mm)", "y (T)", (Series("line", [0.0, 1.0], [2.0, 3.0]),))
    names = list(read_part("S7").numbers)
    printed = replaced(
        lambda inputs: Answers(
            ones(read_part("S7")), (figure,), {names[0]: "It is computed.", "": "All of it."}
        ),
        explanations={names[0]: "It is printed."},
    )
    result = compute_part("S7")
    assert len(result.comparisons) == sum(map(len, printed.numbers.values()))
    assert result.curves == (figure,)
    assert result.explanations == {names[0]: "It is printed. It is computed.", "": "All of it."}


def test_an_explanation_of_nothing_is_refused(replaced):
    replaced(lambda inputs: Answers(ones(read_part("S7")), explanations={"nothing": "text"}))
    with pytest.raises(LookupError, match="nothing"):
        compute_part("S7")


def test_a_missing_map_is_named_with_the_command_that_makes_it(replaced, tmp_path):
    replaced(lambda inputs: {}, map="quick")
    with pytest.raises(MapMissing, match="fieldmap map quick"):
        compare(["S7"], tmp_path)
    result = attempt_part("S7", tmp_path)
    assert (result.state, result.remedy) == ("no map", "fieldmap map quick")
    assert compare((), tmp_path) == []


def test_a_part_that_fails_says_why_and_takes_nothing_with_it(replaced, capsys):
    def failing(inputs):
        raise ZeroDivisionError("by nought")

    replaced(failing)
    assert attempt_part("S7").state == "failed"
    assert main(["thesis", "S7", "S3"]) == 1
    out, err = capsys.readouterr()
    assert "ZeroDivisionError: by nought" in err
    assert "0 of 0 sharp numbers" in out


@pytest.mark.parametrize(
    ("series", "message"),
    [(([0, 1], [0]), "must be"), (([[0.0]], [[0.0]]), "must be"), (([0], [0], "mine"), "kind")],
)
def test_a_series_that_cannot_be_drawn(series, message):
    with pytest.raises(ValueError, match=message):
        Series("line", *series)
