"""From a fit file to unknowns and readings, and the fit itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.device.changes import key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, FitError
from fieldmap.field import AnyField
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding, closest, one_of
from fieldmap.inputs.key_paths import Location
from fieldmap.inputs.tables import MILLI
from fieldmap.iron import NonlinearSolver, solve_linear
from fieldmap.levitation.unknowns import Unknown
from fieldmap.records import Record
from fieldmap.shipped import is_file
from fieldmap.studies.fit_schema import (
    FIT,
    FitFile,
    FluxDensityKeys,
    InductanceKeys,
    LiftCurrentKeys,
    UnknownKeys,
)
from fieldmap.studies.machine_fit import (
    FieldReadings,
    InductanceReadings,
    LiftCurrentReadings,
    MachineFit,
    Readings,
    fit_machine,
)
from fieldmap.typing import Array, PathLike

_LETTERS = ("x", "y", "z")


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Record):
    """What a fit file asks for. path, device_path: the files; readings are fitted, those of `predict` are not; solve:
    the field of a device, None for the way that `fit_machine` chooses; labels: by table, what each reading is; units:
    by table, the unit in which the file states it and how many SI units that is."""

    path: Path
    title: str
    device_path: Path
    unknowns: tuple[Unknown, ...]
    readings: tuple[Readings, ...]
    predict: tuple[Readings, ...]
    solve: Callable[[Device], AnyField] | None
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
    document = _device_document(contents, file)
    device = device_of(document)
    findings = [*_of_keys(contents, document), *_of_tables(contents, device)]
    if findings:
        raise FitError(*file.problems(findings))
    tables = [(keys, _readings(keys, device)) for keys in _tables(contents)]
    return Fit(
        path=path,
        title=contents.title,
        device_path=document.path,
        unknowns=tuple(_unknown(keys) for keys in contents.unknown),
        readings=tuple(table for keys, table in tables if keys.use == "fit"),
        predict=tuple(table for keys, table in tables if keys.use == "predict"),
        solve=_solve(contents),
        labels={keys.name: tuple(_labels(keys)) for keys in _tables(contents)},
        units={keys.name: _unit(keys) for keys in _tables(contents)},
    )


_Keys = FluxDensityKeys | InductanceKeys | LiftCurrentKeys


def _tables(contents: FitFile) -> list[_Keys]:
    return [*contents.flux_density, *contents.inductance, *contents.lift_current]


def _device_document(contents: FitFile, file: Document) -> Document:
    beside = file.path.parent / contents.device
    try:
        return DEVICE.load(beside if is_file(beside) else DEVICE.find(contents.device))
    except DeviceFileError as error:
        findings = [
            Finding(("device",), f"{problem.where}: {problem.must_hold}", problem.received, problem.remedy)
            for problem in error.problems
        ]
        raise FitError(*file.problems(findings)) from error


def _of_keys(contents: FitFile, document: Document) -> Iterator[Finding]:
    for k, unknown in enumerate(contents.unknown):
        finding = key_finding(("unknown", k, "key"), unknown.key, document)
        if finding is not None:
            yield finding


def _of_tables(contents: FitFile, device: Device) -> Iterator[Finding]:
    coils = len(device.coils)
    for k, table in enumerate(contents.flux_density):
        place: Location = ("flux_density", k)
        yield from _of_lengths(table.deviation_mT, len(table.points_mm), (*place, "deviation_mT"), "points")
        given = table.currents_A
        rows = given if isinstance(given, list) and isinstance(given[0], list) else None
        if rows is not None and len(rows) != len(table.points_mm):
            must_hold = f"a list of currents for each of the {len(table.points_mm)} points"
            yield Finding((*place, "currents_A"), must_hold, f"{len(rows)} lists", "add or remove some")
        for row in rows or [given]:
            if isinstance(row, list) and len(row) != coils:
                must_hold = f"one number for each of the {coils} coils ({', '.join(device.coil_names)})"
                yield Finding((*place, "currents_A"), must_hold, f"{len(row)} numbers", "list as many")
                break
    for k, bridge in enumerate(contents.inductance):
        place = ("inductance", k)
        yield from _of_lengths(bridge.measured_mH, len(bridge.coils), (*place, "measured_mH"), "pairs")
        yield from _of_lengths(bridge.deviation_mH, len(bridge.coils), (*place, "deviation_mH"), "pairs")
        for j, pair in enumerate(bridge.coils):
            for name in pair:
                if name not in device.coil_names:
                    guess = closest(name, list(device.coil_names))
                    remedy = f'did you mean "{guess}"?' if guess else "write the name of a coil"
                    must_hold = f"must be a coil of the device: {one_of(list(device.coil_names))}"
                    yield Finding((*place, "coils", j), must_hold, f'"{name}"', remedy)
    for k, lift in enumerate(contents.lift_current):
        place = ("lift_current", k)
        yield from _of_lengths(lift.measured_A, len(lift.positions_mm), (*place, "measured_A"), "places")
        yield from _of_lengths(lift.deviation_A, len(lift.positions_mm), (*place, "deviation_A"), "places")
        if lift.shares is not None:
            yield from _of_lengths(lift.shares, coils, (*place, "shares"), "coils")
        if device.payload is None:
            yield Finding(
                place, "the device needs a [payload] that is carried", "none", "add one to its file"
            )


def _of_lengths(given: Any, count: int, place: Location, what: str) -> Iterator[Finding]:
    if isinstance(given, list) and len(given) != count:
        remedy = "add or remove some"
        yield Finding(
            place, f"must hold a number for each of the {count} {what}", f"{len(given)} numbers", remedy
        )


def _unknown(keys: UnknownKeys) -> Unknown:
    low = -np.inf if keys.lower is None else keys.lower
    high = np.inf if keys.upper is None else keys.upper
    prior = None if keys.prior is None else (keys.prior[0], keys.prior[1])
    return Unknown(keys.key, keys.start, low, high, prior, keys.step)


def _readings(keys: _Keys, device: Device) -> Readings:
    if isinstance(keys, InductanceKeys):
        pairs = [[device.coil_names.index(name) for name in pair] for pair in keys.coils]
        return InductanceReadings(keys.name, pairs, _milli(keys.measured_mH), _milli(keys.deviation_mH))
    if isinstance(keys, LiftCurrentKeys):
        places = _milli(keys.positions_mm)
        return LiftCurrentReadings(keys.name, places, keys.measured_A, keys.deviation_A, keys.shares)
    coils, given = len(device.coils), np.asarray(keys.currents_A, float)
    measured = np.full((len(keys.points_mm), 3), np.nan)
    measured[:, [_LETTERS.index(letter) for letter in keys.components]] = _milli(keys.measured_mT)
    deviation = _milli(keys.deviation_mT)
    each = np.repeat(deviation, 3) if deviation.ndim else deviation
    currents = np.full(coils, float(given)) if given.ndim == 0 else given
    return FieldReadings(keys.name, _milli(keys.points_mm), currents, measured, each)


def _milli(values: Any) -> Array:
    return np.asarray(values, dtype=float) * MILLI


def _labels(keys: _Keys) -> Iterator[str]:
    if isinstance(keys, InductanceKeys):
        yield from (pair[0] if pair[0] == pair[1] else " and ".join(pair) for pair in keys.coils)
        return
    points = keys.points_mm if isinstance(keys, FluxDensityKeys) else keys.positions_mm
    for point in points:
        place = ", ".join(f"{value:g}" for value in point)
        if isinstance(keys, LiftCurrentKeys):
            yield f"at ({place}) mm"
        else:
            yield from (f"B{letter} at ({place}) mm" for letter in _LETTERS if letter in keys.components)


def _unit(keys: _Keys) -> tuple[str, float]:
    if isinstance(keys, LiftCurrentKeys):
        return "A", 1.0
    return ("mT" if isinstance(keys, FluxDensityKeys) else "mH"), MILLI


def _solve(contents: FitFile) -> Callable[[Device], AnyField] | None:
    iron = contents.iron
    if iron == type(iron)():
        return None
    return partial(_solved, iron.model, iron.refinement)


def _solved(model: str | None, refinement: float, device: Device) -> AnyField:
    """The field of a device, as the file asks for it."""
    saturates = any(device.materials[body.material].saturates for body in device.bodies)
    if device.bodies and (model == "saturating" or (model is None and saturates)):
        return NonlinearSolver(device, refinement)
    return solve_linear(device, refinement=refinement)
