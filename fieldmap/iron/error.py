"""Error estimates of a solution, from its complementary form and from a coarser mesh.

The potential form errs to one side in the energy, the flux form to the other. On one mesh the gap between the two shows
what the elements inside the iron do not resolve, even where similar meshes agree with each other. In the energy norm
the mean of the two forms is off by half the gap (Prager and Synge, Quart. Appl. Math. 5 (1947) 241); half the gap is
the estimate for fields as well. It is no bound: the true field at a point may lie outside of the fields of both forms.
Both forms have two errors in common: flat faces on round surfaces, and charges constant on each face. These show as a
change between two meshes, which estimates the error of the coarser one. Where the shares of all faces in the error of B
are known (`fieldmap.iron.solvers.refinement`), twice their sum is an estimate for the finer one. For B the smaller of
the two is taken, for the gradient the change. The estimate for each source is the larger of this and half the gap.

Errors of B are relative to its largest value in the workspace. A gradient may vanish, in a shield or in the
middle of a symmetric machine; its errors are relative to the larger of its own largest value and |B| / L. L is half the
diagonal of the workspace, or the distance from its middle to the nearest iron where that is longer: an error e of the
gradient then adds at most e times |B| to the field between the middle and the corners, and a small workspace far from
the iron does not loosen the scale.

`Tolerance` states the allowed errors, and `ToleranceReport` how a run that refines for them went. An error is within a
tolerance if it is no larger than the relative part times the size that it is relative to, or no larger than the
absolute part: the larger of the two is allowed. Where a field is shielded to almost nothing, the absolute part alone
makes sense.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fieldmap.arguments import raise_all
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record, count_of
from fieldmap.typing import Array

# The mean of two complementary solutions is off by half their distance.
_GAP_SHARE = 0.5
_POINTS_PER_EDGE = 5
# Factor on the sum of the shares. True errors are up to 2.6 times the sum in shells and spheres, below it elsewhere.
_SHARES_SHORT = 2.0
# Errors fall at least in proportion to the number of faces. If that number grows by less than this share, the change
# shows only a part of the error.
ENOUGH_GROWTH = 1.0
QUANTITIES = ("B", "gradient")


@dataclass(frozen=True, repr=False)
class BothForms(Record):
    """The largest component of B at one point, T, by the form of the solution and by its complement: at (3,) in m,
    source in words.

    The two values are no bounds. The forms have errors in common, and the true value may lie outside of both.
    """

    what: str
    at: tuple[float, float, float]
    source: str
    solution: float
    complement: float

    def __str__(self) -> str:
        place = ", ".join(f"{1e3 * x:.4g}" for x in self.at)
        one, other = self.solution, self.complement
        gap = 100 * abs(one - other) / max(abs(one), abs(other), 1e-300)
        return (
            f"{self.what} of {self.source} at ({place}) mm by the two forms: {1e3 * one:.6g} and {1e3 * other:.6g} mT "
            f"({gap:.2g} % apart; no bounds: the true value may lie outside)"
        )


@dataclass(frozen=True, repr=False)
class LargestError(Record):
    """The largest estimated error of one quantity, "B" or "gradient", of one source in the workspace.

    error, size: in T or T/m, for a coil with 1 A in it; relative errors are error / size. at (3,): where the error is
    largest, m.
    """

    quantity: str
    source: str
    at: tuple[float, float, float]
    error: float
    size: float

    @property
    def relative(self) -> float:
        """error / size; 0 where there is no field."""
        return self.error / self.size if self.size > 0 else 0.0

    def __str__(self) -> str:
        place = ", ".join(f"{1e3 * x:.4g}" for x in self.at)
        unit, scale = ("mT", 1e3) if self.quantity == "B" else ("T/m", 1.0)
        return (
            f"{self.quantity} of {self.source} at ({place}) mm: {scale * self.error:.2g} {unit}, "
            f"{100 * self.relative:.2g} % of {scale * self.size:.3g} {unit}"
        )


@dataclass(frozen=True, repr=False)
class ErrorEstimate(Record):
    """Estimated errors of the worst source, a coil or the magnets and background. They are relative to the largest |B|
    in the workspace and to the scale of the gradient (module docstring).

    flux_density, gradient: the estimates; change: (B, gradient) between two meshes, or None if there is only one; gap:
    (B, gradient) between the potential form and the flux form on the same mesh, both_forms: B of the two in the middle
    of the workspace (values, no bounds), or None if only one form can be used; shares: sum of the shares of all faces
    in the error of B, or None. by_source: the largest errors of B, one for each source, then of the gradient, in T and
    T/m and with their places; length: the L of the gradient's scale, m.
    """

    flux_density: float
    gradient: float
    change: tuple[float, float] | None
    gap: tuple[float, float] | None
    both_forms: BothForms | None = None
    shares: float | None = None
    by_source: tuple[LargestError, ...] = ()
    length: float | None = None

    def worst(self, quantity: str) -> LargestError | None:
        """The error of the source with the largest relative error.

        Parameters
        ----------
        quantity
            "B" or "gradient".

        Returns
        -------
        LargestError | None
            The error; None if `by_source` is empty.
        """
        found = [one for one in self.by_source if one.quantity == quantity]
        return max(found, key=lambda one: one.relative, default=None)

    def __str__(self) -> str:
        words = []
        if self.change is not None:
            words.append(f"B changes by {100 * self.change[0]:.2g} % between two meshes")
        if self.shares is not None:
            words.append(f"constant charges leave out {100 * self.shares:.2g} %")
        if self.gap is not None:
            words.append(f"{100 * self.gap[0]:.2g} % between the two forms on one mesh")
        forms = "" if self.both_forms is None else f"; {self.both_forms}"
        return (
            f"estimated error in the workspace {100 * self.flux_density:.2g} % of B, {100 * self.gradient:.2g} % of "
            f"its gradient ({', '.join(words)}){forms}"
        )


def workspace_surface(device: Device) -> Array:
    """Points (n, 3) on the surface of the workspace's box. Errors are largest there, because field and gradient are
    harmonic inside. Raises InputError if the device has no workspace."""
    bounds = device.bounds
    if bounds is None:
        must_hold = "must have a workspace, in which the error is estimated"
        remedy = "add a [workspace] table to the device file"
        raise InputError.of(f"device '{device.name}'", must_hold, "none", remedy)
    lower, upper = bounds
    t = np.linspace(0, 1, _POINTS_PER_EDGE)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    on_surface = ((grid == 0) | (grid == 1)).any(axis=1)
    return lower + grid[on_surface] * (upper - lower)


def gradient_length(points: Array, iron: Array) -> float:
    """The length L (m) of the gradient's scale: the larger of half the diagonal of the box of points (n, 3), and of the
    distance from its middle to the nearest of the points of the iron (m, 3).

    >>> corners = np.array([[-3.0, -4.0, 0.0], [3.0, 4.0, 0.0]])
    >>> gradient_length(corners, np.array([[0.0, 0.0, 2.0]])), gradient_length(corners, np.array([[0.0, 0.0, 9.0]]))
    (5.0, 9.0)
    """
    lower, upper = points.min(axis=0), points.max(axis=0)
    half = 0.5 * float(np.linalg.norm(upper - lower))
    distance = np.linalg.norm(iron - 0.5 * (lower + upper), axis=1)
    return max(half, float(distance.min(initial=np.inf))) if len(iron) else half


class Solution(Protocol):
    """The parts of a solution that the estimate needs: its fields outside the iron, for each source (c)."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Each source, in words."""
        ...

    @property
    def iron_points(self) -> Array:
        """Points (m, 3) all over the surface of the iron, m."""
        ...

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Field (c, n, 3), T, and gradient (c, n, 3, 3), T/m, at points (n, 3)."""
        ...


def estimate_error(
    points: Array,
    solution: Solution,
    coarser: Solution | None,
    complement: Solution | None,
    shares: Array | None = None,
    growth: float = 1.0,
) -> ErrorEstimate:
    """Estimate at points (n, 3) by comparison with a coarser mesh, with the other form or with both; 0 with neither.

    shares (c,): sums of the shares of all faces in the error of B of every source, where known. growth: the ratio of
    faces on this and on the coarser mesh, minus 1. Meshes that hardly differ agree even if their error is large: if the
    growth is below `ENOUGH_GROWTH`, the change is multiplied by `ENOUGH_GROWTH` over the growth.
    `both_forms` is for the point in the middle of all points.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    places = np.vstack([points, middle])
    fields = solution.source_fields(places)
    length = gradient_length(points, solution.iron_points)
    sizes = _norms(*fields).max(axis=2)
    sizes[1] = np.maximum(sizes[1], sizes[0] / length)
    errors = np.zeros((2, len(fields[0]), len(places)))
    change = gap = both_forms = None
    if coarser is not None:
        others = coarser.source_fields(places)
        changed = _norms(fields[0] - others[0], fields[1] - others[1])
        change = _relative(changed, sizes)
        errors = changed * max(1.0, ENOUGH_GROWTH / max(growth, 1e-3))
        if shares is not None:
            most = _SHARES_SHORT * shares * sizes[0]
            errors[0] *= np.minimum(1.0, most / np.maximum(errors[0].max(axis=1), 1e-300))[:, None]
    if complement is not None:
        others = complement.source_fields(places)
        apart = _norms(fields[0] - others[0], fields[1] - others[1])
        gap = _relative(apart, sizes)
        errors = np.maximum(errors, _GAP_SHARE * apart)
        both_forms = _by_both_forms(middle, solution.sources, fields[0][:, -1], others[0][:, -1])
    by_source = _largest_errors(errors, sizes, places, solution.sources)
    total = None if shares is None else float(shares.max(initial=0.0))
    return ErrorEstimate(*_relative(errors, sizes), change, gap, both_forms, total, by_source, length)


def _norms(field: Array, gradient: Array) -> Array:
    """Norms (2, c, n) of B (c, n, 3) and of the gradient (c, n, 3, 3) at every point, T and T/m."""
    return np.stack([np.linalg.norm(field, axis=-1), np.linalg.norm(gradient, axis=(-2, -1))])


def _relative(errors: Array, sizes: Array) -> tuple[float, float]:
    """The largest of the errors (2, c, n) of B and of the gradient, each source relative to its size (2, c)."""
    values = errors.max(axis=2) / np.where(sizes > 0, sizes, np.inf)
    return float(values[0].max(initial=0.0)), float(values[1].max(initial=0.0))


def _largest_errors(
    errors: Array, sizes: Array, places: Array, sources: tuple[str, ...]
) -> tuple[LargestError, ...]:
    """The largest of the errors (2, c, n) at places (n, 3), for each quantity and source."""
    out = []
    for quantity, values, size in zip(QUANTITIES, errors, sizes, strict=True):
        for k, source in enumerate(sources):
            at = int(values[k].argmax())
            x, y, z = (float(value) for value in places[at])
            out.append(LargestError(quantity, source, (x, y, z), float(values[k, at]), float(size[k])))
    return tuple(out)


def _by_both_forms(place: Array, sources: tuple[str, ...], one: Array, other: Array) -> BothForms:
    """The two values at the source with the largest relative difference between two fields (c, 3)."""
    size = np.linalg.norm(one, axis=1)
    relative = np.linalg.norm(one - other, axis=1) / np.where(size > 0, size, np.inf)
    worst = int(relative.argmax())
    component = int(np.abs(one[worst]).argmax())
    x, y, z = (float(value) for value in place)
    values = float(one[worst, component]), float(other[worst, component])
    return BothForms("B" + "xyz"[component], (x, y, z), sources[worst], *values)


ENDS = {
    "reached": "within the tolerance",
    "stalled": "the estimate fell no further",
    "memory": "the next mesh does not fit into memory",
    "meshes": "as many meshes as were allowed",
}
"""The ways in which a run may end, with their meanings."""
_GRADIENT_PER_FIELD = 3.0


@dataclass(frozen=True, repr=False)
class Tolerance(Record):
    """Allowed errors in the workspace. A quantity whose two parts are None may have any error.

    flux_density: relative to the largest |B|; gradient: relative to the larger of the largest |grad B| and of |B| over
    a length; absolute_flux_density in T; absolute_gradient in T/m. Each holds for
    every source by itself: the magnets and the background, and every coil with 1 A, or with its entry of `currents`, A.
    Raises InputError for values out of range.

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
        between, finite = (
            ("must lie between 0 and {:g}", "try 1e-3"),
            ("must be a finite number > 0", "leave it out"),
        )
        problems = []
        for name, most, (must_hold, remedy) in (
            ("flux_density", 1.0, between),
            ("absolute_flux_density", np.inf, finite),
            ("gradient", np.inf, between),
            ("absolute_gradient", np.inf, finite),
        ):
            value = getattr(self, name)
            if value is not None and not 0 < value < most:
                problems.append(Problem(f"Tolerance, {name}", must_hold.format(most), repr(value), remedy))
        given = self.flux_density, self.gradient, self.absolute_flux_density, self.absolute_gradient
        if all(value is None for value in given):
            must_hold = "must say of what an error is allowed"
            problems.append(Problem("Tolerance, flux_density", must_hold, "None", "try 1e-3"))
        if not all(map(np.isfinite, self.currents or ())):
            remedy = "give one for each coil, A"
            problems.append(
                Problem("Tolerance, currents", "must be finite numbers", repr(self.currents), remedy)
            )
        raise_all(problems)

    @classmethod
    def of(cls, tolerance: float | Tolerance, gradient: float | None = None) -> Tolerance:
        """A tolerance from numbers.

        Parameters
        ----------
        tolerance
            Relative, of B; or a `Tolerance`, which is returned unchanged.
        gradient
            Relative, of the gradient; inf allows any error of it. None: three times the tolerance of B.

        Returns
        -------
        Tolerance
            The tolerance.
        """
        if isinstance(tolerance, Tolerance):
            return tolerance
        allowed = _GRADIENT_PER_FIELD * tolerance if gradient is None else gradient
        return cls(tolerance, None if allowed == np.inf else allowed)

    @property
    def solving(self) -> float:
        """Tolerance of the iteration on every mesh: the smallest relative part, or 1e-3 if that is smaller and there is
        an absolute part."""
        relative = [part for part in (self.flux_density, self.gradient) if part is not None]
        absolute = self.absolute_flux_density is not None or self.absolute_gradient is not None
        return min([*relative, 1e-3] if absolute else relative)

    def allowed(self, one: LargestError, source: int, coils: int) -> float:
        """The allowed error of one source.

        Parameters
        ----------
        one
            The largest error of the source.
        source
            Its number among the sources; the coils come first.
        coils
            Number of coils.

        Returns
        -------
        float
            T or T/m; inf if any error is allowed.
        """
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
        """The largest ratio of an estimated error to the allowed one.

        Parameters
        ----------
        estimate
            The estimate.
        coils
            Number of coils.

        Returns
        -------
        float
            1 or less is within the tolerance.
        """
        worst = self.worst(estimate, coils)
        return 0.0 if worst is None else worst[1]

    def worst(self, estimate: ErrorEstimate, coils: int) -> tuple[LargestError, float] | None:
        """The error with the largest ratio to the allowed one.

        Parameters
        ----------
        estimate
            The estimate.
        coils
            Number of coils.

        Returns
        -------
        tuple[LargestError, float] | None
            The error, and that ratio; None if the estimate's `by_source` is empty.
        """
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
    """One mesh of a run: counts, bytes of its matrix, wall time in s; flux_density, gradient: relative estimates;
    excess: the largest ratio of an estimate to the allowed error. These three are None on the first mesh."""

    faces: int
    tetrahedra: int
    matrix_bytes: int
    seconds: float
    flux_density: float | None = None
    gradient: float | None = None
    excess: float | None = None


@dataclass(frozen=True, repr=False)
class ErrorShare(Record):
    """The share of one body in the error of B in the workspace, from the indicators of its faces and elements.

    share: part of the sum over all bodies; at (3,): the mesher's tetrahedron with the largest part of it, m; size,
    wanted: element size there that the mesher is asked for, in this and in the next mesh, m; layer: thickness of the
    first layer at a sharp edge, m, None elsewhere.
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
    """The cost of a mesh that was not solved, predicted from solved ones: matrix in bytes, wall time in s."""

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
    """The report of a run to a tolerance.

    ended: one of `ENDS`; steps: its meshes; worst: the error with the largest ratio to the allowed one, with its place
    in the workspace, on the mesh of the answer; shares: of the bodies, the largest first; next_mesh: the cost of the
    next mesh; whole: the cost of a mesh within the tolerance, if the estimate goes on falling as before. Either is None
    if it cannot be predicted from the run.
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
    """The cost of a mesh. Time grows with a power of the number of faces; the exponent follows from the steps and is
    kept between 1 and 3 (2 if the steps are too few or too alike)."""
    last, power = steps[-1], 2.0
    if len(steps) > 1 and last.faces > 1.2 * steps[0].faces and steps[0].seconds > 0:
        measured = np.log(last.seconds / steps[0].seconds) / np.log(last.faces / steps[0].faces)
        power = float(np.clip(measured, 1.0, 3.0))
    seconds = last.seconds * (faces / last.faces) ** power
    return ExpectedCost(round(faces), round(tetrahedra), matrix_bytes, float(seconds))


def faces_within(steps: Sequence[MeshStep]) -> float | None:
    """Number of faces of a mesh within the tolerance, if the excess goes on falling with the same power of the number
    of faces. None if the exponent is less than a quarter, or without estimates on two meshes that differ."""
    known = [(np.log(step.faces), np.log(step.excess)) for step in steps if step.excess]
    if not known:
        return None
    x, y = np.array(known).T
    if np.ptp(x) < np.log(1.2):
        return None
    slope = float(np.polyfit(x, y, 1)[0])
    if slope > -0.25:
        return None
    return float(np.exp(x[-1]) * np.exp(y[-1] / -slope))
