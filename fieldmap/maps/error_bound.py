"""Differences between lookups of a map and the solver: measured at samples, and bounded anywhere in the box.

The bound (docs/theory/lookup.md, certificate): B and gradient are harmonic in the box, of the solver and of one
polynomial P for the whole box. A sum of norms of harmonic functions is subharmonic, so the difference between solver
and P is largest on the surface of the box, and the difference between P and the polynomial of a cell on the faces of
the cell. Both are sampled at Chebyshev points. Between n x n of these a polynomial of degree d < n in each variable
stays below 1 / cos(pi d / 2 n)^2 times its largest sample (Ehlich, Zeller, Math. Z. 86 (1964) 41).
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, vstack

from fieldmap.core import CoreMap
from fieldmap.core.block import DEGREE, HEADER, LENGTH
from fieldmap.core.harmonics import derivative_matrix
from fieldmap.errors import InputError
from fieldmap.interpolants import Form, cell_form, global_form, hermite_form, set_size
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix, largest_on_sphere
from fieldmap.parallel import results_of
from fieldmap.store import FieldError, Grid, MapData
from fieldmap.typing import Array, Index

Pair = tuple[Array, Array]
RANDOM_POINTS = 200
SEED = 20240229
# Chebyshev points along the edges of the box, and assumed degree of the difference between solver and P. P has degree
# 16; the terms of the solver's field more than halve from each degree to the next.
SURFACE_POINTS, SURFACE_DEGREE = 24, 18
# Points at which the certificate evaluates the solver.
SOLVER_POINTS = 6 * SURFACE_POINTS**2
# Most numbers held at a time for the cells of a row, which limits the memory of a certificate.
_NUMBERS_AT_ONCE = 4_000_000
# Chebyshev points along the edges of a cell, and degree of B up to which they bound it: see `_BeyondFaces`.
FACE_POINTS, FACE_DEGREE = 12, 8
_SYMMETRIC = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))

UnitFields: TypeAlias = Callable[[Array], Pair]
"""Flux density (n_fields, n, 3) and gradient (n_fields, n, 3, 3) at points (n, 3), per ampere or at weight 1."""


def sample_points(grid: Grid) -> Array:
    """Points (n, 3): random ones all over the box, and the centres of cells at its corners, edges and faces.

    An interpolant is worst at cell centres, and a method that treats its boundary badly is worst in the outer
    cells. The random points are the same on every run.
    """
    random = grid.lower + np.random.default_rng(SEED).random((RANDOM_POINTS, 3)) * (grid.upper - grid.lower)
    cells = [(0, (n - 1) // 2, n - 2) for n in grid.shape]
    middle = tuple(index[1] for index in cells)
    outer = [cell for cell in itertools.product(*cells) if cell != middle]
    centres = grid.lower + (np.array(outer) + 0.5) * grid.spacing
    return np.concatenate([random, centres])


def interpolation_error(data: MapData, unit_fields: UnitFields) -> FieldError:
    """Largest difference between the Hermite form and the solver over the sample points.

    The norms of the fields' differences are summed, each times the scale of its field (for a coil the reference
    current). The sum holds at the sampled points for all currents up to these, of either sign. It is no bound.
    """
    points = sample_points(data.grid)
    form = hermite_form(data, "raise")
    return FieldError(*map(float, difference_to_solver(form, data.field_scale, points, unit_fields)))


def difference_to_solver(form: Form, scale: Array, points: Array, unit_fields: UnitFields) -> Array:
    """Largest difference (2,) at points (n, 3), B in T and gradient in T/m: the norms of the differences of the fields
    are summed, each times its scale."""
    return _largest(_by_field(form, points), zip(*unit_fields(points), strict=True), scale)


def _by_field(form: Form, points: Array) -> Iterator[tuple[Array, Array]]:
    """Flux density (n, 3) and gradient (n, 3, 3) of each field in turn, at weight 1."""
    core = CoreMap(form.unit)
    for one in np.eye(form.n_coils):
        flux, slope = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
        core.fields(points, one[None], flux, slope)
        yield flux, slope


def _largest(ours: Iterable[Pair], theirs: Iterable[Pair], scale: Array) -> Array:
    total: list[Array | float] = [0.0, 0.0]
    # At a point on an edge or a wire the error is infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        for factor, (flux, slope), (exact, exact_slope) in zip(scale, ours, theirs, strict=True):
            total[0] = total[0] + factor * np.linalg.norm(flux - exact, axis=1)
            total[1] = total[1] + factor * np.linalg.norm(slope - exact_slope, axis=(1, 2))
    return np.array([np.max(part) for part in total])


def certified_bounds(data: MapData, unit_fields: UnitFields, scale: Array) -> Mapping[str, FieldError]:
    """Bounds by kind of lookup: see `bounds_of_forms`. Empty if no single polynomial fits the whole box."""
    try:
        whole = global_form(data, "raise")
    except InputError:
        return {}
    return bounds_of_forms(cell_form(data, "raise"), whole, data.grid, unit_fields, scale)


def bounds_of_forms(
    cells: Form, whole: Form, grid: Grid, unit_fields: UnitFields, scale: Array
) -> Mapping[str, FieldError]:
    """Bounds by kind of lookup, "harmonic" and "global": T and T/m, summed over the fields times their scale.

    They hold at all points of the box for weights of the fields up to `scale` (n_fields,) in magnitude: the reference
    currents, or for saturating iron the largest weights in the domain of the currents. grid: the grid of `cells`.
    """
    surface = box_surface(grid, SURFACE_POINTS)
    outer = between_samples(SURFACE_POINTS, SURFACE_DEGREE) * difference_to_solver(
        whole, scale, surface, unit_fields
    )
    inner = difference_of_polynomials(cells, whole, grid, scale)
    return {"harmonic": FieldError(*map(float, outer + inner)), "global": FieldError(*map(float, outer))}


def difference_of_polynomials(cells: Form, whole: Form, grid: Grid, scale: Array) -> Array:
    """Bounds (2,) on the difference in B and gradient between the polynomials of cells and of the whole box."""
    unit, count = float(cells.unit[LENGTH]), whole.n_coils
    degree = max(int(form.unit[DEGREE]) for form in (cells, whole))
    polynomial = np.zeros(((degree + 1) ** 2, count))
    polynomial[: set_size(whole.unit)] = whole.unit[HEADER:].reshape(count, -1).T
    # Coefficients in the cells' unit of length. B is the derivative of the potential by the local coordinates.
    polynomial *= ((unit / float(whole.unit[LENGTH])) ** (_degrees(degree) - 1.0))[:, None]
    centres = [
        (np.arange(n - 1) - (n - 2) / 2) * h / unit for n, h in zip(grid.shape, grid.spacing, strict=True)
    ]
    shape = tuple(len(axis) for axis in centres)
    ours = cells.unit[HEADER:].reshape(*shape, count, -1)
    size = np.array(grid.spacing) / unit
    on_faces = _faces_matrix(size)
    derivatives = _BeyondFaces(degree, float(np.linalg.norm(size)) / 2)

    to_rows = [shift_matrix(degree, 1, y) for y in centres[1]]
    at_once = max(
        1, _NUMBERS_AT_ONCE // (count * max(len(polynomial), on_faces.shape[0] * on_faces.shape[1]))
    )
    to_cells = []
    for begin in range(0, shape[2], at_once):
        some = slice(begin, min(begin + at_once, shape[2]))
        # Rows in the order of the product below: the first coefficient of all these cells, then the second.
        stacked = vstack([shift_matrix(degree, 2, z) for z in centres[2][some]], format="csr")
        order = np.arange(stacked.shape[0]).reshape(some.stop - begin, -1).T.ravel()
        to_cells.append((some, stacked[order]))

    def of_slab(i: int) -> Array:
        worst = np.zeros(2)
        slab = shift_matrix(degree, 0, centres[0][i]) @ polynomial
        for j, along_y in enumerate(to_rows):
            row = along_y @ slab
            for some, along_z in to_cells:
                difference = (along_z @ row).reshape(len(row), -1, count)
                difference[: ours.shape[-1]] -= np.moveaxis(ours[i, j, some], -1, 0)
                found = _largest_sampled(on_faces, difference, scale) + derivatives.largest(difference, scale)
                worst = np.maximum(worst, found)
        return worst

    return np.array(np.max(list(results_of(of_slab, range(shape[0]))), axis=0)) / (1.0, unit)


def _degrees(degree: int) -> Index:
    """Degree of every coefficient, ((degree + 1)^2,)."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)


@cache
def _unit_shift(degree: int, axis: int) -> tuple[csr_array, NDArray[np.intp]]:
    """Matrix that moves the origin of coefficients ((degree + 1)^2,) by 1 along an axis, and for each entry the power
    of the shift to which it is proportional. It is Taylor's series, p(x + s) = sum_k (s d/dx)^k p(x) / k!, which is
    finite for a polynomial."""
    terms = (degree + 1) ** 2
    derivative = csr_array(derivative_matrix(degree, axis))
    derivative.resize((terms, terms))
    total = term = eye_array(terms, format="csr")
    for k in range(1, degree + 1):
        term = (1.0 / k) * (derivative @ term)
        total = total + term
    of_degree = _degrees(degree)
    rows = np.repeat(np.arange(terms), np.diff(total.indptr))
    return total, of_degree[total.indices] - of_degree[rows]


def shift_matrix(degree: int, axis: int, shift: float) -> csr_array:
    """Matrix ((degree + 1)^2, (degree + 1)^2) that moves the origin of coefficients by `shift` along an axis."""
    unit, powers = _unit_shift(degree, axis)
    data = unit.data * (shift ** np.arange(degree + 1))[powers]
    return csr_array((data, unit.indices, unit.indptr), shape=unit.shape)


def _faces_matrix(size: Array) -> Array:
    """Matrix (9, n, (FACE_DEGREE + 2)^2) from coefficients to flux density and gradient at points on the faces of a
    cell. The six rows of the gradient are scaled so that their squares sum to those of its nine entries."""
    points = _on_faces(-size / 2, size, FACE_POINTS)
    gradient = gradient_matrix(FACE_DEGREE + 1, points)
    entries = [gradient[:, i, j] * (1.0 if i == j else np.sqrt(2.0)) for i, j in _SYMMETRIC]
    return np.stack([*np.moveaxis(field_matrix(FACE_DEGREE + 1, points), 1, 0), *entries])


def _largest_sampled(on_faces: Array, difference: Array, scale: Array) -> Array:
    """Bounds (2,) on B and gradient on the faces, from the lower degrees of differences (terms, cells, fields)."""
    terms = min(on_faces.shape[-1], len(difference))
    low = difference[:terms]
    values = on_faces[..., :terms].reshape(-1, terms) @ low.reshape(terms, -1)
    squares = (values**2).reshape(9, -1, len(scale))
    norms = [np.sqrt(part.sum(axis=0)) @ scale for part in (squares[:3], squares[3:])]
    return between_samples(FACE_POINTS, FACE_DEGREE) * np.array([norm.max() for norm in norms])


class _BeyondFaces:
    """Bound on the degrees of B above FACE_DEGREE in a cell of radius `radius`, from their coefficients."""

    def __init__(self, degree: int, radius: float) -> None:
        first = [csr_array(derivative_matrix(degree, i)) for i in range(3)]
        second = [csr_array(derivative_matrix(degree - 1, j)) @ first[i] for i, j in _SYMMETRIC]
        self._matrices = first, second
        twice = [1.0 if i == j else 2.0 for i, j in _SYMMETRIC]
        self._shares = np.ones(3), np.array(twice)
        self._radius, self._degree = radius, degree

    def largest(self, difference: Array, scale: Array) -> Array:
        """Bounds (2,) on B and gradient for differences (terms, cells, fields)."""
        flat = difference.reshape(len(difference), -1).copy()
        flat[: (FACE_DEGREE + 2) ** 2] = 0.0
        return np.array([self._of(order, flat, scale) for order in (0, 1)])

    def _of(self, order: int, flat: Array, scale: Array) -> float:
        degree = self._degree - 1 - order
        squares = largest_on_sphere(degree)[:, None] * sum(
            share * (matrix @ flat) ** 2
            for share, matrix in zip(self._shares[order], self._matrices[order], strict=True)
        )
        starts = np.arange(degree + 1) ** 2
        of_degree = np.sqrt(np.add.reduceat(squares, starts, axis=0))
        of_field = (self._radius ** np.arange(degree + 1)) @ of_degree
        return float((of_field.reshape(-1, len(scale)) @ scale).max())


def between_samples(count: int, degree: int) -> float:
    """Factor by which a polynomial between count x count Chebyshev points can exceed its largest sample."""
    return float(np.cos(np.pi * degree / (2 * count)) ** -2)


def box_surface(grid: Grid, count: int) -> Array:
    """Points (6 count^2, 3): count x count Chebyshev points on every face of the box."""
    return _on_faces(grid.lower, np.array(grid.upper - grid.lower), count)


def _on_faces(lower: Array, size: Array, count: int) -> Array:
    """Points (6 count^2, 3) on the faces of a box with the lower corner (3,) and the edge lengths `size` (3,)."""
    t = (1 - np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))) / 2
    plane = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    unit = np.concatenate([np.insert(plane, axis, end, axis=1) for axis in range(3) for end in (0.0, 1.0)])
    return lower + unit * size
