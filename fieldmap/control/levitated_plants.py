"""Plants of a levitated body, linear about its equilibrium: from a map's forces, or from the lumped model."""

from dataclasses import dataclass

import numpy as np
import scipy.constants
from numpy.typing import NDArray

from fieldmap.arguments import check_not_negative, check_numbers, check_positive
from fieldmap.control.linear_models import StateSpace

Array = NDArray[np.float64]


def levitated_plant(
    mass: float, stiffness: float, force_per_ampere: float, damping: float = 0.0
) -> StateSpace:
    """m d2x/dt2 = -stiffness x - damping dx/dt + force_per_ampere i, with the states (x, dx/dt) and the output x.

    mass kg; stiffness = -dF/dx N/m (negative: unstable); force_per_ampere N/A; damping N s/m. One axis of an
    `Equilibrium` or `LiftCurrent`: its diagonal of `stiffness`, its entry of `force_per_ampere`. Raises InputError.

    >>> levitated_plant(mass=0.01, stiffness=-4.0, force_per_ampere=0.1).A.tolist()
    [[0.0, 1.0], [400.0, -0.0]]
    """
    check_positive("levitated_plant", mass=mass)
    check_numbers("levitated_plant", stiffness=stiffness, force_per_ampere=force_per_ampere, damping=damping)
    A = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])
    return StateSpace(A, np.array([[0.0], [force_per_ampere / mass]]), np.eye(1, 2), np.zeros((1, 1)))


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
