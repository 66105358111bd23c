"""Cholesky factor and inverse of large matrices, while other threads of this process go on.

SciPy's functions hold the interpreter's lock until LAPACK is done. The same routines are called here by their addresses
(scipy.linalg.cython_lapack), without it.
"""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

_PREFIX = {np.dtype(np.float32): "s", np.dtype(np.float64): "d"}


def cholesky_in_place(matrix: NDArray[np.floating[Any]]) -> None:
    """Overwrite the lower triangle of a matrix (n, n) in Fortran's order, float32 or float64, with its factor L.

    Raises LinAlgError if the matrix is not positive definite; what it holds then is of no use.
    """
    failed = _call("potrf", matrix)
    if failed:
        raise LinAlgError(f"not positive definite: the leading minor of order {failed} is not positive")


def inverse_in_place(factor: NDArray[np.floating[Any]]) -> None:
    """Overwrite the lower triangle of a factor L (n, n) in Fortran's order with that of (L L^T)^-1.

    Raises LinAlgError for a zero on the diagonal.
    """
    failed = _call("potri", factor)
    if failed:
        raise LinAlgError(f"the inverse of a factor has failed at row {failed}")


def _call(routine: str, matrix: NDArray[np.floating[Any]]) -> int:
    if not matrix.flags.f_contiguous or matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{routine} takes a square matrix in Fortran's order, not {matrix.shape}")
    size, leading, failed = ctypes.c_int(len(matrix)), ctypes.c_int(max(len(matrix), 1)), ctypes.c_int(0)
    function = _function(_PREFIX[matrix.dtype] + routine)
    function(b"L", ctypes.byref(size), matrix.ctypes.data, ctypes.byref(leading), ctypes.byref(failed))
    return failed.value


@cache
def _function(name: str) -> Any:
    # uplo, n, a, lda, info
    integer = ctypes.POINTER(ctypes.c_int)
    prototype = ctypes.CFUNCTYPE(None, ctypes.c_char_p, integer, ctypes.c_void_p, integer, integer)
    return prototype(get_cython_function_address("scipy.linalg.cython_lapack", name))
