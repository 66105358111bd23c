"""Force balance of a rigid magnet of finite size that turns until no torque is left."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import NotConverged, Problem
from fieldmap.levitation.conventions import GRAVITY
from fieldmap.levitation.interface import LevitationField
from fieldmap.lookup.finite_magnet import FiniteMagnet
from fieldmap.typing import Array

_TORQUE = 1e-8
"""Largest torque left, over moment times field; less is noise where a map jumps between its cells."""
_TURNS = 60


class _BothAtOnce:
    """A `LevitationField` as `FiniteMagnet` asks for it."""

    def __init__(self, source: LevitationField) -> None:
        self.source = source
        self.coil_names, self.lower, self.upper = source.coil_names, source.lower, source.upper

    def field_and_gradient(self, points: ArrayLike, currents: ArrayLike) -> tuple[Array, Array]:
        """B (n, 3) and G (n, 3, 3)."""
        return self.source.field(points, currents), self.source.gradient(points, currents)


@dataclass(eq=False)
class RigidBalance:
    """Magnetic force and weight of a rigid magnet, integrated over its volume, at fixed currents.

    The magnet turns about its centre until T = 0, docs/theory/equilibrium.md (8). lever: how far the centre of mass
    of the levitated body lies below the magnet's centre, along the magnet's axis, m; its weight uprights the magnet.
    sign: +1 for a moment that begins upward, -1 downward. step: half the distance over which forces are differenced
    for the stiffness, m. `evaluations` counts places of the magnet.
    """

    source: LevitationField
    currents: Array
    mass: float
    magnet: FiniteMagnet
    lever: float = 0.0
    sign: float = 1.0
    step: float = 2e-4
    evaluations: int = field(default=0)

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.mass * GRAVITY

    def moments(self, points: Array) -> Array:
        """Moment (n, 3) at points (n, 3) once the magnet has turned, A m^2."""
        return self.magnet.moment * self.axes(points)

    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3) with the centre at points (n, 3), N."""
        return self._wrench(points, self.axes(points))[:, :3]

    def residual(self, points: Array) -> Array:
        """Magnetic force plus weight (n, 3), N."""
        force = self.magnetic_force(points)
        force[:, 2] -= self.weight
        return force

    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at one position (3,), N/m, the magnet turning as it moves; by central differences."""
        steps = self.step * np.eye(3)
        forces = self.magnetic_force(np.concatenate([position + steps, position - steps]))
        return -(forces[:3] - forces[3:]).T / (2.0 * self.step)

    def axes(self, points: Array) -> Array:
        """Unit vectors (n, 3) along the moment at which no torque is left. Raises NotConverged."""
        axis = np.tile([0.0, 0.0, self.sign], (len(points), 1))
        flux = self.source.field(points, self.currents)
        restoring = self.magnet.moment * np.linalg.norm(flux, axis=1) + self.weight * self.lever
        for _ in range(_TURNS):
            torque = self._wrench(points, axis)[:, 3:] + self.sign * self.weight * self.lever * _cross_up(
                axis
            )
            if (np.linalg.norm(torque, axis=1) <= _TORQUE * restoring).all():
                return axis
            # A turn by torque over the restoring moment of a small tilt: Newton's step but for the field's gradient.
            axis = axis + np.cross(torque, axis) / restoring[:, None]
            axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        raise NotConverged(
            Problem(
                "rigid magnet",
                f"the torque must fall to {_TORQUE:g} of moment times field",
                f"{np.max(np.linalg.norm(torque, axis=1) / restoring):.1e} after {_TURNS} turns",
                "choose places where the field is not weak, or moment='fixed'",
            )
        )

    def _wrench(self, points: Array, axis: Array) -> Array:
        self.evaluations += len(points)
        return self.magnet.wrench(_BothAtOnce(self.source), points, self.currents, _frames(axis))


def _cross_up(axis: Array) -> Array:
    """axis x e_z: the torque of a unit weight that hangs a unit length below the centre, along the axis."""
    return np.stack([axis[:, 1], -axis[:, 0], np.zeros(len(axis))], axis=1)


def _frames(axis: Array) -> Array:
    """Rotations (n, 3, 3) whose third column is the axis, without a twist about it (Rodrigues's formula)."""
    up = np.where(axis[:, 2] >= 0.0, 1.0, -1.0)
    c = np.abs(axis[:, 2])
    # The rotation that takes up * e_z to the axis; a magnet that hangs downward is turned about x first.
    v = np.stack([-axis[:, 1] * up, axis[:, 0] * up, np.zeros(len(axis))], axis=1)
    cross = np.zeros((len(axis), 3, 3))
    cross[:, 0, 2], cross[:, 1, 2] = v[:, 1], -v[:, 0]
    cross[:, 2, 0], cross[:, 2, 1] = -v[:, 1], v[:, 0]
    turn = np.eye(3) + cross + np.einsum("nij,njk->nik", cross, cross) / (1.0 + c)[:, None, None]
    turn[up < 0] = turn[up < 0] @ np.diag([1.0, -1.0, -1.0])
    return turn
