"""Measured flux densities: a table of places, currents and readings, and its CSV file."""

from __future__ import annotations

import contextlib
import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.arguments import LARGEST_NUMBER
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

_UNITS = {"m": 1.0, "mm": 1e-3, "A": 1.0, "T": 1.0, "mT": 1e-3, "uT": 1e-6}
_PLACE = re.compile(r"([xyz])_(mm|m)")
_FLUX = re.compile(r"B([xyz])_(T|mT|uT)")
_CURRENT = re.compile(r"I_(.+)_A")
_GRADIENT = re.compile(r"dB[xyz]_d[xyz]_T_per_m")
_MOST_PROBLEMS = 20


@dataclass(frozen=True, eq=False, repr=False)
class Measurements(Record):
    """n readings: points (n, 3) in m, currents (n, n_coils) in A in the order of coil_names, flux_density (n, 3) in T.

    Raises InputError where shapes do not fit or numbers are not finite.
    """

    coil_names: tuple[str, ...]
    points: Array
    currents: Array
    flux_density: Array

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
        if problems:
            raise InputError(*problems)


def read_measurements(path: PathLike) -> Measurements:
    """Read a CSV file, one reading a row, with the columns

        x_mm, y_mm, z_mm (or _m), I_NAME_A for every coil, Bx_mT, By_mT, Bz_mT (or _T, _uT)

    in any order; the unit is the last part of the name. Lines that begin with # are remarks. Columns of a gradient
    (dBx_dy_T_per_m), which `write_csv` adds, are not read: a fit has its own.

    Parameters
    ----------
    path
        Path of the file.

    Returns
    -------
    Measurements
        The readings, in SI units.

    Raises
    ------
    InputError
        With every mistake of the file at once, and its line; numbers beyond 1e30 are mistakes.
    """
    source = Path(path)
    try:
        with source.open(newline="", encoding="utf-8-sig") as stream:
            rows = [
                (k, row)
                for k, row in enumerate(csv.reader(stream), 1)
                if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#")
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError.of(str(source), "must be a CSV file", str(error), "check the name") from None
    must_hold, remedy = "must have a header and readings", "see the manual"
    if not rows:
        raise InputError.of(str(source), must_hold, "an empty file", remedy)
    header = [cell.strip() for cell in rows[0][1]]
    places, coils, scales = _columns(source, header)
    if len(rows) < 2:
        raise InputError.of(str(source), must_hold, "a header alone", remedy)
    values = _numbers(source, header, rows[1:]) * scales
    order = [places[name] for name in ("x", "y", "z", "Bx", "By", "Bz")]
    return Measurements(
        tuple(coils), values[:, order[:3]], values[:, list(coils.values())], values[:, order[3:]]
    )


def _columns(source: Path, header: list[str]) -> tuple[dict[str, int], dict[str, int], Array]:
    """Column of every coordinate and component, of every coil, and what each column is multiplied by."""
    places: dict[str, int] = {}
    coils: dict[str, int] = {}
    scales, unknown, double = np.ones(len(header)), [], []
    for k, name in enumerate(header):
        flux, place, current = _FLUX.fullmatch(name), _PLACE.fullmatch(name), _CURRENT.fullmatch(name)
        if _GRADIENT.fullmatch(name):
            continue
        key = f"B{flux[1]}" if flux else place[1] if place else current[1] if current else None
        table = coils if current else places
        if key is None:
            unknown.append(name)
        elif key in table:
            double.append(name)
        else:
            table[key] = k
            scales[k] = _UNITS[name.rsplit("_", 1)[1]]
    missing = [name for name in ("x", "y", "z", "Bx", "By", "Bz") if name not in places]
    missing += [] if coils else ["I_NAME_A"]
    wanted = "x_mm, y_mm, z_mm, I_NAME_A of every coil, Bx_mT, By_mT, Bz_mT (or m, T, uT), each once"
    found = [("unknown", unknown), ("twice", double), ("missing", missing)]
    received = "; ".join(f"{what}: {', '.join(names)}" for what, names in found if names)
    if received:
        raise InputError.of(f"{source}:1", f"columns {wanted}", received, "correct the header")
    return places, coils, scales


def _numbers(source: Path, header: list[str], rows: list[tuple[int, list[str]]]) -> Array:
    problems, values = [], np.full((len(rows), len(header)), np.nan)
    for row, (line, cells) in enumerate(rows):
        if len(cells) != len(header):
            problems.append((line, f"{len(header)} cells", f"{len(cells)}"))
            continue
        for k, cell in enumerate(cells):
            with contextlib.suppress(ValueError):
                values[row, k] = float(cell)
            if not abs(values[row, k]) <= LARGEST_NUMBER:
                problems.append((line, f"a finite number in column {header[k]}", repr(cell)))
    if problems:
        shown = [
            Problem(f"{source}:{k}", f"must have {hold}", got, "correct it") for k, hold, got in problems
        ]
        raise InputError(*shown[:_MOST_PROBLEMS])
    return values
