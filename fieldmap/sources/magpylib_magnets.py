"""Magnetised tetrahedra as magpylib objects, for use of solved iron in magpylib."""

import magpylib
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def magpylib_tetrahedra(corners: Array, polarisation: Array, label: str) -> magpylib.Collection:
    """Tetrahedra with corners (n, 4, 3) in m and polarisation (n, 3) in T, uniform in each, as one Collection.

    >>> import numpy as np
    >>> unit = np.vstack([np.zeros(3), np.eye(3)])
    >>> ball = magpylib_tetrahedra(unit[None], np.array([[0.0, 0.0, 1.0]]), "a corner")
    >>> print(ball.getB([5.0, 0.0, 0.0]).round(6))
    [-1.80e-05  1.00e-06 -1.22e-04]
    """
    magnets = [
        magpylib.magnet.Tetrahedron(vertices=vertices, polarization=vector)
        for vertices, vector in zip(corners, polarisation, strict=True)
    ]
    return magpylib.Collection(*magnets, style_label=label)


def magpylib_assembly(*parts: magpylib.Collection) -> magpylib.Collection:
    """Several Collections as one."""
    return magpylib.Collection(*parts)
