"""Figures as data: which series are drawn over which axes, in which units, and where each comes from."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fieldmap.records import Record
from fieldmap.typing import Array

SERIES_KINDS = ("ours", "published", "measured", "asked")


@dataclass(frozen=True, eq=False, repr=False)
class Series(Record):
    """One line or set of points of a figure.

    name: for the legend; series of the same name get the same colour. x, y (n,): in the units of the figure's labels;
    NaN interrupts a line. kind: "ours", "published" (computed or printed in a publication), "measured", or "asked" (the
    reference of a control loop). points: markers instead of a line. Raises ValueError for other shapes and kinds.
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

    Labels carry the unit: "depth below the core (mm)". remark: a sentence below the figure; log_y: logarithmic y axis;
    equal: equal scales of x and y. message: the result in one line, computed from the data. Without it the figure
    states the difference between ours and published or measured series (`message_of`).

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
    message: str = ""


_FEW = 3
"""Least number of points for a comparison of two series."""
_SAME = 1e-3
"""Lines that differ by less than this share of the range count as the same."""


@dataclass(frozen=True, repr=False)
class Agreement(Record):
    """Largest difference between a line of ours and another series, over the range of the other series."""

    name: str
    kind: str
    difference: float


def agreements(curves: Curves) -> tuple[Agreement, ...]:
    """Compare every published or measured series with our line of the same name, or with our only line.

    Our line is interpolated linearly at the x of the other series that lie in its range. The difference is relative to
    the range of the compared values, extended to zero.

    >>> x = [0.0, 1.0, 2.0]
    >>> ours, theirs = Series("B", x, [0.0, 1.0, 2.2]), Series("B", x, [0.0, 1.0, 2.0], "measured", points=True)
    >>> round(agreements(Curves("t", "x (mm)", "B (T)", (ours, theirs)))[0].difference, 3)
    0.1
    """
    ours = [one for one in curves.series if one.kind == "ours" and not one.points and len(one.x) > 1]
    found = []
    for other in curves.series:
        if other.kind not in ("published", "measured"):
            continue
        partners = [one for one in ours if one.name == other.name] or (ours if len(ours) == 1 else [])
        if len(partners) != 1:
            continue
        difference = _difference(partners[0], other)
        if difference is not None:
            found.append(Agreement(other.name, other.kind, difference))
    return tuple(found)


def _difference(ours: Series, other: Series) -> float | None:
    """The largest difference, relative to the range of the other's compared values."""
    pair = _compared(ours, other)
    size = 0.0 if pair is None else _range(pair[1])
    return float(np.abs(pair[0] - pair[1]).max()) / size if pair is not None and size else None


def _range(values: Array) -> float:
    """Largest less smallest value; zero counts as a value."""
    return max(float(values.max()), 0.0) - min(float(values.min()), 0.0)


def _compared(ours: Series, other: Series) -> tuple[Array, Array] | None:
    """Our values at the other's x, and the other's values, within the range of our x."""
    known = np.isfinite(ours.x) & np.isfinite(ours.y)
    x, y = ours.x[known], ours.y[known]
    if len(x) < 2 or not (np.diff(x) > 0).all():
        return None
    within = np.isfinite(other.y) & (other.x >= x[0]) & (other.x <= x[-1])
    if within.sum() < _FEW:
        return None
    return np.interp(other.x[within], x, y), other.y[within]


def message_of(curves: Curves) -> str:
    """The worst of `agreements` in one line; for lines of ours alone, the difference between formulas and the computed
    line; empty if there is nothing to compare."""
    found = agreements(curves)
    if not found:
        return _message_of_lines(curves)
    worst = max(found, key=lambda one: one.difference)
    kinds = " and ".join(dict.fromkeys(one.kind for one in found))
    of = f" (worst: {worst.name})" if len(found) > 1 else ""
    if worst.difference > 0.5:
        return f"Ours and {kinds} are up to {percent(worst.difference)} of the range apart{of}"
    return f"Ours follows what is {kinds} within {percent(worst.difference)} of the range{of}"


def _message_of_lines(curves: Curves) -> str:
    """Whether all our lines are the same, or how far formulas are from the line named "computed"."""
    if any(one.kind != "ours" for one in curves.series):
        return ""
    lines = [one for one in curves.series if not one.points and len(one.x) > 1]
    pairs = [_compared(one, other) for one, other in combinations(lines, 2)]
    size = _range(np.concatenate([one.y[np.isfinite(one.y)] for one in lines])) if pairs else 0.0
    if size and all(pair is not None and np.abs(pair[0] - pair[1]).max() < _SAME * size for pair in pairs):
        return f"All {len(lines)} lines are the same" if len(lines) > 2 else "Both lines are the same"
    computed = next((one for one in lines if one.name == "computed"), None)
    formulas = [one for one in lines if one is not computed]
    found = [] if computed is None else [(_difference(one, computed), one.name) for one in formulas]
    known = [(difference, name) for difference, name in found if difference is not None]
    if not known:
        return ""
    worst, name = max(known)
    if len(known) > 1:
        return f"Within {percent(worst)} of the computed range (worst: {name})"
    return f"{name} is within {percent(worst)} of the computed range"


def percent(share: float) -> str:
    """A share in per cent, to two digits.

    >>> percent(0.1234), percent(0.00321), percent(1.7)
    ('12 %', '0.32 %', '170 %')
    """
    return f"{float(f'{100 * share:.2g}'):g} %"
