"""The material of every element of a mesh."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.elements.bh_law import LawTables
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class Magnetisation:
    """Index of the law of every element (e,), tables of the laws, remanence (c, e, 3) per source, T."""

    law: NDArray[np.int64]
    tables: LawTables
    remanence: Array
