"""Plots of a parameter study: every summary over the varied keys."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fieldmap.plot.style import new_figure, save_figure
from fieldmap.plot.words import unit_in_words, with_unit
from fieldmap.studies.quantities import QUANTITIES, Quantity
from fieldmap.typing import PathLike

_LABELS = {
    "common_current": "mean current",
    "equilibrium_x": "equilibrium $x$",
    "equilibrium_y": "equilibrium $y$",
    "stiffness_x": "stiffness $k_x$",
    "stiffness_y": "stiffness $k_y$",
    "stiffness_z": "stiffness $k_z$",
    "equilibrium_area": "equilibrium area",
    "reach_height": "reach, lowest $z$",
    "reachable_share": "reachable share of workspace",
    "largest_flux_density": "largest $B$ in the iron",
    "error_flux_density": "estimated error of $B$",
}
_STYLES = ("-", "--", ":", "-.")
_MARKERS = "osD^v"
_PANEL = (3.1, 2.4)
_COLUMNS = 3


def save_study_plot(data: Any, path: PathLike) -> Path | None:
    """Draw every scalar summary of a study into a PNG file.

    The first varied key is the abscissa, the second the colour, all others and the currents the line style;
    variants listed one by one stand side by side.

    Parameters
    ----------
    data
        The study's data set (xarray.Dataset).
    path
        Path of the file.

    Returns
    -------
    Path | None
        The path; None if there is no summary to draw.
    """
    shown = [q for q in QUANTITIES if q.name in _LABELS and q.name in data and _is_something(data, q)]
    if not shown:
        return None
    return save_figure(study_figure(data, shown), path)


def _is_something(data: Any, quantity: Quantity) -> bool:
    """Whether there are finite numbers larger than rounding errors."""
    values = quantity.printed[0] * data[quantity.name].values
    return bool((np.abs(values[np.isfinite(values)]) > 1e-6).any())


def study_figure(data: Any, shown: list[Quantity]) -> Figure:
    """The figure with one panel for each quantity."""
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    first = "common_current" if "common_current" in data else shown[0].name
    with new_figure((_PANEL[0] * columns + 0.4, _PANEL[1] * rows + 0.9)) as figure:
        for k, quantity in enumerate(shown):
            axes = figure.add_subplot(rows, columns, k + 1)
            _panel(axes, data, quantity, data[first].dims[0])
        handles, labels = axes.get_legend_handles_labels()
        if len(labels) > 1:
            figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(labels)))
        words = [study_message(data, shown[0]), data.attrs.get("title", "")]
        figure.suptitle("\n".join(text for text in words if text))
    return figure


def study_message(data: Any, quantity: Quantity) -> str:
    """Sentence with the variant at which the first summary is least."""
    values = quantity.printed[0] * data[quantity.name]
    if not bool(np.isfinite(values.values).any()):
        return ""
    least = {axis: int(k) for axis, k in values.argmin(dim=...).items()}
    at = ", ".join(_named(data, axis, k) for axis, k in least.items() if len(data[axis]) > 1)
    least_value = f"{float(values.isel(least)):.3g} {unit_in_words(quantity.printed_unit)}".rstrip()
    return f"Least {_LABELS[quantity.name]}: {least_value}" + (f" at {at}" if at else "")


def _panel(axes: Axes, data: Any, quantity: Quantity, abscissa: str) -> None:
    factor = quantity.printed[0]
    along = data[abscissa].values
    numbers = along.dtype.kind in "fiu"
    x = along if numbers else np.arange(len(along))
    for line, colour, style, marker, label in _lines(data, quantity.name, abscissa):
        axes.plot(x, factor * line, style, marker=marker, markersize=4, color=colour, label=label)
    axes.set_ylabel(with_unit(_LABELS[quantity.name], quantity.printed_unit), fontsize=8)
    axes.set_xlabel(with_unit(abscissa, data[abscissa].attrs.get("units", "")), fontsize=8)
    if not numbers:
        axes.set_xticks(x, [str(text) for text in along], rotation=30, ha="right")
    axes.tick_params(labelsize=8)
    axes.margins(y=0.12)
    room = 0.06 * max(float(np.ptp(x)), 1e-9 if len(x) > 1 else 1.0)
    axes.set_xlim(float(np.min(x)) - room, float(np.max(x)) + room)


def _lines(data: Any, name: str, abscissa: str) -> Iterator[tuple[Any, Any, str, str, str]]:
    """Values, colour, style, marker and label of every line of a panel."""
    variable = data[name]
    others = [axis for axis in variable.dims if axis != abscissa]
    coloured = others[0] if len(others) > 1 else None
    styled = [axis for axis in others if axis != coloured]
    count = len(data[coloured]) if coloured else 1
    # Perceptually uniform, without the light end, which is hardly visible on white.
    shades = colormaps["viridis"](np.linspace(0.0, 0.82, count))
    combinations = list(itertools.product(*(range(len(data[axis])) for axis in styled)))
    for j, places in enumerate(combinations):
        for k in range(count):
            at = dict(zip(styled, places, strict=True)) | ({coloured: k} if coloured else {})
            words = [_named(data, axis, k) for axis, k in at.items() if len(data[axis]) > 1]
            shade = shades[k] if coloured else colormaps["viridis"](0.82 * j / max(len(combinations) - 1, 1))
            yield (
                variable.isel(at).transpose(abscissa).values,
                shade,
                _STYLES[j % len(_STYLES)],
                _MARKERS[j % len(_MARKERS)],
                ", ".join(reversed(words)),
            )


def _named(data: Any, axis: str, k: int) -> str:
    value = data[axis].values[k]
    if axis == "currents":
        return f"currents {value}"
    unit = unit_in_words(data[axis].attrs.get("units", ""))
    shown = str(value) if isinstance(value, str) else f"{value:g}"
    return f"{axis} {shown} {unit}".strip()
