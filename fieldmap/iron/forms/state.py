"""What either form of the iron problem leaves: charges for the air, flux densities for the inside."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.operators.surface import ChargedFaces

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class IronState:
    """Solved iron for one or several sources (columns c).

    faces: the m charged faces; density (c, m) in T: mu0 times magnetic charge per area; flux_density (c, e, 3):
    mean of every element, T; iterations: steps of the solver; residuals: its history, relative, worst column.
    """

    faces: ChargedFaces
    density: Array
    flux_density: Array
    iterations: int
    residuals: tuple[float, ...]
