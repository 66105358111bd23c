"""Fit files: unknown keys of a device, the tables that were measured on the machine, and the fit that they ask for."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from fieldmap.device.changes import key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import FitError
from fieldmap.field import AnyField
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.findings import Finding, meant, one_of, shown
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import MILLI, Table, Text, Versioned, broken
from fieldmap.levitation.unknowns import Unknown, wrong_numbers
from fieldmap.maps.recipe import IronLaw, Refinement
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
from fieldmap.typing import PathLike


class _Measured(Table):
    """A table of readings."""

    use: Literal["fit", "predict"] = Field(
        default="fit", description="whether the unknowns are fitted to it, or it is predicted with them"
    )


def _lengths(table: Any, count: int, what: str, *keys: str) -> Iterator[Finding]:
    """Lists of other lengths than they must have."""
    for key in keys:
        given = getattr(table, key)
        if isinstance(given, list) and len(given) != count:
            must_hold = f"must hold a number for each of the {count} {what}"
            yield Finding((key,), must_hold, f"{len(given)} numbers", "add or remove some")


def _a_row_for_each_point(keys: Any) -> None:
    if len(set(keys.components)) < len(keys.components):
        raise broken("every component is listed once", shown(keys.components), "remove the second one")
    if len(keys.measured_mT) != len(keys.points_mm):
        received = f"{len(keys.measured_mT)} rows for {len(keys.points_mm)} points"
        raise broken("measured_mT needs a row for each point", received, "add or remove rows")
    wrong = {len(row) for row in keys.measured_mT} - {len(keys.components)}
    if wrong:
        must_hold = f"each row of measured_mT holds {', '.join(keys.components)}"
        remedy = "complete the rows, or state components"
        raise broken(must_hold, f"{min(wrong)} numbers", remedy)


class _Probe(_Measured):
    """What a probe read."""

    components: Annotated[list[Literal["x", "y", "z"]], Field(min_length=1)] = Field(
        default=["x", "y", "z"], description="what was read", examples=[["z"]]
    )

    def also_makes(self) -> Mapping[str, Any]:
        """All components, and a deviation of each; NaN for what was not read."""
        keys: Any = self
        measured = np.full((len(keys.points_mm), 3), np.nan)
        measured[:, ["xyz".index(letter) for letter in self.components]] = keys.measured_mT
        deviation = np.asarray(keys.deviation_mT)
        each = np.repeat(deviation, 3) if deviation.ndim else deviation
        return {"measured": MILLI * measured, "deviation": MILLI * each}


_PROBE: Any = table_of(FieldReadings, bases=(_Probe,), rules=(_a_row_for_each_point,))
_BRIDGE: Any = table_of(InductanceReadings, bases=(_Measured,))
_LIFT: Any = table_of(LiftCurrentReadings, bases=(_Measured,))


def _probe_mistakes(table: Any, device: Device) -> Iterator[Finding]:
    """Deviations and currents of other numbers than points and coils."""
    yield from _lengths(table, len(table.points_mm), "points", "deviation_mT")
    given, coils = table.currents_A, len(device.coils)
    rows = given if isinstance(given, list) and isinstance(given[0], list) else None
    if rows is not None and len(rows) != len(table.points_mm):
        must_hold = f"a list of currents for each of the {len(table.points_mm)} points"
        yield Finding(("currents_A",), must_hold, f"{len(rows)} lists", "add or remove some")
    wrong = [row for row in rows or [given] if isinstance(row, list) and len(row) != coils]
    if wrong:
        must_hold = f"one number for each of the {coils} coils ({', '.join(device.coil_names)})"
        yield Finding(("currents_A",), must_hold, f"{len(wrong[0])} numbers", "list as many")


def _bridge_mistakes(table: Any, device: Device) -> Iterator[Finding]:
    """Numbers that do not fit the pairs, and coils that the device does not have."""
    yield from _lengths(table, len(table.coils), "pairs", "measured_mH", "deviation_mH")
    names = list(device.coil_names)
    for j, pair in enumerate(table.coils):
        for name in pair:
            if name not in names:
                remedy = meant(name, names, "write the name of a coil")
                must_hold = f"must be a coil of the device: {one_of(names)}"
                yield Finding(("coils", j), must_hold, f'"{name}"', remedy)


def _lift_mistakes(table: Any, device: Device) -> Iterator[Finding]:
    """Numbers that do not fit the places or coils, and a device without a payload."""
    yield from _lengths(table, len(table.positions_mm), "places", "measured_A", "deviation_A")
    yield from _lengths(table, len(device.coils), "coils", "shares")
    if device.payload is None:
        yield Finding((), "the device needs a [payload] that is carried", "none", "add one to its file")


def _place(point: list[float]) -> str:
    return f"({', '.join(f'{value:g}' for value in point)}) mm"


def _probe_labels(table: Any) -> Iterator[str]:
    for point in table.points_mm:
        yield from (f"B{letter} at {_place(point)}" for letter in "xyz" if letter in table.components)


def _bridge_labels(table: Any) -> Iterator[str]:
    yield from (pair[0] if pair[0] == pair[1] else " and ".join(pair) for pair in table.coils)


def _lift_labels(table: Any) -> Iterator[str]:
    yield from (f"at {_place(point)}" for point in table.positions_mm)


@dataclass(frozen=True)
class _Kind:
    """A kind of readings. mistakes: what does not fit the device or other keys; labels: what each reading is; unit: in
    which the file states the readings, and how many SI units that is."""

    mistakes: Callable[[Any, Device], Iterator[Finding]]
    labels: Callable[[Any], Iterator[str]]
    unit: tuple[str, float]


_KINDS = {
    "flux_density": _Kind(_probe_mistakes, _probe_labels, ("mT", MILLI)),
    "inductance": _Kind(_bridge_mistakes, _bridge_labels, ("mH", MILLI)),
    "lift_current": _Kind(_lift_mistakes, _lift_labels, ("A", 1.0)),
}


@dataclass(frozen=True, repr=False)
class FitIron(Record):
    """How the iron is solved."""

    model: Annotated[
        str | None,
        Key(
            IronLaw | None,
            "saturating where a material of the device does, if left out",
            examples=("linear",),
        ),
    ] = None
    refinement: Annotated[float, Key(Refinement, "divides the device's mesh sizes")] = 1.0


def _names_of_their_own(keys: Any) -> None:
    names = [table.name for kind in _KINDS for table in getattr(keys, kind)]
    for what, all_of_it in (("unknown", [one.key for one in keys.unknown]), ("table", names)):
        twice = sorted({one for one in all_of_it if all_of_it.count(one) > 1})
        if twice:
            raise broken(f"every {what} is named once", one_of(twice), "rename or remove one")


@dataclass(frozen=True, eq=False, repr=False)
class FitSettings(Record):
    """A fit file."""

    title: Annotated[str, Key(Text, "one line about the fit")]
    device: Annotated[str, Key(Text, "device file or name of a shipped device")]
    unknowns: Annotated[
        tuple[Unknown, ...],
        Key(
            Annotated[list[table_of(Unknown)], Field(min_length=1)],  # type: ignore[misc]
            "[[unknown]] tables",
            name="unknown",
        ),
    ]
    iron: Annotated[FitIron, Key(table_of(FitIron), "how the iron is solved")] = FitIron()
    flux_density: Annotated[
        tuple[FieldReadings, ...], Key(list[_PROBE], "[[flux_density]]: readings of a probe")
    ] = ()
    inductance: Annotated[
        tuple[InductanceReadings, ...], Key(list[_BRIDGE], "[[inductance]]: readings of a bridge")
    ] = ()
    lift_current: Annotated[
        tuple[LiftCurrentReadings, ...], Key(list[_LIFT], "[[lift_current]]: currents that carry the payload")
    ] = ()


FIT = FileKind(
    "fit",
    table_of(FitSettings, "", "FitFile", (Versioned,), rules=(_names_of_their_own,)),
    FitError,
    "maps",
    "fits",
)


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
        """Find the unknowns: see `fit_machine`.

        Parameters
        ----------
        on_solve
            Called with the values of each solve.

        Returns
        -------
        MachineFit
            The fit.
        """
        return fit_machine(self.device_path, self.unknowns, self.readings, self.predict, self.solve, on_solve)


def read_fit(path_or_name: PathLike) -> Fit:
    """Read and check a fit file, as docs/fit_machine.md describes it.

    Parameters
    ----------
    path_or_name
        Path of the file, or the name of a shipped one ("loop_and_sphere").

    Raises
    ------
    FitError
        One Problem for every error of the file.

    Examples
    --------
    >>> fit = read_fit("loop_and_sphere")
    >>> [one.key for one in fit.unknowns], [table.name for table in fit.predict]
    (['coil.loop.position_mm.3', 'coil.loop.turns'], ['off the axis'])
    """
    file = FIT.load(FIT.find(path_or_name))
    contents = FIT.contents(file)
    document = device_file(contents.device, file, FitError)
    device = device_of(document)
    settings: FitSettings = record_of(contents)
    findings = []
    for k, unknown in enumerate(settings.unknowns):
        findings += [Finding(("unknown", k), *told) for told in wrong_numbers(unknown)]
        found = key_finding(("unknown", k, "key"), unknown.key, document)
        findings += [] if found is None else [found]
    tables = [(kind, k, table) for kind in _KINDS for k, table in enumerate(getattr(contents, kind))]
    for kind, k, table in tables:
        findings += [one.below(kind, k) for one in _KINDS[kind].mistakes(table, device)]
    if findings:
        raise FitError(*file.problems(findings))
    uses = {table.name: table.use for _, _, table in tables}
    readings: list[Readings] = [*settings.flux_density, *settings.inductance, *settings.lift_current]
    return Fit(
        path=file.path,
        title=settings.title,
        device_path=document.path,
        unknowns=settings.unknowns,
        readings=tuple(one for one in readings if uses[one.name] == "fit"),
        predict=tuple(one for one in readings if uses[one.name] == "predict"),
        solve=partial(solved_field, model=settings.iron.model, refinement=settings.iron.refinement),
        labels={table.name: tuple(_KINDS[kind].labels(table)) for kind, _, table in tables},
        units={table.name: _KINDS[kind].unit for kind, _, table in tables},
    )
