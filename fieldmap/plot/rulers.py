"""Axes along three edges of the scene's box, with ticks at round numbers and upright labels."""

import numpy as np
import pyvista as pv

from fieldmap.plot.style import INK
from fieldmap.typing import Array

MILLIMETRES = ("x, mm", "y, mm", "z, mm")


def add_rulers(
    scene: pv.Plotter,
    font_size: int = 18,
    titles: tuple[str, str, str] = MILLIMETRES,
    spread: float = 1.0,
) -> None:
    """Rule the scene: x along the lower front edge, y along the lower right one, z along the left front one.

    titles: of the three axes. spread: how far off the labels stand, above 1 for small windows. Front is the side of
    smallest y. Call it last: the box is that of all drawn so far.
    """
    low, high = np.array(scene.bounds).reshape(3, 2).T
    size = float((high - low).max())
    # A little air between the ruler and what it measures.
    low, high = low - 0.04 * size, high + 0.04 * size
    down, right, left = -np.eye(3)[2], np.eye(3)[0], -np.eye(3)[0]
    rulers = (
        (titles[0], 0, np.array([low[0], low[1], low[2]]), down),
        (titles[1], 1, np.array([high[0], low[1], low[2]]), 0.6 * right + 0.6 * down),
        (titles[2], 2, np.array([low[0], low[1], low[2]]), left),
    )
    for title, axis, corner, outward in rulers:
        _add_ruler(scene, title, axis, corner, high[axis], size, outward, font_size, spread)


def label_step(span: float) -> float:
    """Distance of labels: 1, 2 or 5 times a power of ten, at most some six to a span.

    >>> label_step(511.0)
    100.0
    """
    wanted = span / 6.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= wanted))


def round_numbers(low: float, high: float, step: float) -> Array:
    """Multiples of step from low to high."""
    return step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)


def _add_ruler(
    scene: pv.Plotter,
    title: str,
    axis: int,
    corner: Array,
    end: float,
    size: float,
    outward: Array,
    font_size: int,
    spread: float,
) -> None:
    def at(value: float, distance: float) -> Array:
        point = corner + distance * size * outward
        point[axis] = value + distance * size * outward[axis]
        return point

    # Short sides get finer steps, or they would carry one label.
    step = label_step(max(end - corner[axis], size / 2))
    values = round_numbers(corner[axis], end, step)
    lines = [at(corner[axis], 0.0), at(end, 0.0)]
    for value in values:
        lines += [at(value, 0.0), at(value, 0.012)]
    scene.add_lines(np.array(lines), color=INK, width=2)
    decimals = max(0, int(np.ceil(-np.log10(step) - 1e-9)))
    words = [f"{value + 0.0:.{decimals}f}" for value in values] + [title]
    # Along x the title would meet the labels of y, and along y those of y itself: beside the middle.
    beside = {0: 0.085, 1: 0.125}
    name_at = (
        at(0.5 * (corner[axis] + end), beside[axis] * spread)
        if axis in beside
        else at(end + 0.06 * spread * size, 0.0)
    )
    places = [*(at(value, 0.035 * spread) for value in values), name_at]
    scene.add_point_labels(
        np.array(places),
        words,
        font_size=font_size,
        text_color=INK,
        shape=None,
        show_points=False,
        always_visible=True,
        justification_horizontal="center",
        justification_vertical="center",
    )
