"""Comparison of a field with measurements on its machine: lift current, a factor on the force that reproduces the
measured current, and equilibrium positions over a direction signal.

`fieldmap.device.measured` has the measurements. Without measurements, only the lift currents are computed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.constants import GRAVITY
from fieldmap.currents import CurrentParametrisation, LiftAndDirections
from fieldmap.device.measured import MeasuredMachine, MeasuredShift
from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, NoEquilibrium, OutsideMapError
from fieldmap.field import Field, require_bounds
from fieldmap.levitation.balance import magnet_balance
from fieldmap.levitation.lift import LiftCurrent, lift_current
from fieldmap.levitation.places import box_of_centres
from fieldmap.levitation.signal_surface import equilibrium_surface
from fieldmap.lookup.payload import magnetic_body
from fieldmap.plain import Plain, plain_fields, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

_HEIGHTS = 6
"""Evenly spaced heights of a box, ends included; without a sensor the lift current is stated at the inner ones."""


@dataclass(frozen=True, repr=False)
class LiftAtHeight(Record):
    """The current in each coil, A, that lifts the payload with its magnet at z = height, m, on the axis.

    current: None where it is beyond the field's domain. beyond: the largest current in all coils of the domain, A, if
    even that lifts too little. sensor_mm: reading of the machine's sensor; measured: measured current there, A;
    lift_share: computed lift at that current over the weight; all None without a measurement. volume_error: of the
    current, as in `LiftCurrent`.
    """

    height: float
    current: float | None
    beyond: float | None = None
    sensor_mm: float | None = None
    measured: float | None = None
    lift_share: float | None = None
    volume_error: float | None = None

    @property
    def ratio(self) -> float | None:
        """Computed over measured current."""
        return None if self.measured is None or self.current is None else self.current / self.measured

    def to_dict(self) -> dict[str, Plain]:
        """The row as plain Python."""
        return plain_fields(self) | plain_items(ratio=self.ratio)


def lift_by_height(
    field: Field, payload: Payload, machine: MeasuredMachine | None = None, largest: float | None = None
) -> tuple[LiftAtHeight, ...]:
    """The lift current on the axis at several heights inside the field's box.

    Heights at which the field does not lift, or the payload leaves the field's box, are left out.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        The levitated body.
    machine
        A measured machine; its stated readings give the heights. Without it the heights divide the box.
    largest
        Largest current in all coils, A, of a field that is limited to a domain of currents.

    Returns
    -------
    tuple[LiftAtHeight, ...]
        A row for each height.
    """
    rows = []
    for reading, height in _heights(field, payload, machine):
        # With a constant part of the field a negative current may lift, and a current may lift less than none.
        driven = not getattr(field, "fixed_sources", ())
        share = _lift_share(field, payload, height, largest) if driven and largest is not None else None
        too_weak = share is not None and 0.0 < share < 1.0
        try:
            # The search starts at the largest current, so that it stays in the domain if the result lies there.
            found = None if too_weak else _lift_current(field, payload, height, largest or 1.0)
        except Infeasible:
            continue
        current, error = (None, None) if found is None else (found.current, found.volume_error)
        row = LiftAtHeight(height, current, largest if too_weak else None, reading, volume_error=error)
        if machine is not None and reading is not None:
            measured = machine.lift_current(reading)
            at_measured = _lift_share(field, payload, height, measured)
            row = replace(row, measured=measured, lift_share=at_measured)
        rows.append(row)
    return tuple(rows)


@dataclass(frozen=True, repr=False)
class ForceFit(Record):
    """A factor on the force that is fitted to measured lift currents.

    factor: minimises the sum of squares of lift / weight - 1 at the measured currents; it leaves the iron's reaction
    to the magnets unchanged. currents: lift current in each coil with this factor, A, one for each height; deviations:
    currents over the measured ones, minus 1. None at heights where the current is beyond the field's domain.
    """

    factor: float
    currents: tuple[float | None, ...]
    deviations: tuple[float | None, ...]


def fit_force(field: Field, payload: Payload, lift: Sequence[LiftAtHeight]) -> ForceFit | None:
    """The factor on the force that fits measured lift currents.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        The levitated body.
    lift
        Rows of `lift_by_height`.

    Returns
    -------
    ForceFit | None
        The factor, and the rows' currents with it; None if nothing was measured.
    """
    read = [row for row in lift if row.lift_share is not None]
    drawn = np.array([_drawn_share(field, payload, row.height) for row in read])
    shares = np.array([row.lift_share for row in read]) - drawn
    if not shares.any():
        return None
    factor = float(shares @ (1.0 - drawn) / (shares @ shares))
    currents: list[float | None] = []
    deviations: list[float | None] = []
    for row in lift:
        fitted = deviation = None
        if row.measured is not None and row.lift_share:
            # The scaled force lifts the payload at the current at which the original force lifts a lighter one.
            own = _drawn_share(field, payload, row.height)
            lighter = replace(payload, mass=payload.mass * (own + (1.0 - own) / factor))
            found = _lift_current(field, lighter, row.height, row.measured)
            fitted = None if found is None else found.current
            deviation = None if fitted is None else fitted / row.measured - 1.0
        currents.append(fitted)
        deviations.append(deviation)
    return ForceFit(factor, tuple(currents), tuple(deviations))


@dataclass(frozen=True, eq=False, repr=False)
class ShiftBesideMeasured(Record):
    """Computed and measured equilibrium positions along x over x signals (k,).

    measured (k,), m: x as read. constant_lift (k,), m: computed with a level that keeps the lift at signal 0, as a
    height controller does; levels (k,), A: that level. constant_level (k,), m: computed with the constant level
    `level`, A, the measured lift current. Both start from `zero`, m, the reading at signal 0; NaN where no equilibrium
    is found. n: of `LiftAndDirections`; sensor_mm: reading of the vertical sensor, and height: z of the magnet's
    centre, m. source: of the readings.
    """

    source: str
    n: float
    sensor_mm: float
    height: float
    level: float
    zero: float
    signals: Array
    measured: Array
    constant_lift: Array
    levels: Array
    constant_level: Array


def shifts_beside_measured(
    field: Field, payload: Payload, machine: MeasuredMachine, parametrisation: CurrentParametrisation
) -> tuple[ShiftBesideMeasured, ...]:
    """Every measured shift with this parametrisation, the payload upright.

    Shifts at a height outside the field's box, or without an equilibrium at signal 0, are left out.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        The levitated body.
    machine
        The measured machine.
    parametrisation
        Parametrisation of the currents by signals.

    Returns
    -------
    tuple[ShiftBesideMeasured, ...]
        The shifts.
    """
    if not isinstance(parametrisation, LiftAndDirections):
        return ()
    n = parametrisation.n
    found = (_shift(field, payload, machine, read) for read in machine.shifts if read.n == n)
    return tuple(one for one in found if one is not None)


def _shift(
    field: Field, payload: Payload, machine: MeasuredMachine, read: MeasuredShift
) -> ShiftBesideMeasured | None:
    height = machine.height(read.reading_mm, payload.magnet_offset)
    level = machine.lift_current(read.reading_mm)
    signals, zero = np.array(read.x_signals), 1e-3 * read.zero_mm
    about = (field, payload, np.append(0.0, signals), [0.0], level, height, LiftAndDirections(read.n))
    try:
        follows, stays = (equilibrium_surface(*about, hold_height=held) for held in (True, False))
    except (OutsideMapError, Infeasible, NoEquilibrium):
        return None
    x_follows, x_stays = (surface.positions[:, 0, 0] for surface in (follows, stays))
    return ShiftBesideMeasured(
        source=read.source,
        n=read.n,
        sensor_mm=read.reading_mm,
        height=height,
        level=level,
        zero=zero,
        signals=signals,
        measured=1e-3 * np.array(read.x_mm),
        constant_lift=zero + x_follows[1:] - x_follows[0],
        levels=follows.levels[1:, 0],
        constant_level=zero + x_stays[1:] - x_stays[0],
    )


def _heights(
    field: Field, payload: Payload, machine: MeasuredMachine | None
) -> list[tuple[float | None, float]]:
    """Sensor readings, mm, and heights, m, at which the payload lies inside the box."""
    points = magnetic_body(payload).all_points
    lower, upper = box_of_centres(require_bounds(field), points)
    if (lower[:2] > 0.0).any() or (upper[:2] < 0.0).any():
        return []
    if machine is None:
        low, high = (float(corner[2] - points[:, 2].mean()) for corner in require_bounds(field))
        at: list[tuple[float | None, float]] = [
            (None, float(height)) for height in np.linspace(high, low, _HEIGHTS)[1:-1]
        ]
    else:
        at = [(reading, machine.height(reading, payload.magnet_offset)) for reading in machine.readings_mm]
    return [(reading, height) for reading, height in at if lower[2] <= height <= upper[2]]


def _lift_current(field: Field, payload: Payload, height: float, first: float) -> LiftCurrent | None:
    """The lift current; None if it is beyond the field. Raises Infeasible where the field does not lift."""
    try:
        return lift_current(field, payload, [0.0, 0.0, height], first=first)
    except OutsideMapError:
        return None


def _lift_share(field: Field, payload: Payload, height: float, current: float) -> float | None:
    """Lift of the upright payload over its weight at equal currents; None if these are beyond the field."""
    point, currents = np.array([[0.0, 0.0, height]]), np.full(len(field.coil_names), current)
    try:
        force = float(magnetic_body(payload).wrench(field, point, currents)[0, 2])
    except OutsideMapError:
        return None
    return force / (payload.mass * GRAVITY)


def _drawn_share(field: Field, payload: Payload, height: float) -> float:
    """Vertical force of the iron's reaction to the magnets, over the weight."""
    point = np.array([0.0, 0.0, height])
    balance = magnet_balance(field, np.zeros(len(field.coil_names)), payload, point, "fixed")
    return float(balance.reaction_force(point[None, :])[0, 2] / balance.weight)
