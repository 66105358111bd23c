"""Whether kernels still have to be compiled, so that a first run can say what it waits for."""

import os
from pathlib import Path


def must_compile(kernels: str = "") -> bool:
    """Whether no compiled kernel of this folder of fieldmap/kernels is kept yet.

    False where they are kept elsewhere: NUMBA_CACHE_DIR is set, or the package's folder cannot be written.
    """
    folder = Path(__file__).parents[1] / "kernels" / kernels
    if os.environ.get("NUMBA_CACHE_DIR") or not os.access(folder, os.W_OK):
        return False
    return not any((folder / "__pycache__").glob("*.nbi"))
