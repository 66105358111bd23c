"""Figures of rows: the drawn lines are the given ones, and marks are where the numbers say."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from fieldmap.curves import agreements, message_of
from fieldmap.plot.figures import curves_figure, draw_curves, save_curves, spread
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
    # Left for the legend: line styles, and marks without a line of their name.
    assert words_of(axes) == ["ours", "published", "20 mm (measured)"]


@pytest.mark.parametrize("together", [0.0, 1e-5])
def test_names_of_lines_that_end_together_are_legible(legible, together):
    """Below a message of two lines; two lines coincide, so their common name has two lines as well."""
    names = {"one": 0.0, "two": together, "three": 0.04, "four": 0.08}
    ends = [Series(name, X, X + up) for name, up in names.items()]
    message = "a message that is so long that it takes two lines above the figure, or nearly so"
    legible([Curves(f"together {together}", "x (mm)", "B (mT)", tuple(ends), message=message)])


def named_at_ends(axes):
    """The texts to the right of the axes."""
    return [text for text in axes.texts if text.xycoords == "axes fraction" and text.xy[0] == 1]


def falling(count, end=1.0, names="line {}"):
    """Lines from one point to heights 0, 1, 2 ... at x = 1; the first ends at x = `end`."""
    x = np.linspace(0.0, 1.0, 9)
    lines = [Series(names.format(k), x * (end if k else 1.0), k * x) for k in range(count)]
    return Curves("title", "x (mm)", "B (mT)", tuple(lines))


@pytest.mark.parametrize(
    ("curves", "named"),
    [
        (falling(2), True),
        (falling(5), True),
        # Too many colours; a single line; a name longer than the space beside the axes.
        (falling(6), False),
        (falling(1), False),
        (falling(2, names="{}" + 25 * "n"), True),
        (falling(2, names="{}" + 26 * "n"), False),
        # Ends may differ by 12 % of the width, which is 5 % wider than the lines on both sides.
        (falling(2, end=1.1 * 0.885 - 0.05), True),
        (falling(2, end=1.1 * 0.875 - 0.05), False),
        (replace(falling(2), equal=True), False),
        (replace(falling(2), series=(*falling(2).series, Series("nothing", X, X * np.nan))), False),
        (Curves("t", "x (mm)", "B (mT)", tuple(Series(name, X, X, points=True) for name in "ab")), False),
    ],
)
def test_where_lines_are_named(curves, named):
    axes = curves_figure(curves).axes[0]
    assert len(named_at_ends(axes)) == (len(curves.series) if named else 0)
    assert (axes.get_legend() is None) == (named or len(curves.series) == 1)
    assert axes.get_aspect() == (1.0 if curves.equal else "auto")
    if curves.equal:
        assert axes.get_adjustable() == "datalim"


def test_names_stand_at_the_ends_of_their_lines_a_line_apart():
    """The end is the rightmost known point, for any order of points and any gaps."""
    backwards = Series("backwards", np.array([1.0, 0.5, 0.0]), np.array([3.0, 1.0, 1.0]))
    open_end = Series("open", np.array([0.0, 0.95, 1.0]), np.array([0.0, 1.0, np.nan]))
    close = Series("close", np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    axes = curves_figure(Curves("t", "x (mm)", "B (mT)", (backwards, open_end, close))).axes[0]
    one, two, three = named_at_ends(axes)
    low, high = axes.get_ylim()
    assert one.xy[1] == pytest.approx((3.0 - low) / (high - low))
    assert 0.5 * (two.xy[1] + three.xy[1]) == pytest.approx((1.0 - low) / (high - low))
    axes.figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in (two, three)]
    apart = abs(boxes[1].y0 - boxes[0].y0)
    assert 1.0 < apart / boxes[0].height < 1.6
    for text in (one, two, three):
        assert (text.get_va(), text.get_size()) == ("center", 8)
        assert 0.0 < text.get_window_extent().x0 - axes.bbox.x1 < 15.0
    # Names of two lines are twice as far from other names.
    same = replace(close, name="again")
    axes = curves_figure(Curves("t", "x (mm)", "B (mT)", (open_end, close, same))).axes[0]
    heights = [text.xy[1] for text in named_at_ends(axes)]
    axes.figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in named_at_ends(axes)]
    assert 1.0 < abs(np.diff(heights)[0]) * axes.bbox.height / max(box.height for box in boxes) < 1.6


def test_what_is_not_ours_lies_on_top_and_marks_above_all():
    kinds = ("ours", "published", "measured", "asked")
    lines = [Series(f"line {kind}", X, X + k, kind) for k, kind in enumerate(kinds)]
    marks = [Series(f"marks {kind}", X, X + 4 + k, kind, points=True) for k, kind in enumerate(kinds)]
    axes = drawn(Curves("t", "x (mm)", "B (mT)", (*lines, *marks)))
    ours, published, measured, asked, *dots = axes.lines
    assert [line.get_linestyle() for line in axes.lines] == ["-", "--", "-.", "-"] + 4 * ["None"]
    assert 1.0 < asked.get_zorder() < ours.get_zorder() < published.get_zorder() == measured.get_zorder()
    assert {measured.get_zorder() < dot.get_zorder() for dot in dots} == {True}
    widths = [line.get_linewidth() for line in (asked, ours, published, measured)]
    assert 0.5 < widths[0] < widths[1] < widths[2] == widths[3] < 3.0
    assert [dot.get_marker() for dot in dots] == ["o", "s", "x", "."]
    # Published marks are hollow and larger, so that ours are visible inside.
    sizes = [dot.get_markersize() for dot in dots]
    assert 5.0 < sizes[0] == sizes[3] < sizes[2] < sizes[1] < 10.0
    assert dots[1].get_markerfacecolor() == "none"
    assert 1.0 < dots[2].get_markeredgewidth() < 2.5
    assert (axes.get_axisbelow(), axes.xaxis.get_gridlines()[0].get_visible()) == (True, True)


@pytest.mark.parametrize(
    ("near", "apart", "covered"),
    [(20, 0.0099, True), (19, 0.0099, True), (18, 0.0099, False), (20, 0.0101, False)],
)
def test_a_line_is_covered_by_one_that_is_mostly_nearer_than_a_hundredth(near, apart, covered):
    """Relative to the height of the figure, here 2 mT, over more than nine tenths of the points."""
    x = np.linspace(0.0, 1.0, 20)
    away = np.where(np.arange(20) < near, 2.0 * apart, 0.5)
    frame = Series("frame", np.array([0.0, 1.0]), np.array([-1.0, 1.0]))
    lines = (Series("below", x, 0 * x), Series("above", x, away), frame)
    for curves, dashed in (
        (Curves("t", "x", "y", lines), covered),
        # A line of the same name, marks, and a line over other places cover nothing.
        (Curves("t", "x", "y", (replace(lines[0], name="above"), *lines[1:])), False),
        (Curves("t", "x", "y", (replace(lines[0], points=True), *lines[1:])), False),
        (Curves("t", "x", "y", (replace(lines[0], x=x + 2.0), *lines[1:])), False),
    ):
        below, above, _ = drawn(curves).lines
        assert above.is_dashed() == dashed
        assert above.get_zorder() - below.get_zorder() == (0.5 if dashed else 2.0 - below.get_zorder())
        if dashed:
            _, (dash, gap) = above._unscaled_dash_pattern
            assert 2.0 < dash == gap < 6.0


@pytest.mark.parametrize(("apart", "same"), [(0.0, True), (0.0009, True), (0.0011, False)])
def test_lines_within_a_thousandth_are_said_to_be_the_same(apart, same):
    """Largest difference relative to the height, 3 mT; unknown values do not count."""
    away = np.array([0.0, 3.0 * apart, np.nan])
    frame = Series("frame", np.array([0.0, 2.0]), np.array([0.0, 3.0]))
    curves = Curves("t", "x", "y", (Series("one", X, X), Series("other", X, X + away), frame))
    named = [text.get_text() for text in named_at_ends(drawn(curves))]
    # The other line ends in the middle of the axes, where names are not placed.
    assert named == (["one, other:\nthe same", "frame"] if same else [])
    legend = drawn(
        replace(curves, series=(*curves.series, Series("a name that is far too long for the end", X, 0 * X)))
    )
    assert ("other, the same as one" in words_of(legend)) == same


def test_a_legend_says_whose_a_line_is_where_there_are_several_kinds():
    asked, ours = Series("asked for", X, X + 3, "asked"), Series("a", X, X)
    theirs = Series("a", X, X + 1, "published")
    own_words = Series("measured on a rig", X, X + 2, "measured", points=True)
    for series, words in (
        # References are no kind; a single kind needs no word, and a name that contains the kind needs no second.
        ((ours, asked, replace(ours, name="b", y=2 * X)), ["a", "asked for", "b"]),
        (
            (ours, theirs, own_words, asked),
            ["a (ours)", "a (published)", "measured on a rig", "asked for"],
        ),
        # Each pair of name and kind once.
        ((ours, replace(ours, y=3 * X), theirs), ["a (ours)", "a (published)"]),
    ):
        axes = drawn(Curves("t", "x", "y", (*series, Series("z" * 30, X[:2], X[:2]))))
        assert words_of(axes)[:-1] == words
    # With names at the ends, the legend has styles and marks; our marks on a line of their name need no entry.
    marks, other = replace(ours, y=X, points=True), replace(ours, name="b", y=2 * X)
    assert words_of(drawn(Curves("t", "x", "y", (ours, other, marks, theirs)))) == ["ours", "published"]
    assert words_of(drawn(Curves("t", "x", "y", (ours, other, marks)))) == []
    lone = replace(marks, name="c")
    assert words_of(drawn(Curves("t", "x", "y", (ours, other, lone)))) == ["c"]


def test_a_legend_stands_where_there_is_room():
    """Inside with few entries that hide nothing, beside the axes with many, below the axes if names are beside them."""
    x = np.linspace(0.0, 1.0, 5)
    short = [Series(f"line {k}", (0.5 if k else 1.0) * x, (k + 1) * x) for k in range(6)]
    for count, inside in ((5, True), (6, False)):
        axes = curves_figure(Curves("t", "x (mm)", "B (mT)", tuple(short[:count]))).axes[0]
        axes.figure.draw_without_rendering()
        box = axes.get_legend().get_window_extent()
        assert (box.x1 <= axes.bbox.x1) == inside
        assert (box.x0 >= axes.bbox.x1 - 5.0) != inside
        assert box.y1 <= axes.bbox.y1 + 5.0
    full = [
        Series(f"noise {k}", np.linspace(0.0, 1.0, 999), np.sin(1e3 * np.arange(999) + k)) for k in range(2)
    ]
    full += [Series(f"dots {k}", x, x - 0.1 * k, "measured", points=True) for k in range(4)]
    axes = curves_figure(Curves("t", "x (mm)", "B (mT)", tuple(full))).axes[0]
    axes.figure.draw_without_rendering()
    box = axes.get_legend().get_window_extent()
    assert 0.0 < box.y0 < box.y1 < axes.xaxis.get_tightbbox().y0 + 3.0
    assert 0.5 * (box.x0 + box.x1) == pytest.approx(0.5 * (axes.bbox.x0 + axes.bbox.x1), abs=1.0)
    assert axes.get_legend()._ncols == 3


def test_names_keep_apart_as_near_as_they_can():
    places = spread(np.array([0.5, 0.1, 0.5, 0.52]), 0.1)
    assert places[1] == 0.1
    # Crowded names are spread evenly about their mean.
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
    # With two lines of ours of other names it is not known which one is meant.
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
    # The difference at the end of the shorter line, relative to the computed range up to there.
    assert message_of(alone) == "Within 25 % of the computed range (worst: formula)"
    two = replace(alone, series=tuple(lines[:2]))
    assert drawn(two).texts[0].get_text() == "formula is within 25 % of the computed range"
    same = tuple(replace(lines[0], name=name) for name in "abc")
    assert message_of(replace(alone, series=same)) == "All 3 lines are the same"
    # No message: lines that differ by a parameter, a single line, disjoint lines, measured lines of other names.
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
    """Figures of the coupled machine are checked with their rows."""
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
