"""A field at given currents: contracted once, evaluated as often as you like."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.field import dipole_wrench
from fieldmap.kernels.map import lookup as kernels
from fieldmap.lookup.compiled import closed_to_new_types
from fieldmap.lookup.doors import Box, field_and_gradient, result_array, with_currents
from fieldmap.typing import Array

_ONE = np.ones((1, 1))
_empty = np.empty


class FieldAtCurrents:
    """Evaluates one contracted block, whoever made it (`FieldMap.at` does). Points, shapes and what happens
    outside are as for `FieldMap`; there is no argument `currents`.
    """

    def __init__(self, block: Array, potential_block: Array, box: Box) -> None:
        self._block = block
        self._potential_block = potential_block
        self._box = box
        self._one = closed_to_new_types(
            kernels.evaluate_one, block, np.zeros(3), np.empty(3), np.empty((3, 3))
        )

    @property
    def lower(self) -> Array:
        """Lower corner of the box in which the field holds, m."""
        return self._box.lower

    @property
    def upper(self) -> Array:
        """Upper corner of the box in which the field holds, m."""
        return self._box.upper

    def field(self, points: ArrayLike, out: Array | None = None) -> Array:
        """Flux density B (n, 3), T."""
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points)[0]
        where, single = checked_vectors("points", points)
        flux = result_array(None if single else out, where.shape)
        field_and_gradient(self._block, None, where, flux, np.empty((len(where), 0, 0)), self._box)
        return single_row(flux, out) if single else flux

    def gradient(self, points: ArrayLike, out: Array | None = None) -> Array:
        """Gradient G (n, 3, 3), G[:, i, j] = dB_i/dx_j, T/m: the exact derivative of `field`."""
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points)[1]
        where, single = checked_vectors("points", points)
        slope = result_array(None if single else out, (*where.shape, 3))
        field_and_gradient(self._block, None, where, np.empty(where.shape), slope, self._box)
        return single_row(slope, out) if single else slope

    def field_and_gradient(
        self, points: ArrayLike, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """B (n, 3) in T and G (n, 3, 3) in T/m in one pass."""
        try:
            if points.ndim == 1:  # type: ignore[union-attr]
                flux, slope = (_empty(3), _empty((3, 3))) if out is None else out
                if self._one(self._block, points, flux, slope) == 0:
                    return flux, slope
        except (TypeError, AttributeError, ValueError):
            pass  # a list, not float64, not contiguous, no pair: what follows sorts it out
        where, single = checked_vectors("points", points)
        given = (None, None) if out is None else out
        flux = result_array(None if single else given[0], where.shape)
        slope = result_array(None if single else given[1], (*where.shape, 3))
        field_and_gradient(self._block, None, where, flux, slope, self._box)
        return (single_row(flux, given[0]), single_row(slope, given[1])) if single else (flux, slope)

    def second_gradient(self, points: ArrayLike) -> Array:
        """Second derivatives (n, 3, 3, 3), [:, i, j, k] = d2B_i/dx_j dx_k, T/m^2."""
        where, single = checked_vectors("points", points)
        second = np.empty((len(where), 3, 3, 3))
        with_currents(kernels.second_gradient, self._block, _ONE, where, second, self._box)
        return second[0] if single else second

    def potential(self, points: ArrayLike) -> Array | float:
        """Scalar potential U (n,) in T m, B = -grad U."""
        where, single = checked_vectors("points", points)
        values = np.empty(len(where))
        with_currents(kernels.potential, self._potential_block, _ONE, where, values, self._box)
        return float(values[0]) if single else values

    def wrench(self, positions: ArrayLike, moments: ArrayLike) -> Array:
        """Force (N) and torque (N m) on point dipoles, (n, 6), about their own positions."""
        where, single = checked_vectors("positions", positions)
        flux, slope = self.field_and_gradient(where)
        result = dipole_wrench(flux, slope, moments)
        return result[0] if single else result

    def compiled(self) -> tuple[Any, Array]:
        """(function, data) for numba functions: see `FieldMap.compiled`."""
        return kernels.at, self._block

    def __getstate__(self) -> dict[str, object]:
        return {"block": self._block, "potential_block": self._potential_block, "box": self._box}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]


def single_row(result: Array, out: Array | None) -> Array:
    """The only row of a result, written to `out` if there is one."""
    if out is None:
        return result[0]
    checked = result_array(out, result.shape[1:])
    checked[...] = result[0]
    return checked
