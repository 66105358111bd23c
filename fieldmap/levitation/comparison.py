"""A field beside what was measured on its machine: the current that lifts the payload, the one factor on the force that
turns it into the measured current, and where the magnet comes to rest over a direction signal.

The measurements are those of `fieldmap.device.measured`. A field whose machine was not measured gives its lift currents
alone.
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
from fieldmap.levitation.lift import LiftCurrent, lift_current
from fieldmap.levitation.places import box_of_centres
from fieldmap.levitation.signal_surface import equilibrium_surface
from fieldmap.lookup.payload import magnetic_body
from fieldmap.plain import Plain, plain_fields, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

_HEIGHTS = 6
"""Of a box, ends included, at whose inner ones the lift current is stated where there is no sensor."""


@dataclass(frozen=True, repr=False)
class LiftAtHeight(Record):
    """The current in each coil, A, that lifts the payload with its magnet at z = height, m, on the axis.

    current: None where the field does not hold it. beyond: the largest current in all coils, A, that the field holds,
    where even that lifts too little. sensor_mm: reading of the machine's sensor; measured: the current measured there,
    A; lift_share: the field's lift at that current over the weight. None where nothing was measured. volume_error: of
    the current, as of `LiftCurrent`.
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
        """Ours over the measured one."""
        return None if self.measured is None or self.current is None else self.current / self.measured

    def to_dict(self) -> dict[str, Plain]:
        """The row as plain Python."""
        return plain_fields(self) | plain_items(ratio=self.ratio)


def lift_by_height(
    field: Field, payload: Payload, machine: MeasuredMachine | None = None, largest: float | None = None
) -> tuple[LiftAtHeight, ...]:
    """The lift current on the axis at several heights inside the field's box.

    Heights where the field does not lift are left out, and those at which the payload leaves the field's box.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        What is levitated.
    machine
        A measured machine: the heights are those of its stated readings, beside what was measured. Without it
        the heights divide the box.
    largest
        The largest current in all coils, A, that the field holds, of a field that does not hold for any.

    Returns
    -------
    tuple[LiftAtHeight, ...]
        A row for each height.
    """
    rows = []
    for reading, height in _heights(field, payload, machine):
        # Beside a field that no current drives, a negative current may lift, and some may lift less than none.
        driven = not getattr(field, "fixed_sources", ())
        share = _lift_share(field, payload, height, largest) if driven and largest is not None else None
        too_weak = share is not None and 0.0 < share < 1.0
        try:
            # From the largest current down: no step of the search leaves a field that holds the answer.
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
    """The one factor on the force that turns the lift currents of a field into the measured ones.

    factor: least squares of factor * lift / weight - 1 at the measured currents. currents: in each coil, A, that then
    lift the payload, one for each of the heights, and deviations: these over the measured ones, less 1. None at heights
    where the field does not hold the current.
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
        What is levitated.
    lift
        Rows of `lift_by_height`.

    Returns
    -------
    ForceFit | None
        The factor, and the rows' currents with it; None if nothing was measured.
    """
    shares = np.array([row.lift_share for row in lift if row.lift_share is not None])
    if not shares.any():
        return None
    factor = float(shares.sum() / (shares @ shares))
    # What a stronger force carries at a current is what the force carries of a lighter payload.
    scaled = replace(payload, mass=payload.mass / factor)
    currents: list[float | None] = []
    deviations: list[float | None] = []
    for row in lift:
        fitted = deviation = None
        if row.measured is not None and row.lift_share:
            found = _lift_current(field, scaled, row.height, row.measured)
            fitted = None if found is None else found.current
            deviation = None if fitted is None else fitted / row.measured - 1.0
        currents.append(fitted)
        deviations.append(deviation)
    return ForceFit(factor, tuple(currents), tuple(deviations))


@dataclass(frozen=True, eq=False, repr=False)
class ShiftBesideMeasured(Record):
    """Where the magnet comes to rest along x over x signals (k,), beside what was measured.

    measured (k,), m: x as read. constant_lift (k,), m: ours if the level follows, so that the lift stays what it is at
    signal 0, as a controller of the height makes it; levels (k,), A: that level. constant_level (k,), m: ours if the
    level stays `level`, A, the measured lift current. Both count from `zero`, m, the reading at signal 0; NaN where the
    field does not hold the currents. n: of `LiftAndDirections`; sensor_mm: reading of the vertical sensor, and height:
    z of the magnet's centre, m. source: where the readings are printed.
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

    Those are left out whose height lies outside the field's box, or for which the field has no equilibrium at
    signal 0.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        What is levitated.
    machine
        The measured machine.
    parametrisation
        How signals become currents.

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
    """None where the field does not hold it. Raises Infeasible where the field does not lift."""
    try:
        return lift_current(field, payload, [0.0, 0.0, height], first=first)
    except OutsideMapError:
        return None


def _lift_share(field: Field, payload: Payload, height: float, current: float) -> float | None:
    """Lift of the payload, upright, over its weight at equal currents; None where the field does not hold them."""
    point, currents = np.array([[0.0, 0.0, height]]), np.full(len(field.coil_names), current)
    try:
        force = float(magnetic_body(payload).wrench(field, point, currents)[0, 2])
    except OutsideMapError:
        return None
    return force / (payload.mass * GRAVITY)
