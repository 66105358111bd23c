"""The difference of two fields in the box that they share."""

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.field import BaseFieldAtCurrents, FieldAtCurrents
from fieldmap.typing import Array


class FieldDifference(BaseFieldAtCurrents):
    """first - second at the same currents: a field like any other."""

    def __init__(self, first: FieldAtCurrents, second: FieldAtCurrents) -> None:
        self.first, self.second = first, second
        self.currents = first.currents

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Those of both."""
        return self.first.coil_names

    def field(self, points: ArrayLike) -> Array:
        """B of the first less that of the second (n, 3), T."""
        return np.asarray(self.first.field(points) - self.second.field(points))

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the first less that of the second (n, 3, 3), T/m."""
        return np.asarray(self.first.gradient(points) - self.second.gradient(points))


def common_box(
    first: tuple[Array, Array], second: tuple[Array, Array], names: tuple[str, str]
) -> tuple[Array, Array]:
    """Lower and upper corner (3,), m, of what two boxes, given by theirs, share. names: of both, for the message.

    Raises InputError where they share no volume.

    >>> low, high = common_box((np.zeros(3), np.ones(3)), (np.full(3, 0.5), np.full(3, 2.0)), ("a", "b"))
    >>> low.tolist(), high.tolist()
    ([0.5, 0.5, 0.5], [1.0, 1.0, 1.0])
    """
    lower, upper = np.maximum(first[0], second[0]), np.minimum(first[1], second[1])
    if (upper <= lower).any():
        boxes = ", ".join(
            f"{name} {_millimetres(low)} to {_millimetres(high)} mm"
            for name, (low, high) in zip(names, (first, second), strict=True)
        )
        remedy = "choose two maps of the same workspace, in the same frame"
        raise InputError(Problem("show, --minus", "the boxes of both must share a volume", boxes, remedy))
    return lower, upper


def check_same_coils(first: tuple[str, ...], second: tuple[str, ...], names: tuple[str, str]) -> None:
    """Both fields must take the same currents. Raises InputError."""
    if first != second:
        received = "; ".join(
            f"{name}: {', '.join(coils)}" for name, coils in zip(names, (first, second), strict=True)
        )
        remedy = "compare two maps of one device"
        raise InputError(
            Problem("show, --minus", "both must have the same coils in the same order", received, remedy)
        )


def _millimetres(point: Array) -> str:
    return "(" + ", ".join(f"{1e3 * x:.6g}" for x in point) + ")"
