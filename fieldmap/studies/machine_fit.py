"""Unknown numbers of a machine from measurements on it: keys of its device file, fitted on solved fields.

The device is read, meshed and solved anew with every set of values, so that anything the device file holds may be
unknown. How the fit goes is said in `fieldmap.levitation.unknowns`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.errors import FieldmapError, InputError
from fieldmap.field import AnyField, as_field
from fieldmap.inputs.declared import Key
from fieldmap.inputs.findings import shown
from fieldmap.inputs.tables import Number, Point, Positive, Text, broken, is_number, one_or_each
from fieldmap.iron import NonlinearSolver, solve_linear
from fieldmap.levitation import lift_current
from fieldmap.levitation.unknowns import Measured, ReadingsFit, Unknown, Workers, find_unknowns, mistakes
from fieldmap.records import Record
from fieldmap.studies.study import saturates
from fieldmap.typing import Array, PathLike


def _amperes(value: Any) -> Any:
    """One number for all coils, a list of one per coil, or a list of such lists, one for each point."""
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    for row in rows:
        numbers = row if isinstance(row, list) else [row]
        if not numbers or not all(is_number(n) for n in numbers) or (len(rows) > 1 and numbers is not row):
            must_hold = "one number for all coils, a list of one per coil, or a list of such lists, one for each point"
            raise broken(must_hold, shown(value), "write for example currents_A = 1.5")
    return value


Deviation = Annotated[
    Positive | list[Positive],
    one_or_each(
        lambda n: n > 0,
        "one number above 0 for all readings, or a list of one for each",
        "state the standard deviation of a reading",
    ),
]
Amperes = Annotated[Number | list[Number] | list[list[Number]], BeforeValidator(_amperes)]
Rows = Annotated[list[Number], Field(min_length=1)]
TableName = Annotated[str, Key(Text, "name of the table", examples=("on the axis",))]


@runtime_checkable
class Readings(Measured, Protocol):
    """Measured numbers and what the machine would show.

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
    points: Annotated[
        ArrayLike, Key(Annotated[list[Point], Field(min_length=1)], "where the probe was", "mm")
    ]
    currents: Annotated[
        ArrayLike | tuple[Any, ...],
        Key(Amperes, "one for all coils, one per coil, or a list of one per coil for each point", "A"),
    ]
    measured: Annotated[
        ArrayLike,
        Key(
            Annotated[list[Rows], Field(min_length=1)],
            "of each point the components that were read",
            "mT",
            examples=([[0.24, 0.01, 1.4]],),
        ),
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
        if currents.ndim == 0:
            currents = np.full(len(device.coils), float(currents))
        if currents.ndim < 2:
            return as_field(field).field(points, currents).ravel()
        rows = [as_field(field).field(x, i) for x, i in zip(points, currents, strict=True)]
        return np.concatenate(rows)


@dataclass(frozen=True, eq=False, repr=False)
class InductanceReadings(Record):
    """Inductances of coils.

    measured (n,), H, between pairs of coils (n, 2), by number from 0 or by name; the same twice: of one coil. Of linear
    iron; saturating iron is taken at its initial permeability.
    """

    name: TableName
    pairs: Annotated[
        ArrayLike | tuple[tuple[str, ...], ...],
        Key(
            Annotated[list[Annotated[list[Text], Field(min_length=2, max_length=2)]], Field(min_length=1)],
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
        Key(
            Annotated[list[Point], Field(min_length=1)],
            "places of the magnet's centre",
            "mm",
            examples=([[0.0, 0.0, -95.0]],),
        ),
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
    """Unknowns found. values: by key path, in the units of the keys; covariance (k, k) and correlation (k, k) in their
    order; indistinct: groups of unknowns of which the readings hold some combination no better than its own size.

    tables: every table of readings, those that were predicted too. device: the machine with these values. solves: how
    many were needed.
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
    workers: Workers = map,
) -> MachineFit:
    """Find numbers of a device from measurements.

    Parameters
    ----------
    device
        A file, its name, or made in Python.
    unknowns
        The numbers to find.
    readings
        What is fitted.
    predict
        Tables that are not fitted, computed with the fit and with error bars from it.
    solve
        Gives the field of a device; `solve_linear` or, where its iron saturates, `NonlinearSolver` unless
        given.
    on_solve
        Called with the values of each solve.
    close
        The search ends where all unknowns change by less than this share of their values.
    workers
        A function like `map` that computes the derivatives' solves, such as the `map` of a pool of processes;
        readings and `solve` are then pickled.

    Returns
    -------
    MachineFit
        The numbers, and how certain they are.

    Raises
    ------
    InputError
        For keys that the device lacks, tables without numbers, fewer readings than unknowns; and what reading
        and solving a device with the values that are tried raise.

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
    problems = list(mistakes("fit_machine", unknowns, tables, len(readings)))
    if not problems:
        try:
            read_device(source, {one.key: one.start for one in unknowns})
        except FieldmapError as error:
            if not error.problems:
                raise
            problems += error.problems
    if problems:
        raise InputError(*problems)
    compute = partial(_tables, source, solve or solved_field)
    found = find_unknowns(unknowns, tables, len(readings), compute, on_solve, workers, xtol=close)
    priors = [f"prior of {one.key}: {one.prior[0]:g} +- {one.prior[1]:g}" for one in unknowns if one.prior]
    return MachineFit(
        found.values,
        found.covariance,
        found.indistinct,
        found.misfit,
        found.misfit_before,
        found.tables,
        read_device(source, found.values),
        found.solves,
        (f"fitted: {', '.join(found.values)}; all else as the device has it", *found.notes, *priors),
    )


def solved_field(device: Device, model: str | None = None, refinement: float = 1.0) -> AnyField:
    """The field of a device with iron that is "linear" or "saturating", which it is where a material saturates unless
    given."""
    if device.bodies and (model == "saturating" or (model is None and saturates(device))):
        return NonlinearSolver(device, refinement)
    return solve_linear(device, refinement=refinement)


def _tables(
    source: PathLike,
    solve: Callable[[Device], AnyField],
    values: dict[str, float],
    tables: Sequence[Readings],
) -> list[Array]:
    """The numbers of tables of one device, which is solved once."""
    device = read_device(source, values)
    field = solve(device)
    found = []
    for table in tables:
        numbers, wanted = np.ravel(table.computed(device, field)), np.size(table.measured)
        if len(numbers) != wanted:
            must_hold = f"must give as many numbers as were measured, {wanted}"
            remedy = "let the function return one for each"
            raise InputError.of(f"fit_machine, {table.name}", must_hold, str(len(numbers)), remedy)
        found.append(numbers)
    return found
