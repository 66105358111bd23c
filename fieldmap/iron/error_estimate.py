"""How far a solution is from the truth, from what can be computed: a coarser mesh, and the complementary form.

Two meshes alone can agree and both be wrong: lowest-order flux elements in a closed circuit change by 1e-3 under
refinement and are 8e-3 off. The two forms err to opposite sides there, so their gap on one mesh cannot be fooled;
but it is the error of the poorer of the two, the flux form. The second-order form is better by an order, which is
what `_GAP_SHARE` states; the estimate is the larger of that share and of the change between two meshes.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Device, WorkspaceBox
from fieldmap.errors import InputError, Problem

Array = NDArray[np.float64]
# Share of the gap between the forms that is charged to the second-order one. Measured on the drive unit (closed
# circuit, mu_r 4000): gap 8e-3, error 2e-4 to 2e-3; on disk with core: gap 6e-4, error 5e-5.
_GAP_SHARE = 0.1
_POINTS_PER_EDGE = 5


@dataclass(frozen=True)
class ErrorEstimate:
    """Relative to the largest |B| and |grad B| in the workspace, for the worst coil.

    flux_density, gradient: the estimates; change: (B, gradient) between the last two meshes; gap: (B, gradient)
    between the potential form and the flux form on the same mesh, or None if only one form can be used.
    """

    flux_density: float
    gradient: float
    change: tuple[float, float]
    gap: tuple[float, float] | None

    def __str__(self) -> str:
        gap = "" if self.gap is None else f", {100 * self.gap[0]:.2g} % between the two forms on one mesh"
        return (
            f"estimated error in the workspace {100 * self.flux_density:.2g} % of B, {100 * self.gradient:.2g} % of "
            f"its gradient (B changes by {100 * self.change[0]:.2g} % between two meshes{gap})"
        )


class _Solution(Protocol):
    def unit_fields(self, points: Array) -> tuple[Array, Array]: ...


def workspace_surface(device: Device) -> Array:
    """Points (n, 3) on the surface of the workspace's box. Field and gradient are harmonic inside, so that errors are
    largest there. Raises InputError if the device has no workspace."""
    space = device.workspace
    if space is None:
        raise InputError(
            Problem(
                f"device '{device.name}'",
                "must have a workspace, in which the error is estimated",
                "none",
                "add a [workspace] table to the device file",
            )
        )
    if isinstance(space, WorkspaceBox):
        lower, upper = space.lower, space.upper
    else:
        reach = np.array([space.radius, space.radius, 0.0])
        lower, upper = space.base - reach, space.base + reach + [0, 0, space.height]
    t = np.linspace(0, 1, _POINTS_PER_EDGE)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    on_surface = ((grid == 0) | (grid == 1)).any(axis=1)
    return lower + grid[on_surface] * (upper - lower)


def estimate_error(
    points: Array, solution: _Solution, coarser: _Solution, complement: _Solution | None
) -> ErrorEstimate:
    """Estimate at points (n, 3) from the same problem on a coarser mesh and in the other form."""
    fields = solution.unit_fields(points)
    change = _difference(fields, coarser.unit_fields(points))
    gap = None if complement is None else _difference(fields, complement.unit_fields(points))
    share = (0.0, 0.0) if gap is None else (_GAP_SHARE * gap[0], _GAP_SHARE * gap[1])
    return ErrorEstimate(max(change[0], share[0]), max(change[1], share[1]), change, gap)


def _difference(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[float, float]:
    """Largest difference of B (c, n, 3) and gradient (c, n, 3, 3), each coil relative to its own largest value."""
    values = []
    for a, b, axes in ((one[0], other[0], (-1,)), (one[1], other[1], (-2, -1))):
        size = np.linalg.norm(a, axis=axes).max(axis=1)
        values.append(float((np.linalg.norm(a - b, axis=axes).max(axis=1) / size).max()))
    return values[0], values[1]
