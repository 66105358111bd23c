"""Types that many signatures share."""

import os
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of float64."""

PathLike: TypeAlias = str | os.PathLike[str]
"""A file by its name."""

Progress: TypeAlias = Callable[[str, float], None]
"""progress(message, fraction): what is being done, and how much of the work is done, 0 to 1."""

Index: TypeAlias = NDArray[np.int64]
"""An array of whole numbers, as a rule positions in other arrays."""
