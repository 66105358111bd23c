"""Plants of a levitated body, linear about its equilibrium: from a map's forces, or from the lumped model."""

from dataclasses import dataclass

import numpy as np
import scipy.constants
from numpy.typing import ArrayLike

from fieldmap.arguments import check_matrix, check_not_negative, check_positive
from fieldmap.control.linear_models import StateSpace


def levitated_plant(
    mass: float, stiffness: ArrayLike, force_per_ampere: ArrayLike, damping: ArrayLike = 0.0
) -> StateSpace:
    """m d2x/dt2 = -stiffness x - damping dx/dt + force_per_ampere i about an equilibrium, one axis or several.

    mass kg; stiffness = -dF/dx, N/m (negative: unstable), a number or (axes, axes); force_per_ampere, N/A, a number or
    (axes, inputs); damping, N s/m, a number or (axes, axes). States: positions, then velocities; outputs: positions.
    For one axis take the diagonal of `Equilibrium.stiffness` or `LiftCurrent.stiffness` and its entry of
    `LiftCurrent.force_per_ampere`; the whole matrix, with the force per ampere of every coil, is the linked model of
    all axes. The angle of a magnet that turns is not part of it. Raises InputError for numbers that are not finite,
    matrices that do not fit, a mass that is not positive.

    >>> levitated_plant(mass=0.01, stiffness=-4.0, force_per_ampere=0.1).A.tolist()
    [[0.0, 1.0], [400.0, -0.0]]
    """
    check_positive("levitated_plant", mass=mass)
    K = check_matrix("levitated_plant(stiffness)", stiffness, (None, None))
    axes = K.shape[0]
    K = check_matrix("levitated_plant(stiffness)", K, (axes, axes))
    force = check_matrix("levitated_plant(force_per_ampere)", force_per_ampere, (axes, None))
    given = np.asarray(damping, dtype=float)
    loss = check_matrix(
        "levitated_plant(damping)", given * np.eye(axes) if given.ndim == 0 else given, (axes, axes)
    )
    still = np.zeros((axes, axes))
    A = np.block([[still, np.eye(axes)], [-K / mass, -loss / mass]])
    B = np.vstack([np.zeros_like(force), force / mass])
    return StateSpace(A, B, np.eye(axes, 2 * axes), np.zeros((axes, force.shape[1])))


@dataclass(frozen=True)
class LumpedMagnet:
    """An electromagnet that lifts a body z below it (z downward, m): thesis (2-18)..(2-20).

    Inductance L(z) = L1 + L0 / (1 + z/a), force 1/2 dL/dz i^2. inductance: L0, H; length: a, m; mass: M, kg; damping:
    N s/m, positive where it opposes motion (in (2-20) drag is printed as M d2z/dt2 = M g + c dz/dt, so its c would be
    minus this); gravity: m/s^2.
    """

    inductance: float
    length: float
    mass: float
    damping: float = 0.0
    gravity: float = scipy.constants.g

    def __post_init__(self) -> None:
        check_positive(
            "LumpedMagnet",
            inductance=self.inductance,
            length=self.length,
            mass=self.mass,
            gravity=self.gravity,
        )
        check_not_negative("LumpedMagnet", damping=self.damping)

    def force(self, z: float, current: float) -> float:
        """Magnetic force along z, N: negative, as it pulls up. (2-18) with (2-19)."""
        return -self.inductance * current**2 / (2 * self.length * self._widening(z) ** 2)

    def acceleration(self, z: float, velocity: float, current: float) -> float:
        """d2z/dt2, m/s^2: (2-20)."""
        return self.gravity + (self.force(z, current) - self.damping * velocity) / self.mass

    def equilibrium_current(self, z: float) -> float:
        """The current that carries the weight at z, A: (1 + z/a) sqrt(2 a M g / L0), a straight line in z."""
        weight = self.mass * self.gravity
        return self._widening(z) * float(np.sqrt(2 * self.length * weight / self.inductance))

    def plant(self, z: float) -> StateSpace:
        """The motion about the equilibrium at z, current in, position out: (2-21), (2-22). Its gain is negative.

        >>> magnet = LumpedMagnet(inductance=0.01, length=0.05, mass=0.01)
        >>> bool(magnet.plant(0.02).B[1, 0] < 0 < magnet.plant(0.02).A[1, 0])
        True
        """
        current, wide = self.equilibrium_current(z), self._widening(z)
        stiffness = -self.inductance * current**2 / (self.length**2 * wide**3)
        per_ampere = -self.inductance * current / (self.length * wide**2)
        return levitated_plant(self.mass, stiffness, per_ampere, self.damping)

    def _widening(self, z: float) -> float:
        check_not_negative("LumpedMagnet", z=z)
        return 1.0 + z / self.length


def lumped_magnet_from_lift_currents(
    current_at_zero: float,
    slope: float,
    mass: float,
    damping: float = 0.0,
    gravity: float = scipy.constants.g,
) -> LumpedMagnet:
    """The lumped magnet whose equilibrium current is current_at_zero + slope z (A, A/m), as measured: (7-18).

    The model's own law is a straight line, so both constants follow: a = current_at_zero / slope and
    L0 = 2 a M g / current_at_zero^2.

    >>> magnet = lumped_magnet_from_lift_currents(1.215, 34.3, mass=0.01119)
    >>> print(round(magnet.equilibrium_current(0.010), 4), "A")
    1.558 A
    """
    where = "lumped_magnet_from_lift_currents"
    check_positive(where, current_at_zero=current_at_zero, slope=slope, mass=mass, gravity=gravity)
    length = current_at_zero / slope
    return LumpedMagnet(2 * length * mass * gravity / current_at_zero**2, length, mass, damping, gravity)
