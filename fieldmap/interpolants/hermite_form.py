"""The tricubic Hermite form of a map: through the stored values and gradients, once continuously differentiable."""

import numpy as np

from fieldmap.interpolants.form import Form, header
from fieldmap.interpolants.node_potential import node_potential
from fieldmap.interpolants.node_slopes import nodal_coefficients
from fieldmap.kernels.map import map_block
from fieldmap.store import MapData
from fieldmap.typing import Array


def hermite_form(data: MapData, outside: str) -> Form:
    """Coefficients of the field (three channels a coil) and of the potential (one), at every node."""
    start = header(map_block.HERMITE, data.grid, len(data.field_names), outside)
    field = _coefficients(data, data.flux_density, data.gradient)
    potential = _coefficients(data, node_potential(data)[..., None], data.flux_density[..., None, :])
    return Form(
        "hermite",
        np.concatenate([start, field]),
        np.concatenate([start, potential]),
        None,
    )


def _coefficients(data: MapData, values: Array, slopes: Array) -> Array:
    """Flat coefficients of values (n_coils, nx, ny, nz, c) and slopes (n_coils, nx, ny, nz, c, 3)."""
    shape = data.grid.shape
    channels = len(values) * values.shape[-1]
    by_node = np.ascontiguousarray(np.moveaxis(values, 0, 3)).reshape(*shape, channels)
    slopes_by_node = np.ascontiguousarray(np.moveaxis(slopes, 0, 3)).reshape(*shape, channels, 3)
    return nodal_coefficients(by_node, slopes_by_node, np.array(data.grid.spacing)).ravel()
