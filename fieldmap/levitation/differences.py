"""Second gradient by central differences, for a solved device that offers field and gradient only."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.typing import Array


class _Solved(Protocol):
    @property
    def coil_names(self) -> tuple[str, ...]: ...

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array: ...

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array: ...


class DifferencedField:
    """A solution with exact field and gradient, seen as a `LevitationField` inside a box.

    lower, upper (3,): the box, m. step: half the distance of the two gradients that are differenced, m; the
    error of the second gradient is O(step^2) and O(rounding / step), some 1e-6 of it at 0.1 mm and 0.1 m
    from the iron. The field must hold a step beyond the box.
    """

    def __init__(self, solution: _Solved, lower: ArrayLike, upper: ArrayLike, step: float = 1e-4) -> None:
        self.solution = solution
        self.lower = np.asarray(lower, dtype=float)
        self.upper = np.asarray(upper, dtype=float)
        self.step = step

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.solution.coil_names

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""
        return self.solution.field(points, currents)

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self.solution.gradient(points, currents)

    def second_gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2; last index is the differenced one."""
        at = np.atleast_2d(np.asarray(points, dtype=float))
        steps = self.step * np.eye(3)
        shifted = np.concatenate([at + steps[:, None, :], at - steps[:, None, :]]).reshape(-1, 3)
        gradient = self.solution.gradient(shifted, currents).reshape(2, 3, len(at), 3, 3)
        return np.moveaxis((gradient[0] - gradient[1]) / (2.0 * self.step), 0, -1)
