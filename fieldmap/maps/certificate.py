"""A bound on how far lookups of a map differ from the solver, anywhere in the box (docs/theory/lookup.md, certificate).

The solver's B and gradient are harmonic in the box, and so are those of one polynomial P for the whole box. The norm
of their difference is largest on the surface of the box (a sum of norms of harmonic functions is subharmonic). What a
polynomial per cell differs from P by is largest on the cell's faces, for the same reason. Both are sampled at
Chebyshev points; between n x n of them a polynomial of degree d < n in each variable stays below
1 / cos(pi d / 2 n)^2 times its largest sample (Ehlich, Zeller, Math. Z. 86 (1964) 41).
"""

from collections.abc import Iterator, Mapping

import numpy as np

from fieldmap.errors import InputError
from fieldmap.interpolants import cell_form, global_form
from fieldmap.maps.interpolation import UnitFields, difference_of_forms, difference_to_solver
from fieldmap.store import FieldError, Grid, MapData
from fieldmap.store.grid import Array

# The polynomial P has degree 16. What remains of the solver's field falls by more than half with every degree.
SURFACE_POINTS, SURFACE_DEGREE = 24, 18
# At how many points the solver is asked.
SOLVER_POINTS = 6 * SURFACE_POINTS**2
# The polynomials of cells have degree 5; a cell is small against the distance of all sources.
FACE_POINTS, FACE_DEGREE = 12, 8
# Points on the faces of a cell lie this share of it inside, so that a lookup takes this cell and no other.
_INSIDE = 1e-9


def certified_bounds(data: MapData, solution: UnitFields, scale: Array) -> Mapping[str, FieldError]:
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
        whole, scale, surface, solution
    )
    cells = cell_form(data, "raise")
    inner = between_samples(FACE_POINTS, FACE_DEGREE) * np.max(
        [difference_of_forms(cells, whole, scale, points) for points in _faces_of_cells(data.grid)], axis=0
    )
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


def _faces_of_cells(grid: Grid) -> Iterator[Array]:
    """Points (m, 3) on the faces of all cells, a slab of cells after the other."""
    spacing = np.array(grid.spacing)
    ny, nz = (n - 1 for n in grid.shape[1:])
    for i in range(grid.shape[0] - 1):
        index = np.stack(np.meshgrid([i], np.arange(ny), np.arange(nz), indexing="ij"), axis=-1).reshape(
            -1, 3
        )
        yield _on_faces(grid.lower + index * spacing, spacing, FACE_POINTS, _INSIDE).reshape(-1, 3)
