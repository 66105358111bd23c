"""Scales of scenes: colour bars with round limits, and axes along three edges of the box with upright labels."""

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.plot.solids import extent
from fieldmap.plot.style import INK
from fieldmap.plot.words import decimals_of, fixed, label_step, round_numbers
from fieldmap.typing import Array

COLOUR_MAP: Final = "viridis"
# A line break after the title separates it from the highest label.
_BAR: dict[str, Any] = {
    "vertical": True,
    "height": 0.5,
    "width": 0.06,
    "position_x": 0.87,
    "position_y": 0.25,
    "color": INK,
    "title_font_size": 26,
    "label_font_size": 22,
}


def colour_bar(title: str, values: ArrayLike) -> dict[str, Any]:
    """`clim` and `scalar_bar_args` for pyvista's add_mesh: limits and labels at round numbers around the values."""
    numbers = np.asarray(values, dtype=float)
    low, high = float(np.nanmin(numbers)), float(np.nanmax(numbers))
    if high - low <= 1e-12 * max(abs(high), abs(low), 1e-300):
        high = low + max(abs(low), 1.0) * 1e-3
    step = label_step(high - low)
    limits = (step * np.floor(low / step), step * np.ceil(high / step))
    labels = round((limits[1] - limits[0]) / step) + 1
    bar = _BAR | {"title": f"{title}\n", "fmt": f"%.{decimals_of(step)}f", "n_labels": labels}
    return {"clim": limits, "scalar_bar_args": bar}


def add_coloured(
    scene: pv.Plotter, mesh: pv.DataSet, title: str, scale: dict[str, Any] | None = None, **look: Any
) -> pv.Actor:
    """Draw the data `title` of a mesh in colour, with a bar.

    scale: from `colour_bar` or `colour_bar_by_decades`; by default for all data. look: options of add_mesh.
    """
    chosen = scale or colour_bar(title, mesh[title])
    return scene.add_mesh(mesh, scalars=title, cmap=COLOUR_MAP, **chosen, **look)


def colour_bar_by_decades(title: str, values: ArrayLike) -> dict[str, Any]:
    """`clim` and `scalar_bar_args` of a logarithmic scale, for positive values."""
    low, high = np.log10([np.min(values), np.max(values)])
    first, last = int(np.floor(low)), max(int(np.ceil(high)), int(np.floor(low)) + 1)
    bar = _BAR | {"title": f"{title}\n", "fmt": "%g", "n_labels": last - first + 1}
    return {"clim": (10.0**first, 10.0**last), "log_scale": True, "scalar_bar_args": bar}


Aligned = Literal["left", "center", "right"]
MILLIMETRES = ("x, mm", "y, mm", "z, mm")
AS_THEY_ARE = (1.0, 1.0, 1.0)


def add_rulers(
    scene: pv.Plotter,
    font_size: int = 18,
    titles: tuple[str, str, str] = MILLIMETRES,
    spread: float = 1.0,
    stretch: Sequence[float] = AS_THEY_ARE,
) -> None:
    """Rule the scene: x along the lower front edge, y along the lower right one, z along the left front one.

    titles: of the three axes. spread: factor of the distance of the labels, above 1 for small windows. stretch: factor
    by which each axis is drawn longer. Front is the side of smallest y. Call it last, because the rulers enclose
    everything drawn so far.
    """
    low, high = extent(scene).T
    size = float((high - low).max())
    # A margin between the rulers and the scene.
    low, high = low - 0.04 * size, high + 0.04 * size
    down, right, left = -np.eye(3)[2], np.eye(3)[0], -np.eye(3)[0]
    front = np.array([high[0], low[1], low[2]])
    edges = (low, down), (front, 0.6 * right + 0.6 * down), (low, left)
    for axis, (corner, outward) in enumerate(edges):
        look = font_size, spread, stretch[axis]
        _add_ruler(scene, titles[axis], axis, corner, high[axis], size * outward, *look)


# Alignment of the labels of each axis at their positions, and their distance from the lines.
_ALIGNED: tuple[Aligned, ...] = ("center", "left", "right")
_OFF = (0.035, 0.018, 0.018)


def _add_ruler(
    scene: pv.Plotter,
    title: str,
    axis: int,
    corner: Array,
    end: float,
    outward: Array,
    font_size: int,
    spread: float,
    stretch: float,
) -> None:
    def at(value: float, distance: float) -> Array:
        point = corner + distance * outward
        point[axis] = value + distance * outward[axis]
        return point

    # Short sides get finer steps, because they would otherwise have only one label.
    size = float(np.linalg.norm(outward))
    step = label_step(max(end - corner[axis], size / 2) / stretch)
    values = round_numbers(corner[axis] / stretch, end / stretch, step)
    lines = [at(corner[axis], 0.0), at(end, 0.0)]
    for value in values:
        lines += [at(stretch * value, 0.0), at(stretch * value, 0.012)]
    scene.add_lines(np.array(lines), color=INK, width=2)
    words = [fixed(value, decimals_of(step)) for value in values]
    places = [at(stretch * value, _OFF[axis] * spread) for value in values]
    add_labels(scene, places, words, font_size, _ALIGNED[axis])
    # The titles of x and y are beside the middle of the edge, away from the labels of y.
    middle = 0.5 * (corner[axis] + end)
    beside = (at(middle, 0.085 * spread), at(middle, 0.15 * spread), at(end + 0.06 * spread * size, 0.0))
    title += f"\nstretched {stretch:g} times" if stretch != 1.0 else ""
    add_labels(scene, [beside[axis]], [title], font_size)


def add_words(
    scene: pv.Plotter, words: str, at: tuple[float, float], font_size: int = 13, name: str | None = None
) -> None:
    """Lines of words on the picture.

    Parameters
    ----------
    words : lines.
    at : upper left corner in the upper half of the picture, lower left corner below; shares of width and height.
    font_size : pixels.
    name : words of the same name are replaced.
    """
    actor = scene.add_text(
        words, position=at, viewport=True, font_size=font_size, color=INK, name=name, render=False
    )
    # With VTK's default spacing the lines touch.
    actor.prop.SetLineSpacing(1.25)
    if at[1] > 0.5:
        actor.prop.SetVerticalJustificationToTop()


def add_labels(
    scene: pv.Plotter, places: list[Array], words: list[str], font_size: int, aligned: Aligned = "center"
) -> None:
    """Words at points (3,), drawn over everything. aligned: "left" if words begin at the point, "right" if they end."""
    scene.add_point_labels(
        np.array(places),
        words,
        font_size=font_size,
        text_color=INK,
        shape=None,
        show_points=False,
        always_visible=True,
        justification_horizontal=aligned,
        justification_vertical="center",
    )
