"""A levitation machine as data: field of the currents, body, control allocation, surroundings, coils with their
amplifiers, and position sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from fieldmap.arguments import (
    check,
    check_choice,
    check_not_negative,
    check_ordered,
    check_positive,
    check_signal,
)
from fieldmap.core.closed_loop import Ending, Sensing
from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import CoreMachine
from fieldmap.device.drives import COUPLED, Bridge, CurrentController, DriveChoice, Heating, lacking
from fieldmap.device.model import Device
from fieldmap.dynamics.allocation import ControlAllocation
from fieldmap.dynamics.field_of_currents import FieldOfCurrents
from fieldmap.dynamics.rigid_body import Drag, NotNegatives, Plate, RigidBody, Walls
from fieldmap.errors import InputError
from fieldmap.inputs.declared import Key, check_fields
from fieldmap.inputs.document import AtKey
from fieldmap.inputs.tables import MILLI, NotNegative, Positive, Table
from fieldmap.instruments import Amplifier, Converter, Micrometer, Rig, SensorFrame
from fieldmap.instruments.converter import USUAL_RANGE
from fieldmap.records import Record
from fieldmap.typing import Array

Count = Annotated[int, Field(ge=1)]
Bits = Annotated[int, Field(ge=1, le=32)]
_IDEAL_CHAIN = np.array([0.0, 1.0, 0.0, -np.inf, np.inf, 0.0, 0.0, 0.0, -np.inf, np.inf])
CONTACTS = {
    "floor": LIBRARY.ON_FLOOR,
    "ceiling": LIBRARY.ON_CEILING,
    "tube": LIBRARY.ON_WALL,
    "currents": LIBRARY.BEYOND,
}
DRIVES = ("ideal", *COUPLED)
"""Drives of the coils: an ideal current source without coupling, or voltage drives of coils that the map couples."""


@dataclass(frozen=True, eq=False, repr=False)
class CoilDrive(Record):
    """Equal amplifiers for n coils.

    amplifier: gain, limits of voltage and current, noise. converter: of the controller's outputs; None: no rounding.
    resistance (n,), ohm, inductance (n,), H: of the windings, without mutual inductance; None: currents follow at
    once. supply: lowest and highest voltage at a winding, V. time_constant: of the amplifier, s; 0: as fast as the
    supply allows. docs/theory/closed_loop.md (1), (2). mode: one of `DRIVES`. In all modes but "ideal" the coils obey
    V = R i + d(linkage)/dt with the linkages of the map and the resistance: docs/theory/electrical.md. The unit of
    the amplifier's gain is A/V for "ideal" and "current_controller", V/V for "voltage", and duty per V for "bridge".
    Its limits of the current apply in all modes. If the controller has a bandwidth, its gains are computed for
    `inductance`, by default that of the map at zero currents. slope: largest rate of the demand, A/s, or V/s for a
    voltage source. heating: None for windings of constant temperature.
    """

    amplifier: Amplifier
    coils: int
    resistance: Any = None
    inductance: Any = None
    supply: tuple[float, float] = (-np.inf, np.inf)
    time_constant: float = 0.0
    converter: Converter | None = None
    mode: str = "ideal"
    controller: CurrentController | None = None
    bridge: Bridge | None = None
    heating: Heating | None = None
    slope: float = np.inf

    def __post_init__(self) -> None:
        check_not_negative("CoilDrive", time_constant=self.time_constant)
        check_ordered("CoilDrive(supply)", *self.supply)
        check_choice("CoilDrive(mode)", self.mode, DRIVES)
        check(self.slope > 0.0, "CoilDrive(slope)", "must be above 0", self.slope, "correct it")
        if self.coupled:
            self._check_coupled()
        else:
            both = (self.resistance is None) == (self.inductance is None)
            must = "must both be given, or neither"
            check(both, "CoilDrive(resistance, inductance)", must, "one", "give both")
        for name in ("resistance", "inductance"):
            if getattr(self, name) is not None:
                given = check_signal(f"CoilDrive({name})", getattr(self, name))
                check_positive(f"CoilDrive({name})", smallest=float(given.min()))
                object.__setattr__(self, name, np.array(np.broadcast_to(given, (self.coils,))))

    def _check_coupled(self) -> None:
        must = f'must be given for the mode "{self.mode}"'
        check(self.resistance is not None, "CoilDrive(resistance)", must, "None", "give ohms")
        check(
            self.time_constant == 0.0,
            "CoilDrive(time_constant)",
            "must be 0",
            self.time_constant,
            "leave it out",
        )
        controlled, switched = self.mode == "current_controller", self.mode == "bridge"
        if controlled:
            check(self.controller is not None, "CoilDrive(controller)", must, "None", "give its bandwidth")
        if switched:
            check(self.bridge is not None, "CoilDrive(bridge)", must, "None", "give its frequency")
            finite = np.isfinite(self.supply).all()
            check(bool(finite), "CoilDrive(supply)", must, f"{self.supply} V", "give volts")

    @property
    def coupled(self) -> bool:
        """Whether the linkages of the map couple the coils with each other and with the payload."""
        return self.mode != "ideal"

    @property
    def gives_voltage(self) -> bool:
        """Whether the drive takes a voltage, or a duty, instead of a current."""
        return self.mode in ("voltage", "bridge")

    @property
    def drives(self) -> Array:
        """Numbers (n, 7), in the order of fieldmap_drive (fieldmap/core/instruments.h)."""
        a, c = self.amplifier, self.converter
        step, widest = (0.0, np.inf) if c is None else (c.resolution, c.range)
        if self.gives_voltage:
            volts = self.supply[1] if self.mode == "bridge" else 1.0
            ends = max(a.lower, -widest), min(a.upper, widest)
            return np.tile([step, *ends, volts * a.gain, volts * a.offset, *self.supply], (self.coils, 1))
        # Voltage limits include the current limits, because a loop detects an active limit by the voltage.
        lower = max(a.lower, -widest, (a.current_lower - a.offset) / a.gain)
        upper = min(a.upper, widest, (a.current_upper - a.offset) / a.gain)
        row = [step, lower, upper, a.gain, a.offset, a.current_lower, a.current_upper]
        return np.tile(np.array(row), (self.coils, 1))

    @property
    def steady(self) -> tuple[Array, Array]:
        """Lowest and highest steady currents (n,), A, within the limits of converter, amplifier and supply."""
        _, lower, upper, gain, offset, *_ = self.drives.T
        low, high = gain * lower + offset, gain * upper + offset
        if self.gives_voltage:
            a = self.amplifier
            low, high = (end / self.resistance for end in (low, high))
            low, high = np.maximum(low, a.current_lower), np.minimum(high, a.current_upper)
        if self.resistance is None:
            return low, high
        least, most = (end / self.resistance for end in self.supply)
        return np.maximum(low, least), np.minimum(high, most)

    @property
    def steady_response(self) -> tuple[Array, Array]:
        """Gain (n,), A/V, and offset (n,), A, from the controller's voltages to steady currents, without limits."""
        gain, offset = self.drives[:, 3], self.drives[:, 4]
        if self.gives_voltage:
            return gain / self._at_ambient, offset / self._at_ambient
        return gain, offset

    @property
    def _loss(self) -> tuple[float, float]:
        """Voltage drop of a bridge, V, and the current, A, below which the drop is proportional to the current."""
        if self.bridge is None or self.mode != "bridge":
            return 0.0, 0.0
        return self.bridge.loss(self.supply[1]), self.bridge.ripple

    @property
    def _at_ambient(self) -> Array:
        """Resistances (n,), ohm, at the start of a run."""
        h = self.heating
        warmer = 0.0 if h is None else h.coefficient * (h.ambient - h.reference)
        return np.asarray(self.resistance * (1.0 + warmer))

    def slope_of_fall(self, currents: Array) -> Array:
        """Differential resistances of coupled coils and their drives.

        Parameters
        ----------
        currents
            Currents (n,), A.

        Returns
        -------
        Array
            Derivatives (n,) of the voltage drop with respect to the current, ohm.
        """
        loss, ripple = self._loss
        small = np.abs(currents) < ripple
        return self._at_ambient + np.where(small, loss / (ripple or 1.0), 0.0)

    def at_rest(self, inputs: Array) -> Array:
        """Steady currents, without limits and rounding.

        Parameters
        ----------
        inputs
            Inputs of the amplifiers (n,), V.

        Returns
        -------
        Array
            Currents (n,), A.
        """
        commands = self.drives[:, 3] * inputs + self.drives[:, 4]
        if not self.gives_voltage:
            return np.asarray(commands)
        (loss, ripple), resistance = self._loss, self._at_ambient
        small = commands / (resistance + loss / (ripple or 1.0))
        beyond = (commands - loss * np.sign(commands)) / resistance
        return np.asarray(np.where(np.abs(small) < ripple, small, beyond))

    def holding(self, currents: Array) -> Array:
        """Commands that hold currents: the currents, or the voltages of a voltage drive.

        Parameters
        ----------
        currents
            Currents (n,), A.

        Returns
        -------
        Array
            Commands (n,), A or V.
        """
        if not self.gives_voltage:
            return currents.copy()
        loss, ripple = self._loss
        return np.asarray(self._at_ambient * currents + loss * np.clip(currents / (ripple or 1.0), -1.0, 1.0))

    def coil_numbers(self, inductance: Array) -> Array:
        """Coupled coils for the C core, in the order of fieldmap_coil (fieldmap/core/electrical.h).

        Parameters
        ----------
        inductance
            Inductances of the map at zero currents (n, n), H.

        Returns
        -------
        Array
            Numbers (n, 15).
        """
        n, limits = self.coils, (self.amplifier.current_lower, self.amplifier.current_upper)
        proportional = integral = np.zeros(n)
        if self.controller is not None and self.mode == "current_controller":
            own = np.diag(inductance) if self.inductance is None else self.inductance
            proportional, integral = self.controller.gains(self.resistance, own)
            limits = -np.inf, np.inf
        (loss, ripple), heat = self._loss, (0.0, 1.0, 0.0, 0.0, 0.0)
        if self.heating is not None:
            h = self.heating
            heat = h.thermal_resistance, h.thermal_capacity, h.coefficient, h.reference, h.ambient
        rest = np.tile([*limits, self.slope, loss, ripple, *heat], (n, 1))
        supply = np.tile(self.supply, (n, 1))
        return np.column_stack([self.resistance, supply, proportional, integral, rest])

    def numbers(self, step: float) -> Array:
        """The drive for the C core, in the order of fieldmap_winding (fieldmap/core/currents.h).

        Parameters
        ----------
        step
            Length of a mechanical step, s.

        Returns
        -------
        Array
            Numbers (n, 4).
        """
        numbers, largest = np.zeros((self.coils, 4)), np.finfo(float).max
        numbers[:, 1] = np.exp(-step / self.time_constant) if self.time_constant else 0.0
        # Without windings only the amplifier acts. The bounds are finite, because 0 times infinity is NaN.
        numbers[:, 2:] = largest, -largest
        if self.resistance is not None and not self.coupled:
            numbers[:, 0] = np.exp(-self.resistance * step / self.inductance)
            numbers[:, 2] = np.clip(self.supply[1] / self.resistance, -largest, largest)
            numbers[:, 3] = np.clip(self.supply[0] / self.resistance, -largest, largest)
        return numbers


def drive_of_device(
    device: Device,
    lowest_voltage: float | None = None,
    choice: DriveChoice | None = None,
    noise: float = 0.0,
    **more: object,
) -> CoilDrive:
    """The drive of a device file: gain, current limit, supply and drive of [driver], resistance and inductance of its
    coils.

    The gain of a voltage drive is set so that an input gives the same steady current as with a current source, at the
    mean resistance of the coils.

    Parameters
    ----------
    device
        Device with a [driver].
    lowest_voltage
        Lowest voltage at a winding, V; by default minus the supply voltage.
    choice
        Replaces the drive of the file.
    noise
        Standard deviation of the currents, A.
    more
        Fields of `CoilDrive` that replace those of the file.

    Returns
    -------
    CoilDrive
        The drive.

    Raises
    ------
    InputError
        If the file has no [driver], or lacks numbers that the drive needs.
    """
    driver = device.driver
    if driver is None:
        must, remedy = "must have a [driver]", "add one to the device file"
        raise InputError.of("drive_of_device(device)", must, "none", remedy)
    chosen = (driver if choice is None else choice).over(driver)
    problem = lacking(chosen, driver.supply_voltage, [one.name for one in device.coils if not one.resistance])
    if problem is not None:
        key, *about = problem
        raise InputError(AtKey(f"driver.{key}", *about))
    windings: dict[str, Any] = {}
    coupled = chosen["mode"] != "ideal"
    if coupled or all(coil.resistance and coil.inductance for coil in device.coils):
        windings["resistance"] = [coil.resistance for coil in device.coils]
        windings["inductance"] = None if coupled else [coil.inductance for coil in device.coils]
    supply, limit = driver.supply_voltage or np.inf, driver.current_limit
    per_ampere = 1.0
    if chosen["mode"] in ("voltage", "bridge"):
        per_ampere = float(np.mean(windings["resistance"]))
    largest, gain = limit / driver.gain, driver.gain * per_ampere
    if chosen["mode"] == "bridge":
        gain /= supply
    amplifier = Amplifier(
        gain, -largest, largest, deviation=noise * per_ampere, current_lower=-limit, current_upper=limit
    )
    chosen["slope"] = chosen["slope"] or np.inf
    voltages = (-supply if lowest_voltage is None else lowest_voltage, supply)
    return CoilDrive(amplifier, len(device.coils), **{**windings, **chosen, "supply": voltages, **more})


@dataclass(frozen=True, eq=False, repr=False)
class Sensors(Record):
    """Two sensors that cross in the horizontal plane and one for the depth; ideal by default.

    frame: of the crossed sensors; without it they read x and y. zero_depth: depth below the map's origin at which the
    third sensor reads 0, m; it reads downward. deviations (3,): noise of the readings, m. rigs: measuring chain of
    each. voltage_noise: of their input converters, V. scan_rate: 1/s, 0 for sensors that read at the moment of
    sampling; averages, one number for all or one for each, and latency: as in `Micrometer`. measured_with: averages
    with which the deviations were measured; by default `averages`.
    """

    frame: SensorFrame | None = None
    zero_depth: Annotated[
        float, Key(..., "depth below the map's origin at which the vertical sensor reads 0", "mm")
    ] = 0.0
    deviations: Annotated[
        tuple[float, float, float],
        Key(NotNegatives, "noise of the two crossed sensors and the vertical one", "mm", name="deviation"),
    ] = (0.0, 0.0, 0.0)
    rigs: tuple[Rig | None, Rig | None, Rig | None] = (None, None, None)
    voltage_noise: float = 0.0
    scan_rate: Annotated[NotNegative, Key(..., "rate of scans; 0: shows what is at each sample", "Hz")] = 0.0
    averages: Annotated[
        int | tuple[int, int, int],
        Key(
            Count | Annotated[list[Count], Field(min_length=3, max_length=3)],
            "scans whose mean is shown; one number, or one for each sensor",
        ),
    ] = 1
    latency: Annotated[
        Annotated[int, Field(ge=0)], Key(..., "scans by which a mean comes late", name="latency_scans")
    ] = 0
    measured_with: Annotated[
        Count | None,
        Key(
            ...,
            "averages with which deviation_mm was measured; `averages` unless given",
            name="deviation_averages",
        ),
    ] = None
    assumptions: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        check_fields(self)
        check_not_negative("Sensors", voltage_noise=self.voltage_noise)

    @property
    def means(self) -> tuple[int, int, int]:
        """Averages of each sensor."""
        given = self.averages
        return given if isinstance(given, tuple) else (given, given, given)

    @property
    def numbers(self) -> Sensing:
        """The numbers for compiled loops."""
        into, shift = np.diag([1.0, 1.0, -1.0]), np.array([0.0, 0.0, -self.zero_depth])
        if self.frame is not None:
            shift[:2] = self.frame.to_local([0.0, 0.0, 0.0])[:2]
            for k in range(2):
                into[:2, k] = (self.frame.to_local(np.eye(3)[k]) - self.frame.to_local(np.zeros(3)))[:2]
        chains = np.array([_IDEAL_CHAIN if rig is None else rig.chain for rig in self.rigs])
        period = 1.0 / self.scan_rate if self.scan_rate else 0.0
        scan = np.array([period, float(self.latency), *map(float, self.means)])
        return Sensing(into, shift, chains, np.ascontiguousarray(np.linalg.inv(into)), scan)

    @property
    def scan_deviations(self) -> Array:
        """Noise of one scan (3,), m. It is white: the mean of n scans has it divided by the square root of n."""
        with_how_many = (self.measured_with,) * 3 if self.measured_with else self.means
        return np.sqrt(with_how_many) * np.asarray(self.deviations)

    def scans(self, duration: float) -> int:
        """Number of scans in a run.

        Parameters
        ----------
        duration
            Duration of the run, s.

        Returns
        -------
        int
            The number.
        """
        return int(np.floor(duration * self.scan_rate + 1e-9)) + 1 if self.scan_rate else 0


class ChainKeys(Table):
    """Keys of the sensors' measuring chain, for their frame, rigs and noise of the converters."""

    angle_deg: float = Field(default=0.0, description="of the crossed sensors against x and y")
    step_mm: NotNegative = Field(default=0.0, description="resolution of the sensors")
    input_bits: Bits | None = Field(default=None, description="of the input converter")
    input_range_V: Positive = Field(
        default=USUAL_RANGE, description="of the input converter, to both sides; assumed unless given"
    )
    mm_per_V: Positive = Field(
        default=2.0, description="of the sensors' outputs, for input_bits; assumed unless given"
    )
    input_noise_V: NotNegative = Field(default=0.0, description="of the input converter")

    def also_makes(self) -> Mapping[str, Any]:
        """Fields of `Sensors`."""
        frame = SensorFrame(np.deg2rad(self.angle_deg), offset=0.0) if self.angle_deg else None
        rig = None
        if self.input_bits is not None or self.step_mm:
            converter = Converter(self.input_range_V, self.input_bits or 48, self.input_noise_V)
            step, scale = self.step_mm / self.mm_per_V, MILLI * self.mm_per_V
            micrometer = Micrometer(0.0, scale, voltage_step=step, lower=-1e3, upper=1e3)
            rig = Rig(micrometer, converter, converter, Amplifier(1.0))
        return {"frame": frame, "rigs": (rig, rig, rig), "voltage_noise": self.input_noise_V}


@dataclass(frozen=True, eq=False, repr=False)
class Machine(Record):
    """The whole machine without the controller.

    magnetic: the field of the currents. allocation: from the controller's outputs to the voltages of the coils.
    ending: contacts that end a run, "floor", "ceiling", "tube", and "currents" outside the table of saturating iron
    or the domain of its model. longest_saturation: time, s, for which a limit of outputs, amplifiers or supply may be
    active without a break before the run ends, rounded up to whole control periods; 0 for no limit.
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
        check_not_negative("Machine", longest_saturation=self.longest_saturation)
        must = f"must be among {', '.join(CONTACTS)}"
        for name in self.ending:
            check(name in CONTACTS, "Machine(ending)", must, name, "choose among them")
        if self.drive.coupled:
            must = "must know the flux linkages of the coils, which couple them"
            received, remedy = (
                f"one of {self.magnetic.iron} iron without",
                "make the map again; take no table",
            )
            check(self.magnetic.linkage is not None, "Machine(magnetic)", must, received, remedy)

    def end_numbers(self, period: float) -> Ending:
        """The ends of a run for the compiled loop.

        Parameters
        ----------
        period
            Control period, s.

        Returns
        -------
        Ending
            The rules.
        """
        # The number of periods is rounded up; the factor allows for rounding of the quotient.
        longest = math.ceil(self.longest_saturation / period * (1.0 - 1e-9))
        return Ending(sum(CONTACTS[name] for name in self.ending), longest)

    def core(self, step: float, search: bool = False) -> CoreMachine:
        """A new machine for the C core.

        Parameters
        ----------
        step
            Length of a step, s.
        search
            As for `FieldOfCurrents.plant`.

        Returns
        -------
        CoreMachine
            The machine for the C core.
        """
        body, windings = self.body.numbers(self.drag, self.plate, self.walls), self.drive.numbers(step)
        coils = (
            self.drive.coil_numbers(self.magnetic.inductance()) if self.drive.coupled and not search else None
        )
        drives = self.drive.drives
        if search:
            # A search finds steady currents.
            drives[:, 3], drives[:, 4] = self.drive.steady_response
        plant = self.magnetic.plant(body, self.body.seen_at, windings, drives, search, coils)
        return CoreMachine(plant)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the motion."""
        drive = self.drive
        winding = "currents follow at once"
        low, high = drive.supply
        if drive.coupled:
            winding = f"coils coupled by the linkages of the map, {drive.mode} drive, {low:g} to {high:g} V"
        elif drive.resistance is not None:
            winding = f"windings by R and L without mutual inductance, {low:g} to {high:g} V"
        notes = (*self.magnetic.assumptions, *self.body.assumptions, *self.allocation.assumptions, winding)
        around = [part.assumptions for part in (self.drag, self.plate, self.sensors) if part is not None]
        return sum(around, notes)
