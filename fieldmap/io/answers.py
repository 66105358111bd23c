"""Questions to a named field: B, force and torque at points, currents of least power, equilibria and lift currents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.constants import GRAVITY
from fieldmap.device.measured import MeasuredMachine, measured_on
from fieldmap.device.model import Payload
from fieldmap.device.payload import moment_held
from fieldmap.errors import InputError
from fieldmap.field import Bounds
from fieldmap.io.field_source import FieldSource
from fieldmap.lookup.inverse import currents_for
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.lookup.payload import check_payload
from fieldmap.plain import Plain, plain_fields, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

# Fields at points and currents need no scipy, so levitation, which needs it, is imported inside functions.
if TYPE_CHECKING:
    from fieldmap.levitation import Equilibrium, LiftCurrent

Moment: TypeAlias = Literal["fixed", "aligned"]
MOMENTS = get_args(Moment)
ALONG_FIELD = "moment along the field, free to turn"


@dataclass(frozen=True, eq=False, repr=False)
class ProbedPoint(Record):
    """B (3,), T, and its gradient (3, 3), T/m, at a point (3,), m; force (3,), N, and torque (3,), N m, on a moment
    (3,), A m^2, or None without one."""

    at: Array
    currents: Array
    B: Array
    gradient: Array
    moment: Array | None = None
    force: Array | None = None
    torque: Array | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Probe(Record):
    """A field at points. assumptions: of the field at these currents. held: direction of the moment and whether it
    turns, such as "moment down, fixed"; empty without a moment."""

    source: FieldSource
    points: tuple[ProbedPoint, ...]
    assumptions: tuple[str, ...]
    held: str = ""

    def to_dicts(self) -> list[dict[str, Plain]]:
        """Each point as plain Python, SI units."""
        about = plain_items(source=self.source.name, kind=self.source.kind, coil_names=self.source.coil_names)
        told = plain_items(**({"held": self.held} if self.held else {}), assumptions=self.assumptions)
        points = [plain_fields(point) for point in self.points]
        return [
            about | {name: one for name, one in point.items() if one is not None} | told for point in points
        ]


def probe(
    source: FieldSource,
    points: Array,
    currents: ArrayLike,
    moment: Array | MagneticBody | None = None,
    turns: bool = False,
) -> Probe:
    """The field at points, and its force and torque on a moment or a body.

    Parameters
    ----------
    source
        Result of `find_source`.
    points
        (n, 3), m.
    currents
        (n_coils,), A.
    moment
        (3,), A m^2, or an upright body; none unless given.
    turns
        Whether the moment (3,) follows the field at each point, and keeps its size.

    Returns
    -------
    Probe
        The numbers at the points.

    Raises
    ------
    InputError and OutsideMapError
        As the field raises them.
    """
    amperes = source.currents(currents)
    state = source.field.at(amperes)
    flux, slope = state.field(points), state.gradient(points)
    rests: tuple[str, ...] = tuple(source.assumptions(amperes))
    loads: list[tuple[Array, ...]] = [()] * len(points)
    held = ""
    if moment is not None:
        whole = moment.moments.sum(axis=0) if isinstance(moment, MagneticBody) else np.asarray(moment)
        held = ALONG_FIELD if turns else moment_held(whole, False)
        if isinstance(moment, MagneticBody):
            wrench = moment.wrench(source.field, points, amperes)
            moments = moment.whole_moment(source.field, points, amperes)
            rests = (*rests, *moment.assumptions)
        else:
            moments = np.broadcast_to(whole, points.shape)
            if turns:
                size = np.linalg.norm(flux, axis=1, keepdims=True)
                along = np.divide(flux, size, out=np.zeros_like(flux), where=size > 0.0)
                moments = float(np.linalg.norm(whole)) * along
            wrench = source.field.wrench(points, moments, amperes)
        loads = [(np.array(m), w[:3], w[3:]) for m, w in zip(moments, wrench, strict=True)]
    rows = zip(points, flux, slope, loads, strict=True)
    told = tuple(ProbedPoint(at, amperes, b, g, *load) for at, b, g, load in rows)
    return Probe(source, told, rests, held)


@dataclass(frozen=True, eq=False, repr=False)
class LeastPower(Record):
    """Currents (n_coils,), A, of least power, and their field and load at a point (`given`).

    asked: force, N, torque, N m, or field, T, each (3,), with NaN for a free component; or direction (3,) of a magnet
    that follows the field. limit: of every current, A; None without one.
    """

    source: FieldSource
    currents: Array
    asked: Mapping[str, Array]
    limit: float | None
    given: Probe

    @property
    def sum_of_squares(self) -> float:
        """Sum of the squares of the currents, A^2: their power per ohm if all coils have the same resistance."""
        return float(self.currents @ self.currents)

    def to_dict(self) -> dict[str, Plain]:
        """The answer as plain Python, SI units; a free component is None."""
        asked = {
            name: [None if np.isnan(value) else float(value) for value in values]
            for name, values in self.asked.items()
        }
        about = plain_items(
            asked=asked,
            limit=self.limit,
            by_name=dict(zip(self.source.coil_names, self.currents.tolist(), strict=True)),
            sum_of_squares=self.sum_of_squares,
        )
        (given,) = self.given.to_dicts()
        return about | given


def least_power(
    source: FieldSource,
    at: Array,
    moment: Array | MagneticBody | None = None,
    limit: float | None = None,
    least_field: float = 0.0,
    **asked: Array | None,
) -> LeastPower:
    """The currents of least power that meet a demand at a point.

    Parameters
    ----------
    source
        Result of `find_source`.
    at
        Point (3,), m.
    moment
        (3,), A m^2, or an upright body.
    limit
        Largest magnitude of each current, A; none unless given.
    least_field
        With a direction: least B along it, T.
    **asked
        force and torque on the moment, and field: each (3,), NaN for a free component. direction (3,): B points along
        it, and so does the moment, with the magnitude of the given one.

    Returns
    -------
    LeastPower
        The currents, and their field and load.

    Raises
    ------
    Infeasible
        If the limit excludes the demand; the error states what is possible.
    InputError, OutsideMapError and NotConverged
        As `fieldmap.lookup.currents_for` raises them.
    """
    wanted = {name: np.asarray(values, dtype=float) for name, values in asked.items() if values is not None}
    direction = wanted.get("direction")
    turns = direction is not None and moment is not None and not isinstance(moment, MagneticBody)
    currents = currents_for(
        source.field,
        at,
        wanted.get("force"),
        float(np.linalg.norm(np.asarray(moment))) if turns else moment,
        limit,
        torque=wanted.get("torque"),
        flux_density=wanted.get("field"),
        direction=direction,
        least_field=least_field,
    )
    return LeastPower(source, currents, wanted, limit, probe(source, at[None, :], currents, moment, turns))


def lift_force(payload: Payload | None, coils: int) -> Array:
    """The force that carries a payload.

    Parameters
    ----------
    payload : Payload or None
        None raises InputError.
    coils : int
        Number of coils. One or two coils cannot hold three components, so x and y stay free.

    Returns
    -------
    array (3,)
        The weight, upward, N; NaN for a free component.
    """
    sideways = 0.0 if coils >= 3 else np.nan
    mass = check_payload(payload, "--lift", pieces=True).mass
    return np.array([sideways, sideways, mass * GRAVITY])


@dataclass(frozen=True, eq=False, repr=False)
class Levitation(Record):
    """Where a payload floats in a named field (`Equilibrium`), or the current that lifts it (`LiftCurrent`).

    assumptions: of the search and of the field.
    """

    source: FieldSource
    payload: Payload
    found: Equilibrium | LiftCurrent
    assumptions: tuple[str, ...]

    @property
    def machine(self) -> MeasuredMachine | None:
        """The machine that the device describes, if something was measured on it."""
        return measured_on(self.source.device_name, len(self.source.coil_names))

    @property
    def reading_mm(self) -> float | None:
        """Reading of the machine's vertical sensor, mm; None for a machine without a measured sensor."""
        if self.machine is None:
            return None
        return self.machine.reading_mm(float(self.found.position[2]), self.payload.magnet_offset)

    @property
    def measured_current(self) -> float | None:
        """The measured current in each coil at this reading, A; None if nothing was measured."""
        reading = self.reading_mm
        return None if self.machine is None or reading is None else self.machine.lift_current(reading)

    @property
    def current_limit(self) -> float | None:
        """Largest current of the driver, A per coil."""
        return None if self.source.driver is None else self.source.driver.current_limit

    def to_dict(self) -> dict[str, Plain]:
        """The answer as plain Python, SI units but for `sensor_mm`."""
        from fieldmap.levitation import LiftCurrent

        numbers = self.found.to_dict()
        if isinstance(self.found, LiftCurrent):
            measured = self.measured_current
            ratio = None if measured is None else self.found.current / measured
            numbers |= plain_items(current_limit=self.current_limit, measured=measured, ratio=ratio)
        about = plain_items(
            source=self.source.name,
            kind=self.source.kind,
            coil_names=self.source.coil_names,
            sensor_mm=self.reading_mm,
            mass=self.payload.mass,
            weight=self.payload.mass * GRAVITY,
            moment_magnitude=self.payload.moment,
            magnet_offset=self.payload.magnet_offset,
        )
        return about | numbers | plain_items(assumptions=self.assumptions)


def floating(
    source: FieldSource,
    payload: Payload,
    currents: ArrayLike,
    start: Array | None = None,
    moment: str | None = None,
) -> Levitation:
    """The place where the payload floats at given currents, found by `find_equilibrium`.

    Parameters
    ----------
    source
        Result of `find_source`.
    payload
        The levitated payload.
    currents
        (n_coils,), A.
    start
        Place where the search begins (3,), m; unless given, the whole box is searched.
    moment
        Model of the magnet, as for `find_equilibrium`.

    Returns
    -------
    Levitation
        The equilibrium.

    Raises
    ------
    NoEquilibrium
        If there is none.
    """
    from fieldmap.levitation import find_equilibrium
    from fieldmap.levitation.places import check_centre

    bounds, amperes = require_box(source), source.currents(currents)
    if start is not None:
        check_centre(bounds, payload, start, "start")
    if moment is not None and moment not in MOMENTS:
        raise InputError.of("moment", "must be fixed or aligned", moment, "choose one")
    found = find_equilibrium(source.field, amperes, payload, start, cast(Moment | None, moment))
    return Levitation(source, payload, found, (*found.assumptions, *source.assumptions(amperes)))


def lifted(
    source: FieldSource,
    payload: Payload,
    height: float,
    on_state: Callable[[float, float], None] | None = None,
) -> Levitation:
    """The common current that carries the payload on the z axis.

    In a map of saturating iron the search begins at the mean of the reference currents.

    Parameters
    ----------
    source
        Result of `find_source`.
    payload
        The levitated payload.
    height
        z of the magnet, m.
    on_state
        on_state(current, share of the weight) is called after each state of saturating iron.

    Returns
    -------
    Levitation
        The equilibrium at that current.

    Raises
    ------
    Infeasible
        If the field does not lift the payload.
    OutsideMapError
        For a place or a current outside the map.
    """
    from fieldmap.levitation import lift_current
    from fieldmap.levitation.places import check_centre

    point = check_centre(require_box(source), payload, [0.0, 0.0, height], "the magnet's centre")
    first = 1.0
    if source.is_map and not source.field.affine:
        from fieldmap.lookup import FieldMap

        assert isinstance(source.field, FieldMap)
        first = float(np.mean(source.field.info.reference_current))
    found = lift_current(source.field, payload, point, first=first, on_state=on_state)
    return Levitation(source, payload, found, (*found.assumptions, *source.assumptions(found.currents)))


def require_box(source: FieldSource) -> Bounds:
    """The box in which a magnet may be. Nothing is solved for it.

    Parameters
    ----------
    source
        Result of `find_source`.

    Returns
    -------
    Bounds
        Lower and upper corner (3,), m.

    Raises
    ------
    InputError
        For a source without a box.
    """
    if source.bounds is None:
        remedy = "add a [workspace] table to the device file"
        raise InputError.of(source.name, "must have a [workspace] to search", "none", remedy)
    return source.bounds
