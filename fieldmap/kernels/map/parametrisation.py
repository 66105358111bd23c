"""A current parametrisation (`fieldmap.currents`) as compiled code takes it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LIFT_AND_DIRECTIONS, MATRIX = 0, 1


class CompiledParametrisation(NamedTuple):
    """LIFT_AND_DIRECTIONS: six currents by `fieldmap.kernels.map.lift_and_directions` with this exponent. MATRIX:
    currents = matrix (n_coils, n_signals) @ signals. What a kind does not need is zero or empty."""

    kind: int
    exponent: float
    matrix: NDArray[np.float64]
