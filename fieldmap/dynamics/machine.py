"""A levitation machine as data: the field of the currents, body, coils, sensors, control allocation, surroundings."""

from __future__ import annotations

from dataclasses import dataclass

from fieldmap.core.closed_loop import Ending
from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import CoreMachine
from fieldmap.dynamics.allocation import ControlAllocation
from fieldmap.dynamics.drives import CoilDrive
from fieldmap.dynamics.field_of_currents import FieldOfCurrents
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.sensors import Sensors
from fieldmap.dynamics.surroundings import Drag, Plate, Walls
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record

CONTACTS = {
    "floor": LIBRARY.ON_FLOOR,
    "ceiling": LIBRARY.ON_CEILING,
    "tube": LIBRARY.ON_WALL,
    "currents": LIBRARY.BEYOND,
}


@dataclass(frozen=True, eq=False, repr=False)
class Machine(Record):
    """Everything that moves, senses and drives, but the controller.

    magnetic: the field of the currents. allocation: from the controller's outputs to the voltages of the coils. ending:
    what ends a run: the contacts "floor", "ceiling", "tube", and "currents" beyond the table of saturating iron or the
    domain of its model.
    longest_saturation: s, after which a limit of outputs, amplifiers or supply that holds without a break ends it; 0
    for never.
    """

    magnetic: FieldOfCurrents
    body: RigidBody
    drive: CoilDrive
    sensors: Sensors
    allocation: ControlAllocation
    drag: Drag | None = None
    plate: Plate | None = None
    walls: Walls | None = None
    ending: tuple[str, ...] = ()
    longest_saturation: float = 0.0

    def __post_init__(self) -> None:
        for name in self.ending:
            if name not in CONTACTS:
                remedy = "choose among them"
                problem = Problem("Machine(ending)", f"must be among {', '.join(CONTACTS)}", name, remedy)
                raise InputError(problem)

    def end_numbers(self, period: float) -> Ending:
        """What ends a run of this control period, s, as the compiled loop takes it."""
        longest = round(self.longest_saturation / period)
        return Ending(
            sum(CONTACTS[name] for name in self.ending), max(longest, int(self.longest_saturation > 0))
        )

    def core(self, step: float, tolerance: float | None = None) -> CoreMachine:
        """Everything that moves, as the C core takes it for steps of this length, s; a new one at every call.
        tolerance: of `FieldOfCurrents.plant`."""
        body = self.body.numbers(self.drag, self.plate, self.walls)
        return CoreMachine(
            self.magnetic.plant(
                body, self.body.seen_at, self.drive.numbers(step), self.drive.drives, tolerance
            )
        )

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What its motion rests on."""
        drive = self.drive
        winding = "currents follow at once"
        if drive.resistance is not None:
            low, high = drive.supply
            winding = f"windings by R and L without mutual inductance, {low:g} to {high:g} V"
        plate = () if self.plate is None else self.plate.assumptions
        drag = () if self.drag is None else self.drag.assumptions
        return (
            *self.magnetic.assumptions,
            *self.body.assumptions,
            *self.allocation.assumptions,
            winding,
            *drag,
            *plate,
            *self.sensors.assumptions,
        )
