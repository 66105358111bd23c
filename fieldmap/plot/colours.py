"""Colour bars with round limits, where the scene leaves room for them."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.plot.style import INK
from fieldmap.plot.words import decimals_of, label_step

# A line break below the title keeps it off the highest label.
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


def colour_bar_by_decades(title: str, values: ArrayLike) -> dict[str, Any]:
    """The same for positive values over several powers of ten."""
    low, high = np.log10([np.min(values), np.max(values)])
    first, last = int(np.floor(low)), max(int(np.ceil(high)), int(np.floor(low)) + 1)
    bar = _BAR | {"title": f"{title}\n", "fmt": "%g", "n_labels": last - first + 1}
    return {"clim": (10.0**first, 10.0**last), "log_scale": True, "scalar_bar_args": bar}
