"""Bodies that act on each other in the field of one machine: fieldmap/core/several_bodies.h."""

from collections.abc import Sequence

from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import BodyNumbers, CoreMachine
from fieldmap.typing import Array

ON_BODY: int = LIBRARY.ON_BODY
"""Contact flag: another body."""
UNSETTLED: int = LIBRARY.UNSETTLED
"""Status: the moments of soft iron do not converge, because bodies overlap."""


class CoreSeveralBodies:
    """Bodies, for one thread at a time: they store the field of the last currents. The field is that of `machine`,
    whose own body is not used. radii (n,), m: of the spheres with which bodies touch each other, 0 for no contact;
    contact (9,): as walls of `BodyNumbers`, with stiffness and damping per kg of the reduced mass of a pair. states
    (n, 13)."""

    def __init__(
        self, machine: CoreMachine, bodies: Sequence[BodyNumbers], radii: Array, contact: Array
    ) -> None:
        self.bodies = LIBRARY.several_bodies(machine.machine, tuple(bodies), radii, contact)

    def follow(self, currents: Array) -> bool:
        """As `CoreMachine.follow`."""
        return bool(LIBRARY.several_follow(self.bodies, currents))

    def wrench(self, states: Array, wrench: Array) -> tuple[int, float]:
        """Fill wrench (n, 6) on each body about its centre of mass, frame of the map. Returns a status, and the
        energy of all bodies in the field and in the fields of each other, J."""
        status, energy = LIBRARY.several_wrench(self.bodies, states, wrench)
        return status, energy

    def fault(self) -> tuple[int, Array]:
        """Return the number of the body and the point in the map (3,), m, of a status other than `INSIDE`."""
        number, place = LIBRARY.several_fault(self.bodies)
        return number, place

    def move(self, states: Array, step: float, every: int, order: int, rows: Array) -> tuple[int, int, int]:
        """As `CoreMachine.move`: advance states and fill rows (m, n, 13)."""
        filled, status, touched = LIBRARY.several_move(self.bodies, states, step, every, order, rows)
        return filled, status, touched
