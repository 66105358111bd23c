"""Figures of rows: what is drawn is what was given, and what is marked lies where the numbers say."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from fieldmap.curves import agreements, message_of
from fieldmap.plot.figures import draw_curves, save_curves, spread
from fieldmap.thesis import Curves, Series, part_names
from fieldmap.thesis.printed import read_part
from tests.computed_parts import computed

X = np.array([0.0, 1.0, 2.0])
PLAIN = Curves(
    "title",
    "x (mm)",
    "B (mT)",
    (
        Series("10 mm", X, X**2),
        Series("10 mm", X, 2 * X, "published"),
        Series("20 mm", X, 3 * X, "measured", points=True),
    ),
)


def drawn(curves):
    axes = Figure().add_subplot()
    draw_curves(axes, curves)
    return axes


def test_colour_says_which_and_style_whose():
    first, second, third = drawn(PLAIN).lines
    assert first.get_color() == second.get_color() != third.get_color()
    assert [line.get_linestyle() for line in (first, second, third)] == ["-", "--", "None"]
    np.testing.assert_array_equal(second.get_data(), (X, 2 * X))


def words_of(axes):
    legend = axes.get_legend()
    return [text.get_text() for text in (legend.get_texts() if legend else [])]


def test_a_legend_where_names_do_not_fit_at_the_ends():
    long = "a name that would take half of the width of the figure"
    axes = drawn(replace(PLAIN, series=(*PLAIN.series, Series(long, X, 5 - X))))
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title("left")) == ("x (mm)", "B (mT)", "title")
    assert words_of(axes) == ["10 mm (ours)", "10 mm (published)", "20 mm (measured)", f"{long} (ours)"]
    short = replace(PLAIN, series=(Series("a", X, X), Series("b", X / 2, X**2)))
    assert words_of(drawn(short)) == ["a", "b"]


def test_lines_are_named_at_their_ends():
    curves = replace(PLAIN, series=(*PLAIN.series, Series("30 mm", X, 5 - X), Series("ten", X, X**2 + 1e-4)))
    axes = drawn(curves)
    ends = (text for text in axes.texts if text.xycoords == "axes fraction" and text.xy[0] == 1)
    at = {text.get_text(): text for text in ends}
    assert set(at) == {"10 mm, ten:\nthe same", "30 mm"}
    low, high = axes.get_ylim()
    assert at["30 mm"].xy[1] == pytest.approx((3.0 - low) / (high - low), abs=1e-9)
    assert at["30 mm"].get_color() == axes.lines[3].get_color()
    # What is left for a legend: the styles of lines, and marks that no line names.
    assert words_of(axes) == ["ours", "published", "20 mm (measured)"]


@pytest.mark.parametrize("together", [0.0, 1e-5])
def test_names_of_lines_that_end_together_are_legible(legible, together):
    """Below a message of two lines; two of them coincide, whose name has two lines as well."""
    names = {"one": 0.0, "two": together, "three": 0.04, "four": 0.08}
    ends = [Series(name, X, X + up) for name, up in names.items()]
    message = "a message that is so long that it takes two lines above the figure, or nearly so"
    legible([Curves(f"together {together}", "x (mm)", "B (mT)", tuple(ends), message=message)])


def test_names_keep_apart_as_near_as_they_can():
    places = spread(np.array([0.5, 0.1, 0.5, 0.52]), 0.1)
    assert places[1] == 0.1
    # Those that crowd stand evenly about their middle.
    np.testing.assert_allclose(np.sort(places[[0, 2, 3]]), 1.52 / 3 + np.array([-0.1, 0.0, 0.1]))


def test_the_message_is_from_the_data():
    x = np.linspace(0.0, 2.0, 50)
    ours = Series("B", x, x**2)
    theirs = Series("B", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.2, 4.0]), "measured", points=True)
    curves = Curves("t", "x (mm)", "B (T)", (ours, theirs))
    (found,) = agreements(curves)
    assert found.difference == pytest.approx(0.2 / 4.0, abs=2e-4)
    assert "5 %" in drawn(curves).texts[0].get_text()
    doubled = replace(curves, series=(replace(ours, y=2 * x**2), theirs))
    assert agreements(doubled)[0].difference == pytest.approx(1.0)
    assert "100 %" in message_of(doubled)
    # Two lines of ours under other names: which is meant is not known.
    both = replace(curves, series=(replace(ours, name="one"), replace(ours, name="other"), theirs))
    assert agreements(both) == ()
    given = replace(curves, message="said")
    assert drawn(given).texts[0].get_text() == "said"


def test_the_message_of_lines_of_ours_is_how_far_they_are_from_the_computed_one():
    x = np.linspace(0.0, 2.0, 50)
    short = x[::2]
    formulas = Series("formula", short, 1.5 * short), Series("other formula", x, 1.9 * x)
    lines = [Series("computed", x, 2.0 * x), *formulas]
    alone = Curves("t", "x (mm)", "B (T)", tuple(lines))
    # At the end of the shorter line, of the computed range as far as it goes.
    assert message_of(alone) == "Within 25 % of the computed range (worst: formula)"
    two = replace(alone, series=tuple(lines[:2]))
    assert drawn(two).texts[0].get_text() == "formula is within 25 % of the computed range"
    same = tuple(replace(lines[0], name=name) for name in "abc")
    assert message_of(replace(alone, series=same)) == "All 3 lines are the same"
    # Lines that differ by a parameter, one line, lines apart, and what was measured under other names say nothing.
    apart = replace(lines[1], x=lines[1].x + 5.0)
    measured = replace(lines[1], kind="measured", points=True, name="rig")
    named = replace(lines[0], name="y = 1 mm")
    for series in ([named, *lines[1:]], lines[:1], [lines[0], apart], [lines[0], lines[2], measured]):
        assert message_of(replace(alone, series=tuple(series))) == ""


def test_a_line_that_would_hide_another_has_gaps():
    near = Series("near", X, X**2 + 0.01)
    first, second, third, fourth = drawn(
        Curves("t", "x (mm)", "y (T)", (PLAIN.series[0], near, PLAIN.series[2], Series("far", X, X)))
    ).lines
    assert [line.get_linestyle() for line in (first, second, fourth)] == ["-", "--", "-"]
    assert second.get_zorder() > first.get_zorder()
    assert third.get_linestyle() == "None"


def test_what_is_asked_for_is_no_answer_and_takes_no_colour():
    asked = Series("asked for", X, np.ones(3), "asked")
    axes = drawn(Curves("t", "time (s)", "y (mm)", (Series("x", X, X), asked, Series("y", X, X**2))))
    named = [text.get_text() for text in axes.texts]
    assert sorted(named) == ["asked for", "x", "y"]
    x, grey, y = axes.lines
    assert x.get_color() != grey.get_color() != y.get_color() == drawn(PLAIN).lines[2].get_color()
    assert grey.get_linewidth() < x.get_linewidth()


def test_a_legend_hides_no_line():
    time = np.linspace(0.0, 1.0, 2000)
    everywhere = Series("noise, with a name that is too long for the end", time, np.sin(1e3 * time))
    axes = drawn(Curves("t", "time (s)", "y (mm)", (everywhere, Series("line", time, 0 * time))))
    axes.figure.draw_without_rendering()
    assert axes.get_legend().get_window_extent().x0 >= axes.get_window_extent().x1
    half = np.linspace(0.0, 1.0, 5)
    inside = drawn(Curves("t", "x (mm)", "y (T)", (Series("low", X, X), Series("lower", half, 0.5 * half))))
    inside.figure.draw_without_rendering()
    assert inside.get_legend().get_window_extent().x1 <= inside.get_window_extent().x1


def test_one_line_needs_no_legend_and_decades_are_a_choice():
    axes = drawn(Curves("t", "x (mm)", "y (T)", (Series("line", X, X + 1),), log_y=True))
    assert axes.get_legend() is None
    assert axes.get_yscale() == "log"


def test_a_figure_becomes_a_picture(tmp_path):
    assert save_curves(PLAIN, tmp_path / "figure.png").read_bytes()[:4] == b"\x89PNG"


WITHOUT_A_MAP = [part for part in part_names() if read_part(part).figures and not read_part(part).map]


@pytest.mark.parametrize("part", [*WITHOUT_A_MAP, "S16_closed_loop", "S20_closed_loop"])
def test_figures_of_rows_without_a_map_are_legible(part, legible):
    """Those of the linked machine: where their rows are tested."""
    legible(computed(part).curves)


def test_equilibria_are_marked_on_the_maxima():
    box = [one for one in computed("S5_current_ratio").curves[0].series if one.kind == "ours"]
    for curve, mark in list(zip(box[::2], box[1::2], strict=True))[1:]:
        assert abs(curve.x[np.argmax(curve.y)] - mark.x[0]) < 2 * np.diff(curve.x).max()


@pytest.mark.parametrize(
    "wrong",
    [
        {"title": "too long a title " * 9},
        {"x_label": "no unit"},
        {"y_label": "far too long a label (mT)" * 5},
    ],
)
def test_what_is_not_legible_is_found(wrong, legible):
    with pytest.raises(AssertionError):
        legible([replace(PLAIN, **{"title": f"wrong {sorted(wrong)}"} | wrong)])
