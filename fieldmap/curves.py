"""Figures as data: which series are drawn over which axes, in which units, and where each comes from."""

from dataclasses import dataclass

import numpy as np

from fieldmap.records import Record
from fieldmap.typing import Array

SERIES_KINDS = ("ours", "published", "measured", "asked")


@dataclass(frozen=True, eq=False, repr=False)
class Series(Record):
    """One line or set of points of a figure.

    name: for the legend; series of the same name get the same colour. x, y (n,): in the units of the figure's labels;
    NaN interrupts a line. kind: "ours", "published" (computed or printed in a publication), "measured", or "asked" (the
    reference of a control loop). points: marks in the place of a line. Raises ValueError for other shapes and kinds.
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


@dataclass(frozen=True, eq=False, repr=False)
class Curves(Record):
    """One figure.

    Labels carry the unit: "depth below the core (mm)". remark: a sentence below the figure; log_y: y by decades; equal:
    one unit as long along x as along y.

    >>> measured = Series("depth 10 mm", [0.0, 1.0], [0.1, 2.3], kind="measured", points=True)
    >>> Curves("Shift", "x control signal (1)", "x (mm)", (measured,)).series[0].kind
    'measured'
    """

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    remark: str = ""
    log_y: bool = False
    equal: bool = False
