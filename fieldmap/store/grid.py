"""Where the nodes of a map are."""

from dataclasses import dataclass

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Grid(Record):
    """Regular grid of nodes: lower (3,) in m, spacing (3,) in m, shape (nx, ny, nz), each at least 2.

    Node (i, j, k) lies at lower + (i, j, k) * spacing; arrays over the grid are in C order of x, y, z.
    Raises InputError if a number is not finite, a spacing not positive or a shape below 2.

    >>> Grid([0, 0, 0], [0.1, 0.1, 0.1], (3, 2, 2)).points()[1]
    array([0. , 0. , 0.1])
    """

    lower: Array
    spacing: Array
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        lower = np.array(self.lower, dtype=np.float64)
        spacing = np.array(self.spacing, dtype=np.float64)
        shape = tuple(int(n) for n in self.shape)
        _check(
            "lower", lower.shape == (3,) and bool(np.isfinite(lower).all()), "three finite numbers, m", lower
        )
        positive = spacing.shape == (3,) and bool(np.isfinite(spacing).all()) and bool((spacing > 0).all())
        _check("spacing", positive, "three positive numbers, m", spacing)
        _check("shape", len(shape) == 3 and min(shape) >= 2, "three whole numbers of at least 2", shape)
        lower.flags.writeable = spacing.flags.writeable = False
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "spacing", spacing)
        object.__setattr__(self, "shape", shape)

    @property
    def upper(self) -> Array:
        """Last node (3,), m."""
        return self.lower + (np.array(self.shape) - 1) * self.spacing

    @property
    def size(self) -> int:
        """Number of nodes."""
        nx, ny, nz = self.shape
        return nx * ny * nz

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Node coordinates along x, y and z, m."""
        x, y, z = (self.lower[a] + np.arange(self.shape[a]) * self.spacing[a] for a in range(3))
        return x, y, z

    def points(self, first: int = 0, last: int | None = None) -> Array:
        """Nodes (n, 3) of the x-planes first <= i < last (all of them by default), m."""
        x, y, z = self.axes
        mesh = np.meshgrid(x[first:last], y, z, indexing="ij")
        return np.stack([axis.ravel() for axis in mesh], axis=1)


def _check(name: str, good: bool, must_hold: str, received: object) -> None:
    if not good:
        problem = Problem(
            f"Grid, {name}", must_hold, str(received), "give the grid three axes with nodes on each"
        )
        raise InputError(problem)
