"""A map made ready for evaluation: one block of coefficients per ampere, and what an interpolant must tell of itself.

Who makes a block does not evaluate it; who evaluates it (`fieldmap.lookup.Evaluator`, the C core) does not ask where it
came from.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.core import CoreMap
from fieldmap.core import block as map_block
from fieldmap.core.block import set_size
from fieldmap.records import Record
from fieldmap.store import FieldError, Grid, MapData, MapInfo
from fieldmap.typing import Array

OUTSIDE_RULES = {"raise": map_block.NAN_OUTSIDE, "nan": map_block.NAN_OUTSIDE, "clamp": map_block.CLAMP}


@dataclass(frozen=True, eq=False, repr=False)
class Form(Record):
    """One of the forms of a map.

    kind: name of its interpolant. unit: block with one set of coefficients per field of the map: of a
    coil per ampere, of saturating iron at weight 1. potential_unit: the same for the potential, if the block above
    does not hold it. misfit: largest difference between form and map at the nodes, T and T/m, summed over the
    fields, coils at their reference currents; None for a form that passes through the nodes.
    constant: whether the last field has weight 1, because no current drives it.
    """

    kind: str
    unit: Array
    potential_unit: Array
    misfit: FieldError | None
    constant: bool = False

    @property
    def n_coils(self) -> int:
        """Number of sets."""
        return int(self.unit[map_block.SETS])

    @property
    def places(self) -> int:
        """Number of cells or nodes that hold coefficients."""
        return (len(self.unit) - map_block.HEADER) // (self.n_coils * set_size(self.unit))


@dataclass(frozen=True)
class Jump(Record):
    """Largest norm of the step across a face between cells, summed over the coils at their reference currents: T and
    T/m.

    flux_density, gradient: at sampled points of every face. bound_factor: no step on all of a face is larger than this
    times the sampled ones.
    """

    flux_density: float = 0.0
    gradient: float = 0.0
    bound_factor: float = 1.0

    @property
    def flux_density_bound(self) -> float:
        """No step of B is larger, T."""
        return float(self.bound_factor * self.flux_density)

    @property
    def gradient_bound(self) -> float:
        """No step of the gradient is larger, T/m."""
        return float(self.bound_factor * self.gradient)


@dataclass(frozen=True, repr=False)
class Interpolant(Record):
    """One way to find a field between the nodes of a map.

    name: for `open_map(kind=...)`. summary: one line, for help and messages. form: the coefficients of a map, by what a
    point outside gives (a key of OUTSIDE_RULES), as a `Form`. kind: of its blocks (`fieldmap.core.block`), which the C
    core evaluates; without it `evaluator` is asked. evaluator: makes the `fieldmap.lookup.Evaluator` of a form; the
    package's own unless given. jump: how far field and gradient step from cell to cell; None where both are continuous.
    in_c: whether fieldmap.h reads its blocks.
    """

    name: str
    summary: str
    form: Callable[[MapData, str], Form]
    kind: int | None = None
    evaluator: Callable[[Form], Any] | None = None
    jump: Callable[[Form, MapInfo], Jump] | None = None
    in_c: bool = False


def header(kind: int, grid: Grid, n_coils: int, outside: str, degree: int = 0, length: float = 1.0) -> Array:
    """Header of a block over the cells of a grid (`fieldmap.core.block` says what is where)."""
    block = np.zeros(map_block.HEADER)
    block[map_block.KIND], block[map_block.RULE] = kind, OUTSIDE_RULES[outside]
    block[map_block.SETS], block[map_block.DEGREE] = n_coils, degree
    block[map_block.LOWER : map_block.LOWER + 3] = grid.lower
    block[map_block.INVERSE : map_block.INVERSE + 3] = 1 / np.array(grid.spacing)
    block[map_block.CELLS : map_block.CELLS + 3] = np.array(grid.shape) - 1
    block[map_block.LOCAL : map_block.LOCAL + 3] = np.array(grid.spacing) / length
    block[map_block.LENGTH], block[map_block.PER_LENGTH] = length, 1 / length
    return block


def contract(block: Array, currents: Array, size: int) -> Array:
    """The block of one set at given currents: what is done once per change of the currents.

    Parameters
    ----------
    block
        Coefficients of all fields.
    currents
        Currents (n_coils,), A.
    size
        Length of a set: `set_size`.

    Returns
    -------
    Array
        Coefficients of their sum.
    """
    places = (len(block) - map_block.HEADER) // (size * len(currents))
    out = np.empty(map_block.HEADER + places * size)
    out[: map_block.HEADER] = block[: map_block.HEADER]
    out[map_block.SETS] = 1.0
    CoreMap(block, components=size // 8).sum_sets(currents, out[map_block.HEADER :])
    return out


def node_potential(data: MapData) -> Array:
    """V (n_coils, nx, ny, nz) in T m/A with grad V = B, zero at the middle node.

    Along x through the first node, along y from there, then along z: trapezoid with the correction of its end
    slopes (Euler and Maclaurin; docs/theory/lookup.md (10)), error O(spacing^4). Different ways round a cell
    agree to that order because B is curl-free.
    """
    steps = [_edge_integrals(data, axis) for axis in range(3)]
    along_x = _running_sums(steps[0][:, :, :1, :1], 1)
    along_y = _running_sums(steps[1][:, :, :, :1], 2)
    potential = along_x + along_y + _running_sums(steps[2], 3)
    nx, ny, nz = (n // 2 for n in data.grid.shape)
    return potential - potential[:, nx : nx + 1, ny : ny + 1, nz : nz + 1]


def _edge_integrals(data: MapData, axis: int) -> Array:
    """Integral of B over every edge along an axis."""
    h = data.grid.spacing[axis]
    value = np.moveaxis(data.flux_density[..., axis], 1 + axis, 0)
    slope = np.moveaxis(data.gradient[..., axis, axis], 1 + axis, 0)
    step = h / 2 * (value[:-1] + value[1:]) + h * h / 12 * (slope[:-1] - slope[1:])
    return np.moveaxis(step, 0, 1 + axis)


def _running_sums(steps: Array, axis: int) -> Array:
    """Running sums that start at zero."""
    zero = np.zeros_like(np.take(steps, [0], axis=axis))
    return np.concatenate([zero, np.cumsum(steps, axis=axis)], axis=axis)
