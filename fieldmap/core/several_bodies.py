"""Bodies that act on each other in the field of one machine, as the C core moves them
(fieldmap/core/several_bodies.h)."""

from collections.abc import Sequence

from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import BodyNumbers, CoreMachine
from fieldmap.typing import Array

ON_BODY: int = LIBRARY.ON_BODY
"""Of what is touched: another body."""
UNSETTLED: int = LIBRARY.UNSETTLED
"""Status where the moments of soft iron come to no end, because bodies overlap."""


class CoreSeveralBodies:
    """Bodies, for one thread at a time: they remember the field of the last currents, which follows them as that of
    `machine`, whose own body is not used. radii (n,), m: of the spheres with which bodies touch each other, 0 for none;
    contact (9,): as walls of `BodyNumbers`, per kg of the reduced mass of two. states (n, 13)."""

    def __init__(
        self, machine: CoreMachine, bodies: Sequence[BodyNumbers], radii: Array, contact: Array
    ) -> None:
        self.bodies = LIBRARY.several_bodies(machine.machine, tuple(bodies), radii, contact)

    def follow(self, currents: Array) -> bool:
        """As `CoreMachine.follow`."""
        return bool(LIBRARY.several_follow(self.bodies, currents))

    def wrench(self, states: Array, wrench: Array) -> tuple[int, float]:
        """Fill wrench (n, 6) of the field on each body about its centre of mass, frame of the map; a status, and the
        energy of all in the field and in each other's, J."""
        status, energy = LIBRARY.several_wrench(self.bodies, states, wrench)
        return status, energy

    def fault(self) -> tuple[int, Array]:
        """After another status than `INSIDE`: the number of the body, and where in the map (3,), m."""
        number, place = LIBRARY.several_fault(self.bodies)
        return number, place

    def move(self, states: Array, step: float, every: int, order: int, rows: Array) -> tuple[int, int, int]:
        """As `CoreMachine.move`: advance states and fill rows (m, n, 13)."""
        filled, status, touched = LIBRARY.several_move(self.bodies, states, step, every, order, rows)
        return filled, status, touched
