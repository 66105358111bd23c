"""Closed formulas for the force of one electromagnet on a levitated dipole, as the thesis's chapter 4 assumes them.

Depth z is positive downwards from the pole piece, as there; forces in N. They are fits, not physics: how far they
hold is measured in docs/theory/force_formulas.md.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.typing import Array


@dataclass(frozen=True)
class HorizontalForce:
    """F_x = side [ -I I0 L0 / (2 b (1 + z/a + side (x - x0)/b + |y|/d)^2) + c I/I0 ].

    side 1 is (4-7), (4-5) at I = I0, and (4-9) with x0 = 0; side -1 is the mirror image (4-8). inductance L0 in H,
    lengths a, b, x0 in m, offset c in N, nominal_current I0 in A; d in m, or infinity where y plays no part. Singular
    where the bracket of the denominator vanishes.

    >>> force = HorizontalForce(-2e-13, 0.22, 0.05, -0.08, x0=-0.17, nominal_current=1e6)  # Table 4-2
    >>> round(float(force(0.0, 0.125, 1e6)), 5), round(float(force.mirrored()(0.0, 0.125, 1e6)), 5)
    (0.00103, -0.00103)
    """

    inductance: float
    a: float
    b: float
    c: float
    x0: float = 0.0
    nominal_current: float = 1.0
    d: float = np.inf
    side: int = 1

    def bracket(self, x: ArrayLike, z: ArrayLike, y: ArrayLike = 0.0) -> Array:
        """1 + z/a + side (x - x0)/b + |y|/d; the formula has a pole where it is 0."""
        along = self.side * (np.asarray(x, dtype=float) - self.x0)
        return 1.0 + np.asarray(z, dtype=float) / self.a + along / self.b + np.abs(y) / self.d

    def __call__(self, x: ArrayLike, z: ArrayLike, current: float, y: ArrayLike = 0.0) -> Array:
        """Force (n,) in N at positions (n,) in m, current in A."""
        attraction = -current * self.nominal_current * self.inductance / (2.0 * self.b)
        force = attraction / self.bracket(x, z, y) ** 2 + self.c * current / self.nominal_current
        return np.asarray(self.side * force)

    def mirrored(self) -> "HorizontalForce":
        """The electromagnet at the other end of the pole piece: (4-8)."""
        return replace(self, x0=-self.x0, side=-self.side)


@dataclass(frozen=True)
class Exponential:
    """A exp(-side b (x - x0)), (4-4)."""

    amplitude: float
    decay: float
    x0: float
    side: int = 1

    def __call__(self, x: ArrayLike) -> Array:
        """Value (n,) at x (n,) in m."""
        return np.asarray(
            self.amplitude * np.exp(-self.side * self.decay * (np.asarray(x, dtype=float) - self.x0))
        )


@dataclass(frozen=True)
class VerticalForce:
    """F_z = (m(x) z + b(x)) I/I0 with exponentials m and b, (4-3), (4-4), (4-6). Upwards is positive."""

    slope: Exponential
    intercept: Exponential
    nominal_current: float

    def __call__(self, x: ArrayLike, z: ArrayLike, current: float) -> Array:
        """Force (n,) in N at positions (n,) in m, current in A."""
        line = self.slope(x) * np.asarray(z, dtype=float) + self.intercept(x)
        return np.asarray(line * current / self.nominal_current)

    def mirrored(self) -> "VerticalForce":
        """The electromagnet at the other end of the pole piece."""
        slope, intercept = (
            replace(part, x0=-part.x0, side=-part.side) for part in (self.slope, self.intercept)
        )
        return VerticalForce(slope, intercept, self.nominal_current)


@dataclass(frozen=True)
class QuadraticForce:
    """F_x = (a0 x^2 + a1 x + a2) I/I0, (4-10): coefficients for one line of constant y and z."""

    coefficients: tuple[float, float, float]
    nominal_current: float = 1.0

    def __call__(self, x: ArrayLike, current: float) -> Array:
        """Force (n,) in N at x (n,) in m."""
        a0, a1, a2 = self.coefficients
        places = np.asarray(x, dtype=float)
        return np.asarray((a0 * places**2 + a1 * places + a2) * current / self.nominal_current)
