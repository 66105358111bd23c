"""Field, gradient and wrench at any point of a map, for any currents."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.errors import InputError, Problem
from fieldmap.kernels import hermite
from fieldmap.lookup.checks import checked_currents, checked_vectors, outside_error
from fieldmap.store import FieldError, MapData, MapInfo

Array = NDArray[np.float64]
Tails = tuple[tuple[int, ...], ...]


class FieldMap:
    """Tricubic Hermite interpolant of every coil's unit field, superposed at the currents asked for.

    One interpolant per coil and component, from the stored values and gradients: once continuously
    differentiable, error O(spacing^4) in B and O(spacing^3) in its gradient. `gradient` is the exact
    derivative of `field`; it is symmetric and trace-free to the interpolation error. Superposition is exact
    for coils with linear iron or none.

    Points (3,) or (n, 3) in m; currents (n_coils,) for all points or (n, n_coils), in A, in the order of
    `coil_names`. A point (3,) gives a result without the leading axis. Outside the box from `lower` to
    `upper`: OutsideMapError, or NaN if opened with outside="nan". NaN in a point or current gives NaN in its
    row. Arguments of another shape: InputError. Objects can be pickled and used from several threads at once.

    >>> from fieldmap.store import Grid
    >>> grid = Grid([0, 0, 0], [0.01, 0.01, 0.01], (3, 3, 3))
    >>> flux, slope = np.tile([0, 0, 1e-3], (1, 3, 3, 3, 1)), np.zeros((1, 3, 3, 3, 3, 3))
    >>> uniform = MapData(grid, ("coil",), [1.0], flux_density=flux, gradient=slope)
    >>> FieldMap(uniform).field([0.005, 0.01, 0.02], [2.0])
    array([0.   , 0.   , 0.002])
    """

    def __init__(self, data: MapData, outside: str = "raise") -> None:
        if outside not in ("raise", "nan"):
            problem = Problem(
                "lookup, outside", 'is "raise" or "nan"', repr(outside), "choose one of the two"
            )
            raise InputError(problem)
        self._info = MapInfo(**{name: getattr(data, name) for name in MapInfo.__dataclass_fields__})
        self._outside = outside
        self._lower = np.array(data.grid.lower)
        self._spacing = np.array(data.grid.spacing)
        self._unit = _unit_coefficients(data)
        # Largest number of points for which evaluating every coil is cheaper than superposing the whole grid.
        self._few = data.grid.size // 4
        self._last: tuple[bytes, Array] = (b"", np.empty(0))

    @property
    def info(self) -> MapInfo:
        """Grid, coil names, reference currents, provenance and errors of the map."""
        return self._info

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils in current order."""
        return self._info.coil_names

    @property
    def lower(self) -> Array:
        """Lower corner of the box in which the map holds, m."""
        return self._info.grid.lower

    @property
    def upper(self) -> Array:
        """Upper corner of the box in which the map holds, m."""
        return self._info.grid.upper

    @property
    def error_bound(self) -> FieldError | None:
        """Certified bound on B (T) and gradient (T/m) against the solver; None until the map is certified.

        `interpolation_error` is there without certification, but is only the largest of sampled differences.
        """
        return self._info.error_bound

    @property
    def interpolation_error(self) -> FieldError | None:
        """Largest difference to the solver found at sampled points when the map was made, or None if unknown.

        Summed over all coils, each at its reference current: T and T/m.
        """
        return self._info.interpolation_error

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Flux density B (n, 3), T."""
        (flux,), single = self._evaluate(hermite.field, ((),), points, currents)
        return flux[0] if single else flux

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Gradient G (n, 3, 3), G[:, i, j] = dB_i/dx_j, T/m: the exact derivative of `field`."""
        return self.field_and_gradient(points, currents)[1]

    def field_and_gradient(self, points: ArrayLike, currents: ArrayLike) -> tuple[Array, Array]:
        """B (n, 3) in T and G (n, 3, 3) in T/m in one pass."""
        (flux, slope), single = self._evaluate(hermite.field_and_gradient, ((), (3,)), points, currents)
        return (flux[0], slope[0]) if single else (flux, slope)

    def second_gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Second derivatives (n, 3, 3, 3), [:, i, j, k] = d2B_i/dx_j dx_k, T/m^2.

        Error O(spacing^2); discontinuous across the faces of the grid's cells.
        """
        (bend,), single = self._evaluate(hermite.second_gradient, ((3, 3),), points, currents)
        return bend[0] if single else bend

    def wrench(self, positions: ArrayLike, moments: ArrayLike, currents: ArrayLike) -> Array:
        """Force (N) and torque (N m) on point dipoles, (n, 6), about their own positions.

        T = m x B, thesis eq. (2-7), and F = grad(m . B) = (grad B)^T m, which is (m . grad) B of eq. (2-8)
        where B is curl-free, and is conservative for a fixed moment even if the interpolant is not quite so.
        moments (3,) for all positions or (n, 3), A m^2. Singular nowhere in the box.
        """
        where, single = checked_vectors("positions", positions)
        dipoles, _ = checked_vectors("moments", moments)
        if len(dipoles) not in (1, len(where)):
            received = f"{len(dipoles)} moments for {len(where)} positions"
            problem = Problem("lookup, moments", "one for all positions or one each", received, "match them")
            raise InputError(problem)
        flux, slope = self.field_and_gradient(where, currents)
        dipoles = np.broadcast_to(dipoles, where.shape)
        force = np.einsum("nij,ni->nj", slope, dipoles)
        result = np.concatenate([force, np.cross(dipoles, flux)], axis=1)
        return result[0] if single else result

    def unit_field(self, points: ArrayLike) -> Array:
        """B per ampere in each coil, (n, n_coils, 3), T/A: what an allocation of currents starts from."""
        where, single = checked_vectors("points", points)
        flux = self._interpolate(hermite.field, self._unit, where, ((),))[0]
        result = flux.reshape(len(where), len(self.coil_names), 3)
        return result[0] if single else result

    def unit_gradient(self, points: ArrayLike) -> Array:
        """Gradient per ampere in each coil, (n, n_coils, 3, 3), T/(m A)."""
        where, single = checked_vectors("points", points)
        slope = self._interpolate(hermite.field_and_gradient, self._unit, where, ((), (3,)))[1]
        result = slope.reshape(len(where), len(self.coil_names), 3, 3)
        return result[0] if single else result

    def _evaluate(
        self, kernel: Callable[..., int], tails: Tails, points: ArrayLike, currents: ArrayLike
    ) -> tuple[list[Array], bool]:
        """Results (n, 3, *tail), one per tail, and whether a single point was given.

        For many points the coefficients of the whole grid are superposed once, for few those at the point.
        The choice depends on the sizes alone: equal calls give equal bits whatever was called before.
        """
        where, single = checked_vectors("points", points)
        amperes = checked_currents(currents, self.coil_names, len(where))
        if amperes.ndim == 1 and len(where) > self._few:
            return self._interpolate(kernel, self._superposed_at(amperes), where, tails), single
        rows = amperes if amperes.ndim == 2 else amperes[None]
        by_channel = self._interpolate(kernel, self._unit, where, tails)
        return [_superposed(values, rows) for values in by_channel], single

    def _interpolate(
        self, kernel: Callable[..., int], coefficients: Array, where: Array, tails: Tails
    ) -> list[Array]:
        results = [np.empty((len(where), coefficients.shape[3], *tail)) for tail in tails]
        outside = kernel(coefficients, self._lower, self._spacing, where, *results)
        if outside and self._outside == "raise":
            raise outside_error(where, outside, self.lower, self.upper)
        return results

    def _superposed_at(self, currents: Array) -> Array:
        """Coefficients (nx, ny, nz, 3, 8) at these currents; the last ones are kept."""
        key = currents.tobytes()
        known, coefficients = self._last
        if known != key:
            coefficients = np.empty((*self._unit.shape[:3], 3, 8))
            hermite.contract(self._unit, currents, coefficients)
            # One assignment of one tuple: another thread sees the old pair or the new one, never a mixture.
            self._last = (key, coefficients)
        return coefficients

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_last": (b"", np.empty(0))}

    def __repr__(self) -> str:
        corners = ", ".join(
            f"{low * 1e3:g} to {high * 1e3:g}" for low, high in zip(self.lower, self.upper, strict=True)
        )
        return f"FieldMap({len(self.coil_names)} coils, box {corners} mm, {self._info.grid.size} nodes)"


def _superposed(values: Array, currents: Array) -> Array:
    """(n, 3, *tail): values (n, 3 n_coils, *tail) times currents (n, n_coils) or (1, n_coils), summed."""
    n, tail = len(values), values.shape[2:]
    result = np.empty((n, 3, *tail))
    size = 3 * math.prod(tail)
    hermite.superpose(values.reshape(n, currents.shape[1], size), currents, result.reshape(n, size))
    return result


def _unit_coefficients(data: MapData) -> Array:
    """Coefficients (nx, ny, nz, 3 n_coils, 8) of all coils; channel 3 c + i is component i of coil c."""
    n_coils = len(data.coil_names)
    values = np.ascontiguousarray(np.moveaxis(data.flux_density, 0, 3)).reshape(*data.grid.shape, 3 * n_coils)
    slopes = np.ascontiguousarray(np.moveaxis(data.gradient, 0, 3)).reshape(*data.grid.shape, 3 * n_coils, 3)
    return hermite.nodal_coefficients(values, slopes, np.array(data.grid.spacing))
