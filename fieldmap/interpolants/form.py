"""A map ready for evaluation, as one block of coefficients (`Form`), and the declaration of an interpolant.

An interpolant makes blocks. An evaluator (`fieldmap.lookup.Evaluator`, the C core) evaluates a block of any origin.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.core import CoreMap
from fieldmap.core import block as map_block
from fieldmap.core.block import set_size
from fieldmap.errors import InputError, MapFileError
from fieldmap.records import Record
from fieldmap.store import FieldError, Grid, LargeMap, MapData, MapInfo
from fieldmap.store.map_data import MappedNumbers
from fieldmap.typing import Array

OUTSIDE_RULES = {"raise": map_block.NAN_OUTSIDE, "nan": map_block.NAN_OUTSIDE, "clamp": map_block.CLAMP}


@dataclass(frozen=True, eq=False, repr=False)
class Form(Record):
    """The coefficients of a map by one interpolant.

    kind: name of the interpolant. unit: block with one set of coefficients per field of the map: of a coil per ampere,
    of saturating iron at weight 1. potential_unit: the block of the potential, the same one if `unit` holds it. misfit:
    largest difference between form and map at the nodes, T and T/m, summed over the fields, coils at their reference
    currents; None for a form that passes through the nodes. constant: whether the last field always has weight 1.
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

    flux_density, gradient: at sampled points of every face. bound_factor: a step anywhere on a face is at most this
    times the largest sample.
    """

    flux_density: float = 0.0
    gradient: float = 0.0
    bound_factor: float = 1.0

    @property
    def flux_density_bound(self) -> float:
        """Bound on the step of B, T."""
        return float(self.bound_factor * self.flux_density)

    @property
    def gradient_bound(self) -> float:
        """Bound on the step of the gradient, T/m."""
        return float(self.bound_factor * self.gradient)


@dataclass(frozen=True, repr=False)
class Interpolant(Record):
    """A method of interpolation between the nodes of a map.

    name: for `open_map(kind=...)`. summary: one line, for help and messages. form: makes the `Form` of a map with a
    rule for points outside (a key of OUTSIDE_RULES). kind: kind of its blocks (`fieldmap.core.block`), for the C core;
    None for blocks that only `evaluator` evaluates. evaluator: makes the `fieldmap.lookup.Evaluator` of a form; the C
    core unless given. jump: steps of field and gradient between cells; None if both are continuous. in_c: whether
    fieldmap.h reads the blocks.
    """

    name: str
    summary: str
    form: Callable[[Any, str], Form]
    kind: int | None = None
    evaluator: Callable[[Form], Any] | None = None
    jump: Callable[[Form, MapInfo], Jump] | None = None
    in_c: bool = False


def header(kind: int, grid: Grid, n_coils: int, outside: str, degree: int = 0, length: float = 1.0) -> Array:
    """Header of a block over the cells of a grid (layout: `fieldmap.core.block`)."""
    block = np.zeros(map_block.HEADER)
    block[map_block.KIND], block[map_block.RULE] = kind, OUTSIDE_RULES[outside]
    block[map_block.SETS], block[map_block.DEGREE] = n_coils, degree
    block[map_block.LOWER : map_block.LOWER + 3] = grid.lower
    block[map_block.INVERSE : map_block.INVERSE + 3] = 1 / np.array(grid.spacing)
    block[map_block.CELLS : map_block.CELLS + 3] = np.array(grid.shape) - 1
    block[map_block.LOCAL : map_block.LOCAL + 3] = np.array(grid.spacing) / length
    block[map_block.LENGTH], block[map_block.PER_LENGTH] = length, 1 / length
    return block


def stored_form(data: LargeMap, kind: str, outside: str) -> Form:
    """A form of a large map, with its coefficients in the file.

    Parameters
    ----------
    data
        The map.
    kind
        Name of the interpolant.
    outside
        Rule for points outside the box, as for `fieldmap.lookup.open_map`.

    Returns
    -------
    Form
        The form.

    Raises
    ------
    InputError
        If the file does not hold this form.
    MapFileError
        If its coefficients do not belong to this map.
    """
    if kind not in data.blocks:
        must_hold = f"a form that the file of a large map holds: {', '.join(data.blocks)}"
        remedy = f'take one of these, or read all of its numbers: interpolate(read_map(PATH), "{kind}")'
        raise InputError.of("open_map, kind", must_hold, repr(kind), remedy)
    unit, grid = data.blocks[kind], data.lookup_grid
    cells = np.ones(3) if unit[map_block.KIND] == map_block.GLOBAL else np.array(grid.shape) - 1
    says = (
        unit[map_block.SETS],
        unit[map_block.CELLS : map_block.CELLS + 3],
        unit[map_block.LOWER : map_block.LOWER + 3],
    )
    if not all(map(np.array_equal, says, (len(data.field_names), cells, grid.lower))):
        must_hold = f"coefficients of {len(data.field_names)} fields in {cells} cells"
        raise MapFileError.of(f"{kind} form of a large map", must_hold, "others", "make the map again")
    unit = with_rule(unit, outside)
    return Form(kind, unit, unit, data.misfits[kind])


def with_rule(unit: Array, outside: str) -> Array:
    """A block, in a file or in memory, with a rule for points outside, as for `fieldmap.lookup.open_map`."""
    start = np.array(unit[: map_block.HEADER])
    start[map_block.RULE] = OUTSIDE_RULES[outside]
    if isinstance(unit, MappedNumbers):
        return unit.beginning(start)
    return np.concatenate([start, unit[map_block.HEADER :]])


def contract(block: Array, currents: Array, size: int) -> Array:
    """The sum of a block's fields at given currents, as a block of one set. It is computed once per change of currents.

    Parameters
    ----------
    block
        Coefficients of all fields.
    currents
        Weights (n_fields,) of the fields, A for coils.
    size
        Length of a set: `set_size`.

    Returns
    -------
    Array
        The block of the sum.
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
    along_x = running_potential(
        data.flux_density[:, :, 0, 0, 0], data.gradient[:, :, 0, 0, 0, 0], data.grid.spacing[0]
    )
    planes = [
        plane_potential(along_x[:, i], data.flux_density[:, i], data.gradient[:, i], data.grid.spacing)
        for i in range(data.grid.shape[0])
    ]
    potential = np.stack(planes, axis=1)
    nx, ny, nz = (n // 2 for n in data.grid.shape)
    return potential - potential[:, nx : nx + 1, ny : ny + 1, nz : nz + 1]


def plane_potential(first: Array, flux: Array, gradient: Array, spacing: Array) -> Array:
    """V (n_coils, ny, nz) in an x-plane of nodes, from V (n_coils,) at its first node, flux density
    (n_coils, ny, nz, 3) and gradient (n_coils, ny, nz, 3, 3)."""
    along_y = running_potential(flux[:, :, 0, 1], gradient[:, :, 0, 1, 1], spacing[1])
    along_z = running_potential(flux[..., 2], gradient[..., 2, 2], spacing[2])
    return np.asarray((first[:, None] + along_y)[..., None] + along_z)


def running_potential(value: Array, slope: Array, spacing: float) -> Array:
    """Integral (..., n) from the first node of a line, from the component of B along the line and its slope."""
    step = spacing / 2 * (value[..., :-1] + value[..., 1:])
    step += spacing * spacing / 12 * (slope[..., :-1] - slope[..., 1:])
    return np.concatenate([np.zeros_like(value[..., :1]), np.cumsum(step, axis=-1)], axis=-1)
