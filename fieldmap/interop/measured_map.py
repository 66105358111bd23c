"""Measured flux densities: a table of places, currents and readings, and its CSV file; and a map from them, harmonic
polynomials fitted to the readings, with the error of the fit stated.

Without currents and iron in the box the field of every coil is the gradient of a harmonic polynomial, to any accuracy
(docs/theory/lookup.md (8)): the fit may not follow what no field can do, which takes noise out, and its derivative is
the gradient that was not measured.
"""

from __future__ import annotations

import contextlib
import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import LARGEST_NUMBER
from fieldmap.errors import InputError, Problem
from fieldmap.file_contents import read_text
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.store import FieldError, Grid, MapData, Provenance
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
    text = read_text(source, otherwise="latin-1")
    try:
        rows = [
            (k, row)
            for k, row in enumerate(csv.reader(io.StringIO(text, newline="")), 1)
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#")
        ]
    except csv.Error as error:
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


HIGHEST_DEGREE = 10
MOST_NODES = 2_000_000
MOST_BYTES = 4e9
"""Of the equations of a fit."""
_NODES_AT_ONCE = 2000
FOLDS = 5
# A higher degree must predict readings that were held out better by this share, or it only follows noise.
WORTH = 0.02


@dataclass(frozen=True, repr=False)
class FitReport(Record):
    """How well harmonic polynomials hold the readings.

    degree: of the potential. residual: root mean square of what is left of the readings, per component, T. held_out,
    held_out_worst: the same, and the largest, for readings predicted by fits without them, T: what to trust.
    standard_error: of the fit at the map's nodes by the readings' scatter, largest, coils at their reference currents
    summed, T and T/m; what the degree cannot follow is not in it. readings: how many.
    """

    degree: int
    residual: float
    held_out: float
    held_out_worst: float
    standard_error: FieldError
    readings: int


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredMap(Record):
    """A map as a solver would have made it, and how well it was measured."""

    data: MapData
    report: FitReport

    def to_dict(self) -> dict[str, Plain]:
        """Coils and report as plain Python, SI units."""
        return plain_items(coils=self.data.coil_names, report=self.report)


def fit_map(
    measurements: Measurements,
    spacing: float,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    degree: int | None = None,
) -> MeasuredMap:
    """Fit a map to readings.

    Currents of several coils in one reading are told apart as long as they were varied. The result's `data`
    goes into `fieldmap.lookup.interpolate` or `fieldmap.store.write_map`, its provenance says what the report
    says.

    Parameters
    ----------
    measurements
        The readings.
    spacing
        Largest distance of the map's nodes, m.
    lower, upper
        Corners (3,) of the box, m; those of the readings unless given.
    degree
        Of the potential; unless given, the one from which on readings that were held out are predicted no
        better.

    Returns
    -------
    MeasuredMap
        The map, and how well it fits.

    Raises
    ------
    InputError
        If the readings cannot tell the coils apart or are too few.
    """
    points = measurements.points
    low = points.min(axis=0) if lower is None else np.asarray(lower, dtype=float)
    high = points.max(axis=0) if upper is None else np.asarray(upper, dtype=float)
    grid = _grid(low, high, spacing)
    centre, length = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    local = (points - centre) / length
    chosen = _best_degree(measurements, local) if degree is None else degree
    needed = 24.0 * _unknowns(measurements, chosen) * len(local)
    if needed > MOST_BYTES:
        received = f"{needed / 1e9:.3g} GB for {len(local)} readings at degree {chosen}"
        remedy = "take fewer readings, or a lower degree"
        raise InputError.of("fit_map", f"equations of at most {MOST_BYTES / 1e9:g} GB", received, remedy)
    held = _held_out(measurements, local, chosen)
    design = _design(measurements, local, chosen)
    values = measurements.flux_density.ravel()
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    coefficients, _, rank, _ = np.linalg.lstsq(design / size, values, rcond=1e-10)
    if rank < design.shape[1]:
        raise _too_few(f"rank {rank} of {design.shape[1]} unknowns at degree {chosen}")
    coefficients /= size
    left = values - design @ coefficients
    scatter = float(np.sqrt(left @ left / max(len(values) - design.shape[1], 1)))
    nodes = (grid.points() - centre) / length
    amperes = np.abs(measurements.currents).max(axis=0)
    error = _standard_error(design, scatter, nodes, length, chosen, amperes)
    residual, predicted = (float(np.sqrt(np.mean(missed**2))) for missed in (left, held))
    report = FitReport(chosen, residual, predicted, float(np.abs(held).max()), error, len(points))
    fitted = np.asarray(coefficients).reshape(len(amperes), -1)
    flux, slope = np.empty((len(amperes), len(nodes), 3)), np.empty((len(amperes), len(nodes), 3, 3))
    for some in _parts(len(nodes)):
        of_field, of_slope = field_matrix(chosen, nodes[some]), gradient_matrix(chosen, nodes[some])
        flux[:, some] = np.einsum("nik,ck->cni", of_field[..., 1:], fitted)
        slope[:, some] = np.einsum("nijk,ck->cnij", of_slope[..., 1:], fitted) / length
    shape = (len(amperes), *grid.shape, 3)
    data = MapData(
        grid,
        measurements.coil_names,
        amperes,
        _provenance(report),
        flux_density=flux.reshape(shape),
        gradient=slope.reshape(*shape, 3),
    )
    return MeasuredMap(data, report)


def _provenance(report: FitReport) -> Provenance:
    stated = {
        "fit": "harmonic polynomials, least squares",
        "degree": report.degree,
        "readings": report.readings,
        "residual_T": report.residual,
        "held_out_T": report.held_out,
        "held_out_worst_T": report.held_out_worst,
        "standard_error_T": report.standard_error.flux_density,
        "standard_error_T_per_m": report.standard_error.gradient,
    }
    assumptions = (
        "measured: the field is proportional to the currents of its coils",
        "measured: no currents and no iron inside the box",
        f"measured: readings predicted without them to {report.held_out:.2g} T (rms per component)",
    )
    return Provenance(title="Measured field", solver_report=stated, assumptions=assumptions)


def _grid(low: Array, high: Array, spacing: float) -> Grid:
    if not (spacing > 0 and np.isfinite(spacing) and np.all(high > low)):
        received = f"spacing {spacing!r}, box {low} to {high} m"
        raise InputError.of("fit_map", "spacing > 0 and a box with a volume", received, "correct it")
    cells = np.maximum(np.ceil((high - low) / spacing - 1e-9), 1.0)
    if np.prod(cells + 1) > MOST_NODES:
        received = f"{np.prod(cells + 1):.3g}, by a spacing of {spacing:g} m in a box from {low} to {high} m"
        remedy = "take a larger spacing, or correct the places; lengths are in m"
        raise InputError.of("fit_map", f"at most {MOST_NODES} nodes", received, remedy)
    nx, ny, nz = (int(count) for count in cells)
    return Grid(low, (high - low) / np.array([nx, ny, nz]), (nx + 1, ny + 1, nz + 1))


def _design(measurements: Measurements, local: Array, degree: int) -> Array:
    """(3 n, n_coils size): readings from the coefficients of all coils, without their constants."""
    rows = field_matrix(degree, local)[..., 1:]
    return np.einsum("nik,nc->nick", rows, measurements.currents).reshape(3 * len(local), -1)


def _best_degree(measurements: Measurements, local: Array) -> int:
    best, least = 0, np.inf
    for degree in range(2, HIGHEST_DEGREE + 1):
        unknowns = _unknowns(measurements, degree)
        if unknowns > 1.5 * len(local) or 24.0 * unknowns * len(local) > MOST_BYTES:
            break
        predicted = float(np.mean(_held_out(measurements, local, degree) ** 2))
        if predicted >= (1 - WORTH) * least:
            break
        best, least = degree, predicted
    if not best:
        raise _too_few(f"{len(local)} readings for {len(measurements.coil_names)} coils")
    return best


def _unknowns(measurements: Measurements, degree: int) -> int:
    return ((degree + 1) ** 2 - 1) * len(measurements.coil_names)


def _held_out(measurements: Measurements, local: Array, degree: int) -> Array:
    """What fits to four fifths of the readings miss of the others, (n, 3), T.

    By normal equations, whose parts are summed over all folds but one: good enough to judge by, and quick.
    """
    design = _design(measurements, local, degree)
    design /= np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    values = measurements.flux_density.ravel()
    fold = np.repeat(np.random.default_rng(20250321).permutation(len(local)) % FOLDS, 3)
    parts = [design[fold == out] for out in range(FOLDS)]
    squares = [part.T @ part for part in parts]
    sides = [part.T @ values[fold == out] for out, part in enumerate(parts)]
    # Where coils cannot be told apart this keeps the equations solvable; the fit itself refuses that.
    ridge = 1e-13 * np.eye(design.shape[1])
    missed = np.empty_like(values)
    for out, part in enumerate(parts):
        fitted = np.linalg.solve(sum(squares) - squares[out] + ridge, sum(sides) - sides[out])
        missed[fold == out] = values[fold == out] - part @ fitted
    return missed.reshape(-1, 3)


def _standard_error(
    design: Array, scatter: float, nodes: Array, length: float, degree: int, amperes: Array
) -> FieldError:
    """Largest standard deviation at the nodes, coils at their reference currents summed."""
    length_of = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    factor = np.linalg.inv(np.linalg.qr(design / length_of, mode="r")) / length_of[:, None]
    size = factor.shape[0] // len(amperes)
    # A row times the rows of a coil's coefficients is as long as times a triangle with the same products of these rows.
    of_coils = np.split(factor, len(amperes))
    parts = [np.transpose(np.linalg.qr(of_coil.T, mode="r")) for of_coil in of_coils]
    flux, slope = np.zeros(len(nodes)), np.zeros(len(nodes))
    for some in _parts(len(nodes)):
        of_field = field_matrix(degree, nodes[some])[..., 1:].reshape(-1, size)
        of_slope = gradient_matrix(degree, nodes[some])[..., 1:].reshape(-1, size) / length
        count = len(flux[some])
        for part, ampere in zip(parts, amperes, strict=True):
            flux[some] += ampere * np.linalg.norm((of_field @ part).reshape(count, -1), axis=1)
            slope[some] += ampere * np.linalg.norm((of_slope @ part).reshape(count, -1), axis=1)
    return FieldError(scatter * float(flux.max()), scatter * float(slope.max()))


def _parts(nodes: int) -> Iterator[slice]:
    """Of many nodes: the matrices of all of them together would take a hundred times the memory of the map."""
    for begin in range(0, nodes, _NODES_AT_ONCE):
        yield slice(begin, begin + _NODES_AT_ONCE)


def _too_few(received: str) -> InputError:
    must_hold = "readings enough to tell the coils apart, all over the box"
    return InputError.of("fit_map", must_hold, received, "measure more, or ask for a lower degree")
