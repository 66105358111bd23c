"""Measured flux densities: positions, currents and readings, and files of instruments and programs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.arguments import LARGEST_NUMBER, check, check_numbers, raise_all
from fieldmap.errors import Problem
from fieldmap.inputs.columns import Column, TextColumns, columns_of_roles, read_columns, si_values
from fieldmap.records import Record
from fieldmap.store.field_mesh import is_hdf5, read_field_mesh
from fieldmap.typing import Array, PathLike

_ROLES = {axis: (axis,) for axis in "xyz"} | {
    f"B{axis}": (f"b{axis}", f"b_{axis}", f"b {axis}") for axis in "xyz"
}
_SI = {role: "T" if role.startswith("B") else "m" for role in _ROLES}
_COIL = re.compile(r"(?:I_|currents? |coil )(?P<name>.+)", re.IGNORECASE)


@dataclass(frozen=True, eq=False, repr=False)
class Measurements(Record):
    """n readings: points (n, 3) in m, currents (n, n_coils) in A in the order of coil_names, flux_density (n, 3) in T.

    From a file: source, its name; lines, the line of each reading; unread, columns that were not used.

    Raises InputError for wrong shapes or numbers that are not finite.
    """

    coil_names: tuple[str, ...]
    points: Array
    currents: Array
    flux_density: Array
    source: str = ""
    lines: tuple[int, ...] = ()
    unread: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.points))
        wanted = {"points": (n, 3), "currents": (n, len(self.coil_names)), "flux_density": (n, 3)}
        problems = []
        for name, shape in wanted.items():
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != shape or not (np.abs(values) <= LARGEST_NUMBER).all():
                received = (
                    f"shape {values.shape}" if values.shape != shape else "NaN, infinity, or beyond 1e30"
                )
                problems.append(
                    Problem(f"Measurements, {name}", f"finite, of shape {shape}", received, "correct it")
                )
            object.__setattr__(self, name, values)
        raise_all(problems)

    def where(self, reading: int) -> str:
        """Location of a reading: its line in the file, or its row in the arrays.

        Parameters
        ----------
        reading
            Number of the reading, from 0.

        Returns
        -------
        str
            The location for messages.
        """
        return f"{self.source}:{self.lines[reading]}" if self.lines else f"Measurements, row {reading}"


def read_measurements(
    path: PathLike,
    currents: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Measurements:
    """Read readings from a text file of columns, or from an openPMD FieldMesh (HDF5).

    Columns are x, y, z, I_NAME for every coil, and Bx, By, Bz, in any order and with units: `x_mm`, `x (cm)`, `x
    [mm]`, `Bx_G`, `Bx/mT`, `I_left_mA`. Tables of Opera and texts of COMSOL are read without changes. Rows may be in
    any order, and nodes of a grid may be missing. Every column in a unit of current belongs to a coil. Other columns,
    such as an index or the gradient of `write_csv`, are ignored and listed in `unread`.

    Parameters
    ----------
    path
        Path of the file.
    currents
        Name -> current, A, of coils whose current was constant and has no column.
    units
        Column -> unit, for headings without a unit.
    delimiter
        comma, semicolon, tab or blanks; by default recognised.
    decimal
        "." or ","; by default recognised.

    Returns
    -------
    Measurements
        The readings, in SI units.

    Raises
    ------
    InputError
        With every mistake of the file at once, and its line; numbers beyond 1e30 are mistakes.
    """
    source, fixed = Path(path), dict(currents or {})
    check_numbers("read_measurements(currents)", **fixed)
    if is_hdf5(source):
        points, flux_density = read_field_mesh(source)
        must, remedy = "must say the coil and its current", 'read_measurements(..., currents={"coil": 1.0})'
        check(len(fixed) == 1, f"{source}: currents", must, f"{len(fixed)} currents", remedy)
        amperes = np.tile([*fixed.values()], (len(points), 1))
        return Measurements(tuple(fixed), points, amperes, flux_density, str(source))
    table = read_columns(source, 1, delimiter, decimal, units)
    must, remedy = (
        "must hold a line of names above the numbers",
        "add one, such as x_mm,y_mm,z_mm,I_coil_A,Bx_mT,By_mT,Bz_mT",
    )
    check(table.named, f"{source}:{table.rows[0][0]}", must, "numbers", remedy)
    found, problems = columns_of_roles(table, _ROLES, tuple(_ROLES), {}, {"names": "a heading"})
    coils, twice = _coils(table, found, fixed)
    in_si, wrong = si_values(table, found | coils, _SI | dict.fromkeys(coils, "A"), units=units)
    raise_all(problems + twice + wrong)
    in_si |= {name: np.full(len(table.rows), ampere) for name, ampere in fixed.items()}
    read = [column.number for column in (*found.values(), *coils.values())]
    return Measurements(
        tuple(name for name in (*coils, *fixed)),
        np.stack([in_si[axis] for axis in "xyz"], axis=1),
        np.stack([in_si[name] for name in (*coils, *fixed)], axis=1),
        np.stack([in_si[f"B{axis}"] for axis in "xyz"], axis=1),
        str(source),
        tuple(line for line, _ in table.rows),
        tuple(column.name for column in table.columns if column.number not in read),
    )


def _coils(
    table: TextColumns, found: Mapping[str, Column], fixed: Mapping[str, float]
) -> tuple[dict[str, Column], list[Problem]]:
    """Columns of currents by coil: columns in a unit of current, and columns I_NAME without a unit."""
    coils: dict[str, Column] = {}
    problems = []
    for column in table.columns:
        named = _COIL.fullmatch(column.name)
        of_current = column.quantity == "A" or (column.unit is None and column.name.startswith("I_"))
        if column in found.values() or not of_current:
            continue
        name = named["name"] if named else column.name
        if name in coils or name in fixed or name in _ROLES:
            must = "must be the only current of its coil"
            problems.append(
                Problem(f"{table.source}: column {column.name}", must, f"coil {name} again", "rename it")
            )
        coils[name] = column
    if not coils and not fixed:
        have = ", ".join(column.name for column in table.columns)
        must, remedy = (
            "must have a column of the current of every coil, I_NAME_A",
            "add it, or give a constant current: currents",
        )
        problems.append(Problem(f"{table.source}: currents", must, f"none of {have}", remedy))
    return coils, problems
