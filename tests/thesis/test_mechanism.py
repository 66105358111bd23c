"""The table of printed numbers: its files, what is compared, and what the command does with them."""

import json

import pytest

from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.shipped import shipped_names
from fieldmap.thesis import PARTS, compare, row_names
from fieldmap.thesis.printed import KINDS, half_unit, read_part

ALL = compare()


def test_files_and_functions_belong_together():
    assert sorted(PARTS) == shipped_names("thesis")


@pytest.mark.parametrize("part", PARTS)
def test_every_printed_number_has_its_place_and_kind(part):
    numbers = [number for group in read_part(part).numbers.values() for number in group]
    assert numbers
    assert all(n.place and n.quantity and n.unit and n.kind in KINDS for n in numbers)


@pytest.mark.parametrize("number", [c for c in ALL if c.kind == "sharp"], ids=lambda c: f"{c.id}-{c.name}")
def test_sharp_numbers_agree_to_the_printed_digits(number):
    """And a number that is called a misprint is one."""
    assert number.agrees == (not number.misprint), f"{number.thesis} printed, {number.ours} computed"


def test_only_sharp_numbers_are_judged():
    assert all(c.agrees is None for c in ALL if c.kind != "sharp")


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


def test_table_names_every_row(capsys):
    assert main(["thesis"]) == 0
    printed = capsys.readouterr().out
    assert all(f"\n{row} " in f"\n{printed}" for row in row_names())
    assert "sharp numbers agree to the printed digits" in printed


def test_bad_row_on_the_command_line(capsys):
    assert main(["thesis", "S0"]) == 2
    assert "S0" in capsys.readouterr().err
