"""A map from measured flux densities: harmonic polynomials fitted to the readings, with the error of the fit stated.

Without currents and iron in the box the field of every coil is the gradient of a harmonic polynomial, to any accuracy
(docs/theory/lookup.md (8)). The fit contains only possible fields, which reduces noise, and its derivative is the
gradient, which was not measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError
from fieldmap.interop.reading_faults import refuse_faults, require_volume
from fieldmap.interop.readings import Measurements
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.store import FieldError, Grid, MapData, Provenance
from fieldmap.typing import Array

HIGHEST_DEGREE = 10
MOST_NODES = 2_000_000
MOST_BYTES = 4e9
"""Largest memory of the equations of a fit, bytes."""
_NODES_AT_ONCE = 2000
FOLDS = 5
# A higher degree must reduce the mean square error of held-out readings by this share, or it only follows noise.
WORTH = 0.02
_TRUSTED = 0.97
"""Share of the readings, those with the smallest errors, that is used to compare degrees."""


@dataclass(frozen=True, repr=False)
class FitReport(Record):
    """Errors of the fit of harmonic polynomials to the readings.

    degree: of the potential. residual: root mean square of the residuals per component, T. held_out, held_out_worst:
    root mean square and largest error of readings predicted by fits without them, T; these are the errors to trust.
    standard_error: largest standard error of the fit at the map's nodes from the scatter of the readings, summed over
    coils at their reference currents, T and T/m; it does not include the truncation of the degree. readings: their
    number.
    """

    degree: int
    residual: float
    held_out: float
    held_out_worst: float
    standard_error: FieldError
    readings: int


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredMap(Record):
    """A map in the form of a solved one, and the errors of the fit."""

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

    A reading may have currents in several coils, if the currents were varied independently. The result's `data` is
    for `fieldmap.lookup.interpolate` or `fieldmap.store.write_map`; its provenance contains the report.

    Parameters
    ----------
    measurements
        The readings.
    spacing
        Largest distance of the map's nodes, m.
    lower, upper
        Corners (3,) of the box, m; by default those of the readings.
    degree
        Degree of the potential; by default the degree above which held-out readings are not predicted better.

    Returns
    -------
    MeasuredMap
        The map, with the errors of the fit.

    Raises
    ------
    InputError
        If the readings cannot distinguish the coils, are too few, or lie in one plane; and for readings that fit no
        field: outliers (with their lines), exchanged components, wrong signs, and readings that others do not
        predict.
    """
    points = measurements.points
    require_volume(measurements)
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
    currents = measurements.currents
    design = _design(currents, local, chosen)
    values = measurements.flux_density.ravel()
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    coefficients, _, rank, _ = np.linalg.lstsq(design / size, values, rcond=1e-10)
    if rank < design.shape[1]:
        raise _too_few(f"rank {rank} of {design.shape[1]} unknowns at degree {chosen}")
    most = max(chosen, *(d for d in range(2, 7) if _unknowns(measurements, d) <= len(local)), 2)
    refuse_faults(measurements, design / size, held, lambda some: _design(currents[some], local[some], most))
    coefficients /= size
    left = values - design @ coefficients
    scatter = float(np.sqrt(left @ left / max(len(values) - design.shape[1], 1)))
    nodes = (grid.points() - centre) / length
    amperes = np.abs(currents).max(axis=0)
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


def _design(currents: Array, local: Array, degree: int) -> Array:
    """Matrix (3 n, n_coils size) from the coefficients of all coils, without constants, to readings."""
    rows = field_matrix(degree, local)[..., 1:]
    return np.einsum("nik,nc->nick", rows, currents).reshape(3 * len(local), -1)


def _best_degree(measurements: Measurements, local: Array) -> int:
    best, least = 0, np.inf
    for degree in range(2, HIGHEST_DEGREE + 1):
        unknowns = _unknowns(measurements, degree)
        if unknowns > 1.5 * len(local) or 24.0 * unknowns * len(local) > MOST_BYTES:
            break
        # The largest errors are left out, because one outlier would select a low degree, whose errors would hide it.
        worst_last = np.sort(_held_out(measurements, local, degree).ravel() ** 2)
        predicted = float(np.mean(worst_last[: int(_TRUSTED * len(worst_last))]))
        if predicted >= (1 - WORTH) * least:
            break
        best, least = degree, predicted
    if not best:
        raise _too_few(f"{len(local)} readings for {len(measurements.coil_names)} coils")
    return best


def _unknowns(measurements: Measurements, degree: int) -> int:
    return ((degree + 1) ** 2 - 1) * len(measurements.coil_names)


def _held_out(measurements: Measurements, local: Array, degree: int) -> Array:
    """Errors (n, 3), T, of readings that are predicted by fits to the other four fifths.

    The normal equations are summed over all folds but one, which is fast and accurate enough for a comparison.
    """
    design = _design(measurements.currents, local, degree)
    design /= np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    values = measurements.flux_density.ravel()
    fold = np.repeat(np.random.default_rng(20250321).permutation(len(local)) % FOLDS, 3)
    parts = [design[fold == out] for out in range(FOLDS)]
    squares = [part.T @ part for part in parts]
    sides = [part.T @ values[fold == out] for out, part in enumerate(parts)]
    # The ridge keeps the equations solvable if coils cannot be distinguished; the fit itself refuses this case.
    ridge = 1e-13 * np.eye(design.shape[1])
    missed = np.empty_like(values)
    for out, part in enumerate(parts):
        fitted = np.linalg.solve(sum(squares) - squares[out] + ridge, sum(sides) - sides[out])
        missed[fold == out] = values[fold == out] - part @ fitted
    return missed.reshape(-1, 3)


def _standard_error(
    design: Array, scatter: float, nodes: Array, length: float, degree: int, amperes: Array
) -> FieldError:
    """Largest standard error at the nodes, summed over the coils at their reference currents."""
    length_of = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    factor = np.linalg.inv(np.linalg.qr(design / length_of, mode="r")) / length_of[:, None]
    size = factor.shape[0] // len(amperes)
    # A triangle with the same scalar products replaces the rows of a coil's coefficients and keeps all lengths.
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
    """Parts of many nodes, because matrices for all nodes would take a hundred times the memory of the map."""
    for begin in range(0, nodes, _NODES_AT_ONCE):
        yield slice(begin, begin + _NODES_AT_ONCE)


def _too_few(received: str) -> InputError:
    must_hold = "readings enough to tell the coils apart, all over the box"
    return InputError.of("fit_map", must_hold, received, "measure more, or ask for a lower degree")
