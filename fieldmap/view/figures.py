"""Figures given as data (fieldmap.thesis.Curves) drawn by matplotlib: no window, no global state."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldmap.thesis.curves import Curves, Series

WIDTH, HEIGHT, DOTS_PER_INCH = 6.4, 4.4, 130
# Okabe and Ito's colours, which the colour-blind tell apart; the pale yellow one is left out.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
_LINES = {"ours": "-", "thesis": "--", "measured": "-."}
_MARKS = {"ours": "o", "thesis": "s", "measured": "x"}
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
    names = list(dict.fromkeys(series.name for series in curves.series))
    for k, series in enumerate(curves.series):
        style = _style(series)
        if not series.points and any(_covers(series, below, curves) for below in curves.series[:k]):
            # With gaps, through which the line below shows.
            style |= {"linestyle": (0, (4.0, 4.0)), "zorder": style["zorder"] + 0.5}
        axes.plot(series.x, series.y, color=COLOURS[names.index(series.name) % len(COLOURS)], **style)
    axes.set(xlabel=curves.x_label, ylabel=curves.y_label, yscale="log" if curves.log_y else "linear")
    if curves.equal:
        axes.set_aspect("equal")
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
        return {"linestyle": "none", "marker": _MARKS[series.kind], "markersize": 6, "zorder": 4}
    # What is not ours lies on top, and through its gaps ours is seen.
    ours = series.kind == "ours"
    return {"linestyle": _LINES[series.kind], "linewidth": 1.6 if ours else 2.2, "zorder": 2 if ours else 3}


def _add_legend(axes: Axes, curves: Curves) -> None:
    """Each name and kind once; whose a series is, is said only where there are several kinds."""
    several = len({series.kind for series in curves.series}) > 1
    entries: dict[str, Any] = {}
    for series, line in zip(curves.series, axes.lines, strict=True):
        words = (
            f"{series.name} ({series.kind})" if several and series.kind not in series.name else series.name
        )
        entries.setdefault(words, line)
    if len(entries) < 2:
        return
    if len(entries) <= _MANY:
        axes.legend(entries.values(), entries.keys(), fontsize=8)
    else:
        axes.legend(
            entries.values(),
            entries.keys(),
            fontsize=8,
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            frameon=False,
        )
