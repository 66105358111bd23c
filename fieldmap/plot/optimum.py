"""Pictures of an optimisation: its path, the trade-off with each limit, and the machine before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fieldmap.device.model import Device
from fieldmap.plot.device_drawing import device_scene
from fieldmap.plot.picture import extent_seen, look_at
from fieldmap.plot.rendering import new_scene
from fieldmap.plot.solids import extent
from fieldmap.plot.style import COLOURS, INK, QUIET, new_figure, save_figure, save_screenshot
from fieldmap.plot.words import fitting_prefix, unit_in_words, with_unit
from fieldmap.studies.optimum import LimitAtOptimum, Optimum
from fieldmap.studies.quantities import QUANTITIES
from fieldmap.typing import Array, Index, PathLike

_PANEL = (4.4, 3.3)
_BLUE, _ORANGE, *_ = COLOURS
# Ratio of the largest to the smallest number of an axis above which the axis is logarithmic.
_WIDE = 20.0
# Units that take a prefix for short numbers. Areas do not, because their prefix would be squared.
_PREFIXED = ("T", "A", "W", "H", "N", "K")
_SMALLEST_PICTURE, _TALLEST_PICTURE = 500, 1500
_QUANTITIES = {one.name: one for one in QUANTITIES}


def save_optimum_plot(found: Optimum, path: PathLike) -> Path:
    """Draw `optimum_figure` into a PNG file.

    Parameters
    ----------
    found
        The best design.
    path
        Path of the file.

    Returns
    -------
    Path
        The path.
    """
    return save_figure(optimum_figure(found), path)


def optimum_figure(found: Optimum) -> Figure:
    """All solved designs: objective and variables in the order of the search, and for each limit the objective over the
    limited number, with the Pareto front.

    Filled points meet all limits, hollow ones do not; crosses could not be solved. Designs of the check on a finer mesh
    are left out, because their numbers have the error of another mesh. Printed units.
    """
    count = 2 + len(found.limits)
    columns = 2 if count == 4 else min(count, 3)
    rows = -(-count // columns)
    with new_figure((_PANEL[0] * columns, _PANEL[1] * rows + 0.6)) as figure:
        panels = [figure.add_subplot(rows, columns, k + 1) for k in range(count)]
        designs = _Designs(found)
        _objective(panels[0], designs)
        _variables(panels[1], designs)
        for axes, limit in zip(panels[2:], found.limits, strict=True):
            _trade_off(axes, designs, limit)
        known: dict[str, Any] = {}
        for axes in (panels[0], *panels[2:]):
            known |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
        figure.suptitle(f"{optimum_message(found)}\n{found.title}".rstrip())
    return figure


def optimum_message(found: Optimum) -> str:
    """The objective at the start and at the best design, in words."""
    factor, unit = _printed(found, found.objective)
    before, after = (f"{factor * value:.4g}" for value in (found.start_value, found.value))
    label = _words(found.objective)
    return f"{label[:1].upper()}{label[1:]}: {before} at the start, {after} {unit}".rstrip() + " at the best"


def undominated(first: Array, second: Array) -> Index:
    """Indices, by rising `first`, of the pairs (n,), (n,) for which no other pair is smaller in both numbers.

    >>> undominated(np.array([1.0, 2.0, 3.0, 2.5]), np.array([5.0, 3.0, 4.0, 1.0])).tolist()
    [0, 1, 3]
    """
    order = np.lexsort((second, first))
    least = np.minimum.accumulate(np.concatenate([[np.inf], second[order]]))[:-1]
    return order[second[order] < least]


class _Designs:
    """The designs of the search, without those of the check, as arrays."""

    def __init__(self, found: Optimum) -> None:
        self.found, self.steps = found, [step for step in found.path if step.role != "check"]
        self.number = np.arange(1.0, len(self.steps) + 1.0)
        self.feasible = np.array([step.feasible for step in self.steps], dtype=bool)
        self.failed = np.array([bool(step.failure) for step in self.steps], dtype=bool)
        same = [all(step.values[key] == value for key, value in found.values.items()) for step in self.steps]
        self.best = same.index(True) if any(same) else None

    def numbers(self, label: str) -> Array:
        """A number of every design, in printed units; NaN if the design could not be solved."""
        factor = _printed(self.found, label)[0]
        return factor * np.array([step.numbers.get(label, np.nan) for step in self.steps])

    def draw(self, axes: Axes, x: Array, label: str) -> Array:
        """Draw points of a number of every design over x. Returns the numbers (n,)."""
        y, meets = self.numbers(label), self.feasible
        if (~meets & ~self.failed).any():
            axes.plot(x[~meets], y[~meets], "o", color=QUIET, markerfacecolor="none", label="misses a limit")
        axes.plot(x[meets], y[meets], "o", color=_BLUE, label="meets all limits")
        if self.best is not None:
            axes.plot(x[self.best], y[self.best], "*", color=_ORANGE, markersize=13, label="best")
        axes.set_ylabel(_axis(self.found, label))
        return y


def _objective(axes: Axes, designs: _Designs) -> None:
    values = designs.draw(axes, designs.number, designs.found.objective)
    meets = np.where(designs.feasible, values, np.nan)
    best = (np.fmax if designs.found.maximise else np.fmin).accumulate(meets)
    axes.plot(designs.number, best, ":", color=_BLUE, drawstyle="steps-post", label="best so far")
    if designs.failed.any():
        at = designs.number[designs.failed]
        low = axes.get_ylim()[0]
        axes.plot(at, np.full(len(at), low), "x", color=QUIET, clip_on=False, label="could not be solved")
        # Crosses are at the lower edge and must not move it.
        axes.set_ylim(bottom=low)
    axes.set_xlabel("design")


def _variables(axes: Axes, designs: _Designs) -> None:
    """Draw the variables as shares of their ranges; the legend has the best values."""
    for k, one in enumerate(designs.found.variables):
        values = np.array([step.values[one.key] for step in designs.steps])
        share = 100.0 * (values - one.lower) / (one.upper - one.lower)
        words = f"{one.key} = {designs.found.values[one.key]:.4g}"
        axes.plot(designs.number, share, ".-", color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=words)
    axes.set(ylim=(-3.0, 103.0), xlabel="design", ylabel="variables, % of their range")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)


def _trade_off(axes: Axes, designs: _Designs, limit: LimitAtOptimum) -> None:
    found, numbers = designs.found, designs.numbers(limit.number)
    values = designs.draw(axes, numbers, found.objective)
    known = np.flatnonzero(np.isfinite(numbers) & np.isfinite(values))
    side = 1.0 if np.isfinite(limit.upper) else -1.0
    better = -1.0 if found.maximise else 1.0
    front = known[undominated(side * numbers[known], better * values[known])]
    front = front[np.argsort(numbers[front])]
    words = "no other is better in both"
    axes.plot(numbers[front], values[front], "-", color=_BLUE, linewidth=1.0, label=words)
    factor = _printed(found, limit.number)[0]
    for bound in (limit.lower, limit.upper):
        if np.isfinite(bound):
            axes.axvline(factor * bound, color=INK, linestyle="--", linewidth=1.0, label="limit")
    if known.size and 0.0 < _WIDE * numbers[known].min() < numbers[known].max():
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel(_axis(found, limit.number))


def _printed(found: Optimum, label: str) -> tuple[float, str]:
    """Factor and unit of a number by its name, with a prefix that fits its value at the best design; 1 and "" for a
    number that studies do not have."""
    known = _QUANTITIES.get(label.split(" ")[0].split(",")[0])
    if known is None:
        return 1.0, ""
    unit = unit_in_words(known.printed_unit)
    if unit not in _PREFIXED:
        return known.printed[0], unit
    at_best = {found.objective: found.value} | {one.number: one.value for one in found.limits}
    prefix, factor = fitting_prefix(abs(at_best[label]))
    return factor, f"{prefix}{unit}"


def _words(label: str) -> str:
    return label.replace("_", " ")


def _axis(found: Optimum, label: str) -> str:
    return with_unit(_words(label), _printed(found, label)[1])


def save_before_and_after(
    before: Device,
    after: Device,
    path: PathLike,
    captions: tuple[str, str] = ("before", "after"),
    width: int = 2000,
) -> Path:
    """Draw two devices side by side, from one place and at one scale, and save it as PNG.

    Parameters
    ----------
    before, after
        The devices.
    path
        Path of the picture.
    captions
        One or more lines above each device.
    width
        Width of the picture, pixels; the height follows from the devices.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    FieldmapError
        On a machine without OpenGL.

    Examples
    --------
    >>> import fieldmap as fm                                                     # doctest: +SKIP
    >>> thick = fm.read_device("drive_unit", {"parameters.disk": 12})             # doctest: +SKIP
    >>> save_before_and_after(fm.read_device("drive_unit"), thick, "disks.png")   # doctest: +SKIP
    """
    scene = new_scene((width, width // 2), panels=2)
    boxes = []
    for k, (device, words) in enumerate(zip((before, after), captions, strict=True)):
        scene.subplot(0, k)
        device_scene(device, plotter=scene, axes=False, names=False)
        scene.add_text(words, position="upper_left", font_size=13, color=INK)
        boxes.append(extent(scene))
    lower, upper = np.minimum(*boxes)[:, 0], np.maximum(*boxes)[:, 1]
    together = np.column_stack([lower, upper])
    across, along = extent_seen(together)
    height = int(np.clip(0.5 * width * 1.4 * along / across, _SMALLEST_PICTURE, _TALLEST_PICTURE))
    scene.window_size = [width, height]
    for k in range(2):
        scene.subplot(0, k)
        look_at(scene, together, margin=0.3)
    save_screenshot(scene, path)
    scene.close()
    return Path(path)
