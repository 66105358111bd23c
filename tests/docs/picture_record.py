"""The content of a figure or a scene as data: titles, axes, curves, solids and their positions, without pixels.

Each picture of the documentation has such a record, so that a test can tell whether its command would still draw the
same (docs/images/records.json).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from fieldmap.typing import Array

SAMPLES = 9
"""Values that stand for a curve or an image: at evenly spread places, the ends among them."""


def figure_record(figure: Figure) -> dict[str, Any]:
    """Title and background of a figure, and for each of its axes title, texts, labels, scales and content.

    >>> from matplotlib.figure import Figure
    >>> figure = Figure()
    >>> axes = figure.add_subplot(xlabel="x (mm)", ylabel="B (mT)")
    >>> [line] = axes.plot([0.0, 1.0, 2.0], [3.0, 4.0, 6.0], label="ours")
    >>> figure_record(figure)["axes"][0]["lines"][0]["y"]
    [3.0, 4.0, 6.0]
    """
    return {
        "title": figure.get_suptitle(),
        "paper": to_hex(figure.get_facecolor()),
        "axes": [_axes_record(axes) for axes in figure.axes],
    }


def _axes_record(axes: Axes) -> dict[str, Any]:
    legend = axes.get_legend()
    return {
        "title": axes.get_title("left") or axes.get_title(),
        "texts": [text.get_text() for text in axes.texts if text.get_text()],
        "x": axes.get_xlabel(),
        "y": axes.get_ylabel(),
        "scales": [axes.get_xscale(), axes.get_yscale()],
        "legend": [] if legend is None else [text.get_text() for text in legend.get_texts()],
        "lines": [
            {
                "colour": to_hex(line.get_color()),
                "label": "" if str(line.get_label()).startswith("_") else str(line.get_label()),
                "points": int(np.size(line.get_xdata())),
                "x": sampled(line.get_xdata()),
                "y": sampled(line.get_ydata()),
            }
            for line in axes.lines
        ],
        "images": [sampled(image.get_array()) for image in [*axes.images, *_meshes(axes)]],
    }


def _meshes(axes: Axes) -> list[QuadMesh]:
    return [one for one in axes.collections if isinstance(one, QuadMesh)]


def scene_record(scene: pv.Plotter) -> dict[str, Any]:
    """Bounds, mm, colour and opacity of every solid of a scene, in the order in which they were added.

    Rulers, texts and colour bars are only counted; paper: the background colour.
    """
    solids = [actor for actor in scene.actors.values() if isinstance(actor, pv.Actor)]
    return {
        "paper": to_hex(scene.background_color.float_rgb),
        "solids": [
            {
                "bounds": [round(float(bound), 2) for bound in actor.bounds],
                "colour": [round(float(share), 3) for share in actor.prop.color.float_rgb],
                "opacity": float(actor.prop.opacity),
            }
            for actor in solids
        ],
        "others": len(scene.actors) - len(solids),
    }


def sampled(values: ArrayLike | None) -> list[float]:
    """Some values of an array, to seven digits; NaN stays NaN."""
    flat: Array = np.ma.filled(np.ma.asarray(values, dtype=float), np.nan).ravel()
    if not len(flat):
        return []
    places = np.unique(np.linspace(0, len(flat) - 1, SAMPLES).round().astype(int))
    return [float(f"{flat[place]:.7g}") for place in places]


def differences(then: object, now: object, where: str = "", share: float = 1e-3) -> list[str]:
    """Differences of two records: of texts and counts, and of numbers by more than a share of their list's largest."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        keys = [*then, *(key for key in now if key not in then)]
        return [
            text
            for key in keys
            for text in differences(then.get(key), now.get(key), f"{where}.{key}".strip("."), share)
        ]
    if _are_numbers(then) and _are_numbers(now):
        one, other = np.array(then, dtype=float), np.array(now, dtype=float)
        if one.shape != other.shape:
            return [f"{where}: {len(one)} numbers, {len(other)} now"]
        size = np.nanmax(np.abs(one), initial=0.0)
        if np.allclose(one, other, rtol=0.0, atol=share * size, equal_nan=True):
            return []
        return [f"{where}: {then}, now {now}"]
    if isinstance(then, list) and isinstance(now, list):
        found = [] if len(then) == len(now) else [f"{where}: {len(then)} entries, {len(now)} now"]
        pairs = enumerate(zip(then, now, strict=False))
        return found + [text for k, (a, b) in pairs for text in differences(a, b, f"{where}[{k}]", share)]
    return [] if then == now else [f"{where}: {then!r}, now {now!r}"]


def _are_numbers(value: object) -> bool:
    return (
        isinstance(value, Sequence)
        and not isinstance(value, str)
        and bool(value)
        and all(isinstance(one, int | float) and not isinstance(one, bool) for one in value)
    )
