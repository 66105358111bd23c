"""Verification of a map file without the solver; all problems are reported at once."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import MapFileError, Problem
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.store.map_data import Grid, MapInfo
from fieldmap.store.map_format import (
    FLUX_DENSITY,
    GRADIENT,
    OWN,
    QUANTITIES,
    UNREADABLE,
    Quantity,
    planes_per_chunk,
)
from fieldmap.store.map_reader import (
    Refused,
    check_attributes,
    hard,
    opened_map,
    read_header,
    read_numbers,
    stored,
)
from fieldmap.store.openpmd import of_component, of_record, of_source, on_grid
from fieldmap.store.seal import REMAKE
from fieldmap.store.stated_accuracy import MissedAccuracy, missed_accuracy
from fieldmap.typing import Array

DIVERGENCE_AND_CURL = 1e-4
"""Allowed divergence and curl of a stored gradient at a node, as a share of the largest gradient of that field."""
VALUES_AND_GRADIENTS = 0.05
"""Allowed difference between steps of B over two cells and Simpson's integral of the gradient, as a share of the
largest integral. A swapped component or a wrong unit is an error of order 1; Simpson's rule has O(spacing^4)."""
# Nodes whose numbers are in memory at a time.
_NODES_AT_A_TIME = 1 << 19
TOTAL = 1e-9
"""Allowed difference between the stored total and the sum of the fields, as a share of the largest total."""


@dataclass(frozen=True, eq=False, repr=False)
class MapCheck(Record):
    """Result of a verification. All deviations are relative: see the constants of this module.

    Attributes
    ----------
    info : description of the map.
    bytes : length of the file.
    data_sets : number of data sets that were checked.
    divergence, curl : largest over fields and nodes.
    values_and_gradients : largest difference between steps of B and the integrated gradient; None if no axis has three
        nodes.
    total : largest difference between the stored total and the sum of the fields.
    notes : facts that are allowed but worth knowing.
    """

    info: MapInfo
    bytes: int
    data_sets: int
    divergence: float
    curl: float
    values_and_gradients: float | None
    total: float
    notes: tuple[str, ...] = ()

    @property
    def missed_accuracy(self) -> MissedAccuracy | None:
        """Errors of the current model if they are larger than the recipe allows, otherwise None."""
        return missed_accuracy(self.info.provenance.solver_report)

    def to_dict(self) -> dict[str, Plain]:
        """The result and the description of the file as plain Python."""
        info = self.info
        return plain_items(
            title=info.provenance.title,
            device=info.provenance.device_name,
            coil_names=info.coil_names,
            grid=info.grid,
            bytes=self.bytes,
            data_sets=self.data_sets,
            divergence=self.divergence,
            curl=self.curl,
            values_and_gradients=self.values_and_gradients,
            total=self.total,
            fingerprint=info.provenance.fingerprint,
            versions=info.provenance.versions,
            created=info.provenance.created,
            interpolation_error=info.interpolation_error,
            error_bounds=info.error_bounds,
            current_error=info.current_error,
            missed_accuracy=self.missed_accuracy,
            notes=self.notes,
        )


@dataclass
class _Findings:
    """Problems so far, data sets that could not be read, and the figures of the fields."""

    where: str
    problems: list[Problem] = field(default_factory=list)
    data_sets: int = 0
    unread: set[str] = field(default_factory=set)
    figures: dict[str, list[float]] = field(default_factory=dict)

    def add(self, must_hold: str, received: str, remedy: str = REMAKE) -> None:
        self.problems.append(Problem(self.where, must_hold, received, remedy))

    def attempt(self, step: Callable[..., Any], *arguments: Any) -> Any:
        """Call a step of the verification. Returns its result, or adds a problem and returns None if it fails."""
        try:
            return step(*arguments)
        except Refused as refusal:
            self.add(*refusal.args)
        except (*UNREADABLE, MemoryError) as error:
            name = next((a for a in arguments if isinstance(a, str)), "the file")
            self.add(
                f"{name}: undamaged", f"what cannot be read ({type(error).__name__}: {error})".split("\n")[0]
            )
        return None

    def figure(self, name: str, value: float, limit: float, of: str) -> None:
        """Store a figure of a field, and add a problem if it exceeds its limit."""
        self.figures.setdefault(name, []).append(value)
        if not value <= limit:
            self.add(f"{of}: {name.replace('_', ' ')} up to {limit:g} of the largest", f"{value:.3g}")


def check_map(path: str | os.PathLike[str]) -> MapCheck:
    """Verify a map file.

    These are checked: the seal (length and SHA-256 of the whole file), format version and completeness; checksum,
    shape, type, unit, grid and finite values of every data set; recipe and device texts with their hashes, and
    provenance; the reduced model of saturating iron; the links for other programs. The numbers must be a magnetic
    field: gradients have no divergence and no curl, steps of B agree with them, and the total is the sum of the fields.
    The limits are constants of this module. The check reads some planes of a map at a time.

    Parameters
    ----------
    path
        Path of the file.

    Returns
    -------
    MapCheck
        The description of the map and the deviations found.

    Raises
    ------
    MapFileError
        With every problem found; only with the first one if the file cannot be opened safely.
    """
    with opened_map(path) as file:
        info, records = read_header(file)
        findings = _Findings(os.fspath(path))
        findings.attempt(_check_completion, file, info)
        for number, (name, record) in enumerate(zip(info.field_names, records, strict=True)):
            source = of_source(name, info.field_scale[number])
            for quantity in QUANTITIES:
                _check_record(file, quantity, record, source, info.grid, findings)
            findings.attempt(_check_link, file, f"/ExternalFieldPath/{number + 1}", FLUX_DENSITY.path(record))
        _check_record(file, FLUX_DENSITY, "", {}, info.grid, findings)
        _check_fields(file, info, records, findings)
        size = int(file.id.get_filesize())
    if findings.problems:
        raise MapFileError(*findings.problems)
    largest = {name: max(values) for name, values in findings.figures.items()}
    return MapCheck(
        info=info,
        bytes=size,
        data_sets=findings.data_sets,
        divergence=largest["divergence"],
        curl=largest["curl"],
        values_and_gradients=largest.get("values_against_gradients"),
        total=largest["total_against_sum"],
        notes=_notes(info),
    )


def _notes(info: MapInfo) -> tuple[str, ...]:
    source, missed = info.provenance, missed_accuracy(info.provenance.solver_report)
    missing = {
        "no fingerprint: the inputs of its numbers are not recorded": not source.fingerprint,
        "no versions of the libraries that made it": not source.versions,
        "no recipe": not source.recipe_text,
        "no device file: payload and driver are not known": not source.device_text,
        "no error stated: how far its interpolant is from the solver is not known": (
            info.interpolation_error is None and not info.error_bounds
        ),
    }
    notes = tuple(text for text, is_missing in missing.items() if is_missing)
    return notes if missed is None else (*notes, missed.text)


def _check_completion(file: h5py.File, info: MapInfo) -> None:
    flags = stored(file, f"{OWN}/completion/chunks", "u")[()]
    parts = -(-info.grid.shape[0] // planes_per_chunk(info.grid))
    if flags.shape != (parts,) or not (flags == 1).all():
        raise Refused(
            "every part flagged as written", f"{int(np.count_nonzero(flags))} of {flags.size}", REMAKE
        )


@dataclass
class _Extremes:
    """Largest values of a field over the planes read so far. of_gradient: gradient, divergence, curl; of_steps: results
    of `_mismatch` along each axis."""

    of_gradient: Array = field(default_factory=lambda: np.zeros(3))
    of_steps: Array = field(default_factory=lambda: np.full((3, 2), np.nan))

    def add(self, flux: Array | None, gradient: Array, grid: Grid) -> None:
        """Include planes (n, ny, nz). The first two planes are the last two of the previous call."""
        trace, curl = np.trace(gradient, axis1=-2, axis2=-1), gradient - np.swapaxes(gradient, -2, -1)
        largest = [np.abs(values).max() for values in (gradient, trace, curl)]
        self.of_gradient = np.maximum(self.of_gradient, largest)
        for axis in range(3):
            if flux is not None and flux.shape[axis] >= 3:
                found = _mismatch(flux, gradient, grid, axis)
                self.of_steps[axis] = np.fmax(self.of_steps[axis], found)

    def tell(self, of: str, findings: _Findings) -> None:
        """Store the figures, relative to the largest gradient and integral."""
        scale, trace, curl = (float(value) for value in self.of_gradient)
        findings.figure("divergence", trace / (scale or 1.0), DIVERGENCE_AND_CURL, of)
        findings.figure("curl", curl / (scale or 1.0), DIVERGENCE_AND_CURL, of)
        known = self.of_steps[~np.isnan(self.of_steps[:, 0])]
        if known.size:
            worst = float(known[:, 0].max() / (known[:, 1].max() or 1.0))
            findings.figure("values_against_gradients", worst, VALUES_AND_GRADIENTS, of)


def _check_fields(file: h5py.File, info: MapInfo, records: tuple[str, ...], findings: _Findings) -> None:
    """Check that the readable numbers are magnetic fields, and that the total is the sum of the fields."""
    grid, extremes = info.grid, [_Extremes() for _ in records]
    planes = max(1, _NODES_AT_A_TIME // (grid.shape[1] * grid.shape[2]))
    difference, scale, summed = 0.0, 0.0, True
    every_one = {
        f"{each.path(record)}/{c}" for each in QUANTITIES for record in records for c in each.components
    }
    for first in range(0, grid.shape[0], planes):
        # Steps over two cells need two planes more.
        at = slice(max(0, first - 2), first + planes)
        # Broadcast in the sum below: an array of a grid that the header claims is never allocated without its data.
        total = np.zeros(3)
        for number, record in enumerate(records):
            flux, slope = (_values(file, each, record, at, grid, findings) for each in QUANTITIES)
            if slope is not None:
                extremes[number].add(flux, slope.reshape(*slope.shape[:3], 3, 3), grid)
            summed = summed and flux is not None
            if flux is not None and summed:
                total = total + info.reference_weights[number] * flux
        there = _values(file, FLUX_DENSITY, "", at, grid, findings)
        summed = summed and there is not None
        if there is not None and summed:
            difference = max(difference, float(np.abs(there - total).max()))
            scale = max(scale, float(np.abs(total).max()))
        if every_one <= findings.unread:
            # The header of a damaged map may claim a giant grid.
            break
    for name, record, found in zip(info.field_names, records, extremes, strict=True):
        if not findings.unread & {f"{GRADIENT.path(record)}/{c}" for c in GRADIENT.components}:
            found.tell(f"field of {name!r}", findings)
    if summed:
        findings.figure("total_against_sum", difference / (scale or 1.0), TOTAL, "total field")


def _mismatch(flux: Array, gradient: Array, grid: Grid, axis: int) -> tuple[float, float]:
    """Largest difference between the change of B over two cells along an axis and Simpson's integral of its derivative,
    and the largest integral."""
    values, slopes = np.moveaxis(flux, axis, 0), np.moveaxis(gradient[..., axis], axis, 0)
    integral = grid.spacing[axis] / 3.0 * (slopes[:-2] + 4.0 * slopes[1:-1] + slopes[2:])
    return float(np.abs(values[2:] - values[:-2] - integral).max()), float(np.abs(integral).max())


def _check_record(
    file: h5py.File,
    quantity: Quantity,
    field: str,
    source: dict[str, Any],
    grid: Grid,
    findings: _Findings,
) -> None:
    """Check the attributes of a record and its components. source: attributes that name its field."""
    path = quantity.path(field)
    findings.attempt(check_attributes, file, path, of_record(quantity.unit) | on_grid(grid) | source)
    for name in quantity.components:
        findings.attempt(check_attributes, file, f"{path}/{name}", of_component(quantity.unit))
    findings.data_sets += len(quantity.components)


def _values(
    file: h5py.File, quantity: Quantity, field: str, at: slice, grid: Grid, findings: _Findings
) -> Array | None:
    """All components of a record in x-planes (n, ny, nz, n components); None if one of them could not be read."""
    values: list[Any] = []
    for name in quantity.components:
        path = f"{quantity.path(field)}/{name}"
        # A data set that cannot be read is one problem, not one for each of its parts.
        found = None if path in findings.unread else findings.attempt(read_numbers, file, path, grid, at)
        if found is None:
            findings.unread.add(path)
        values.append(found)
    return None if any(v is None for v in values) else np.stack(values, axis=-1)


def _check_link(file: h5py.File, path: str, target: str) -> None:
    """Check that the soft link for openPMD-beamphysics leads to the record."""
    link = hard(file, path).get("magneticField", getlink=True)
    if not isinstance(link, h5py.SoftLink) or link.path != target:
        raise Refused(f"{path}/magneticField: a soft link to {target}", f"{type(link).__name__}", REMAKE)
