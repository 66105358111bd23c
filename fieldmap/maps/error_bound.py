"""How far lookups of a map differ from the solver: measured at samples, and bounded anywhere in the box.

The bound (docs/theory/lookup.md, certificate): the solver's B and gradient are harmonic in the box, and so are those of
one polynomial P for the whole box. The norm of their difference is largest on the surface of the box (a sum of norms of
harmonic functions is subharmonic). What a polynomial per cell differs from P by is largest on the cell's faces, for the
same reason. Both are sampled at Chebyshev points; between n x n of them a polynomial of degree d < n in each variable
stays below 1 / cos(pi d / 2 n)^2 times its largest sample (Ehlich, Zeller, Math. Z. 86 (1964) 41).
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeAlias

import numpy as np

from fieldmap.errors import InputError
from fieldmap.interpolants import Form, cell_form, contract, global_form, hermite_form, set_size
from fieldmap.kernels.map import lookup as kernels
from fieldmap.parallel import in_threads, threads_of_kernels
from fieldmap.store import FieldError, Grid, MapData
from fieldmap.typing import Array

Pair = tuple[Array, Array]
RANDOM_POINTS = 200
SEED = 20240229
# The polynomial P has degree 16. What remains of the solver's field falls by more than half with every degree.
SURFACE_POINTS, SURFACE_DEGREE = 24, 18
# At how many points the solver is asked.
SOLVER_POINTS = 6 * SURFACE_POINTS**2
# The polynomials of cells have degree 5; a cell is small against the distance of all sources.
FACE_POINTS, FACE_DEGREE = 12, 8
# Points on the faces of a cell lie this share of it inside, so that a lookup takes this cell and no other.
_INSIDE = 1e-9


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

    The norm of each field's difference times its scale, a coil's reference current, is summed over the fields, so the
    figure holds at the sampled points for any currents up to these, whatever their signs. A sample, not a bound.
    """
    points = sample_points(data.grid)
    form = hermite_form(data, "raise")
    return FieldError(*map(float, difference_to_solver(form, data.field_scale, points, unit_fields)))


def difference_to_solver(form: Form, scale: Array, points: Array, unit_fields: UnitFields) -> Array:
    """(2,): largest sum over the fields of the norms of the differences at points (n, 3), each times its scale: B and
    gradient."""
    return _largest(_by_field(form, points), zip(*unit_fields(points), strict=True), scale)


def difference_of_forms(one: Form, other: Form, scale: Array, points: Array) -> Array:
    """The same between two forms of one map."""
    return _largest(_by_field(one, points), _by_field(other, points), scale)


def _by_field(form: Form, points: Array) -> Iterator[tuple[Array, Array]]:
    """Field (n, 3) and gradient (n, 3, 3) of one coil after the other, per ampere."""
    for one in np.eye(form.n_coils):
        flux, slope = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
        kernels.evaluate(contract(form.unit, one, set_size(form.unit)), points, flux, slope)
        yield flux, slope


def _largest(ours: Iterable[Pair], theirs: Iterable[Pair], scale: Array) -> Array:
    total: list[Array | float] = [0.0, 0.0]
    for factor, (flux, slope), (exact, exact_slope) in zip(scale, ours, theirs, strict=True):
        total[0] = total[0] + factor * np.linalg.norm(flux - exact, axis=1)
        total[1] = total[1] + factor * np.linalg.norm(slope - exact_slope, axis=(1, 2))
    return np.array([np.max(part) for part in total])


def certified_bounds(data: MapData, unit_fields: UnitFields, scale: Array) -> Mapping[str, FieldError]:
    """Bounds by kind of lookup, "harmonic" and "global": T and T/m, summed over the fields times their scale.

    They hold for all points of the box and for all weights of the fields up to scale (n_fields,) in size: the
    reference currents, or of saturating iron the largest weights in the domain of the currents. Empty where no
    polynomial holds the whole box.
    """
    try:
        whole = global_form(data, "raise")
    except InputError:
        return {}
    surface = box_surface(data.grid, SURFACE_POINTS)
    outer = between_samples(SURFACE_POINTS, SURFACE_DEGREE) * difference_to_solver(
        whole, scale, surface, unit_fields
    )
    cells = cell_form(data, "raise")

    def of_slab(number: int) -> Array:
        return difference_of_forms(cells, whole, scale, _faces_of_cells(data.grid, number))

    slabs = range(data.grid.shape[0] - 1)
    found = [outcome.result() for outcome in in_threads(of_slab, slabs, threads_of_kernels())]
    inner = between_samples(FACE_POINTS, FACE_DEGREE) * np.max(found, axis=0)
    return {"harmonic": FieldError(*map(float, outer + inner)), "global": FieldError(*map(float, outer))}


def between_samples(count: int, degree: int) -> float:
    """How much larger a polynomial can be between count x count Chebyshev points than at them."""
    return float(np.cos(np.pi * degree / (2 * count)) ** -2)


def box_surface(grid: Grid, count: int) -> Array:
    """Points (6 count^2, 3): count x count Chebyshev points on every face of the box."""
    return _on_faces(grid.lower[None], np.array(grid.upper - grid.lower), count, 0.0)[0]


def _on_faces(lower: Array, size: Array, count: int, inside: float) -> Array:
    """Points (n, 6 count^2, 3) on the faces of n boxes of one size (3,) at corners lower (n, 3)."""
    t = (1 - np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))) / 2
    plane = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    ends = (inside, 1 - inside)
    unit = np.concatenate([np.insert(plane, axis, end, axis=1) for axis in range(3) for end in ends])
    return lower[:, None, :] + unit * size


def _faces_of_cells(grid: Grid, slab: int) -> Array:
    """Points (m, 3) on the faces of the cells of one slab across x."""
    spacing = np.array(grid.spacing)
    ny, nz = (n - 1 for n in grid.shape[1:])
    index = np.stack(np.meshgrid([slab], np.arange(ny), np.arange(nz), indexing="ij"), axis=-1).reshape(-1, 3)
    return _on_faces(grid.lower + index * spacing, spacing, FACE_POINTS, _INSIDE).reshape(-1, 3)
