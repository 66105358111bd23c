"""Summary of a map file: device, grid, field in the middle, accuracy, and comparison with measurements."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.device import recorded_device
from fieldmap.device.measured import MeasuredMachine, measured_on
from fieldmap.device.model import Device, Payload
from fieldmap.errors import InputError, MissingExtraError, OutsideMapError
from fieldmap.io.field_source import existing_map
from fieldmap.lookup import FieldMap, open_map
from fieldmap.plain import Plain, plain_fields, plain_items
from fieldmap.reaction import own_reaction
from fieldmap.records import Record
from fieldmap.store import FieldError, MapInfo, MissedAccuracy, missed_accuracy
from fieldmap.typing import Array, PathLike

if TYPE_CHECKING:
    from fieldmap.levitation.comparison import ForceFit, LiftAtHeight, ShiftBesideMeasured

NO_SATURATION = (
    'This map is linear: no saturation. A recipe with iron.model = "saturating" makes a map over currents with '
    "saturation (docs/recipes.md)."
)

# Points along each edge of the box at which the pull of the iron's reaction is evaluated.
_LATTICE = 9


@dataclass(frozen=True, eq=False, repr=False)
class MiddleField(Record):
    """Bz, T, and dBz/dz, T/m, in the middle of the box (3,), m: for 1 A in each coil alone and in all coils, without
    the field of fixed sources; for saturating iron at the reference currents. without_currents: field of the fixed
    sources, if there are any."""

    at: Array
    Bz: tuple[float, ...]
    dBz_dz: tuple[float, ...]
    without_currents: tuple[float, float] | None = None


@dataclass(frozen=True)
class ErrorShares(Record):
    """Errors of B and of its gradient, as shares of the largest in the workspace."""

    flux_density: float
    gradient: float


@dataclass(frozen=True, repr=False)
class TriedStates(Record):
    """States of one kind at which a current model was tested: their number, the number of solved ones (the others are
    mirror images), and the largest errors."""

    kind: str
    states: int
    solved: int
    largest: ErrorShares


@dataclass(frozen=True, repr=False)
class MapAccuracy(Record):
    """Errors of a map: mesh, interpolation between its nodes, and current model. None: not measured.

    meshed: whether there is iron with a mesh, which causes an error. mesh: estimated error. bound: certified error of
    lookups by the harmonic form, T and T/m; interpolation: largest error of the Hermite form at sampled points.
    tried: tested states of the current model; empty for a map that is linear in the currents.
    """

    meshed: bool
    mesh: ErrorShares | None
    interpolation: FieldError | None
    bound: FieldError | None
    tried: tuple[TriedStates, ...] = ()

    @property
    def current_model(self) -> ErrorShares | None:
        """Largest errors over all kinds of tested states."""
        if not self.tried:
            return None
        found = [one.largest for one in self.tried]
        return ErrorShares(max(e.flux_density for e in found), max(e.gradient for e in found))

    def to_dict(self) -> dict[str, Plain]:
        """The errors as plain Python."""
        return plain_fields(self) | plain_items(current_model=self.current_model)


@dataclass(frozen=True, eq=False, repr=False)
class ReactionOfMap(Record):
    """The iron's reaction to magnets in a map.

    fields: number of fields that span the reaction; error: due to their number; asymmetry: error of the solver's
    reciprocity; width: largest ratio of the width of an element of the iron to its distance from the box; change: of
    the reaction of saturating iron at the largest currents. pull: largest force on the payload's upright moment with
    all coils off, on a coarse lattice of points in the box, N, and its place `at` (3,), m; None without a moment."""

    fields: int
    error: float
    asymmetry: float
    width: float
    change: float
    pull: float | None = None
    at: Array | None = None


@dataclass(frozen=True, eq=False, repr=False)
class SensorOfMap(Record):
    """A field sensor of a map.

    position (3,), m; axis (3,), unit vector. of_currents: reading with 1 A in every coil, or at the reference currents
    of a map of saturating iron, T. of_payload: reading of the payload's upright moment in the middle of the box, T;
    None without a moment."""

    name: str
    position: Array
    axis: Array
    of_currents: float
    of_payload: float | None


@dataclass(frozen=True, eq=False, repr=False)
class MapSummary(Record):
    """The contents of `fieldmap info`. size: of the file, bytes; lift_source: source of the measured lift currents;
    force_fit and shifts: comparison with measurements on the machine, if there are any. lift_missing: reason why the
    currents that lift the payload were not computed, or empty. reaction: of the iron to magnets; None if the map does
    not hold it. sensors: of the device, in the order of `FieldMap.readings`."""

    path: Path
    size: int
    info: MapInfo
    device: Device | None
    middle: MiddleField
    lift: tuple[LiftAtHeight, ...]
    lift_source: str
    force_fit: ForceFit | None = None
    shifts: tuple[ShiftBesideMeasured, ...] = ()
    lift_missing: str = ""
    reaction: ReactionOfMap | None = None
    sensors: tuple[SensorOfMap, ...] = ()

    @property
    def lift_assumptions(self) -> tuple[str, ...]:
        """Error of the lift currents due to the volume rules of the payload's magnets, if these have shapes."""
        if self.payload is None or not self.payload.sized or not self.lift:
            return ()
        from fieldmap.levitation.balance import model_of, rule_stated

        errors = [row.volume_error for row in self.lift if row.volume_error is not None]
        largest = float(np.max(errors)) if errors else np.nan
        return rule_stated(self.payload, model_of(self.payload), largest, "A of the lift currents")

    @property
    def payload(self) -> Payload | None:
        """The payload of the recorded device."""
        return None if self.device is None else self.device.payload

    @property
    def current_limit(self) -> float | None:
        """Largest current of the recorded device's driver, A per coil."""
        driver = None if self.device is None else self.device.driver
        return None if driver is None else driver.current_limit

    @property
    def domain(self) -> CurrentDomain | None:
        """The domain of the currents of a map of saturating iron; None for a map that holds for any currents."""
        return None if self.info.reduced_model is None else self.info.reduced_model.domain

    @property
    def saturation(self) -> str:
        """A note that a linear map has no saturation, if its device has saturating iron; otherwise empty."""
        from fieldmap.device.materials import keys_of_table

        text = self.info.provenance.device_text if self.domain is None else ""
        tables: Mapping[str, Mapping[str, Any]] = tomllib.loads(text).get("material", {})
        found = (keys_of_table(table) for table in tables.values())
        saturates = any(keys is not None and keys.makes.saturates for keys in found)
        return NO_SATURATION if saturates else ""

    @property
    def missed_accuracy(self) -> MissedAccuracy | None:
        """Errors of the current model, if they are larger than the recipe allows."""
        return missed_accuracy(self.info.provenance.solver_report)

    @property
    def accuracy(self) -> MapAccuracy:
        """The accuracy stated in the file."""
        info, report = self.info, self.info.provenance.solver_report
        estimate, tried = report.get("error"), []
        for kind, of in report.get("states_tried", {}).items():
            largest = ErrorShares(of["flux_density_share"], of["gradient_share"])
            tried.append(TriedStates(kind, of["states"], of["solved"], largest))
        return MapAccuracy(
            meshed=bool(report.get("tetrahedra")),
            mesh=ErrorShares(estimate["flux_density"], estimate["gradient"]) if estimate else None,
            interpolation=info.interpolation_error,
            bound=info.error_bounds.get("harmonic"),
            tried=tuple(tried),
        )

    def signal_ranges(self) -> dict[str, tuple[float, float]]:
        """Range of each signal of `domain`, by name; for independent currents by the names of the coils."""
        domain = self.domain
        if domain is None:
            return {}
        ranges = zip(domain.lower.tolist(), domain.upper.tolist(), strict=True)
        return dict(zip(signal_names(domain, self.info.coil_names), ranges, strict=True))

    def to_dict(self) -> dict[str, Plain]:
        """The summary as plain Python, SI units but for `sensor_mm`."""
        info, record, grid = self.info, self.info.provenance, self.info.grid
        return plain_items(
            path=str(self.path),
            size=self.size,
            title=record.title,
            device=record.device_name,
            created=record.created,
            coil_names=info.coil_names,
            fixed_sources=info.fixed_sources,
            solver=record.solver_report,
            grid={"lower": grid.lower, "upper": grid.upper, "spacing": grid.spacing, "shape": grid.shape},
            reference_current=info.reference_current,
            interpolation_error=info.interpolation_error,
            error_bounds=info.error_bounds,
            current_error=info.current_error,
            accuracy=self.accuracy.to_dict(),
            missed_accuracy=self.missed_accuracy,
            current_domain=self._domain_items(),
            current_limit=self.current_limit,
            middle=self.middle,
            assumptions=record.assumptions,
            payload=self.payload,
            lift=[row.to_dict() for row in self.lift],
            force_fit=self.force_fit,
            shifts=self.shifts,
            lift_missing=self.lift_missing,
            lift_assumptions=self.lift_assumptions,
            saturation=self.saturation,
            reaction=self.reaction,
            sensors=self.sensors,
        )

    def _domain_items(self) -> dict[str, object] | None:
        if self.domain is None:
            return None
        parametrisation = self.domain.parametrisation
        return {
            "division_exponent": parametrisation.parameters.get("n"),
            "ranges": self.signal_ranges(),
            "parametrisation": parametrisation.name,
            "limit": parametrisation.parameters.get("limit"),
        }


def signal_names(domain: CurrentDomain, coil_names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the signals of a domain; for independent currents the names of the coils.

    Parameters
    ----------
    domain
        The domain.
    coil_names
        Names of the coils.

    Returns
    -------
    tuple[str, ...]
        The names.
    """
    names = domain.parametrisation.signal_names
    return tuple(coil_names) if domain.parametrisation.name == "independent" else names


def summarise_map(path: PathLike) -> MapSummary:
    """Summarise a map file.

    Parameters
    ----------
    path
        Path of the file.

    Returns
    -------
    MapSummary
        The summary.

    Raises
    ------
    MapFileError
        As for `open_map`.
    """
    place = existing_map(path)
    opened = open_map(place)
    record = opened.info.provenance
    device = recorded_device(record.device_text) if record.device_text else None
    machine = measured_on(record.device_name, len(opened.coil_names))
    payload = None if device is None else device.payload
    summary = MapSummary(
        path=place,
        size=place.stat().st_size,
        info=opened.info,
        device=device,
        middle=middle_field(opened),
        lift=(),
        lift_source="" if machine is None else machine.lift_source,
        reaction=_reaction(opened, payload),
        sensors=_sensors(opened, payload),
    )
    return summary if payload is None else _with_lift(summary, opened, payload, machine)


def _with_lift(
    summary: MapSummary, opened: FieldMap, payload: Payload, machine: MeasuredMachine | None
) -> MapSummary:
    """The summary with the currents that lift the payload and their comparison with measurements, or with the reason
    why they are missing."""
    try:
        from fieldmap.levitation.comparison import fit_force, lift_by_height, shifts_beside_measured
    except MissingExtraError as error:
        (problem,) = error.problems
        return replace(summary, lift_missing=f"{problem.must_hold}: {problem.remedy}")
    domain = summary.domain
    try:
        lift = lift_by_height(opened, payload, machine, domain.largest_equal_current() if domain else None)
    except InputError as error:
        (problem,) = error.problems
        return replace(summary, lift_missing=f"{problem.must_hold}; {problem.received}: {problem.remedy}")
    shifts: tuple[ShiftBesideMeasured, ...] = ()
    if machine is not None and domain is not None:
        shifts = shifts_beside_measured(opened, payload, machine, domain.parametrisation)
    return replace(summary, lift=lift, force_fit=fit_force(opened, payload, lift), shifts=shifts)


def _reaction(opened: FieldMap, payload: Payload | None) -> ReactionOfMap | None:
    """The reaction as the map's report describes it, and the largest pull on the payload's moment."""
    told = opened.info.provenance.solver_report.get("reaction")
    if opened.reaction is None or told is None:
        return None
    known = {name: told[name] for name in ("fields", "error", "asymmetry", "width", "change")}
    if payload is None or not payload.moment:
        return ReactionOfMap(**known)
    shares = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, _LATTICE)] * 3, indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    points = opened.lower + shares * (opened.upper - opened.lower)
    _, slope = own_reaction(opened.reaction, points, np.array([0.0, 0.0, payload.moment]))
    pull = payload.moment * np.linalg.norm(slope[:, 2], axis=1)
    largest = int(pull.argmax())
    return ReactionOfMap(**known, pull=float(pull[largest]), at=points[largest])


def _sensors(opened: FieldMap, payload: Payload | None) -> tuple[SensorOfMap, ...]:
    sensors = opened.sensors
    if sensors is None:
        return ()
    middle, moment = 0.5 * (opened.lower + opened.upper), payload.moment if payload else None
    currents = 1.0 if opened.info.reduced_model is None else opened.info.reference_current
    shares = opened.readings(middle, np.zeros(3), currents)
    whole = opened.readings(middle, [0.0, 0.0, moment or 0.0], currents)
    added = [float(value) if moment else None for value in whole - shares]
    each = zip(sensors.names, sensors.positions, sensors.axes, shares.tolist(), added, strict=True)
    return tuple(SensorOfMap(*one) for one in each)


def middle_field(opened: FieldMap) -> MiddleField:
    """The field in the middle of a map's box.

    Parameters
    ----------
    opened
        The map.

    Returns
    -------
    MiddleField
        The field.
    """
    centre = 0.5 * (np.asarray(opened.lower) + np.asarray(opened.upper))
    off = None
    # The domain of a map of saturating iron may exclude zero currents.
    with suppress(OutsideMapError):
        if getattr(opened, "fixed_sources", ()):
            off = float(opened.constant_field(centre)[2]), float(opened.constant_gradient(centre)[2, 2])
    if opened.info.reduced_model is None:
        flux, slope = opened.unit_field(centre)[:, 2], opened.unit_gradient(centre)[:, 2, 2]
        return MiddleField(
            centre, (*flux.tolist(), float(flux.sum())), (*slope.tolist(), float(slope.sum())), off
        )
    state = opened.at(opened.info.reference_current)
    return MiddleField(centre, (float(state.field(centre)[2]),), (float(state.gradient(centre)[2, 2]),), off)
