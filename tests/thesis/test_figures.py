"""The list of the thesis's figures, its page, and checks that both agree with the figures that the rows draw."""

from pathlib import Path

import pytest

from fieldmap.curves import Curves
from fieldmap.thesis.computation import Answers, compute_part
from fieldmap.thesis.printed import PrintedPart, figure_numbers, part_names, read_part, thesis_figures
from fieldmap.thesis.report import figure_page

PAGE = Path(__file__).parents[2] / "docs" / "thesis_figures.md"


def test_every_figure_is_drawn_or_said_why_not():
    assert {number for part in part_names() for number in read_part(part).figures} <= thesis_figures().keys()
    assert all(bool(figure.drawn_by) != bool(figure.not_drawn) for figure in thesis_figures().values())


def test_the_list_has_no_gaps():
    last = {"2": 15, "3": 10, "4": 16, "5": 22, "6": 27, "7": 38}
    assert list(thesis_figures()) == [f"{c}-{n}" for c, end in last.items() for n in range(1, end + 1)]


def test_the_page_is_what_the_rows_say():
    assert PAGE.read_text(encoding="utf-8") == figure_page(), "run python scripts/dev/figure_table.py"


@pytest.mark.parametrize(
    ("title", "numbers"),
    [
        ("Fig. 2-4: windings", ("2-4",)),
        ("Figs 7-7, 7-9, 7-13: height", ("7-7", "7-9", "7-13")),
        ("Figs 4-10, 4-12 to 4-14: force", ("4-10", "4-12", "4-13", "4-14")),
        ("Table 7-1: step", ()),
        ("Step of Fig. 7-1: x", ()),
    ],
)
def test_numbers_of_a_title(title, numbers):
    assert figure_numbers(title) == numbers


def test_a_part_must_draw_what_its_data_file_says(monkeypatch):
    monkeypatch.setattr(
        "fieldmap.thesis.computation.read_part", lambda part: PrintedPart("a title", {}, figures=("2-4",))
    )
    answers = Answers({}, (Curves("Figs 2-4, 2-5: both", "x (mm)", "y (T)", ()),))
    monkeypatch.setattr("fieldmap.thesis.computation.function_of", lambda part: lambda inputs: answers)
    with pytest.raises(LookupError, match="differ in 2-5"):
        compute_part("S4_levitation")
