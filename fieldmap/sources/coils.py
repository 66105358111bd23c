"""Flux density and gradient of a device's coils, per ampere: checked input, placement, turns, polarity."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.device.model import Coil
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.path import path_flux_density, path_flux_density_and_gradient
from fieldmap.sources.winding_path import winding_path

Array = NDArray[np.float64]


def unit_flux_density(coil: Coil, points: ArrayLike, digits: float = 10.0) -> Array:
    """Flux density B (n, 3) of a coil carrying 1 A, T/A, at points (n, 3) or (3,) in m, global frame.

    Turns and polarity are included; the current density is uniform over the winding section, docs/theory/coils.md.
    digits: decimal digits wanted (4 to 14); fewer are faster. Continuous everywhere; within a micrometre of the
    winding's surface fewer digits hold. Raises InputError for points of another shape or not finite.

    >>> from fieldmap.device.model import CircularCoil
    >>> coil = CircularCoil("one", inner_radius=0.011, outer_radius=0.021, height=0.039, turns=840)
    >>> bool(unit_flux_density(coil, [0.0, 0.0, 0.0])[0, 2] > 0)
    True
    """
    local = _local_points(coil, points)
    path = winding_path(coil)
    field = path_flux_density(local, path.arcs, path.bars, path.thickness, path.height, float(digits))
    return coil.turns * coil.polarity * field @ coil.placement.rotation.T


def unit_flux_density_and_gradient(
    coil: Coil, points: ArrayLike, digits: float = 10.0
) -> tuple[Array, Array]:
    """B (n, 3) in T/A and its gradient G (n, 3, 3), G[:, i, j] = dB_i/dx_j in T/(m A), as `unit_flux_density`.

    Analytic; symmetric and trace-free outside the winding, curl B = mu0 J inside it. The gradient is logarithmically
    infinite on the edges of the winding section and jumps at its surface.
    """
    local = _local_points(coil, points)
    path = winding_path(coil)
    field, gradient = path_flux_density_and_gradient(
        local, path.arcs, path.bars, path.thickness, path.height, float(digits)
    )
    ampere_turns = coil.turns * coil.polarity
    rotation = coil.placement.rotation
    return ampere_turns * field @ rotation.T, ampere_turns * (rotation @ gradient @ rotation.T)


def checked_points(points: ArrayLike, where: str) -> Array:
    """Points as an array (n, 3) of finite float64, C order. Raises InputError otherwise."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != 3:
        raise InputError(
            Problem(
                where, "must have the shape (n, 3) or (3,)", f"shape {array.shape}", "give x, y, z in metres"
            )
        )
    bad = np.flatnonzero(~np.isfinite(array.reshape(-1, 3)).all(axis=1))
    if len(bad):
        raise InputError(
            Problem(
                where,
                "must be finite",
                f"{array.reshape(-1, 3)[bad[0]]} at index {bad[0]} ({len(bad)} in all)",
                "remove or correct these points",
            )
        )
    return np.ascontiguousarray(array.reshape(-1, 3))


def _local_points(coil: Coil, points: ArrayLike) -> Array:
    checked = checked_points(points, "points")
    return np.ascontiguousarray((checked - coil.placement.position) @ coil.placement.rotation)
