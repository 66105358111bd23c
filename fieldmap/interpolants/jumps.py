"""How far the polynomials of neighbouring cells differ on the face between them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fieldmap.interpolants.form import Form
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.kernels.map import map_block
from fieldmap.kernels.map.cell_harmonics import DEGREE, SIZE
from fieldmap.store import MapInfo
from fieldmap.typing import Array

# On a face a difference of fields is a polynomial of degree 4 in two variables, known from 5 x 5 Chebyshev points.
NODES = np.cos((2 * np.arange(5) + 1) * np.pi / 10)
LEBESGUE = (np.sum(1 / np.tan((2 * np.arange(5) + 1) * np.pi / 20)) / 5) ** 2


@dataclass(frozen=True)
class Jump:
    """Largest norm of the step across a face, summed over the coils at their reference currents: T and T/m.

    flux_density, gradient: at 5 x 5 Chebyshev points of every face. flux_density_bound, gradient_bound: on all
    of every face, the former times the Lebesgue constant 3.96 of these points (docs/theory/lookup.md (7)).
    """

    flux_density: float
    gradient: float

    @property
    def flux_density_bound(self) -> float:
        """No step of B is larger, T."""
        return float(LEBESGUE * self.flux_density)

    @property
    def gradient_bound(self) -> float:
        """No step of the gradient is larger, T/m."""
        return float(LEBESGUE * self.gradient)


def jump_between_cells(form: Form, info: MapInfo) -> Jump:
    """The jump of a form over all faces between its cells; nothing for a form of continuous gradient."""
    if form.kind != "harmonic":
        return Jump(0.0, 0.0)
    cells = tuple(n - 1 for n in info.grid.shape)
    coefficients = form.unit[map_block.HEADER :].reshape(*cells, form.n_coils, SIZE)
    half = form.unit[map_block.LOCAL : map_block.LOCAL + 3] / 2
    per_length = float(form.unit[map_block.PER_LENGTH])
    steps = [_across(coefficients, half, axis, info.field_scale) for axis in range(3)]
    largest = np.max(steps, axis=0)
    return Jump(float(largest[0]), float(largest[1]) * per_length)


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
