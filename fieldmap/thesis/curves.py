"""Figures as data: what is drawn over what, in which units, and whose it is."""

import re
from dataclasses import dataclass

import numpy as np

from fieldmap.typing import Array

SERIES_KINDS = ("ours", "thesis", "measured", "asked")


@dataclass(frozen=True, eq=False)
class Series:
    """One line or set of points of a figure.

    name: what it is, for the legend; series of the same name get the same colour. x, y (n,): in the units of the
    figure's labels; NaN interrupts a line. kind: "ours", "thesis" (computed or printed there), "measured" (there) or
    "asked": the reference of a control loop.
    points: marks in the place of a line.
    """

    name: str
    x: Array
    y: Array
    kind: str = "ours"
    points: bool = False

    def __post_init__(self) -> None:
        x, y = np.asarray(self.x, dtype=float), np.asarray(self.y, dtype=float)
        if x.ndim != 1 or x.shape != y.shape:
            raise ValueError(f"Series {self.name!r}: x and y must be (n,); received {x.shape} and {y.shape}")
        if self.kind not in SERIES_KINDS:
            raise ValueError(
                f"Series {self.name!r}: kind must be one of {SERIES_KINDS}; received {self.kind!r}"
            )
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "y", y)


@dataclass(frozen=True, eq=False)
class Curves:
    """One figure.

    title: begins with the figures of the thesis that it stands for, if any: "Figs 5-6 to 5-8, 5-10: ...". Labels carry
    the unit: "depth below the core (mm)". remark: a sentence below it; log_y: y by decades; equal: one unit as long
    along x as along y.

    >>> measured = Series("depth 10 mm", [0.0, 1.0], [0.1, 2.3], kind="measured", points=True)
    >>> Curves("Figs 2-9, 6-5 to 6-7: shift", "x control signal (1)", "x (mm)", (measured,)).figures
    ('2-9', '6-5', '6-6', '6-7')
    """

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    remark: str = ""
    log_y: bool = False
    equal: bool = False

    @property
    def figures(self) -> tuple[str, ...]:
        """Numbers of the thesis's figures that the title begins with; none where it begins with something else."""
        led = re.match(r"Figs?\.? ([\d, to-]+):", self.title)
        return tuple(number for part in led[1].split(", ") for number in _each(part)) if led else ()


def _each(part: str) -> list[str]:
    """ "5-6 to 5-8" as single numbers."""
    first, _, last = part.partition(" to ")
    if not last:
        return [first]
    chapter, begin = first.split("-")
    return [f"{chapter}-{number}" for number in range(int(begin), int(last.split("-")[1]) + 1)]
