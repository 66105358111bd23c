"""Figures given as data (fieldmap.curves) drawn by matplotlib: no window, no global state."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from scipy.optimize import isotonic_regression

from fieldmap.curves import Curves, Series, message_of
from fieldmap.plot.style import COLOURS, QUIET, add_heading, grouped, new_figure, save_figure
from fieldmap.typing import Array, PathLike

# Lines that are not ours are on top and have gaps, through which ours show.
_LINES: dict[str, dict[str, Any]] = {
    "ours": {"linestyle": "-", "linewidth": 1.6, "zorder": 2.0},
    "published": {"linestyle": "--", "linewidth": 2.2, "zorder": 3.0},
    "measured": {"linestyle": "-.", "linewidth": 2.2, "zorder": 3.0},
    "asked": {"linestyle": "-", "linewidth": 0.9, "zorder": 1.5},
}
# Hollow markers, so that ours shows through; heavy ones, so that a single cross is visible on lines.
_MARKS: dict[str, dict[str, Any]] = {
    "ours": {"marker": "o"},
    "published": {"marker": "s", "markersize": 9, "markerfacecolor": "none"},
    "measured": {"marker": "x", "markersize": 8, "markeredgewidth": 1.8},
    "asked": {"marker": "."},
}
_MARK: dict[str, Any] = {"linestyle": "none", "markersize": 6, "zorder": 4.0}
_ASKED = "#404040"
_MANY = 5
_APART, _MOSTLY = 0.01, 0.9
"""Lines that are closer than this share of the figure's height, over this share of their points, hide each other."""
_SAME = 1e-3
"""Lines whose largest distance is below this share of the figure's height are labelled as the same."""
# Direct labels: font size; line spacing over it; largest distance of the end of a line from the right edge, as a share
# of the width; and largest number of characters.
_LABEL_SIZE, _SPACING, _SHORT, _LONGEST = 8, 1.35, 0.12, 26


def save_curves(curves: Curves, path: PathLike) -> Path:
    """Draw one figure and save it as PNG.

    Parameters
    ----------
    curves
        The figure as data.
    path
        Path of the file, in an existing folder.

    Returns
    -------
    Path
        The path.
    """
    return save_figure(curves_figure(curves), path)


def curves_figure(curves: Curves) -> Figure:
    """One figure, in the style of the package."""
    with new_figure() as figure:
        draw_curves(figure.add_subplot(), curves)
    return figure


def draw_curves(axes: Axes, curves: Curves) -> None:
    """Draw into axes: colour by the name of a series, style by its kind.

    The heading is the message of the data, if there is one, and the title. Lines are named at their right ends if the
    names fit, otherwise in a legend; lines that coincide are labelled as the same.
    """
    names = list(dict.fromkeys(series.name for series in curves.series if series.kind != "asked"))
    for k, series in enumerate(curves.series):
        style = _MARK | _MARKS[series.kind] if series.points else _LINES[series.kind]
        if any(_covers(series, below, curves) for below in curves.series[:k]):
            # The line below shows through the gaps.
            style = style | {"linestyle": (0, (4.0, 4.0)), "zorder": style["zorder"] + 0.5}
        asked = series.kind == "asked"
        colour = _ASKED if asked else COLOURS[names.index(series.name) % len(COLOURS)]
        axes.plot(series.x, series.y, color=colour, **style)
    axes.set(xlabel=curves.x_label, ylabel=curves.y_label, yscale="log" if curves.log_y else "linear")
    if curves.equal:
        # Wider limits, not a smaller frame, so that a legend beside the frame keeps its place.
        axes.set_aspect("equal", adjustable="datalim")
    add_heading(axes, curves.message or message_of(curves), curves.title)
    axes.grid(True)
    axes.set_axisbelow(True)
    if not _name_at_ends(axes, curves):
        _add_legend(axes, _entries(axes, curves, curves.series))


def _apart(one: Series, other: Series, curves: Curves) -> Array | None:
    """Distances (n,) of two lines over the same x, as shares of the figure's height; None for other lines."""
    if one.points or other.points or one.x.shape != other.x.shape or not np.allclose(one.x, other.x):
        return None
    height = np.ptp(np.concatenate([line.y[np.isfinite(line.y)] for line in curves.series]))
    return np.asarray(np.abs(one.y - other.y) / max(float(height), 1e-300))


def _covers(series: Series, below: Series, curves: Curves) -> bool:
    """Whether a line would hide one of another name that was drawn before it."""
    apart = None if below.name == series.name else _apart(series, below, curves)
    # Not all points need to be close: steep lines differ much in y for a small shift in x.
    return apart is not None and bool(np.mean(apart < _APART) > _MOSTLY)


def _same(one: Series, other: Series, curves: Curves) -> bool:
    """Whether two lines cannot be distinguished by eye."""
    apart = _apart(one, other, curves)
    return apart is not None and bool(np.nanmax(apart, initial=0.0) <= _SAME)


def _name_at_ends(axes: Axes, curves: Curves) -> bool:
    """Name the lines at their ends, and the rest in a legend; do nothing and return False if the names do not fit."""
    lines = [series for series in curves.series if not series.points]
    # Lines with a common label: of one name and any kind, or of several names but equal.
    groups = grouped(lines, lambda one, other: one.name == other.name or _same(one, other, curves))
    words = [_group_name(group) for group in groups]
    if not 1 < len(groups) <= _MANY or max(len(text) for text in words) > _LONGEST or curves.equal:
        return False
    axes.autoscale_view()
    ends = axes.transScale.transform([_end(group[0]) for group in groups])
    shares = axes.transLimits.transform(ends)
    if np.isnan(shares).any():
        return False
    figure = axes.get_figure(root=True)
    assert figure is not None
    # The heading takes a part of the height.
    _lay_out(figure)
    high = max(text.count("\n") + 1 for text in words)
    height = high * _LABEL_SIZE * _SPACING * figure.dpi / 72.0 / axes.get_window_extent().height
    if (shares[:, 0] < 1.0 - _SHORT).any():
        return False
    for group, text, place in zip(groups, words, spread(shares[:, 1], height), strict=True):
        drawn = axes.lines[curves.series.index(group[0])]
        axes.annotate(
            text,
            (1.0, place),
            xycoords="axes fraction",
            xytext=(4.0, 0.0),
            textcoords="offset points",
            fontsize=_LABEL_SIZE,
            color=drawn.get_color(),
            va="center",
            annotation_clip=False,
        )
    _add_legend(axes, _rest(axes, curves, groups), least=1)
    return True


def _group_name(group: Sequence[Series]) -> str:
    names = list(dict.fromkeys(series.name for series in group))
    return names[0] if len(names) == 1 else f"{', '.join(names)}:\nthe same"


def _end(series: Series) -> tuple[float, float]:
    """The finite point with the largest x; NaN without one."""
    known = np.flatnonzero(np.isfinite(series.x) & np.isfinite(series.y))
    if not known.size:
        return np.nan, np.nan
    last = known[int(np.argmax(series.x[known]))]
    return float(series.x[last]), float(series.y[last])


def spread(heights: Array, least: float) -> Array:
    """Positions nearest to the heights (n,), by least squares, with a distance of at least `least`.

    >>> spread(np.array([0.0, 0.0, 1.0]), 0.2).round(2).tolist()
    [-0.1, 0.1, 1.0]
    """
    order, steps = np.argsort(heights, kind="stable"), least * np.arange(len(heights))
    places = np.empty(len(heights))
    places[order] = isotonic_regression(heights[order] - steps).x + steps
    return places


def _rest(axes: Axes, curves: Curves, groups: Sequence[Sequence[Series]]) -> dict[str, Any]:
    """Entries of the legend beside direct labels: meaning of line styles, and markers."""
    entries: dict[str, Any] = {}
    kinds = list(dict.fromkeys(s.kind for group in groups for s in group if s.kind != "asked"))
    for kind in kinds if len(kinds) > 1 else ():
        entries[kind] = Line2D([], [], color=QUIET, **_LINES[kind])
    named = {series.name for group in groups for series in group}
    marks = [s for s in curves.series if s.points and not (s.kind == "ours" and s.name in named)]
    return entries | _entries(axes, curves, marks)


def _entries(axes: Axes, curves: Curves, shown: Sequence[Series]) -> dict[str, Any]:
    """Entries of the legend, each name and kind once; the kind is stated only if there are several kinds."""
    several = len({series.kind for series in curves.series} - {"asked"}) > 1
    entries: dict[str, Any] = {}
    for k, (series, line) in enumerate(zip(curves.series, axes.lines, strict=True)):
        if not any(series is one for one in shown):
            continue
        words = (
            f"{series.name} ({series.kind})" if several and series.kind not in series.name else series.name
        )
        same = [
            one.name for one in curves.series[:k] if one.name != series.name and _same(one, series, curves)
        ]
        words += f", the same as {same[0]}" if same else ""
        entries.setdefault(words, line)
    return entries


def _add_legend(axes: Axes, entries: dict[str, Any], least: int = 2) -> None:
    if len(entries) < least:
        return
    if len(entries) <= _MANY:
        legend = axes.legend(entries.values(), entries.keys())
        if not _hides_a_line(axes, legend):
            return
    beside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    if any(text.get_text() and text.get_position()[0] == 4.0 for text in axes.texts):
        # The names of lines are on the right.
        beside = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 3}
    axes.legend(entries.values(), entries.keys(), **beside)


def _hides_a_line(axes: Axes, legend: Legend) -> bool:
    """Whether a line or a marker is hidden by the legend at the best position that matplotlib found."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    _lay_out(figure)
    box = legend.get_window_extent()
    return any(
        line.get_transform().transform_path(line.get_path()).intersects_bbox(box, filled=False)
        for line in axes.lines
    )


def _lay_out(figure: Figure) -> None:
    """Run the layout of drawing without drawing, which takes longer."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
