"""What error is asked for, and how a run that refines for it went: its meshes, its end, and what more would cost.

An error is within a tolerance if it is no larger than the relative part times the size that it is relative to
(`fieldmap.iron.error.estimate`), or no larger than the absolute part: the larger of the two is allowed. Where a field
is shielded to almost nothing, the absolute part alone can be meant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.iron.error.estimate import ErrorEstimate, LargestError
from fieldmap.records import Record, count_of

ENDS = {
    "reached": "within the tolerance",
    "stalled": "the estimate fell no further",
    "memory": "the next mesh does not fit into memory",
    "meshes": "as many meshes as were allowed",
}
"""How a run may end, with what that means."""
_GRADIENT_PER_FIELD = 3.0


@dataclass(frozen=True, repr=False)
class Tolerance(Record):
    """Allowed errors in the workspace; of a quantity whose two parts are None any error is allowed.

    flux_density: relative to the largest |B|; gradient: relative to the larger of the largest |grad B| and of |B| over
    a length (`fieldmap.iron.error.estimate`); absolute_flux_density in T; absolute_gradient in T/m. Each holds for
    every source by itself: the magnets and the background, and every coil with 1 A, or with its entry of `currents`, A.
    Raises InputError for values that cannot be meant.

    >>> Tolerance(flux_density=0.01, absolute_flux_density=1e-6)
    Tolerance(flux_density=0.01, absolute_flux_density=1e-06)
    """

    flux_density: float | None = None
    gradient: float | None = None
    absolute_flux_density: float | None = None
    absolute_gradient: float | None = None
    currents: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.currents is not None:
            object.__setattr__(self, "currents", tuple(float(value) for value in self.currents))
        problems = [
            Problem(f"Tolerance, {name}", must_hold, repr(value), remedy)
            for name, must_hold, remedy, value, right in self._judged()
            if not right
        ]
        if problems:
            raise InputError(*problems)

    def _judged(self) -> list[tuple[str, str, str, object, bool]]:
        out: list[tuple[str, str, str, object, bool]] = []
        for name in ("flux_density", "gradient"):
            value = getattr(self, name)
            most = 1.0 if name == "flux_density" else np.inf
            right = value is None or bool(0 < value < most)
            out.append((name, f"must lie between 0 and {most:g}", "try 1e-3", value, right))
            absolute = getattr(self, f"absolute_{name}")
            right = absolute is None or bool(np.isfinite(absolute) and absolute > 0)
            out.append((f"absolute_{name}", "must be a finite number > 0", "leave it out", absolute, right))
        parts = (self.flux_density, self.gradient, self.absolute_flux_density, self.absolute_gradient)
        some = any(part is not None for part in parts)
        out.append(("flux_density", "must say of what an error is allowed", "try 1e-3", None, some))
        right = self.currents is None or all(map(np.isfinite, self.currents))
        out.append(("currents", "must be finite numbers", "give one for each coil, A", self.currents, right))
        return out

    @classmethod
    def of(cls, tolerance: float | Tolerance, gradient: float | None = None) -> Tolerance:
        """A number is relative, of B, and three times it of the gradient, or `gradient` where that is given; inf allows
        any error of the gradient."""
        if isinstance(tolerance, Tolerance):
            return tolerance
        allowed = _GRADIENT_PER_FIELD * tolerance if gradient is None else gradient
        return cls(tolerance, None if allowed == np.inf else allowed)

    @property
    def solving(self) -> float:
        """Tolerance of the iteration on every mesh: the smallest relative part, no larger than 1e-3 where an absolute
        part may be the one that counts."""
        relative = [part for part in (self.flux_density, self.gradient) if part is not None]
        absolute = self.absolute_flux_density is not None or self.absolute_gradient is not None
        return min([*relative, 1e-3] if absolute else relative)

    def allowed(self, one: LargestError, source: int, coils: int) -> float:
        """Of the source with this number among the sources, of which the first are coils: T or T/m; inf if any is."""
        name = "flux_density" if one.quantity == "B" else "gradient"
        relative, absolute = getattr(self, name), getattr(self, f"absolute_{name}")
        if relative is None and absolute is None:
            return float("inf")
        current = 1.0
        if self.currents is not None and source < coils:
            current = abs(self.currents[source])
        fixed = 0.0 if absolute is None else absolute / current if current else float("inf")
        return max((relative or 0.0) * one.size, fixed)

    def excess(self, estimate: ErrorEstimate, coils: int) -> float:
        """The largest estimated error over what is allowed: 1 or less is within the tolerance."""
        worst = self.worst(estimate, coils)
        return 0.0 if worst is None else worst[1]

    def worst(self, estimate: ErrorEstimate, coils: int) -> tuple[LargestError, float] | None:
        """The error that is the largest multiple of what is allowed, and that multiple."""
        count = max(1, len(estimate.by_source) // 2)
        found = [
            (one, one.error / max(self.allowed(one, number % count, coils), 1e-300))
            for number, one in enumerate(estimate.by_source)
        ]
        return max(found, key=lambda pair: pair[1], default=None)

    def __str__(self) -> str:
        words = []
        for name, what, unit in (("flux_density", "B", "T"), ("gradient", "its gradient", "T/m")):
            relative, absolute = getattr(self, name), getattr(self, f"absolute_{name}")
            parts = [] if relative is None else [f"{100 * relative:.3g} %"]
            parts += [] if absolute is None else [f"{absolute:.3g} {unit}"]
            if parts:
                words.append(f"{' or '.join(parts)} of {what}")
        return ", ".join(words)


@dataclass(frozen=True, repr=False)
class MeshStep(Record):
    """One mesh of a run: counts, bytes of its matrix, wall time in s; flux_density, gradient: estimates, relative, None
    on the first mesh; excess: the largest estimate over what is allowed."""

    faces: int
    tetrahedra: int
    matrix_bytes: int
    seconds: float
    flux_density: float | None = None
    gradient: float | None = None
    excess: float | None = None


@dataclass(frozen=True, repr=False)
class ErrorShare(Record):
    """What one body shares in the error of B in the workspace, by the indicators of its faces and elements.

    share: of all bodies together; at (3,): the element that has most of it, m; size, wanted: length of an element there
    and in the next mesh, m; layer: thickness of the first layer where it lies at a sharp edge, m, None elsewhere.
    """

    body: str
    share: float
    at: tuple[float, float, float]
    size: float
    wanted: float
    layer: float | None = None

    def __str__(self) -> str:
        place = ", ".join(f"{1e3 * x:.3g}" for x in self.at)
        edge = "" if self.layer is None else f" with layers of {1e3 * self.layer:.2g} mm at the edges"
        sizes = f"elements of {1e3 * self.size:.2g} mm"
        if self.wanted < self.size:
            sizes = f"{sizes}, which would have to be {1e3 * self.wanted:.2g} mm{edge}"
        return (
            f"body '{self.body}' has {100 * self.share:.0f} % of the error, most at ({place}) mm in {sizes}"
        )


@dataclass(frozen=True, repr=False)
class ExpectedCost(Record):
    """Of a mesh that was not solved, predicted from those that were: its matrix in bytes, wall time in s."""

    faces: int
    tetrahedra: int
    matrix_bytes: float
    seconds: float

    def __str__(self) -> str:
        return (
            f"{self.faces:,} surface faces, {self.tetrahedra:,} tetrahedra, {self.matrix_bytes / 1e9:.2g} GB, "
            f"{self.seconds:.0f} s"
        )


@dataclass(frozen=True, repr=False)
class ToleranceReport(Record):
    """How a run to a tolerance went.

    ended: one of `ENDS`; steps: its meshes; worst: the error that is the largest multiple of what is allowed, with its
    place in the workspace, on the mesh of the answer; shares: of the bodies, the largest first; next_mesh: what the
    next one would cost, and whole: a mesh within the tolerance, if the estimate goes on falling as it did; None where
    the run does not tell.
    """

    asked: Tolerance
    ended: str
    steps: tuple[MeshStep, ...]
    worst: LargestError | None = None
    shares: tuple[ErrorShare, ...] = ()
    next_mesh: ExpectedCost | None = None
    whole: ExpectedCost | None = None

    @property
    def reached(self) -> bool:
        """Whether the estimate is within the tolerance."""
        return self.ended == "reached"

    def __str__(self) -> str:
        parts = [f"{ENDS[self.ended]} ({self.asked}) after {count_of(len(self.steps), 'mesh', 'meshes')}"]
        if self.worst is not None:
            parts.append(f"largest error: {self.worst}")
        if not self.reached and self.shares:
            parts.append(str(self.shares[0]))
        if not self.reached and self.next_mesh is not None:
            parts.append(f"the next mesh would have {self.next_mesh}")
        if not self.reached and self.whole is not None:
            parts.append(f"the tolerance would take about {self.whole}")
        return "; ".join(parts)


def expected_cost(
    steps: Sequence[MeshStep], faces: float, tetrahedra: float, matrix_bytes: float
) -> ExpectedCost:
    """Time by the power of the number of faces that the steps show, between 1 and 3 (2 where one alone is known)."""
    last, power = steps[-1], 2.0
    if len(steps) > 1 and last.faces > 1.2 * steps[0].faces and steps[0].seconds > 0:
        measured = np.log(last.seconds / steps[0].seconds) / np.log(last.faces / steps[0].faces)
        power = float(np.clip(measured, 1.0, 3.0))
    seconds = last.seconds * (faces / last.faces) ** power
    return ExpectedCost(round(faces), round(tetrahedra), matrix_bytes, float(seconds))


def faces_within(steps: Sequence[MeshStep]) -> float | None:
    """How many faces a mesh within the tolerance would have, by the power of their number with which the excess has
    fallen so far; None where that is less than a quarter or two meshes alone have no estimate to compare."""
    known = [(np.log(step.faces), np.log(step.excess)) for step in steps if step.excess]
    if len(known) < 2:
        return None
    x, y = np.array(known).T
    if np.ptp(x) < np.log(1.2):
        return None
    slope = float(np.polyfit(x, y, 1)[0])
    if slope > -0.25:
        return None
    return float(np.exp(x[-1]) * np.exp(y[-1] / -slope))
