"""Figures given as data (fieldmap.curves) drawn by matplotlib: no window, no global state."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend

from fieldmap.curves import Curves, Series

WIDTH, HEIGHT, DOTS_PER_INCH = 6.4, 4.4, 130
# Okabe and Ito's colours, which the colour-blind tell apart; the pale yellow one is left out.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
_LINES = {"ours": "-", "published": "--", "measured": "-.", "asked": "-"}
_MARKS = {"ours": "o", "published": "s", "measured": "x", "asked": "."}
# Hollow, so that ours shows through where both agree; heavy, so that a single cross is seen upon lines.
_MARK_STYLES: dict[str, dict[str, Any]] = {
    "published": {"markersize": 9, "markerfacecolor": "none"},
    "measured": {"markersize": 8, "markeredgewidth": 1.8},
}
_ASKED = "#404040"
_MANY = 5
_APART, _MOSTLY = 0.01, 0.9
"""Lines that are closer than this share of the figure's height, over this share of their points, hide each other."""


def save_curves(curves: Curves, path: str | Path) -> Path:
    """Draw one figure and save it as PNG; the folder must be there."""
    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained", dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    draw_curves(figure.add_subplot(), curves)
    figure.savefig(path)
    return Path(path)


def draw_curves(axes: Axes, curves: Curves) -> None:
    """Draw into axes: colour by the name of a series, style by whose it is."""
    names = list(dict.fromkeys(series.name for series in curves.series if series.kind != "asked"))
    for k, series in enumerate(curves.series):
        style = _style(series)
        if not series.points and any(_covers(series, below, curves) for below in curves.series[:k]):
            # With gaps, through which the line below shows.
            style |= {"linestyle": (0, (4.0, 4.0)), "zorder": style["zorder"] + 0.5}
        asked = series.kind == "asked"
        colour = _ASKED if asked else COLOURS[names.index(series.name) % len(COLOURS)]
        axes.plot(series.x, series.y, color=colour, **style)
    axes.set(xlabel=curves.x_label, ylabel=curves.y_label, yscale="log" if curves.log_y else "linear")
    if curves.equal:
        # By wider limits, not a smaller frame: a legend beside the frame keeps its place.
        axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(curves.title, fontsize=10)
    axes.grid(color="0.9")
    axes.set_axisbelow(True)
    _add_legend(axes, curves)


def _covers(series: Series, below: Series, curves: Curves) -> bool:
    """Whether a line would hide one of another name that was drawn before it."""
    if below.points or below.name == series.name or series.x.shape != below.x.shape:
        return False
    heights = np.concatenate([line.y[np.isfinite(line.y)] for line in curves.series])
    near = np.abs(series.y - below.y) < _APART * float(np.ptp(heights))
    # Where lines are steep, a little aside is far apart.
    return bool(np.allclose(series.x, below.x) and np.mean(near) > _MOSTLY)


def _style(series: Series) -> dict[str, Any]:
    if series.points:
        style: dict[str, Any] = {
            "linestyle": "none",
            "marker": _MARKS[series.kind],
            "markersize": 6,
            "zorder": 4,
        }
        return style | _MARK_STYLES.get(series.kind, {})
    if series.kind == "asked":
        return {"linestyle": _LINES["asked"], "linewidth": 0.9, "zorder": 1.5}
    # What is not ours lies on top, and through its gaps ours is seen.
    ours = series.kind == "ours"
    return {"linestyle": _LINES[series.kind], "linewidth": 1.6 if ours else 2.2, "zorder": 2 if ours else 3}


def _add_legend(axes: Axes, curves: Curves) -> None:
    """Each name and kind once; whose a series is, is said only where there are several kinds."""
    several = len({series.kind for series in curves.series} - {"asked"}) > 1
    entries: dict[str, Any] = {}
    for series, line in zip(curves.series, axes.lines, strict=True):
        words = (
            f"{series.name} ({series.kind})" if several and series.kind not in series.name else series.name
        )
        entries.setdefault(words, line)
    if len(entries) < 2:
        return
    if len(entries) <= _MANY:
        legend = axes.legend(entries.values(), entries.keys(), fontsize=8)
        if not _hides_a_line(axes, legend):
            return
    axes.legend(
        entries.values(),
        entries.keys(),
        fontsize=8,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
    )


def _hides_a_line(axes: Axes, legend: Legend) -> bool:
    """Whether a line or a mark lies under a legend that took the best place it found."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    box = legend.get_window_extent()
    return any(
        line.get_transform().transform_path(line.get_path()).intersects_bbox(box, filled=False)
        for line in axes.lines
    )
