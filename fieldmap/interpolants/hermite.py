"""The tricubic Hermite form of a map: through the stored values and gradients, once continuously differentiable."""

import numpy as np

from fieldmap.core.block import HERMITE
from fieldmap.interpolants.form import Form, Interpolant, header, node_potential, stored_form
from fieldmap.store import LargeMap, MapData
from fieldmap.typing import Array

NAME = "hermite"
STENCIL = 5


def hermite_form(data: MapData | LargeMap, outside: str) -> Form:
    """The tricubic Hermite interpolant.

    Parameters
    ----------
    data
        The map.
    outside
        Rule for points outside the box, as for `fieldmap.lookup.open_map`.

    Returns
    -------
    Form
        Coefficients of the field (three channels a coil) and of the potential (one), at every node.
    """
    if isinstance(data, LargeMap):
        return stored_form(data, NAME, outside)
    start = header(HERMITE, data.grid, len(data.field_names), outside)
    field = _coefficients(data, data.flux_density, data.gradient)
    potential = _coefficients(data, node_potential(data)[..., None], data.flux_density[..., None, :])
    return Form(NAME, np.concatenate([start, field]), np.concatenate([start, potential]), None)


def _coefficients(data: MapData, values: Array, slopes: Array) -> Array:
    """Flat coefficients of values (n_coils, nx, ny, nz, c) and slopes (n_coils, nx, ny, nz, c, 3)."""
    shape = data.grid.shape
    channels = len(values) * values.shape[-1]
    by_node = np.ascontiguousarray(np.moveaxis(values, 0, 3)).reshape(*shape, channels)
    slopes_by_node = np.ascontiguousarray(np.moveaxis(slopes, 0, 3)).reshape(*shape, channels, 3)
    return nodal_coefficients(by_node, slopes_by_node, np.array(data.grid.spacing)).ravel()


def nodal_coefficients(values: Array, gradient: Array, spacing: Array) -> Array:
    """Coefficients (nx, ny, nz, n_channels, 8) from values (nx, ny, nz, n_channels) and their exact gradient
    (nx, ny, nz, n_channels, 3); layout: fieldmap/core/hermite.h.

    Only mixed derivatives are estimated: f_xy is the mean of the differences of f_x along y and of f_y
    along x, and so on; f_xyz is the mean of the differences of the mixed second derivatives. Their error O(h^4) enters
    the interpolant as O(h^6), which is below the error of the interpolant, also at the boundary.
    """
    fx, fy, fz = (gradient[..., axis] * spacing[axis] for axis in range(3))
    fxy = 0.5 * (difference(fx, 1) + difference(fy, 0))
    fxz = 0.5 * (difference(fx, 2) + difference(fz, 0))
    fyz = 0.5 * (difference(fy, 2) + difference(fz, 1))
    fxyz = (difference(fxy, 2) + difference(fxz, 1) + difference(fyz, 0)) / 3.0
    return np.stack([values, fz, fy, fyz, fx, fxz, fxy, fxyz], axis=-1)


def difference(values: Array, axis: int) -> Array:
    """d values / d index along an axis, over 5 nodes (all if there are fewer).

    Fourth order; the stencil is centred inside and shifted, not shortened, at both ends.
    """
    along = np.moveaxis(values, axis, 0)
    n = len(along)
    width = min(n, STENCIL)
    weights = difference_weights(width)
    half = width // 2
    out = np.empty_like(along)
    inner = n - width + 1
    out[half : half + inner] = sum(weights[half, s] * along[s : s + inner] for s in range(width))
    out[:half] = np.tensordot(weights[:half], along[:width], 1)
    out[half + inner :] = np.tensordot(weights[half + 1 :], along[n - width :], 1)
    return np.moveaxis(out, 0, axis)


def difference_weights(n_nodes: int) -> Array:
    """Weights (n_nodes, n_nodes): row i differentiates the polynomial through unit-spaced nodes at node i."""
    apart = np.subtract.outer(np.arange(n_nodes), np.arange(n_nodes)) + np.eye(n_nodes)
    scale = apart.prod(axis=1)
    weights: Array = scale[:, None] / scale / apart
    np.fill_diagonal(weights, 0.0)
    np.fill_diagonal(weights, -weights.sum(axis=1))
    return weights


INTERPOLANT = Interpolant(NAME, "tricubic Hermite, continuous from cell to cell", hermite_form, HERMITE)
