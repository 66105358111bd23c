"""Fit files: unknown keys of a device, the tables that were measured on the machine, and the fit that they ask for."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from fieldmap.device.changes import key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import FitError
from fieldmap.field import AnyField
from fieldmap.inputs.findings import Finding, closest, one_of, shown
from fieldmap.inputs.key_paths import Location
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import (
    LARGEST_NUMBER,
    MILLI,
    Format,
    Point,
    Positive,
    Table,
    Text,
    broken,
    is_number,
)
from fieldmap.levitation.unknowns import Unknown
from fieldmap.records import Record
from fieldmap.studies.machine_fit import (
    FieldReadings,
    InductanceReadings,
    LiftCurrentReadings,
    MachineFit,
    Readings,
    fit_machine,
    solved_field,
)
from fieldmap.studies.reading import device_file
from fieldmap.typing import Array, PathLike

Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]


def _deviation(value: Any) -> Any:
    """One positive number for all readings, or a list of one for each."""
    numbers = value if isinstance(value, list) else [value]
    if not numbers or not all(is_number(n) and n > 0 for n in numbers):
        must_hold = "one number above 0 for all readings, or a list of one for each"
        raise broken(must_hold, shown(value), "state the standard deviation of a reading")
    return value


def _amperes(value: Any) -> Any:
    """One number for all coils, a list of one per coil, or a list of such lists, one for each point."""
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    for row in rows:
        numbers = row if isinstance(row, list) else [row]
        if not numbers or not all(is_number(n) for n in numbers):
            must_hold = "one number for all coils, a list of one per coil, or a list of such lists, one for each point"
            raise broken(must_hold, shown(value), "write for example currents_A = 1.5")
    return value


def _or_lists(number: dict[str, Any], depth: int) -> WithJsonSchema:
    """JSON Schema of a number, or of lists of it, of as many dimensions at most."""
    choices = [number]
    for _ in range(depth):
        choices.append({"type": "array", "items": choices[-1]})
    return WithJsonSchema({"anyOf": choices})


Deviation = Annotated[
    Any, BeforeValidator(_deviation), _or_lists({"type": "number", "exclusiveMinimum": 0}, 1)
]
Amperes = Annotated[Any, BeforeValidator(_amperes), _or_lists({"type": "number"}, 2)]
Rows = Annotated[list[Number], Field(min_length=1)]


class UnknownKeys(Table):
    """A number of the device that is to be found; all values in the unit of its key."""

    key: Text = Field(description='key path of the device file, for example "joint.ends.gap_mm"')
    start: Number = Field(description="where the search begins")
    lower: Number | None = Field(default=None, description="lower bound, if there is one")
    upper: Number | None = Field(default=None, description="upper bound, if there is one")
    prior: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="mean and standard deviation that are known from elsewhere",
        examples=[[1500.0, 300.0]],
    )
    step: Positive | None = Field(
        default=None,
        description="difference for the derivative; a hundredth of start if left out",
        examples=[0.5],
    )

    @model_validator(mode="after")
    def _bounds_in_order(self) -> "UnknownKeys":
        low = -LARGEST_NUMBER if self.lower is None else self.lower
        high = LARGEST_NUMBER if self.upper is None else self.upper
        if not low <= self.start <= high or low == high:
            received = f"lower {self.lower}, start {self.start:g}, upper {self.upper}"
            raise broken("start must lie between lower and upper", received, "correct the numbers")
        if self.prior is not None and not self.prior[1] > 0:
            raise broken(
                "the deviation of the prior must be above 0", shown(self.prior), "write [mean, deviation]"
            )
        return self


class _MeasuredKeys(Table):
    name: Text = Field(description="name of the table", examples=["on the axis"])
    use: Literal["fit", "predict"] = Field(
        default="fit", description="whether the unknowns are fitted to it, or it is predicted with them"
    )

    unit: ClassVar[tuple[str, float]] = ("A", 1.0)
    """In which the file states the readings, and how many SI units that is."""

    def mistakes(self, device: Device) -> Iterator[Finding]:
        """What does not fit the device or other keys, at its place in the table."""
        raise NotImplementedError

    def readings(self, device: Device) -> Readings:
        """In SI."""
        raise NotImplementedError

    def labels(self) -> Iterator[str]:
        """What each reading is."""
        raise NotImplementedError

    def _lengths(self, count: int, what: str, *keys: str) -> Iterator[Finding]:
        for key in keys:
            given = getattr(self, key)
            if isinstance(given, list) and len(given) != count:
                must_hold = f"must hold a number for each of the {count} {what}"
                yield Finding((key,), must_hold, f"{len(given)} numbers", "add or remove some")


class FluxDensityKeys(_MeasuredKeys):
    """Flux densities at points."""

    points_mm: Annotated[list[Point], Field(min_length=1)] = Field(description="where the probe was")
    currents_A: Amperes = Field(
        description="one for all coils, one per coil, or a list of one per coil for each point"
    )
    components: Annotated[list[Literal["x", "y", "z"]], Field(min_length=1)] = Field(
        default=["x", "y", "z"], description="what was read", examples=[["z"]]
    )
    measured_mT: Annotated[list[Rows], Field(min_length=1)] = Field(
        description="of each point the components that were read", examples=[[[0.24, 0.01, 1.4]]]
    )
    deviation_mT: Deviation = Field(
        description="standard deviation, of all readings or of those of each point", examples=[0.01]
    )

    unit: ClassVar[tuple[str, float]] = ("mT", MILLI)

    @model_validator(mode="after")
    def _a_row_for_each_point(self) -> "FluxDensityKeys":
        if len(set(self.components)) < len(self.components):
            raise broken("every component is listed once", shown(self.components), "remove the second one")
        if len(self.measured_mT) != len(self.points_mm):
            received = f"{len(self.measured_mT)} rows for {len(self.points_mm)} points"
            raise broken("measured_mT needs a row for each point", received, "add or remove rows")
        wrong = {len(row) for row in self.measured_mT} - {len(self.components)}
        if wrong:
            must_hold = f"each row of measured_mT holds {', '.join(self.components)}"
            remedy = "complete the rows, or state components"
            raise broken(must_hold, f"{min(wrong)} numbers", remedy)
        return self

    def mistakes(self, device: Device) -> Iterator[Finding]:
        """Deviations and currents of other numbers than points and coils."""
        yield from self._lengths(len(self.points_mm), "points", "deviation_mT")
        given, coils = self.currents_A, len(device.coils)
        rows = given if isinstance(given, list) and isinstance(given[0], list) else None
        if rows is not None and len(rows) != len(self.points_mm):
            must_hold = f"a list of currents for each of the {len(self.points_mm)} points"
            yield Finding(("currents_A",), must_hold, f"{len(rows)} lists", "add or remove some")
        wrong = [row for row in rows or [given] if isinstance(row, list) and len(row) != coils]
        if wrong:
            must_hold = f"one number for each of the {coils} coils ({', '.join(device.coil_names)})"
            yield Finding(("currents_A",), must_hold, f"{len(wrong[0])} numbers", "list as many")

    def readings(self, device: Device) -> Readings:
        """Flux densities."""
        given = np.asarray(self.currents_A, float)
        measured = np.full((len(self.points_mm), 3), np.nan)
        measured[:, ["xyz".index(letter) for letter in self.components]] = _milli(self.measured_mT)
        deviation = _milli(self.deviation_mT)
        each = np.repeat(deviation, 3) if deviation.ndim else deviation
        currents = np.full(len(device.coils), float(given)) if given.ndim == 0 else given
        return FieldReadings(self.name, _milli(self.points_mm), currents, measured, each)

    def labels(self) -> Iterator[str]:
        """Component and place."""
        for point in self.points_mm:
            yield from (f"B{letter} at {_place(point)}" for letter in "xyz" if letter in self.components)


class InductanceKeys(_MeasuredKeys):
    """Inductances of coils."""

    coils: Annotated[list[Annotated[list[Text], Field(min_length=2, max_length=2)]], Field(min_length=1)] = (
        Field(
            description="pairs of coils by name; the same twice for a coil's own inductance",
            examples=[[["coil", "coil"]]],
        )
    )
    measured_mH: Rows = Field(description="of each pair", examples=[[6.46]])
    deviation_mH: Deviation = Field(
        description="standard deviation, one or one for each pair", examples=[0.03]
    )

    unit: ClassVar[tuple[str, float]] = ("mH", MILLI)

    def mistakes(self, device: Device) -> Iterator[Finding]:
        """Numbers that do not fit the pairs, and coils that the device does not have."""
        yield from self._lengths(len(self.coils), "pairs", "measured_mH", "deviation_mH")
        names = list(device.coil_names)
        for j, pair in enumerate(self.coils):
            for name in pair:
                if name not in names:
                    guess = closest(name, names)
                    remedy = f'did you mean "{guess}"?' if guess else "write the name of a coil"
                    must_hold = f"must be a coil of the device: {one_of(names)}"
                    yield Finding(("coils", j), must_hold, f'"{name}"', remedy)

    def readings(self, device: Device) -> Readings:
        """Inductances."""
        pairs = [[device.coil_names.index(name) for name in pair] for pair in self.coils]
        return InductanceReadings(self.name, pairs, _milli(self.measured_mH), _milli(self.deviation_mH))

    def labels(self) -> Iterator[str]:
        """The coils."""
        yield from (pair[0] if pair[0] == pair[1] else " and ".join(pair) for pair in self.coils)


class LiftCurrentKeys(_MeasuredKeys):
    """Currents that carry the payload."""

    positions_mm: Annotated[list[Point], Field(min_length=1)] = Field(
        description="places of the magnet's centre", examples=[[[0.0, 0.0, -95.0]]]
    )
    shares: Rows | None = Field(
        default=None, description="current of each coil per ampere; 1 if left out", examples=[[1.0, 0.5]]
    )
    measured_A: Rows = Field(description="of each place the common current", examples=[[1.56]])
    deviation_A: Deviation = Field(
        description="standard deviation, one or one for each place", examples=[0.02]
    )

    def mistakes(self, device: Device) -> Iterator[Finding]:
        """Numbers that do not fit the places or coils, and a device without a payload."""
        yield from self._lengths(len(self.positions_mm), "places", "measured_A", "deviation_A")
        yield from self._lengths(len(device.coils), "coils", "shares")
        if device.payload is None:
            yield Finding((), "the device needs a [payload] that is carried", "none", "add one to its file")

    def readings(self, device: Device) -> Readings:
        """Lift currents."""
        places = _milli(self.positions_mm)
        return LiftCurrentReadings(self.name, places, self.measured_A, self.deviation_A, self.shares)

    def labels(self) -> Iterator[str]:
        """The place."""
        yield from (f"at {_place(point)}" for point in self.positions_mm)


def _milli(values: Any) -> Array:
    return np.asarray(values, dtype=float) * MILLI


def _place(point: list[float]) -> str:
    return f"({', '.join(f'{value:g}' for value in point)}) mm"


class FitIronKeys(Table):
    """How the iron is solved."""

    model: Literal["linear", "saturating"] | None = Field(
        default=None,
        description="saturating where a material of the device does, if left out",
        examples=["linear"],
    )
    refinement: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=1.0, description="divides the device's mesh sizes"
    )


class FitFile(Table):
    """A fit file."""

    format: Format
    title: Text = Field(description="one line about the fit")
    device: Text = Field(description="device file or name of a shipped device")
    iron: FitIronKeys = Field(default=FitIronKeys(), description="how the iron is solved")
    unknown: Annotated[list[UnknownKeys], Field(min_length=1)] = Field(description="[[unknown]] tables")
    flux_density: list[FluxDensityKeys] = Field(
        default=[], description="[[flux_density]]: readings of a probe"
    )
    inductance: list[InductanceKeys] = Field(default=[], description="[[inductance]]: readings of a bridge")
    lift_current: list[LiftCurrentKeys] = Field(
        default=[], description="[[lift_current]]: currents that carry the payload"
    )

    @model_validator(mode="after")
    def _names_of_their_own(self) -> "FitFile":
        names = [table.name for _, table in self.tables()]
        for what, all_of_it in (("unknown", [one.key for one in self.unknown]), ("table", names)):
            twice = sorted({one for one in all_of_it if all_of_it.count(one) > 1})
            if twice:
                raise broken(f"every {what} is named once", one_of(twice), "rename or remove one")
        return self

    def tables(self) -> list[tuple[Location, _MeasuredKeys]]:
        """Every table of readings, and its place."""
        kinds: dict[str, Sequence[_MeasuredKeys]] = {
            "flux_density": self.flux_density,
            "inductance": self.inductance,
            "lift_current": self.lift_current,
        }
        return [((kind, k), one) for kind, tables in kinds.items() for k, one in enumerate(tables)]


FIT = FileKind("fit", FitFile, FitError, "maps", "fits")


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Record):
    """What a fit file asks for. path, device_path: the files; readings are fitted, those of `predict` are not; solve:
    the field of a device; labels: by table, what each reading is; units:
    by table, the unit in which the file states it and how many SI units that is."""

    path: Path
    title: str
    device_path: Path
    unknowns: tuple[Unknown, ...]
    readings: tuple[Readings, ...]
    predict: tuple[Readings, ...]
    solve: Callable[[Device], AnyField]
    labels: Mapping[str, tuple[str, ...]]
    units: Mapping[str, tuple[str, float]]

    def run(self, on_solve: Callable[[Mapping[str, float]], None] | None = None) -> MachineFit:
        """Find the unknowns: `fit_machine`. on_solve is called with the values of each solve."""
        return fit_machine(self.device_path, self.unknowns, self.readings, self.predict, self.solve, on_solve)


def read_fit(path_or_name: PathLike) -> Fit:
    """Read and check a fit file: its path, or the name of a shipped one ("loop_and_sphere").

    The format is described in docs/fit_machine.md. Raises FitError with one Problem for every error of the file.

    >>> fit = read_fit("loop_and_sphere")
    >>> [one.key for one in fit.unknowns], [table.name for table in fit.predict]
    (['coil.loop.position_mm.3', 'coil.loop.turns'], ['off the axis'])
    """
    path = FIT.find(path_or_name)
    file = FIT.load(path)
    contents = FIT.contents(file)
    document = device_file(contents.device, file, FitError)
    device = device_of(document)
    findings = [
        finding
        for k, unknown in enumerate(contents.unknown)
        if (finding := key_finding(("unknown", k, "key"), unknown.key, document)) is not None
    ]
    tables = [table for _, table in contents.tables()]
    for place, table in contents.tables():
        findings += [replace(one, location=(*place, *one.location)) for one in table.mistakes(device)]
    if findings:
        raise FitError(*file.problems(findings))
    return Fit(
        path=path,
        title=contents.title,
        device_path=document.path,
        unknowns=tuple(_unknown(keys) for keys in contents.unknown),
        readings=tuple(table.readings(device) for table in tables if table.use == "fit"),
        predict=tuple(table.readings(device) for table in tables if table.use == "predict"),
        solve=partial(solved_field, model=contents.iron.model, refinement=contents.iron.refinement),
        labels={table.name: tuple(table.labels()) for table in tables},
        units={table.name: table.unit for table in tables},
    )


def _unknown(keys: UnknownKeys) -> Unknown:
    low = -np.inf if keys.lower is None else keys.lower
    high = np.inf if keys.upper is None else keys.upper
    prior = None if keys.prior is None else (keys.prior[0], keys.prior[1])
    return Unknown(keys.key, keys.start, low, high, prior, keys.step)
