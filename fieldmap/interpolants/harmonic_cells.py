"""One harmonic polynomial per cell: curl- and divergence-free to rounding, fitted to the cell's eight corners.

docs/theory/lookup.md (4), (5). Every cell is fitted by itself, so a cell at the boundary is as good as one inside,
and the fit of all cells is one matrix product.
"""

import itertools
from itertools import pairwise

import numpy as np

from fieldmap.core import block as map_block
from fieldmap.core.block import HARMONIC
from fieldmap.core.harmonics import regular_table
from fieldmap.interpolants.form import Form, Interpolant, Jump, header, node_potential
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.store import FieldError, MapData, MapInfo
from fieldmap.typing import Array

DEGREE = 5
SIZE = (DEGREE + 1) ** 2
NAME = "harmonic"
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))

# Weight of a gradient times half a spacing against a field. Measured: from 0.1 to 0.5 the errors of field and
# gradient at places between the nodes stay within 35 % of their smallest; below, the fit leans on few equations.
GRADIENT_WEIGHT = 0.3

# On a face a difference of fields is a polynomial of degree 4 in two variables, known from 5 x 5 Chebyshev points.
NODES = np.cos((2 * np.arange(5) + 1) * np.pi / 10)
LEBESGUE = (np.sum(1 / np.tan((2 * np.arange(5) + 1) * np.pi / 20)) / 5) ** 2


def cell_form(data: MapData, outside: str) -> Form:
    """One harmonic polynomial in each cell.

    Parameters
    ----------
    data
        The map.
    outside
        Rule of points outside the box, as for `fieldmap.lookup.open_map`.

    Returns
    -------
    Form
        Coefficients (cells, n_coils, 36) of all coils behind a header, and the largest misfit at the nodes.
    """
    grid, n_coils = data.grid, len(data.field_names)
    length = float(np.max(grid.spacing)) / 2
    corners = (CORNERS - 0.5) * np.array(grid.spacing) / length
    design = _design(corners)
    solve = np.linalg.pinv(design[:, 1:])
    cells = [n - 1 for n in grid.shape]
    coefficients = np.empty((*cells, n_coils, SIZE))
    worst = np.zeros(2)
    for i in range(cells[0]):
        values = _corner_values(data, i, length)
        coefficients[i, ..., 1:] = values @ solve.T
        worst = np.maximum(worst, _misfit(values - coefficients[i, ..., 1:] @ design[:, 1:].T, data))
    coefficients[..., 0] = _constants(data, coefficients, corners, length)
    start = header(HARMONIC, grid, n_coils, outside, DEGREE, length)
    unit = np.concatenate([start, coefficients.ravel()])
    return Form(NAME, unit, unit, FieldError(float(worst[0]), float(worst[1]) / length))


def _design(corners: Array) -> Array:
    """(96, 36): fields and weighted gradients at the corners."""
    of_field = field_matrix(DEGREE, corners).reshape(-1, SIZE)
    of_gradient = gradient_matrix(DEGREE, corners).reshape(-1, SIZE)
    return np.concatenate([of_field, GRADIENT_WEIGHT * of_gradient])


def _corner_values(data: MapData, i: int, length: float) -> Array:
    """(ny - 1, nz - 1, n_coils, 96): what the design matrix should give in the cells of slab i."""
    _, ny, nz = data.grid.shape
    n_coils = len(data.field_names)
    values = np.empty((ny - 1, nz - 1, n_coils, 96))
    of_field = values[..., :24].reshape(ny - 1, nz - 1, n_coils, 8, 3)
    of_gradient = values[..., 24:].reshape(ny - 1, nz - 1, n_coils, 8, 9)
    for c, (a, b, d) in enumerate(CORNERS):
        at = (slice(None), i + a, slice(b, ny - 1 + b), slice(d, nz - 1 + d))
        of_field[..., c, :] = np.moveaxis(data.flux_density[at], 0, 2)
        slope = np.moveaxis(data.gradient[at], 0, 2).reshape(ny - 1, nz - 1, n_coils, 9)
        of_gradient[..., c, :] = GRADIENT_WEIGHT * length * slope
    return values


def _misfit(residual: Array, data: MapData) -> Array:
    """Largest norm of the residuals at a corner in B and in length times gradient, summed over the coils."""
    shape = residual.shape[:3]
    flux = np.linalg.norm(residual[..., :24].reshape(*shape, 8, 3), axis=-1)
    slope = np.linalg.norm(residual[..., 24:].reshape(*shape, 8, 9), axis=-1) / GRADIENT_WEIGHT
    amperes = data.field_scale
    return np.array([np.einsum("jkcv,c->jkv", norm, amperes).max() for norm in (flux, slope)])


def _constants(data: MapData, coefficients: Array, corners: Array, length: float) -> Array:
    """Constant terms (cells, n_coils): the mean of the potential at a cell's corners is that of its nodes."""
    nx, ny, nz = data.grid.shape
    at_nodes = np.moveaxis(node_potential(data), 0, 3) / length
    mean = np.zeros(coefficients.shape[:4])
    for a, b, d in CORNERS:
        mean += at_nodes[a : nx - 1 + a, b : ny - 1 + b, d : nz - 1 + d] / 8
    return mean - coefficients[..., 1:] @ regular_table(DEGREE, corners).mean(axis=0)[1:]


def jump_between_cells(form: Form, info: MapInfo) -> Jump:
    """The jump of a form over all faces between its cells: at 5 x 5 Chebyshev points of every face.

    The bound is that times the Lebesgue constant 3.96 of these points (docs/theory/lookup.md (7)).

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
    cells = tuple(n - 1 for n in info.grid.shape)
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
