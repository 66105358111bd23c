"""Parameters of a machine fitted to measurements on it: keys of its device file, with solved fields.

The device is read, meshed and solved anew with every set of values, so that any key of the device file may be unknown.
`fieldmap.levitation.unknowns` describes the fit. A fit file names the unknown keys, the tables of measurements, and the
model of the iron.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from fieldmap.arguments import check
from fieldmap.device import read_device
from fieldmap.device.changes import key_finding
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import FitError
from fieldmap.field import AnyField, as_field
from fieldmap.inputs import tables as rules
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.findings import Finding, meant, one_of, shown
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import MILLI, Number, Point, Positive, Text, broken
from fieldmap.iron import NonlinearSolver, solve_linear
from fieldmap.levitation import lift_current
from fieldmap.levitation import unknowns as fits
from fieldmap.levitation.unknowns import Measured, ReadingsFit, Unknown
from fieldmap.maps.recipe import IronLaw, Refinement
from fieldmap.parallel import Workers
from fieldmap.records import Record
from fieldmap.studies.reading import device_file
from fieldmap.studies.study import Some, saturates
from fieldmap.typing import Array, PathLike


def _amperes(value: Any) -> Any:
    """One number for all coils, a list of one per coil, or a list of such lists, one for each point."""
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    for row in rows:
        numbers = row if isinstance(row, list) else [row]
        if (
            not numbers
            or not all(rules.is_number(n) for n in numbers)
            or (len(rows) > 1 and numbers is not row)
        ):
            must_hold = "one number for all coils, a list of one per coil, or a list of such lists, one for each point"
            raise broken(must_hold, shown(value), "write for example currents_A = 1.5")
    return value


Deviation = Annotated[
    Positive | list[Positive],
    rules.one_or_each(
        lambda n: n > 0,
        "one number above 0 for all readings, or a list of one for each",
        "state the standard deviation of a reading",
    ),
]
Amperes = Annotated[Number | list[Number] | list[list[Number]], BeforeValidator(_amperes)]
Rows = Some[Number]
Pair = Annotated[list[Text], Field(min_length=2, max_length=2)]
TableName = Annotated[str, Key(Text, "name of the table", examples=("on the axis",))]


@runtime_checkable
class Readings(Measured, Protocol):
    """Measured numbers, and the same numbers computed for a device.

    name: of the table; measured (n,), NaN where nothing was read; deviation: their standard deviation, one or (n,).
    """

    def computed(self, device: Device, field: AnyField) -> Array:
        """The same numbers of a device and its solved field.

        Parameters
        ----------
        device
            The device.
        field
            Its solved field.

        Returns
        -------
        Array
            Numbers (n,).
        """
        ...


@dataclass(frozen=True, eq=False, repr=False)
class FieldReadings(Record):
    """Flux densities at points.

    measured (n, 3), T, NaN for components that were not read, at points (n, 3), m, with one current for all coils, one
    set of currents (c,) or one for each point (n, c), A.
    """

    name: TableName
    points: Annotated[ArrayLike, Key(Some[Point], "where the probe was", "mm")]
    currents: Annotated[
        ArrayLike | tuple[Any, ...],
        Key(Amperes, "one for all coils, one per coil, or a list of one per coil for each point", "A"),
    ]
    measured: Annotated[
        ArrayLike,
        Key(Some[Rows], "of each point the components that were read", "mT", examples=([[0.24, 0.01, 1.4]],)),
    ]
    deviation: Annotated[
        ArrayLike,
        Key(
            Deviation, "standard deviation, of all readings or of those of each point", "mT", examples=(0.01,)
        ),
    ]

    def computed(self, device: Device, field: AnyField) -> Array:
        """Flux density at the points.

        Parameters
        ----------
        device, field
            As for `Readings.computed`.

        Returns
        -------
        Array
            B (3 n,), T.
        """
        points, currents = np.asarray(self.points, dtype=float), np.asarray(self.currents, dtype=float)
        if currents.ndim < 2:
            currents = np.broadcast_to(currents, len(device.coils))
            return as_field(field).field(points, currents).ravel()
        rows = [as_field(field).field(x, i) for x, i in zip(points, currents, strict=True)]
        return np.concatenate(rows)


@dataclass(frozen=True, eq=False, repr=False)
class InductanceReadings(Record):
    """Inductances of coils.

    measured (n,), H, between pairs of coils (n, 2), by number from 0 or by name; a pair of equal coils means the coil's
    own inductance. The iron is linear; saturating iron has its initial permeability.
    """

    name: TableName
    pairs: Annotated[
        ArrayLike | tuple[tuple[str, ...], ...],
        Key(
            Some[Pair],
            "pairs of coils by name; the same twice for a coil's own inductance",
            name="coils",
            examples=([["coil", "coil"]],),
        ),
    ]
    measured: Annotated[ArrayLike, Key(Rows, "of each pair", "mH", examples=([6.46],))]
    deviation: Annotated[
        ArrayLike, Key(Deviation, "standard deviation, one or one for each pair", "mH", examples=(0.03,))
    ]

    def computed(self, device: Device, field: AnyField) -> Array:
        """Entries of the inductance matrix.

        Parameters
        ----------
        device, field
            As for `Readings.computed`.

        Returns
        -------
        Array
            (n,), H.
        """
        matrix = field.inductance() if hasattr(field, "inductance") else solve_linear(device).inductance()
        pairs: Any = self.pairs
        numbers: Any = {name: k for k, name in enumerate(device.coil_names)}
        first, second = np.array([[numbers.get(coil, coil) for coil in pair] for pair in pairs]).T
        return np.asarray(matrix[first, second])


@dataclass(frozen=True, eq=False, repr=False)
class LiftCurrentReadings(Record):
    """Currents that carry the payload.

    measured (n,), A, of the common current, with the payload's magnet at positions (n, 3), m. shares (c,): currents of
    the coils per ampere, 1 unless given.
    """

    name: TableName
    positions: Annotated[
        ArrayLike,
        Key(Some[Point], "places of the magnet's centre", "mm", examples=([[0.0, 0.0, -95.0]],)),
    ]
    measured: Annotated[ArrayLike, Key(Rows, "of each place the common current", "A", examples=([1.56],))]
    deviation: Annotated[
        ArrayLike, Key(Deviation, "standard deviation, one or one for each place", "A", examples=(0.02,))
    ]
    shares: Annotated[
        ArrayLike | None,
        Key(Rows | None, "current of each coil per ampere; 1 if left out", examples=([1.0, 0.5],)),
    ] = None

    def computed(self, device: Device, field: AnyField) -> Array:
        """Lift currents.

        Parameters
        ----------
        device, field
            As for `Readings.computed`.

        Returns
        -------
        Array
            (n,), A.
        """
        first, amperes = 1.0, []
        for position in np.asarray(self.positions, dtype=float):
            first = lift_current(field, device.payload, position, self.shares, first).current
            amperes.append(first)
        return np.array(amperes)


@dataclass(frozen=True, eq=False, repr=False)
class ComputedReadings(Record):
    """Anything that a function computes from the device and its field: places of equilibrium, forces, resistances."""

    name: str
    function: Callable[[Device, AnyField], ArrayLike]
    measured: ArrayLike
    deviation: ArrayLike

    def computed(self, device: Device, field: AnyField) -> Array:
        """The function's numbers.

        Parameters
        ----------
        device, field
            As for `Readings.computed`.

        Returns
        -------
        Array
            (n,).
        """
        return np.ravel(np.asarray(self.function(device, field), dtype=float))


@dataclass(frozen=True, eq=False, repr=False)
class MachineFit(Record):
    """Result of a fit. values: by key path, in the units of the keys; covariance (k, k) and correlation (k, k) in their
    order; indistinct: groups of unknowns with a combination whose standard deviation exceeds its size.

    tables: all tables of readings, also predicted ones. device: the machine with these values. solves: number of
    solves.
    """

    values: Mapping[str, float]
    covariance: Array
    indistinct: tuple[tuple[str, ...], ...]
    misfit: float
    misfit_before: float
    tables: tuple[ReadingsFit, ...]
    device: Device
    solves: int
    assumptions: tuple[str, ...]

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each unknown."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> Array:
        """Correlation (k, k) of the unknowns."""
        size = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(size, size)


def fit_machine(
    device: PathLike | Device,
    unknowns: Sequence[Unknown],
    readings: Sequence[Readings],
    predict: Sequence[Readings] = (),
    solve: Callable[[Device], AnyField] | None = None,
    on_solve: Callable[[Mapping[str, float]], None] | None = None,
    close: float = 1e-5,
    workers: int = 1,
    scheduler: str | None = None,
) -> MachineFit:
    """Fit numbers of a device to measurements.

    Parameters
    ----------
    device
        Device file, name of a shipped device, or a device made in Python.
    unknowns
        The numbers to fit.
    readings
        Tables to which they are fitted.
    predict
        Tables that are not fitted, but predicted with error bars.
    solve
        Function that returns the field of a device; unless given, `NonlinearSolver` if its iron saturates, else
        `solve_linear`.
    on_solve
        Called with the values of each solve.
    close
        The search ends when all unknowns change by less than this share of their values.
    workers
        Processes that solve for the derivatives, one table each: `fieldmap.parallel.Workers`. Readings and `solve`
        are then pickled.
    scheduler
        Address of a dask scheduler whose workers are used instead.

    Returns
    -------
    MachineFit
        The numbers with their uncertainty.

    Raises
    ------
    InputError
        For keys that the device lacks, tables without numbers, fewer readings than unknowns; and errors of
        reading and solving a device with the values that are tried.

    Examples
    --------
    >>> gap = Unknown("joint.1.gap_mm", 0.1, lower=0.001)  # doctest: +SKIP
    >>> steel = Unknown("material.steel.mu_r", 1000.0, lower=1.0)  # doctest: +SKIP
    >>> table = LiftCurrentReadings("of 3 May", positions, amperes, deviation=0.02)  # doctest: +SKIP
    >>> found = fit_machine("my_rig.toml", [gap, steel], [table], predict=[other])  # doctest: +SKIP
    >>> print(found.values, found.deviations, found.indistinct)  # doctest: +SKIP
    """
    tables = (*readings, *predict)
    source = device.to_toml() if isinstance(device, Device) else device
    compute = partial(_tables, source, solve or solved_field)
    with Workers(workers, scheduler) as team:
        others = map if team.alone else team.results
        found = fits.find_unknowns(
            "fit_machine", unknowns, tables, len(readings), compute, on_solve, others, xtol=close
        )
    priors = [f"prior of {one.key}: {one.prior[0]:g} +- {one.prior[1]:g}" for one in unknowns if one.prior]
    held = (f"fitted: {', '.join(found.values)}; all else as the device has it", *found.notes, *priors)
    fit = {name: value for name, value in vars(found).items() if name not in ("alike", "notes")}
    return MachineFit(device=read_device(source, found.values), assumptions=held, **fit)


def solved_field(device: Device, model: str | None = None, refinement: float = 1.0) -> AnyField:
    """The field of a device. model: of its iron, "linear" or "saturating"; by default saturating if a material is."""
    if device.bodies and (model == "saturating" or (model is None and saturates(device))):
        return NonlinearSolver(device, refinement)
    return solve_linear(device, refinement=refinement)


def _tables(
    source: PathLike,
    solve: Callable[[Device], AnyField],
    values: dict[str, float],
    tables: Sequence[Readings],
) -> list[Array]:
    """The numbers of several tables for one device, which is solved once."""
    device = read_device(source, values)
    field = solve(device)
    found = []
    for table in tables:
        numbers, wanted = np.ravel(table.computed(device, field)), np.size(table.measured)
        must_hold = f"must give as many numbers as were measured, {wanted}"
        where, remedy = f"fit_machine, {table.name}", "let the function return one for each"
        check(len(numbers) == wanted, where, must_hold, len(numbers), remedy)
        found.append(numbers)
    return found


class _Stated(rules.Table):
    """A table of readings."""

    use: Literal["fit", "predict"] = Field(
        default="fit", description="whether the unknowns are fitted to it, or it is predicted with them"
    )


def _lengths(table: Any, count: int, what: str, *keys: str) -> Iterator[Finding]:
    """Findings for lists of a wrong length."""
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


class _Probe(_Stated):
    """Readings of a probe."""

    components: Some[Literal["x", "y", "z"]] = Field(
        default=["x", "y", "z"], description="what was read", examples=[["z"]]
    )

    def also_makes(self) -> Mapping[str, Any]:
        """All components, NaN for those that were not read, and a deviation of each."""
        keys: Any = self
        measured = np.full((len(keys.points_mm), 3), np.nan)
        measured[:, ["xyz".index(letter) for letter in self.components]] = keys.measured_mT
        deviation = np.asarray(keys.deviation_mT)
        each = np.repeat(deviation, 3) if deviation.ndim else deviation
        return {"measured": MILLI * measured, "deviation": MILLI * each}


_PROBE: Any = table_of(FieldReadings, bases=(_Probe,), rules=(_a_row_for_each_point,))
_BRIDGE: Any = table_of(InductanceReadings, bases=(_Stated,))
_LIFT: Any = table_of(LiftCurrentReadings, bases=(_Stated,))


def _probe_mistakes(table: Any, device: Device) -> Iterator[Finding]:
    """Findings for deviations and currents that do not fit the numbers of points and coils."""
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
    """Findings for numbers that do not fit the pairs, and for coils that the device does not have."""
    yield from _lengths(table, len(table.coils), "pairs", "measured_mH", "deviation_mH")
    names = list(device.coil_names)
    for j, pair in enumerate(table.coils):
        for name in pair:
            if name not in names:
                remedy = meant(name, names, "write the name of a coil")
                must_hold = f"must be a coil of the device: {one_of(names)}"
                yield Finding(("coils", j), must_hold, f'"{name}"', remedy)


def _lift_mistakes(table: Any, device: Device) -> Iterator[Finding]:
    """Findings for numbers that do not fit the places or coils, and for a device without a payload."""
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
    """A kind of readings. mistakes: findings for keys that do not fit the device or each other; labels: name of each
    reading; unit: of the readings in the file, and its SI value."""

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
        Key(Some[table_of(Unknown)], "[[unknown]] tables", name="unknown"),  # type: ignore[misc]
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
    table_of(FitSettings, "", "FitFile", (rules.Versioned,), rules=(_names_of_their_own,)),
    FitError,
    "maps",
    "fits",
)


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Record):
    """The fit of a fit file. path, device_path: the files; readings are fitted, those of `predict` are not; solve:
    returns the field of a device; labels: names of the readings, by table; units: unit of a table's readings in the
    file and its SI value, by table."""

    path: Path
    title: str
    device_path: Path
    unknowns: tuple[Unknown, ...]
    readings: tuple[Readings, ...]
    predict: tuple[Readings, ...]
    solve: Callable[[Device], AnyField]
    labels: Mapping[str, tuple[str, ...]]
    units: Mapping[str, tuple[str, float]]

    def run(
        self,
        on_solve: Callable[[Mapping[str, float]], None] | None = None,
        workers: int = 1,
        scheduler: str | None = None,
    ) -> MachineFit:
        """Find the unknowns: see `fit_machine`.

        Parameters
        ----------
        on_solve
            Called with the values of each solve.
        workers, scheduler
            As for `fit_machine`.

        Returns
        -------
        MachineFit
            The fit.
        """
        asked = self.device_path, self.unknowns, self.readings, self.predict, self.solve, on_solve
        return fit_machine(*asked, workers=workers, scheduler=scheduler)


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
    told: list[Finding | None] = []
    for k, unknown in enumerate(settings.unknowns):
        told += [Finding(("unknown", k), *wrong) for wrong in fits.wrong_numbers(unknown)]
        told.append(key_finding(("unknown", k, "key"), unknown.key, document))
    tables = [(kind, k, table) for kind in _KINDS for k, table in enumerate(getattr(contents, kind))]
    for kind, k, table in tables:
        told += [one.below(kind, k) for one in _KINDS[kind].mistakes(table, device)]
    findings = [one for one in told if one is not None]
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
        solve=partial(solved_field, **vars(settings.iron)),
        labels={table.name: tuple(_KINDS[kind].labels(table)) for kind, _, table in tables},
        units={table.name: _KINDS[kind].unit for kind, _, table in tables},
    )
