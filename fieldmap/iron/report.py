"""The report of a solve, progress and time of its steps, and warnings of thin gaps.

Flux across a gap is inaccurate if the gap is thin against the faces on both sides. Flat, parallel gaps between pieces
of iron are meshed as sheets (`fieldmap.iron.geometry.thin_gaps`). The warnings name all other gaps: gaps between curved
or slanting faces, gaps that another gap holds open, slots within one body, and gaps of bodies that are meshes.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.error import ErrorEstimate, ToleranceReport
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.records import Record, count_of

# A gap below this share of the width of a face is thin: forces across are off by two per cent and more.
_THIN = 1 / 5
# Largest cosine between the normals of facing faces, and their largest offset along the faces, in radii.
_FACING, _BESIDE = -0.9, 0.5
_NEIGHBOURS = 4


def thin_gap_warnings(iron: AssembledIron) -> tuple[str, ...]:
    """One warning for each pair of bodies, with the widths of the gap and of the faces there."""
    faces = iron.surface
    if len(faces.areas) < 2:
        return ()
    # Neighbours in place with the opposite normal: normals are three more coordinates, longer than any face.
    long = 4 * float(faces.radii.max())
    tree = cKDTree(np.column_stack([faces.centres, long * faces.normals]))
    _, near = tree.query(
        np.column_stack([faces.centres, -long * faces.normals]), k=min(_NEIGHBOURS, len(faces.areas))
    )
    mine = np.repeat(np.arange(len(near)), near.shape[1])
    other = near.ravel()
    across = faces.centres[other] - faces.centres[mine]
    gap = np.einsum("nd,nd->n", across, faces.normals[mine])
    beside = np.linalg.norm(across - gap[:, None] * faces.normals[mine], axis=1)
    width = np.sqrt(2 * np.minimum(faces.areas[mine], faces.areas[other]))
    facing = np.einsum("nd,nd->n", faces.normals[mine], faces.normals[other]) < _FACING
    reach = _BESIDE * np.maximum(faces.radii[mine], faces.radii[other])
    thin = facing & (gap > 0) & (gap < _THIN * width) & (beside < reach)
    names, body = iron.mesh.body_names, iron.mesh.body[iron.topology.owner[iron.topology.surface, 0]]
    pairs = np.sort(body[np.column_stack([mine, other])], axis=1)
    warnings = []
    for a, b in np.unique(pairs[thin], axis=0).tolist():
        here = thin & (pairs == (a, b)).all(axis=1)
        least, size = 1e3 * float(gap[here].min()), 1e3 * float(np.median(width[here]))
        who = f"of '{names[a]}' and '{names[b]}'" if a != b else f"of '{names[a]}'"
        warnings.append(
            f"warning: faces {who} lie {least:.3g} mm apart, a thin gap for elements of {size:.2g} mm: flux and forces "
            f"across it may be some per cent off; smaller elements there, or flat faces, which are meshed as a sheet"
        )
    return tuple(warnings)


@dataclass(frozen=True, repr=False)
class SolverReport(Record):
    """Counts, times and residuals of one solve.

    form: "potential" or "flux", both of second order, or "surface", without tetrahedra (docs/theory/iron_elements.md);
    tetrahedra, surface_faces, charged_faces, unknowns: size of the problem; magnetic_bodies: connected pieces of iron;
    iterations and residual: of the worst source (Newton steps for nonlinear iron); matrix_bytes: memory of the matrix
    of mutual potentials and its inverse; storage: how that matrix is stored, in words;
    seconds: wall time per step; assumptions: everything the result rests on that the device file or the caller
    chose; largest_flux_density: in the iron, T (nonlinear iron only); beyond_table: elements whose field strength
    lies above the last point of their B-H table; below_table: below the first; error: estimate, where one was made;
    continuation: shares of the currents that were solved on the way, because Newton's method failed at the full
    currents; symmetry: the iron's symmetry and its use, in words; refinement: surface faces and estimated error of B of
    every mesh that was estimated on the way to a tolerance; tolerance: the report of that run.
    """

    form: str
    tetrahedra: int
    surface_faces: int
    charged_faces: int
    unknowns: int
    magnetic_bodies: int
    iterations: int
    residual: float
    matrix_bytes: int
    seconds: dict[str, float]
    assumptions: tuple[str, ...]
    largest_flux_density: float | None = None
    beyond_table: int = 0
    below_table: int = 0
    error: ErrorEstimate | None = None
    continuation: tuple[float, ...] = ()
    symmetry: str = "none"
    storage: str = ""
    refinement: tuple[tuple[int, float], ...] = ()
    tolerance: ToleranceReport | None = None

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "SolverReport":
        """The report from the result of `dataclasses.asdict`, also after JSON.

        Parameters
        ----------
        plain
            The plain report.

        Returns
        -------
        'SolverReport'
            The report without its error estimate and the report of a run to a tolerance.
        """
        lists = {name: tuple(plain[name]) for name in ("assumptions", "continuation")}
        steps = tuple((int(count), float(error)) for count, error in plain["refinement"])
        return cls(**{**plain, **lists, "refinement": steps, "error": None, "tolerance": None})

    @property
    def total_seconds(self) -> float:
        """Wall time of the whole solve."""
        return sum(self.seconds.values())

    def card_rows(self) -> dict[str, str]:
        """Rows of a card in a notebook: bodies, size, error, residual, time and assumptions."""
        return {
            "iron": f"{count_of(self.magnetic_bodies, 'magnetic body', 'magnetic bodies')}, symmetry: {self.symmetry}",
            "size": f"{self._size}, {self.matrix_bytes / 1e6:.0f} MB",
            "error": "not estimated" if self.error is None else str(self.error),
            "residual": f"{self.residual:.1e} after {self.iterations} iterations",
            "time": f"{self.total_seconds:.1f} s",
            "assumes": "; ".join(self.assumptions),
        }

    def __str__(self) -> str:
        steps = ", ".join(f"{name} {value:.1f} s" for name, value in self.seconds.items())
        peak = "" if self.largest_flux_density is None else f", iron up to {self.largest_flux_density:.2f} T"
        bodies = count_of(self.magnetic_bodies, "magnetic body", "magnetic bodies")
        return (
            f"{self.form} form, {self._size}, {self.surface_faces} surface faces, {bodies}{peak}; "
            f"{self.iterations} iterations to {self.residual:.1e}{self.steps_text}{self._outside()}; "
            f"symmetry: {self.symmetry}; {self.total_seconds:.1f} s ({steps})"
        )

    @property
    def _size(self) -> str:
        tetrahedra = f"{self.tetrahedra} tetrahedra, " if self.tetrahedra else ""
        return f"{tetrahedra}{self.unknowns} unknowns"

    @property
    def steps_text(self) -> str:
        """The continuation as text, empty where there was none."""
        shares = ", ".join(f"{100 * share:.3g}" for share in self.continuation)
        return f", in steps of the currents ({shares} %)" if shares else ""

    def _outside(self) -> str:
        """The share of the iron outside the range of its B-H laws, as text."""
        sides = ((self.below_table, "below the first point"), (self.beyond_table, "above the last point"))
        words = [
            f"{100 * count / self.tetrahedra:.3g} % of the elements {side}" for count, side in sides if count
        ]
        return f"; {' and '.join(words)} of their B-H law" if words else ""


def report_of(
    form: ConvexForm, state: IronState, seconds: dict[str, float], assumptions: tuple[str, ...]
) -> SolverReport:
    """The report of iron solved on one mesh in one form."""
    iron = form.iron
    gaps = tuple(
        f"gap of {1e3 * sheet.gap:.4g} mm between {sheet.name.replace(' | ', ' and ')}: meshed as a sheet"
        for sheet in iron.mesh.sheets
        if sheet.drawn
    )
    return SolverReport(
        form=form.name,
        tetrahedra=len(iron.mesh.tets),
        surface_faces=len(iron.surface.areas),
        charged_faces=len(state.faces.areas),
        unknowns=form.elements.count,
        magnetic_bodies=iron.magnetic_bodies,
        iterations=state.iterations,
        residual=state.residuals[-1],
        matrix_bytes=iron.mutual.bytes,
        seconds=seconds,
        assumptions=(*assumptions, *gaps, *thin_gap_warnings(iron)),
        symmetry=iron.symmetry,
        storage=iron.mutual.storage,
    )


Progress = Callable[[str, float], None]


class Stages:
    """Calls `progress(message, fraction)` when a step begins, and keeps the wall time of each step."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._start = time.perf_counter()
        self._name = ""
        self.seconds: dict[str, float] = {}

    def next(self, name: str, fraction: float) -> None:
        """End the current step and begin another."""
        self._begin(name, name, fraction)

    def done(self, message: str = "solved") -> None:
        """End the last step."""
        self._begin("", message, 1.0)

    def _begin(self, name: str, message: str, fraction: float) -> None:
        now = time.perf_counter()
        if self._name:
            self.seconds[self._name] = now - self._start
        self._start, self._name = now, name
        if self._progress is not None:
            self._progress(message, fraction)
