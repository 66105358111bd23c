"""Figures of rows: what is drawn is what was given, and what is marked lies where the numbers say."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure

from fieldmap.plot.figures import draw_curves, save_curves
from fieldmap.thesis import Curves, Series, part_names
from fieldmap.thesis.computation import compute_part
from fieldmap.thesis.printed import read_part

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


def test_labels_and_legend():
    axes = drawn(PLAIN)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("x (mm)", "B (mT)", "title")
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert words == ["10 mm (ours)", "10 mm (published)", "20 mm (measured)"]


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
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert words == ["x", "asked for", "y"]
    x, grey, y = axes.lines
    assert x.get_color() != grey.get_color() != y.get_color() == drawn(PLAIN).lines[2].get_color()
    assert grey.get_linewidth() < x.get_linewidth()


def test_a_legend_hides_no_line():
    time = np.linspace(0.0, 1.0, 2000)
    everywhere = Series("noise", time, np.sin(1e3 * time))
    axes = drawn(Curves("t", "time (s)", "y (mm)", (everywhere, Series("line", time, 0 * time))))
    axes.figure.draw_without_rendering()
    assert axes.get_legend().get_window_extent().x0 >= axes.get_window_extent().x1
    inside = drawn(Curves("t", "x (mm)", "y (T)", (Series("low", X, X), Series("lower", X, 0.5 * X))))
    inside.figure.draw_without_rendering()
    assert inside.get_legend().get_window_extent().x1 <= inside.get_window_extent().x1


def test_one_line_needs_no_legend_and_decades_are_a_choice():
    axes = drawn(Curves("t", "x (mm)", "y (T)", (Series("line", X, X + 1),), log_y=True))
    assert axes.get_legend() is None
    assert axes.get_yscale() == "log"


def test_a_figure_becomes_a_picture(tmp_path):
    assert save_curves(PLAIN, tmp_path / "figure.png").read_bytes()[:4] == b"\x89PNG"


computed = cache(compute_part)


WITHOUT_A_MAP = [part for part in part_names() if read_part(part).figures and not read_part(part).map]


@pytest.mark.parametrize("part", [*WITHOUT_A_MAP, "S16_closed_loop", "S20_closed_loop"])
def test_figures_of_rows_without_a_map_are_legible(part, legible):
    """Those of the linked machine: where their rows are tested."""
    legible(computed(part).curves)


def test_the_sphere_is_marked_where_force_and_weight_cross():
    force, weight, mark, _ = computed("S4_levitation").curves[2].series
    assert np.interp(mark.x[0], force.x, force.y) == pytest.approx(mark.y[0], rel=1e-5)
    assert weight.y[0] == mark.y[0]
    assert 44 < mark.x[0] < 45


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
