"""How far a solution is from the truth, from what can be computed: the complementary form, and a coarser mesh.

The potential form errs to one side in the energy, the flux form to the other: what the elements inside the iron cannot
resolve lies between the two on one mesh, and similar meshes that agree with each other cannot hide it. In the energy
norm the mean of the two is half their distance from the truth (Prager and Synge, Quart. Appl. Math. 5 (1947) 241);
half the gap is charged for fields as well. What both forms have in common, rounded surfaces of flat faces and charges
constant on each, shows between two meshes, of which the estimate is for the coarser; where the shares of all faces in
the error are known (`fieldmap.iron.error.refinement`), their sum is an estimate for the finer one. The smaller of
these two counts. The estimate is the larger of that and the gap, for each source by itself.

Relative errors of B are those of its largest value in the workspace. A gradient may vanish, in a shield or in the
middle of a symmetric machine; its errors are relative to the larger of its own largest value and |B| / L. L is half the
diagonal of the workspace, or the distance from its middle to the nearest iron where that is longer: an error e of the
gradient then adds at most e times |B| to the field between the middle and the corners, and a small workspace far from
the iron does not loosen the scale.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fieldmap.device.model import Background, Coil, Device
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.records import Record
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.typing import Array

# The mean of two complementary solutions is off by half their distance.
_GAP_SHARE = 0.5
_POINTS_PER_EDGE = 5
# True errors of shells and spheres are up to 2.6 times the sum of the shares, those of other devices below it.
_SHARES_SHORT = 2.0
# Errors fall like the number of faces, at least: over fewer more of them a change is only a part of the error.
ENOUGH_GROWTH = 1.0
QUANTITIES = ("B", "gradient")


@dataclass(frozen=True, repr=False)
class Bracket(Record):
    """The largest component of B at one point by both forms: at (3,) in m, low and high in T, source in words."""

    what: str
    at: tuple[float, float, float]
    source: str
    low: float
    high: float

    def __str__(self) -> str:
        place = ", ".join(f"{1e3 * x:.4g}" for x in self.at)
        gap = 100 * (self.high - self.low) / max(abs(self.high), abs(self.low), 1e-300)
        return (
            f"{self.what} of {self.source} at ({place}) mm between {1e3 * self.low:.6g} and {1e3 * self.high:.6g} mT "
            f"({gap:.2g} %)"
        )


@dataclass(frozen=True, repr=False)
class LargestError(Record):
    """The largest estimated error of one quantity, "B" or "gradient", of one source in the workspace.

    error, size: in T or T/m, of 1 A in a coil; what relative errors are relative to is `size`. at (3,): where it is
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
    """Relative to the largest |B| in the workspace and to the scale of the gradient (see above), for the worst source:
    a coil, or the magnets.

    flux_density, gradient: the estimates; change: (B, gradient) between two meshes, or None if there is only one; gap:
    (B, gradient) between the potential form and the flux form on the same mesh, bracket: of B in the middle of the
    workspace, or None if only one form can be used; shares: sum of the shares of all faces in the error of B, or None.
    by_source: the largest errors of B, one for each source, then those of the gradient, in T and T/m and with their
    places; length: the L of the gradient's scale, m.
    """

    flux_density: float
    gradient: float
    change: tuple[float, float] | None
    gap: tuple[float, float] | None
    bracket: Bracket | None = None
    shares: float | None = None
    by_source: tuple[LargestError, ...] = ()
    length: float | None = None

    def worst(self, quantity: str) -> LargestError | None:
        """That of the source with the largest relative error of "B" or "gradient"; None if no places were kept."""
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
        bracket = "" if self.bracket is None else f"; {self.bracket}"
        return (
            f"estimated error in the workspace {100 * self.flux_density:.2g} % of B, {100 * self.gradient:.2g} % of "
            f"its gradient ({', '.join(words)}){bracket}"
        )


class Solution(Protocol):
    """What the estimate asks of a solution: its fields outside the iron, per source (c)."""

    @property
    def sources(self) -> tuple[str, ...]:
        """What each source is, in words."""
        ...

    @property
    def iron_points(self) -> Array:
        """Points (m, 3) all over the surface of the iron, m."""
        ...

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Field (c, n, 3) and gradient (c, n, 3, 3) at points (n, 3)."""
        ...


def workspace_surface(device: Device) -> Array:
    """Points (n, 3) on the surface of the workspace's box. Field and gradient are harmonic inside, so that errors are
    largest there. Raises InputError if the device has no workspace."""
    bounds = device.bounds
    if bounds is None:
        raise InputError(
            Problem(
                f"device '{device.name}'",
                "must have a workspace, in which the error is estimated",
                "none",
                "add a [workspace] table to the device file",
            )
        )
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
    distance = np.linalg.norm(iron - 0.5 * (lower + upper), axis=1).min(initial=np.inf)
    half = 0.5 * float(np.linalg.norm(upper - lower))
    return max(half, float(distance)) if np.isfinite(distance) else half


def estimate_error(
    points: Array,
    solution: Solution,
    coarser: Solution | None,
    complement: Solution | None,
    shares: Array | None = None,
    growth: float = 1.0,
) -> ErrorEstimate:
    """Estimate at points (n, 3) from the same problem on a coarser mesh and in the other form; not without both.

    shares (c,): sums of the shares of all faces in the error of B of every source, where known. growth: how many more
    faces this mesh has than the coarser one, relative to it; meshes that hardly differ agree whatever their error, so
    that a change over less than `ENOUGH_GROWTH` is taken for that part of the change over it. The bracket is that of
    the point in the middle of all points.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    places = np.vstack([points, middle])
    fields = solution.source_fields(places)
    length = gradient_length(points, solution.iron_points)
    sizes = _sizes(fields, length)
    change = gap = bracket = None
    nothing = np.zeros((2, len(fields[0]), len(places)))
    changed, apart = nothing, nothing
    if coarser is not None:
        changed = _distances(fields, coarser.source_fields(places))
        change = _relative(changed, sizes)
        changed = changed * max(1.0, ENOUGH_GROWTH / max(growth, 1e-3))
        if shares is not None:
            most = _SHARES_SHORT * shares * sizes[0]
            changed[0] *= np.minimum(1.0, most / np.maximum(changed[0].max(axis=1), 1e-300))[:, None]
    if complement is not None:
        others = complement.source_fields(places)
        apart = _distances(fields, others)
        gap = _relative(apart, sizes)
        bracket = _bracket(middle, solution.sources, fields[0][:, -1], others[0][:, -1])
    by_source = _largest_errors(np.maximum(changed, _GAP_SHARE * apart), sizes, places, solution.sources)
    flux_density, gradient = (
        max((one.relative for one in by_source if one.quantity == name), default=0.0) for name in QUANTITIES
    )
    total = None if shares is None else float(shares.max(initial=0.0))
    return ErrorEstimate(flux_density, gradient, change, gap, bracket, total, by_source, length)


def _sizes(fields: tuple[Array, Array], length: float) -> Array:
    """What errors of B and gradient (2, c) are relative to, T and T/m."""
    b = np.linalg.norm(fields[0], axis=-1).max(axis=1)
    g = np.linalg.norm(fields[1], axis=(-2, -1)).max(axis=1)
    return np.stack([b, np.maximum(g, b / length)])


def _distances(one: tuple[Array, Array], other: tuple[Array, Array]) -> Array:
    """Of B (c, n, 3) and gradient (c, n, 3, 3) at every point: (2, c, n), T and T/m."""
    field, gradient = one[0] - other[0], one[1] - other[1]
    return np.stack([np.linalg.norm(field, axis=-1), np.linalg.norm(gradient, axis=(-2, -1))])


def _relative(distances: Array, sizes: Array) -> tuple[float, float]:
    """The largest of the distances (2, c, n) of B and of the gradient, each source relative to its size (2, c)."""
    values = distances.max(axis=2) / np.where(sizes > 0, sizes, np.inf)
    return float(values[0].max(initial=0.0)), float(values[1].max(initial=0.0))


def _largest_errors(
    errors: Array, sizes: Array, places: Array, sources: tuple[str, ...]
) -> tuple[LargestError, ...]:
    """Of errors (2, c, n) at places (n, 3)."""
    out = []
    for quantity, values, size in zip(QUANTITIES, errors, sizes, strict=True):
        for k, source in enumerate(sources):
            at = int(values[k].argmax())
            x, y, z = (float(value) for value in places[at])
            out.append(LargestError(quantity, source, (x, y, z), float(values[k, at]), float(size[k])))
    return tuple(out)


def _bracket(place: Array, sources: tuple[str, ...], one: Array, other: Array) -> Bracket:
    """Of fields (c, 3): the source whose two fields differ most, relative to their size."""
    size = np.linalg.norm(one, axis=1)
    relative = np.linalg.norm(one - other, axis=1) / np.where(size > 0, size, np.inf)
    worst = int(relative.argmax())
    component = int(np.abs(one[worst]).argmax())
    low, high = sorted((float(one[worst, component]), float(other[worst, component])))
    x, y, z = (float(value) for value in place)
    return Bracket("B" + "xyz"[component], (x, y, z), sources[worst], low, high)


@dataclass(frozen=True, eq=False)
class _StateFields:
    """Fields of one state outside the iron, as `fieldmap.iron.error.estimate` asks for them."""

    coils: tuple[Coil, ...]
    currents: Array
    iron: IronState
    background: Background | None

    @property
    def sources(self) -> tuple[str, ...]:
        """There is one: all currents together."""
        return ("these currents",)

    @property
    def iron_points(self) -> Array:
        """Centres (m, 3) of the charged faces."""
        return self.iron.faces.centres

    def source_fields(self, points: Array) -> tuple[Array, Array]:
        """Field (1, n, 3) and gradient (1, n, 3, 3) at points (n, 3)."""
        b, g = self.iron.faces.field_and_gradient(points, self.iron.density)
        for coil, current in zip(self.coils, self.currents, strict=True):
            coil_b, coil_g = unit_flux_density_and_gradient(coil, points)
            b[0] += current * coil_b
            g[0] += current * coil_g
        if self.background is not None:
            flux, slope = self.background.field_and_gradient(points)
            b[0] += flux
            g[0] += slope
        return b, g


class Complement:
    """The flux form of a mesh, for states that the potential form has solved on it."""

    def __init__(self, iron: AssembledIron) -> None:
        self._form = FluxForm(iron)

    def solve(
        self, material: Magnetisation, field: CoilField, potential: Array, tolerance: float
    ) -> IronState:
        """The state of the same sources, by Newton from the nodal potential (k, 1). Raises NotConverged."""
        elements = self._form.elements
        values = elements.nodal.coil_field_at_points(field)
        try:
            start = elements.from_nodal(potential)
            return self._form.solve(material, values, tolerance, start).iron
        except NotConverged:
            return self._form.solve(material, values, tolerance).iron


def state_error(
    device: Device, currents: Array, iron: IronState, coarser: IronState, complement: IronState
) -> ErrorEstimate:
    """Estimate for `iron` in the workspace, from the same currents on a coarser mesh and in the flux form."""
    fine, coarse, other = (
        _StateFields(device.coils, currents, state, device.background)
        for state in (iron, coarser, complement)
    )
    return estimate_error(workspace_surface(device), fine, coarse, other)
