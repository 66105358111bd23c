"""Lookups by compiled callers in a block whose last set is a field that no current drives: its weight is 1."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.copy_vector import copy_vector


@cache
def with_constant(at_currents: Callable[..., Any]) -> Callable[..., Any]:
    """`at_currents`(data, weights, x, y, z), such as `fieldmap.kernels.map.lookup.at_currents`, for the currents of the
    coils (n_coils,) in the place of the weights (n_coils + 1,) of all fields."""

    @njit
    def at(data: Any, currents: Any, x: float, y: float, z: float) -> Any:
        weights = np.empty(currents.size + 1)
        copy_vector(currents, weights[: currents.size])
        weights[currents.size] = 1.0
        return at_currents(data, weights, x, y, z)

    return at
