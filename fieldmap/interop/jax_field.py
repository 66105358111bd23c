"""Maps for JAX: pure functions of points and currents under jit, vmap and grad (pip install "fieldmap[jax]").

They compute the same as the C core, which tests check: `cell_field_and_gradient` for one polynomial per cell, and a
recurrence for one polynomial of the whole box.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations_with_replacement, product
from math import prod
from types import ModuleType
from typing import Any

import numpy as np

from fieldmap.core import CoreMap
from fieldmap.core import block as map_block
from fieldmap.core.harmonics import derivative_matrix
from fieldmap.errors import InputError
from fieldmap.extras import require
from fieldmap.interop.c_map import check_harmonic
from fieldmap.interpolants import Form
from fieldmap.lookup import FieldMap, MapAtCurrents, saturates, unit_block
from fieldmap.lookup.current_model import require_no_memory
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

DEGREE = 5
SIZE = (DEGREE + 1) ** 2
# Number of points in a piece of a large batch, so few that intermediate results stay in the processor's cache.
PIECE = 1024
# Largest number of Newton steps, and the shares of a step that the line search tries.
_STEPS = 60
_SHARES = (1.0, 0.6, 0.35, 0.2, 0.1, 0.03, 0.01)


def jax_field(field: FieldMap | MapAtCurrents) -> JaxField:
    """The field of an opened map as pure functions for JAX.

    The functions compute in double precision if `jax_enable_x64` is set, else in single precision.

    Parameters
    ----------
    field
        A map opened with kind="harmonic" or "global", or a map at fixed currents, `m.at(currents)`. The functions of
        the latter take no currents.

    Returns
    -------
    JaxField
        The functions.

    Raises
    ------
    FieldmapError
        If JAX is not installed.
    InputError
        For other interpolants, and for a map of iron with hysteresis.

    Examples
    --------
    >>> field = jax_field(open_map("linear.h5"))                                           # doctest: +SKIP
    >>> slope = jax.jacfwd(field)(point, currents)          # is m.gradient(point, currents)  # doctest: +SKIP
    """
    jax = require("jax", "jax", "jax_field")
    reaction = None
    if field.reaction is not None:
        reaction = _Polynomials(jax, field.reaction.core.block), field.reaction.signs
    if isinstance(field, MapAtCurrents):
        return JaxField(jax, _Polynomials(jax, unit_block(field)), None, True, reaction)
    weights: Callable[[Any], Any] | None = None
    if saturates(field):
        require_no_memory(field.remembers, "jax_field, field")
        assert field.info.reduced_model is not None
        weights = _ReducedIron(jax, field.info.reduced_model).weights
    elif not field.proportional:
        weights = _with_constant(jax)
    return JaxField(jax, _Polynomials(jax, unit_block(field)), weights, reaction=reaction)


def _with_constant(jax: ModuleType) -> Callable[[Any], Any]:
    """Weights (coils + 1,) from currents (coils,); the weight of the field that no current drives is 1."""
    jnp = jax.numpy
    return lambda currents: jnp.concatenate([currents, jnp.ones(1, currents.dtype)])


class JaxField:
    """Field of a map, its derivatives, and the wrench on dipoles, from `jax_field`. A call evaluates `field`.

    Points (..., 3), m; currents (n_coils,) for all points, or (..., n_coils) with the leading axes of the points, A.
    Results have the leading axes of the points. They are NaN for arguments that are not finite and outside the box. A
    map opened with outside="clamp" has the field of the nearest point of the box outside. No errors are raised,
    because compiled code cannot raise them. Saturating iron is solved in every call, without a check of its domain.
    """

    def __init__(
        self,
        jax: ModuleType,
        polynomials: _Polynomials,
        weights: Callable[[Any], Any] | None,
        fixed: bool = False,
        reaction: tuple[_Polynomials, Array] | None = None,
    ) -> None:
        self._jax, self._jnp, self._reaction = jax, jax.numpy, reaction
        self._polynomials, self._weights_of, self._fixed = polynomials, weights, fixed

    def __call__(self, points: Any, currents: Any = None) -> Any:
        """`field`."""
        return self.field(points, currents)

    def field(self, points: Any, currents: Any = None) -> Any:
        """Flux density.

        Parameters
        ----------
        points
            Positions (..., 3), m.
        currents
            Currents (n_coils,), A; None for a field at fixed currents.

        Returns
        -------
        Any
            B (..., 3), T.
        """
        return self.field_and_gradient(points, currents)[0]

    def gradient(self, points: Any, currents: Any = None) -> Any:
        """Gradient of the flux density.

        Parameters
        ----------
        points
            Positions (..., 3), m.
        currents
            As for `field`.

        Returns
        -------
        Any
            Gradient (..., 3, 3), [..., i, j] = dB_i/dx_j, T/m.
        """
        return self.field_and_gradient(points, currents)[1]

    def field_and_gradient(self, points: Any, currents: Any = None) -> tuple[Any, Any]:
        """Flux density and its gradient in one pass.

        Parameters
        ----------
        points
            Positions (..., 3), m.
        currents
            As for `field`.

        Returns
        -------
        tuple[Any, Any]
            B (..., 3), T, and gradient (..., 3, 3), T/m.
        """
        flux, slope = self._in_pieces(self._polynomials.field_and_gradient, points, currents)
        return flux, slope

    def second_gradient(self, points: Any, currents: Any = None) -> Any:
        """Second derivatives of the flux density.

        Parameters
        ----------
        points
            Positions (..., 3), m.
        currents
            As for `field`.

        Returns
        -------
        Any
            Second derivatives (..., 3, 3, 3), [..., i, j, k] = d2B_i/dx_j dx_k, T/m^2.
        """
        return self._in_pieces(self._polynomials.second_gradient, points, currents)

    def wrench(self, positions: Any, moments: Any, currents: Any = None) -> Any:
        """Force and torque on point dipoles, each with the reaction of the iron to it, if the map has one.

        Parameters
        ----------
        positions
            Positions of the dipoles (..., 3), m.
        moments
            Moments (3,) or (..., 3), A m^2.
        currents
            As for `field`.

        Returns
        -------
        Any
            Force, N, then torque, N m (..., 6).
        """
        jnp = self._jnp
        flux, slope = self.field_and_gradient(positions, currents)
        moment = jnp.broadcast_to(jnp.asarray(moments, flux.dtype), flux.shape)
        if self._reaction is not None:
            back = self._own_reaction(jnp.asarray(positions, flux.dtype), moment)
            flux, slope = flux + back[0], slope + back[1]
        force = jnp.einsum("...ij,...i->...j", slope, moment)
        return jnp.concatenate([force, jnp.cross(moment, flux)], axis=-1)

    def _own_reaction(self, positions: Any, moments: Any) -> tuple[Any, Any]:
        """Flux density and gradient of the reaction to each dipole at its place: docs/theory/reaction.md (1), (2)."""
        assert self._reaction is not None
        jnp, (polynomials, signs) = self._jnp, self._reaction
        sets = polynomials.coefficients()

        def one(weights: Any) -> tuple[Any, Any]:
            flux, slope = polynomials.field_and_gradient(sets, positions, weights)
            return flux, slope

        fields, gradients = self._jax.vmap(one)(jnp.eye(len(signs), dtype=positions.dtype))
        weights = jnp.einsum("k,k...i,...i->k...", signs.astype(positions.dtype), fields, moments)
        return jnp.einsum("k...,k...i->...i", weights, fields), jnp.einsum(
            "k...,k...ij->...ij", weights, gradients
        )

    def _weights(self, currents: Any) -> Any:
        jnp = self._jnp
        if (currents is None) != self._fixed:
            must = "must be left out at fixed currents, and given otherwise"
            received = "none" if currents is None else "currents"
            raise InputError.of("currents", must, received, "jax_field(m), or jax_field(m.at(currents))")
        if currents is None:
            return jnp.ones(1)
        given = jnp.asarray(currents, jnp.result_type(float))
        if self._weights_of is None:
            return given
        return jnp.vectorize(self._weights_of, signature="(c)->(w)")(given)

    def _in_pieces(self, evaluate: Callable[..., Any], points: Any, currents: Any) -> Any:
        """Call evaluate(coefficients, points, weights), piece by piece for many points."""
        jnp, sets = self._jnp, self._polynomials.coefficients()
        where, weights = jnp.asarray(points, jnp.result_type(float)), self._weights(currents)
        if weights.ndim == 1 and prod(where.shape[:-1]) > len(sets) // 4:
            # For many points at the same currents the coils are summed first.
            sets, weights = jnp.einsum("s,psk->pk", weights, sets)[:, None], jnp.ones(1, sets.dtype)
        if where.ndim != 2 or len(where) <= 2 * PIECE:
            return evaluate(sets, where, weights)
        if weights.ndim == 1:
            return self._jax.lax.map(lambda p: evaluate(sets, p, weights), where, batch_size=PIECE)
        return self._jax.lax.map(lambda pw: evaluate(sets, *pw), (where, weights), batch_size=PIECE)


def cell_field_and_gradient(c: Any, x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """Bx, By, Bz, Gxx, Gxy, Gxz, Gyy, Gyz, Gzz: first and second derivatives of the polynomial c (36,), written out.

    It only adds and multiplies, so it works with arrays of JAX and of numpy.

    The five independent second derivatives of the polynomial are harmonic polynomials of degree 3 (16 terms each);
    their coefficients are differences of neighbours on the ladder of harmonics. The field follows from them by Euler's
    theorem on homogeneous functions, degree by degree (docs/theory/lookup.md (6)):

        B(x) = B(0) + sum_l [second derivatives of degree l at x] x / (l + 1)
    """
    # Harmonics of degree 1 to 3: p for the real, q for the imaginary parts.
    rho2 = x * x + y * y
    r2 = rho2 + z * z
    p11, q11 = 0.5 * x, 0.5 * y
    p20 = 0.5 * z * z - 0.25 * rho2
    p21, q21 = z * p11, z * q11
    p22, q22 = 0.25 * (p11 * x - q11 * y), 0.25 * (p11 * y + q11 * x)
    p30 = z * (5.0 * p20 - r2) * (1.0 / 9.0)
    p31, q31 = 0.125 * (5.0 * z * p21 - r2 * p11), 0.125 * (5.0 * z * q21 - r2 * q11)
    p32, q32 = z * p22, z * q22
    p33, q33 = (1.0 / 6.0) * (p22 * x - q22 * y), (1.0 / 6.0) * (p22 * y + q22 * x)

    # Of every degree: zz, 2 xz, 2 yz, 2 (xx - yy), 4 xy. Euler's sums hold the same over degree + 1.
    zz, xz, yz, dd, xy = c[4], c[5], c[6], c[7], c[8]
    ezz, exz, eyz, edd, exy = zz, xz, yz, dd, xy

    a0, a1, b1, a2, b2, a3, b3 = c[9], c[10], c[11], c[12], c[13], c[14], c[15]
    s = a0 * z + a1 * p11 + b1 * q11
    zz = zz + s
    ezz = ezz + 0.5 * s
    s = a1 * z + (a2 - 2.0 * a0) * p11 + b2 * q11
    xz = xz + s
    exz = exz + 0.5 * s
    s = b1 * z + b2 * p11 - (a2 + 2.0 * a0) * q11
    yz = yz + s
    eyz = eyz + 0.5 * s
    s = a2 * z + (a3 - a1) * p11 + (b3 + b1) * q11
    dd = dd + s
    edd = edd + 0.5 * s
    s = b2 * z + (b3 - b1) * p11 - (a3 + a1) * q11
    xy = xy + s
    exy = exy + 0.5 * s

    third = 1.0 / 3.0
    a0, a1, b1, a2, b2, a3, b3, a4, b4 = c[16], c[17], c[18], c[19], c[20], c[21], c[22], c[23], c[24]
    s = a0 * p20 + a1 * p21 + b1 * q21 + a2 * p22 + b2 * q22
    zz = zz + s
    ezz = ezz + third * s
    s = a1 * p20 + (a2 - 2.0 * a0) * p21 + b2 * q21 + (a3 - a1) * p22 + (b3 - b1) * q22
    xz = xz + s
    exz = exz + third * s
    s = b1 * p20 + b2 * p21 - (a2 + 2.0 * a0) * q21 + (b3 + b1) * p22 - (a3 + a1) * q22
    yz = yz + s
    eyz = eyz + third * s
    s = a2 * p20 + (a3 - a1) * p21 + (b3 + b1) * q21 + (a4 + 2.0 * a0) * p22 + b4 * q22
    dd = dd + s
    edd = edd + third * s
    s = b2 * p20 + (b3 - b1) * p21 - (a3 + a1) * q21 + b4 * p22 - (a4 - 2.0 * a0) * q22
    xy = xy + s
    exy = exy + third * s

    a0, a1, b1, a2, b2, a3, b3, a4, b4 = c[25], c[26], c[27], c[28], c[29], c[30], c[31], c[32], c[33]
    a5, b5 = c[34], c[35]
    s = a0 * p30 + a1 * p31 + b1 * q31 + a2 * p32 + b2 * q32 + a3 * p33 + b3 * q33
    zz = zz + s
    ezz = ezz + 0.25 * s
    s = a1 * p30 + (a2 - 2.0 * a0) * p31 + b2 * q31 + (a3 - a1) * p32 + (b3 - b1) * q32
    s += (a4 - a2) * p33 + (b4 - b2) * q33
    xz = xz + s
    exz = exz + 0.25 * s
    s = b1 * p30 + b2 * p31 - (a2 + 2.0 * a0) * q31 + (b3 + b1) * p32 - (a3 + a1) * q32
    s += (b4 + b2) * p33 - (a4 + a2) * q33
    yz = yz + s
    eyz = eyz + 0.25 * s
    s = a2 * p30 + (a3 - a1) * p31 + (b3 + b1) * q31 + (a4 + 2.0 * a0) * p32 + b4 * q32
    s += (a5 + a1) * p33 + (b5 + b1) * q33
    dd = dd + s
    edd = edd + 0.25 * s
    s = b2 * p30 + (b3 - b1) * p31 - (a3 + a1) * q31 + b4 * p32 - (a4 - 2.0 * a0) * q32
    s += (b5 - b1) * p33 - (a5 - a1) * q33
    xy = xy + s
    exy = exy + 0.25 * s

    xz, yz, xy = 0.5 * xz, 0.5 * yz, 0.25 * xy
    exz, eyz, exy = 0.5 * exz, 0.5 * eyz, 0.25 * exy
    xx, exx = 0.25 * dd - 0.5 * zz, 0.25 * edd - 0.5 * ezz
    yy, eyy = -zz - xx, -ezz - exx
    bx = 0.5 * c[2] + exx * x + exy * y + exz * z
    by = 0.5 * c[3] + exy * x + eyy * y + eyz * z
    bz = c[1] + exz * x + eyz * y + ezz * z
    return bx, by, bz, xx, xy, xz, yy, yz, zz


class _Polynomials:
    """A block of harmonic polynomials (`fieldmap.core.block`), evaluated by JAX."""

    def __init__(self, jax: ModuleType, block: Array) -> None:
        check_harmonic(block, "jax_field(field)")
        self._jax, self._jnp = jax, jax.numpy
        header = block[: map_block.HEADER]
        self.degree, self._clamps = int(header[map_block.DEGREE]), header[map_block.RULE] == map_block.CLAMP
        self._lower = header[map_block.LOWER : map_block.LOWER + 3]
        self._inverse = header[map_block.INVERSE : map_block.INVERSE + 3]
        self._cells = header[map_block.CELLS : map_block.CELLS + 3]
        self._local = header[map_block.LOCAL : map_block.LOCAL + 3]
        self._per_length = float(header[map_block.PER_LENGTH])
        self.length = float(header[map_block.LENGTH])
        shape = (int(np.prod(self._cells)), int(header[map_block.SETS]), -1)
        self._sets = block[map_block.HEADER :].reshape(shape)
        self._converted: dict[str, Any] = {}

    def coefficients(self) -> Any:
        """Coefficients (places, sets, size) in the precision of JAX."""
        kind = self._jnp.result_type(float)
        if kind.name not in self._converted:
            # The constant must not belong to the function that is being traced.
            with self._jax.ensure_compile_time_eval():
                self._converted[kind.name] = self._jnp.asarray(self._sets, kind)
        return self._converted[kind.name]

    def field_and_gradient(self, sets: Any, points: Any, weights: Any) -> tuple[Any, Any]:
        """B (..., 3) and gradient (..., 3, 3) of the polynomials `sets`, summed with weights (..., s)."""
        jnp = self._jnp
        good, cell, local = self._locate(points)
        c = self._superposed(sets, cell, weights)
        if self.degree == DEGREE:
            x, y, z = (local[..., axis] for axis in range(3))
            bx, by, bz, xx, xy, xz, yy, yz, zz = cell_field_and_gradient(jnp.moveaxis(c, -1, 0), x, y, z)
        else:
            bx, by, bz = jnp.moveaxis(self._derivatives(c, local, 1), -1, 0)
            xx, xy, xz, yy, yz, zz = jnp.moveaxis(self._derivatives(c, local, 2), -1, 0)
        # Multiplication by NaN makes the derivatives NaN, too.
        outside = jnp.where(good, 1.0, jnp.nan)[..., None]
        flux = jnp.stack([bx, by, bz], axis=-1) * outside
        slope = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1) * (self._per_length * outside)
        return flux, slope.reshape(*slope.shape[:-1], 3, 3)

    def second_gradient(self, sets: Any, points: Any, weights: Any) -> Any:
        """Second gradient (..., 3, 3, 3)."""
        good, cell, local = self._locate(points)
        third = self._derivatives(self._superposed(sets, cell, weights), local, 3)
        order = {axes: k for k, axes in enumerate(_axes(3))}
        every = [order[tuple(sorted(axes))] for axes in product(range(3), repeat=3)]
        scale = self._jnp.where(good, self._per_length**2, self._jnp.nan)[..., None]
        second = third[..., np.array(every)] * scale
        return second.reshape(*second.shape[:-1], 3, 3, 3)

    def potential(self, sets: Any, points: Any, weights: Any) -> Any:
        """Potential U (...,), T m, where B = -grad U."""
        good, cell, local = self._locate(points)
        value = self._derivatives(self._superposed(sets, cell, weights), local, 0)[..., 0]
        return value * self._jnp.where(good, -self.length, self._jnp.nan)

    def _superposed(self, sets: Any, cell: Any, weights: Any) -> Any:
        """Coefficients (..., size)."""
        # A single place is not copied for every point.
        return self._jnp.einsum("...s,...sk->...k", weights, sets[0] if len(sets) == 1 else sets[cell])

    def _locate(self, points: Any) -> tuple[Any, Any, Any]:
        """Whether there is a result, number of the cell, and position from its middle in units of LENGTH."""
        jnp, cells = self._jnp, self._cells
        # Rounding of upper = lower + n spacing in the precision of JAX.
        edge = max(map_block.EDGE, 8.0 * float(jnp.finfo(points.dtype).eps) * float(cells.max()))
        u = (points - self._lower) * self._inverse
        good = jnp.isfinite(points).all(-1)
        if self._clamps:
            u = jnp.where(u < 0.0, 0.0, jnp.where(u > cells, cells, u))
        else:
            good &= ((u >= -edge) & (u <= cells + edge)).all(-1)
        u = jnp.where(good[..., None], u, 0.5)
        index = jnp.clip(jnp.floor(self._jax.lax.stop_gradient(u)), 0.0, cells - 1.0)
        i, j, k = (index[..., axis].astype(int) for axis in range(3))
        cell = (i * int(cells[1]) + j) * int(cells[2]) + k
        return good, cell, (u - index - 0.5) * self._local

    def outside(self, points: Array) -> int:
        """Number of points (n, 3) outside a box that does not clamp."""
        if self._clamps:
            return 0
        with np.errstate(invalid="ignore"):
            u = (points - self._lower) * self._inverse
            beyond = ((u < -map_block.EDGE) | (u > self._cells + map_block.EDGE)).any(axis=1)
        return int((beyond & np.isfinite(points).all(axis=1)).sum())

    def _derivatives(self, c: Any, local: Any, order: int) -> Any:
        """All distinct derivatives of an order (..., n), in the order of `_axes`."""
        table = self._harmonics(self.degree - order, local)
        matrices = np.stack([_derivative(self.degree, axes) for axes in _axes(order)])
        # Most calls have the same c at all points, so it is multiplied first.
        return self._jnp.einsum("...h,...nh->...n", table, self._jnp.einsum("nhk,...k->...nh", matrices, c))

    def _harmonics(self, degree: int, local: Any) -> Any:
        """Harmonics (..., (degree + 1)^2), each degree from the two below it: docs/theory/lookup.md (3)."""
        jnp, join = self._jnp, self._jnp.concatenate
        x, y, z = (local[..., axis, None] for axis in range(3))
        r2, sector = x * x + y * y + z * z, (jnp.ones_like(x), jnp.zeros_like(x))
        rows = [jnp.zeros_like(x[..., :0]), jnp.ones_like(x)]
        for l in range(1, degree + 1):
            m = (np.arange(2 * l - 1) + 1) // 2
            up, down = (2 * l - 1) / (l * l - m * m), 1.0 / (l * l - m * m)
            inner = up * z * rows[-1]
            below = rows[-2].shape[-1]
            inner = join([inner[..., :below] - down[:below] * r2 * rows[-2], inner[..., below:]], axis=-1)
            sector = (
                (0.5 / l) * (x * sector[0] - y * sector[1]),
                (0.5 / l) * (x * sector[1] + y * sector[0]),
            )
            # Without the barrier the compiler would compute each degree again at every use.
            rows.append(self._jax.lax.optimization_barrier(join([inner, *sector], axis=-1)))
        return join(rows[1:], axis=-1)


def _axes(order: int) -> list[tuple[int, ...]]:
    """Axes of all distinct derivatives: xx, xy, xz, yy, yz, zz for order 2."""
    return list(combinations_with_replacement(range(3), order))


@cache
def _derivative(degree: int, axes: tuple[int, ...]) -> Array:
    """Matrix from coefficients of a polynomial of this degree to coefficients of a derivative."""
    matrix = np.eye((degree + 1) ** 2)
    for n, axis in enumerate(axes):
        matrix = derivative_matrix(degree - n, axis) @ matrix
    return matrix


class _ReducedIron:
    """The model of a map of saturating iron (`fieldmap.store.ReducedModel`): weights of its fields from currents.

    Newton's method solves the equations of docs/theory/current_dependence.md to rounding. The implicit function
    theorem gives the derivatives with respect to the currents.
    """

    def __init__(self, jax: ModuleType, model: ReducedModel) -> None:
        self._jax, self._jnp, self._model = jax, jax.numpy, model
        self._range = np.maximum(np.ptp(model.known_currents, axis=0), 1e-12)

    def weights(self, currents: Any) -> Any:
        """Weights (coils + fields,): the currents (coils,), those of the iron's fields, and 1 for a background, if
        any."""
        lax, jnp, model = self._jax.lax, self._jnp, self._model
        distances = (((currents - model.known_currents) / self._range) ** 2).sum(axis=1)
        nearest = lax.stop_gradient(jnp.asarray(model.known_amplitudes, currents.dtype)[distances.argmin()])
        source = (model.source @ currents + (model.fixed if model.fixed.size else 0.0)).reshape(-1, 3)

        def solve_linear(of: Callable[[Any], Any], right: Any) -> Any:
            return jnp.linalg.solve(self._jax.jacfwd(of)(jnp.zeros_like(right)), right)

        amplitudes = lax.custom_root(
            lambda a: self._residual(a, source)[0],
            nearest,
            lambda _, a: self._newton(a, source),
            solve_linear,
        )
        constant = jnp.ones(int(model.fixed.size > 0), currents.dtype)
        return jnp.concatenate([currents, model.output @ amplitudes, constant])

    def _residual(self, a: Any, source: Any) -> tuple[Any, Any, Any, Any]:
        """Residual R (r,); for the tangent: w m (p,), w (db/dh - b/h) / h^2 (p,) and h (p, 3)."""
        jnp, model = self._jnp, self._model
        h = source - (model.gradients @ a).reshape(-1, 3)
        # The size is never zero, because the root has no derivative there.
        size = jnp.sqrt((h * h).sum(axis=1) + 1e-28)
        b, slope = self._law(size)
        m = model.weights * (b / size - 1.0)
        along = model.weights * (slope - b / size) / (size * size)
        residual = model.gradients.T @ (m[:, None] * h).ravel() + model.constant - model.air @ a
        return residual, m, along, h

    def _law(self, size: Any) -> tuple[Any, Any]:
        """Flux density b and db/dh (p,)."""
        jnp, model = self._jnp, self._model
        offset, knots, coefficients = model.laws
        b, slope = jnp.zeros_like(size), jnp.zeros_like(size)
        for k in range(len(offset) - 1):
            own, rows = knots[offset[k] : offset[k + 1]], coefficients[offset[k] : offset[k + 1]].copy()
            # Beyond the last knot b is linear.
            rows[-1, :2] = 0.0
            piece = jnp.searchsorted(own, size, side="right") - 1
            c, t = jnp.asarray(rows, size.dtype)[piece], size - jnp.asarray(own, size.dtype)[piece]
            here = model.law == k
            b = jnp.where(here, ((c[:, 0] * t + c[:, 1]) * t + c[:, 2]) * t + c[:, 3], b)
            slope = jnp.where(here, (3.0 * c[:, 0] * t + 2.0 * c[:, 1]) * t + c[:, 2], slope)
        return b, slope

    def _newton(self, start: Any, source: Any) -> Any:
        """Amplitudes (r,) by Newton's method on a convex functional; the slope along a step sets its length."""
        lax, jnp, model = self._jax.lax, self._jnp, self._model
        gradients = jnp.asarray(model.gradients, start.dtype)
        shares, tolerance = jnp.asarray(_SHARES, start.dtype), float(jnp.finfo(start.dtype).eps) ** 0.5

        def goes_on(state: tuple[Any, Any, Any]) -> Any:
            return (state[0] < _STEPS) & (state[1] > tolerance)

        def step(state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
            count, _, a = state
            residual, m, along, h = self._residual(a, source)
            radial = jnp.einsum("pi,pir->pr", h, gradients.reshape(*h.shape, -1))
            tangent = model.air + gradients.T @ (jnp.repeat(m, 3)[:, None] * gradients)
            tangent += radial.T @ (along[:, None] * radial)
            change = jnp.linalg.solve(tangent, residual)
            slope = residual @ change
            ahead = self._jax.vmap(lambda t: self._residual(a + t * change, source)[0] @ change)(shares)
            t = shares[(ahead >= -0.3 * slope).argmax()]
            decrement = jnp.sqrt(jnp.maximum(slope, 0.0) / jnp.maximum(a @ tangent @ a, 1e-30))
            return count + 1, decrement, a + t * change

        first = jnp.zeros((), int), jnp.full((), jnp.inf, start.dtype), start
        _, left, found = lax.while_loop(goes_on, step, first)
        return jnp.where(left <= tolerance, found, jnp.nan)


class JaxEvaluator:
    """Evaluation of a map by JAX in double precision instead of the C core: a `fieldmap.lookup.Evaluator`.

    With `interpolate(data, evaluator=JaxEvaluator)` lookups run on an accelerator that JAX finds. Numbers of points
    are rounded up to a power of two, so that few shapes are compiled.
    """

    def __init__(self, form: Form, weights: Array | None = None) -> None:
        self._jax = jax = require("jax", "jax", "JaxEvaluator")
        self._form, self._fixed = form, weights
        self._polynomials = _Polynomials(jax, form.unit)
        self.places = 1 if weights is not None else form.places
        names = ("field_and_gradient", "second_gradient", "potential")
        self._compiled = {name: jax.jit(getattr(self._polynomials, name)) for name in names}
        each = jax.vmap(self._polynomials.field_and_gradient, (None, None, 0), 1)
        self._compiled["each_field"] = jax.jit(lambda sets, x: each(sets, x, np.eye(sets.shape[1])))

    def _ask(self, name: str, points: Array, weights: Array) -> tuple[list[Array], int]:
        """Results, and the number of points outside."""
        with self._jax.enable_x64(True):
            n = len(points)
            size = 1 << max(n - 1, 0).bit_length()
            padded = np.full((size, 3), np.nan)
            padded[:n] = points
            given = [self._polynomials.coefficients(), padded]
            if name != "each_field":
                rows = weights if self._fixed is None else self._fixed[None]
                every = np.zeros((size, rows.shape[1]))
                every[:n] = rows
                given.append(every)
            found = self._compiled[name](*given)
            parts = found if isinstance(found, tuple | list) else (found,)
            results = [np.asarray(part)[:n] for part in parts]
        return results, self._polynomials.outside(points)

    def field_and_gradient(self, points: Array, weights: Array, flux: Array, slope: Array) -> int:
        """See `fieldmap.lookup.Evaluator.field_and_gradient`.

        Parameters
        ----------
        points, weights, flux, slope
            As there.

        Returns
        -------
        int
            Number of points outside the box.
        """
        (flux[:], whole), outside = self._ask("field_and_gradient", points, weights)
        if slope.size:
            slope[:] = whole
        return outside

    def second_gradient(self, points: Array, weights: Array, second: Array) -> int:
        """See `fieldmap.lookup.Evaluator.second_gradient`.

        Parameters
        ----------
        points, weights, second
            As there.

        Returns
        -------
        int
            Number of points outside the box.
        """
        (second[:],), outside = self._ask("second_gradient", points, weights)
        return outside

    def potential(self, points: Array, weights: Array, values: Array) -> int:
        """See `fieldmap.lookup.Evaluator.potential`.

        Parameters
        ----------
        points, weights, values
            As there.

        Returns
        -------
        int
            Number of points outside the box.
        """
        (values[:],), outside = self._ask("potential", points, weights)
        return outside

    def each_field(self, points: Array, flux: Array, slope: Array) -> int:
        """See `fieldmap.lookup.Evaluator.each_field`.

        Parameters
        ----------
        points, flux, slope
            As there.

        Returns
        -------
        int
            Number of points outside the box.
        """
        if self._fixed is not None:
            return self.field_and_gradient(points, np.ones((1, 1)), flux[:, 0], slope[:, 0])
        (flux[:], whole), outside = self._ask("each_field", points, np.ones(1))
        if slope.size:
            slope[:] = whole
        return outside

    def at(self, weights: Array) -> JaxEvaluator:
        """See `fieldmap.lookup.Evaluator.at`.

        Parameters
        ----------
        weights
            As there.

        Returns
        -------
        JaxEvaluator
            The evaluator of one field.
        """
        return self if self._fixed is not None else JaxEvaluator(self._form, np.array(weights))

    def field_at(self, point: Any, weights: Any) -> tuple[Array, Array] | None:
        """See `fieldmap.lookup.Evaluator.field_at`: there is no faster way.

        Parameters
        ----------
        point, weights
            As there.

        Returns
        -------
        tuple[Array, Array] | None
            None.
        """
        return None

    def dipole_wrench_at(self, point: Any, moment: Any, weights: Any) -> Array | None:
        """See `fieldmap.lookup.Evaluator.dipole_wrench_at`: there is no faster way.

        Parameters
        ----------
        point, moment, weights
            As there.

        Returns
        -------
        Array | None
            None.
        """
        return None

    def core(self) -> CoreMap:
        """See `fieldmap.lookup.Evaluator`: raises InputError."""
        raise InputError.of("compiled", "must be a map of the C core", "one of JAX", "open it without")
