"""One harmonic polynomial per cell: curl- and divergence-free to rounding, fitted to the cell's eight corners.

docs/theory/lookup.md (4), (5). Every cell is fitted by itself, so cells at the boundary are as accurate as inner cells.
The fit of all cells is one matrix product.
"""

import itertools
from itertools import pairwise

import numpy as np

from fieldmap.core import block as map_block
from fieldmap.core.block import HARMONIC
from fieldmap.core.harmonics import regular_table
from fieldmap.interpolants.form import Form, Interpolant, Jump, header, node_potential, stored_form
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.store import FieldError, Grid, LargeMap, MapData, MapInfo
from fieldmap.typing import Array

DEGREE = 5
SIZE = (DEGREE + 1) ** 2
NAME = "harmonic"
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))

# Weight of half a spacing times the gradient, relative to the flux density. From 0.1 to 0.5 the measured errors of both
# between the nodes stay within 35 % of their minimum; below 0.1 the fit rests on few equations.
GRADIENT_WEIGHT = 0.3

# On a face the difference of two cells' fields is a polynomial of degree 4 in two variables. It is determined by 5 x 5
# Chebyshev points, with this Lebesgue constant.
NODES = np.cos((2 * np.arange(5) + 1) * np.pi / 10)
LEBESGUE = (np.sum(1 / np.tan((2 * np.arange(5) + 1) * np.pi / 20)) / 5) ** 2


def cell_form(data: MapData | LargeMap, outside: str) -> Form:
    """One harmonic polynomial in each cell.

    Parameters
    ----------
    data
        The map.
    outside
        Rule for points outside the box, as for `fieldmap.lookup.open_map`.

    Returns
    -------
    Form
        Coefficients (cells, n_coils, 36) of all coils behind a header, and the largest misfit at the nodes.
    """
    if isinstance(data, LargeMap):
        return stored_form(data, NAME, outside)
    grid, n_coils = data.grid, len(data.field_names)
    fit = CellFit(grid)
    cells = [n - 1 for n in grid.shape]
    coefficients = np.empty((*cells, n_coils, SIZE))
    worst = np.zeros(2)
    potential = node_potential(data)
    for i in range(cells[0]):
        at = slice(i, i + 2)
        coefficients[i], residual = fit.slab(data.flux_density[:, at], data.gradient[:, at], potential[:, at])
        worst = np.maximum(worst, _misfit(residual, data))
    unit = np.concatenate([fit.header(n_coils, outside), coefficients.ravel()])
    return Form(NAME, unit, unit, FieldError(float(worst[0]), float(worst[1]) / fit.length))


class CellFit:
    """Fits the polynomials in the cells between two planes of a grid at a time. length: unit of coordinates, m."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.length = float(np.max(grid.spacing)) / 2
        corners = (CORNERS - 0.5) * np.array(grid.spacing) / self.length
        self._design = _design(corners)
        self._solve = np.linalg.pinv(self._design[:, 1:])
        self._mean = regular_table(DEGREE, corners).mean(axis=0)[1:]

    def header(self, n_coils: int, outside: str, grid: Grid | None = None) -> Array:
        """Header of a block of these cells, or of the cells of `grid`, a part of the grid."""
        return header(HARMONIC, grid or self.grid, n_coils, outside, DEGREE, self.length)

    def slab(self, flux: Array, gradient: Array, potential: Array) -> tuple[Array, Array]:
        """The polynomials of a slab of cells.

        Parameters
        ----------
        flux
            (n_coils, 2, ny, nz, 3), per ampere, at the nodes of two neighbouring x-planes.
        gradient
            (n_coils, 2, ny, nz, 3, 3).
        potential
            (n_coils, 2, ny, nz), T m/A, from `node_potential`.

        Returns
        -------
        tuple[Array, Array]
            Coefficients (ny - 1, nz - 1, n_coils, 36), and the residuals at the corners (ny - 1, nz - 1, n_coils, 96).
        """
        values = _corner_values(flux, gradient, self.length)
        coefficients = np.empty((*values.shape[:-1], SIZE))
        coefficients[..., 1:] = values @ self._solve.T
        # The constant makes the polynomial and the potential at the nodes have the same mean over a cell's corners.
        at_nodes = np.moveaxis(potential, 0, 3) / self.length
        _, ny, nz, _ = at_nodes.shape
        mean = np.zeros(values.shape[:-1])
        for a, b, d in CORNERS:
            mean += at_nodes[a, b : ny - 1 + b, d : nz - 1 + d] / 8
        coefficients[..., 0] = mean - coefficients[..., 1:] @ self._mean
        return coefficients, values - coefficients[..., 1:] @ self._design[:, 1:].T


def _design(corners: Array) -> Array:
    """(96, 36): fields and weighted gradients at the corners."""
    of_field = field_matrix(DEGREE, corners).reshape(-1, SIZE)
    of_gradient = gradient_matrix(DEGREE, corners).reshape(-1, SIZE)
    return np.concatenate([of_field, GRADIENT_WEIGHT * of_gradient])


def _corner_values(flux: Array, gradient: Array, length: float) -> Array:
    """Right-hand sides (ny - 1, nz - 1, n_coils, 96) of the fits in the cells between two planes of nodes."""
    n_coils, _, ny, nz, _ = flux.shape
    values = np.empty((ny - 1, nz - 1, n_coils, 96))
    of_field = values[..., :24].reshape(ny - 1, nz - 1, n_coils, 8, 3)
    of_gradient = values[..., 24:].reshape(ny - 1, nz - 1, n_coils, 8, 9)
    for c, (a, b, d) in enumerate(CORNERS):
        at = (slice(None), a, slice(b, ny - 1 + b), slice(d, nz - 1 + d))
        of_field[..., c, :] = np.moveaxis(flux[at], 0, 2)
        slope = np.moveaxis(gradient[at], 0, 2).reshape(ny - 1, nz - 1, n_coils, 9)
        of_gradient[..., c, :] = GRADIENT_WEIGHT * length * slope
    return values


def _misfit(residual: Array, data: MapData) -> Array:
    """Largest norm of the residuals at a corner in B and in length times gradient, summed over the coils."""
    shape = residual.shape[:3]
    flux = np.linalg.norm(residual[..., :24].reshape(*shape, 8, 3), axis=-1)
    slope = np.linalg.norm(residual[..., 24:].reshape(*shape, 8, 9), axis=-1) / GRADIENT_WEIGHT
    amperes = data.field_scale
    return np.array([np.einsum("jkcv,c->jkv", norm, amperes).max() for norm in (flux, slope)])


def jump_between_cells(form: Form, info: MapInfo) -> Jump:
    """The jump of a form at 5 x 5 Chebyshev points of every face between its cells.

    The bound is the jump times the Lebesgue constant 3.96 of these points (docs/theory/lookup.md (7)).

    Parameters
    ----------
    form
        The form.
    info
        The description of its map.

    Returns
    -------
    Jump
        The jump.
    """
    cells = form.unit[map_block.CELLS : map_block.CELLS + 3].astype(int)
    coefficients = form.unit[map_block.HEADER :].reshape(*cells, form.n_coils, SIZE)
    half = form.unit[map_block.LOCAL : map_block.LOCAL + 3] / 2
    per_length = float(form.unit[map_block.PER_LENGTH])
    steps = [_across(coefficients, half, axis, info.field_scale) for axis in range(3)]
    largest = np.max(steps, axis=0)
    return Jump(float(largest[0]), float(largest[1]) * per_length, float(LEBESGUE))


def _across(coefficients: Array, half: Array, axis: int, amperes: Array) -> Array:
    """Largest steps (2,) across the faces that are normal to an axis, a slab of cells at a time."""
    face = np.stack(np.meshgrid(NODES, NODES, indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.insert(face, axis, 1.0, axis=1) * half
    mirrored = points * np.where(np.arange(3) == axis, -1.0, 1.0)
    ours, theirs = _both(points), _both(mirrored)
    cells = np.moveaxis(coefficients, axis, 0)
    worst = np.zeros(2)
    for below, above in pairwise(cells):
        step = below @ ours.T - above @ theirs.T
        flux = np.linalg.norm(step[..., :75].reshape(*step.shape[:-1], 25, 3), axis=-1)
        slope = np.linalg.norm(step[..., 75:].reshape(*step.shape[:-1], 25, 9), axis=-1)
        here = [np.einsum("jkcp,c->jkp", norm, amperes).max() for norm in (flux, slope)]
        worst = np.maximum(worst, here)
    return worst


def _both(points: Array) -> Array:
    """(300, 36): fields, then gradients at 25 points."""
    of_field = field_matrix(DEGREE, points).reshape(-1, SIZE)
    return np.concatenate([of_field, gradient_matrix(DEGREE, points).reshape(-1, SIZE)])


INTERPOLANT = Interpolant(
    NAME, "one harmonic polynomial per cell", cell_form, HARMONIC, jump=jump_between_cells, in_c=True
)
