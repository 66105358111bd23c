"""The force balance of one magnet at fixed currents, as the root finder sees it."""

from dataclasses import dataclass, field

import numpy as np

from fieldmap.levitation.conventions import GRAVITY
from fieldmap.levitation.dipole import aligned_stiffness, dipole_force, dipole_stiffness
from fieldmap.levitation.interface import LevitationField
from fieldmap.typing import Array


@dataclass(eq=False)
class Balance:
    """Magnetic force and weight of a magnet of given moment in a field at fixed currents.

    fixed_moment (3,) in A m^2, or None for a moment that stays parallel to B. `evaluations` counts field
    points.
    """

    source: LevitationField
    currents: Array
    mass: float
    magnitude: float
    fixed_moment: Array | None
    evaluations: int = field(default=0)

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.mass * GRAVITY

    def moments(self, points: Array) -> Array:
        """Moment (n, 3) at points (n, 3), A m^2."""
        if self.fixed_moment is not None:
            return np.broadcast_to(self.fixed_moment, points.shape)
        b = self.source.field(points, self.currents)
        norm = np.linalg.norm(b, axis=-1, keepdims=True)
        # Where B = 0 an aligned dipole has no direction; it feels no force there.
        return np.divide(self.magnitude * b, norm, out=np.zeros_like(b), where=norm > 0.0)

    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3) at points (n, 3), N."""
        self.evaluations += len(points)
        return dipole_force(self.moments(points), self.source.gradient(points, self.currents))

    def residual(self, points: Array) -> Array:
        """Magnetic force plus weight (n, 3), N."""
        force = self.magnetic_force(points)
        force[:, 2] -= self.weight
        return force

    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at one position (3,), N/m."""
        point = position[None, :]
        second = self.source.second_gradient(point, self.currents)[0]
        if self.fixed_moment is not None:
            return dipole_stiffness(self.fixed_moment, second)
        b = self.source.field(point, self.currents)[0]
        return aligned_stiffness(self.magnitude, b, self.source.gradient(point, self.currents)[0], second)
