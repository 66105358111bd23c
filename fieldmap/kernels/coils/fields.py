"""Flux density by the kernels of windings, alone or with its gradient.

A kernel sums both, and writes no gradient if the array for it has no rows. Flux density alone thus takes up to a sixth
longer (half as long again far from a ring), but a second kernel without gradients would take seconds to compile.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from fieldmap.threads import over_rows
from fieldmap.typing import Array


def flux_density(
    kernel: Callable[..., Any], points: Array, *winding: Any, work: float, block: int = 1
) -> Array:
    """B (n, 3) at points (n, 3) by kernel(begin, end, points, *winding, field, gradient).

    block: points in a row of the kernel; work: of one row, as in `fieldmap.threads.over_rows`.
    """
    return _filled(kernel, points, winding, work, block, 0)[0]


def flux_density_and_gradient(
    kernel: Callable[..., Any], points: Array, *winding: Any, work: float, block: int = 1
) -> tuple[Array, Array]:
    """B (n, 3) and its gradient (n, 3, 3), otherwise as `flux_density`."""
    return _filled(kernel, points, winding, work, block, len(points))


def _filled(
    kernel: Callable[..., Any], points: Array, winding: tuple[Any, ...], work: float, block: int, rows: int
) -> tuple[Array, Array]:
    field, gradient = np.zeros((len(points), 3)), np.zeros((rows, 3, 3))
    over_rows(kernel, -(-len(points) // block), points, *winding, field, gradient, work=work)
    return field, gradient
