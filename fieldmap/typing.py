"""Types that many signatures share."""

import os
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of float64."""

PathLike: TypeAlias = str | os.PathLike[str]
"""Path of a file."""

Progress: TypeAlias = Callable[[str, float], None]
"""progress(message, fraction): the present work, and the share of all work that is done, 0 to 1."""

Index: TypeAlias = NDArray[np.int64]
"""An array of whole numbers, as a rule positions in other arrays."""
