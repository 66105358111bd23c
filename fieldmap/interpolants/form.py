"""A map made ready for evaluation: one block of coefficients per ampere, and its contraction at currents.

Two ideas kept apart. Who makes a block does not evaluate it; who evaluates it (fieldmap.kernels.map.lookup, and
`MapAtCurrents` in front of it) does not ask where it came from. A form superposes the unit blocks of coils; a
model of saturating iron would hand over a contracted block of its own.
"""

from dataclasses import dataclass

import numpy as np

from fieldmap.kernels.map import global_harmonics, map_block
from fieldmap.kernels.map import lookup as kernels
from fieldmap.store import FieldError, Grid
from fieldmap.typing import Array

OUTSIDE_RULES = {"raise": map_block.NAN_OUTSIDE, "nan": map_block.NAN_OUTSIDE, "clamp": map_block.CLAMP}


@dataclass(frozen=True, eq=False)
class Form:
    """One of the forms of a map.

    kind: "hermite", "harmonic" or "global". unit: block with one set of coefficients per field of the map: of a
    coil per ampere, of saturating iron at weight 1. potential_unit: the same for the potential, if the block above
    does not hold it. misfit: largest difference between form and map at the nodes, T and T/m, summed over the
    fields, coils at their reference currents; None for a form that passes through the nodes.
    """

    kind: str
    unit: Array
    potential_unit: Array
    misfit: FieldError | None

    @property
    def n_coils(self) -> int:
        """Number of sets."""
        return int(self.unit[map_block.SETS])

    @property
    def places(self) -> int:
        """Number of cells or nodes that hold coefficients."""
        return (len(self.unit) - map_block.HEADER) // (self.n_coils * set_size(self.unit))


def header(kind: int, grid: Grid, n_coils: int, outside: str, degree: int = 0, length: float = 1.0) -> Array:
    """Header of a block over the cells of a grid (fieldmap.kernels.map.map_block says what is where)."""
    block = np.zeros(map_block.HEADER)
    block[map_block.KIND], block[map_block.RULE] = kind, OUTSIDE_RULES[outside]
    block[map_block.SETS], block[map_block.DEGREE] = n_coils, degree
    block[map_block.LOWER : map_block.LOWER + 3] = grid.lower
    block[map_block.INVERSE : map_block.INVERSE + 3] = 1 / np.array(grid.spacing)
    block[map_block.CELLS : map_block.CELLS + 3] = np.array(grid.shape) - 1
    block[map_block.LOCAL : map_block.LOCAL + 3] = np.array(grid.spacing) / length
    block[map_block.LENGTH], block[map_block.PER_LENGTH] = length, 1 / length
    return block


def set_size(block: Array) -> int:
    """How many numbers one set has at one cell or node."""
    if block[map_block.KIND] == map_block.HERMITE:
        return kernels.NODE
    return int(block[map_block.DEGREE] + 1) ** 2


def contract(block: Array, currents: Array, size: int) -> Array:
    """The block of one set at currents (n_coils,): what is done once per change of the currents."""
    places = (len(block) - map_block.HEADER) // (size * len(currents))
    count = map_block.HEADER + places * size
    degree = int(block[map_block.DEGREE])
    wide = block[map_block.KIND] == map_block.GLOBAL_HARMONIC
    out = np.empty(count + (global_harmonics.ROWS * degree**2 if wide else 0))
    map_block.contract(block, size, currents, out[:count])
    if wide:
        global_harmonics.expand(out[map_block.HEADER : count], degree, out[count:])
    return out
