"""How far a solution is from the truth, from what can be computed: the complementary form, and a coarser mesh.

The potential form errs to one side in the energy, the flux form to the other: what the elements inside the iron cannot
resolve lies between the two on one mesh, and similar meshes that agree with each other cannot hide it. In the energy
norm the mean of the two is half their distance from the truth (Prager and Synge, Quart. Appl. Math. 5 (1947) 241);
half the gap is charged for fields as well. What both forms have in common, rounded surfaces of flat faces and charges
constant on each, shows between two meshes, of which the estimate is for the coarser; where the shares of all faces in
the error are known (`fieldmap.iron.error.refinement`), their sum is an estimate for the finer one. The smaller of
these two counts. The estimate is the larger of that and the gap.
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
ENOUGH_GROWTH = 0.3


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
class ErrorEstimate(Record):
    """Relative to the largest |B| and |grad B| in the workspace, for the worst source: a coil, or the magnets.

    flux_density, gradient: the estimates; change: (B, gradient) between two meshes, or None if there is only one; gap:
    (B, gradient) between the potential form and the flux form on the same mesh, bracket: of B in the middle of the
    workspace, or None if only one form can be used; shares: sum of the shares of all faces in the error of B, or None.
    """

    flux_density: float
    gradient: float
    change: tuple[float, float] | None
    gap: tuple[float, float] | None
    bracket: Bracket | None = None
    shares: float | None = None

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


def estimate_error(
    points: Array,
    solution: Solution,
    coarser: Solution | None,
    complement: Solution | None,
    shares: float | None = None,
    growth: float = 1.0,
) -> ErrorEstimate:
    """Estimate at points (n, 3) from the same problem on a coarser mesh and in the other form; not without both.

    shares: sum of the shares of all faces in the error of B, where known. growth: how many more faces this mesh has
    than the coarser one, relative to it; meshes that hardly differ agree whatever their error, so that a change over
    less than `ENOUGH_GROWTH` is taken for that part of the change over it. The bracket is that of the point in the
    middle of all points.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    places = np.vstack([points, middle])
    fields = solution.source_fields(places)
    change = gap = bracket = None
    estimate = np.zeros(2)
    if coarser is not None:
        change = _difference(fields, coarser.source_fields(places))
        estimate = np.array(change) * max(1.0, ENOUGH_GROWTH / max(growth, 1e-3))
        if shares is not None:
            estimate[0] = min(estimate[0], shares)
    if complement is not None:
        others = complement.source_fields(places)
        gap = _difference(fields, others)
        estimate = np.maximum(estimate, _GAP_SHARE * np.array(gap))
        bracket = _bracket(middle, solution.sources, fields[0][:, -1], others[0][:, -1])
    return ErrorEstimate(float(estimate[0]), float(estimate[1]), change, gap, bracket, shares)


def _bracket(place: Array, sources: tuple[str, ...], one: Array, other: Array) -> Bracket:
    """Of fields (c, 3): the source whose two fields differ most, relative to their size."""
    size = np.linalg.norm(one, axis=1)
    relative = np.linalg.norm(one - other, axis=1) / np.where(size > 0, size, np.inf)
    worst = int(relative.argmax())
    component = int(np.abs(one[worst]).argmax())
    low, high = sorted((float(one[worst, component]), float(other[worst, component])))
    x, y, z = (float(value) for value in place)
    return Bracket("B" + "xyz"[component], (x, y, z), sources[worst], low, high)


def _difference(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[float, float]:
    """Largest difference of B (c, n, 3) and gradient (c, n, 3, 3), each source relative to its own largest value."""
    values = []
    for a, b, axes in ((one[0], other[0], (-1,)), (one[1], other[1], (-2, -1))):
        size = np.linalg.norm(a, axis=axes).max(axis=1)
        difference = np.linalg.norm(a - b, axis=axes).max(axis=1)
        values.append(float(np.max(difference / np.where(size > 0, size, np.inf), initial=0.0)))
    return values[0], values[1]


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
