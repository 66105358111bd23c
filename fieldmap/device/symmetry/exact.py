"""From matrices that form a group up to rounding in a device file to matrices that form it exactly."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.symmetry.group import multiplication_table

Array = NDArray[np.float64]
# Values of cosines and sines that appear in matrices of axes along the coordinates.
_EXACT = np.array([0.0, 0.5, 1.0, np.sqrt(0.5), np.sqrt(0.75)])


def exact_matrices(found: Array) -> Array | None:
    """The exact representation next to nearly orthogonal matrices (g, 3, 3), the identity first; None if no group.

    A vector v is known by the function h -> matrices[h]^T v on the group. These functions form a subspace that left
    translations nearly keep; averaged over the group, its projector commutes with them exactly, and its eigenspace
    carries the exact representation.
    """
    table = multiplication_table(found)
    if table is None or len(np.unique(table[:, 0])) < len(found):
        return None
    order = len(found)
    inverse = np.argmax(table == 0, axis=1)
    functions = np.swapaxes(found, 1, 2).reshape(3 * order, 3) / np.sqrt(order)
    rows = 3 * np.repeat(np.arange(order), 3) + np.tile(np.arange(3), order)
    projector = np.zeros((3 * order, 3 * order))
    translations = []
    for g in range(order):
        # (g f)(h) = f(g^-1 h)
        moved = 3 * np.repeat(table[inverse[g]], 3) + np.tile(np.arange(3), order)
        translations.append(moved)
        shifted = functions[moved]
        projector += shifted @ shifted.T / order
    basis = np.linalg.eigh(projector)[1][:, -3:]
    # The orthonormal basis closest to the functions of the coordinate axes keeps the orientation.
    u, _, v = np.linalg.svd(basis.T @ functions)
    basis = basis @ (u @ v)
    exact = np.array([basis[rows].T @ basis[moved] for moved in translations])
    return _rounded(exact)


def _rounded(matrices: Array) -> Array:
    """Entries within rounding of 0, 1/2, 1 and the roots of 1/2 and 3/4 get these values."""
    size = np.abs(matrices)
    nearest = _EXACT[np.abs(size[..., None] - _EXACT).argmin(axis=-1)]
    return np.where(np.abs(size - nearest) < 1e-12, np.sign(matrices) * nearest, matrices)
