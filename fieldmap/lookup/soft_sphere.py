"""Force on a soft iron sphere in any field: induced dipole and quadrupole."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.field import AnyField, as_field
from fieldmap.kernels.constants import MU0
from fieldmap.typing import Array


def soft_sphere_force(
    field: AnyField, positions: ArrayLike, currents: Any, diameter: float, mu_r: float = np.inf
) -> Array:
    """Force (n, 3), N, on a sphere of constant permeability with its centre at positions (n, 3); no torque.

    docs/theory/wrench.md (4): the sphere answers the field's own value and gradient exactly. What is left out, the
    answer to the second gradient, is of the order (radius / R)^4 of the force with R the distance of the nearest
    source; the sphere's influence on the coils' iron is left out as well. The field is that without the sphere.
    Raises InputError for a diameter or permeability that cannot be.
    """
    if not (diameter > 0 and np.isfinite(diameter) and mu_r >= 1):
        received = f"diameter {diameter!r}, mu_r {mu_r!r}"
        raise InputError(Problem("soft_sphere_force", "diameter > 0 in m, mu_r >= 1", received, "correct it"))
    a, share = diameter / 2, 1 / mu_r
    answer = [l * (1 - share) / (l + (l + 1) * share) for l in (1, 2)]
    source = as_field(field)
    flux, slope = source.field_and_gradient(positions, currents)
    bend = source.second_gradient(positions, currents)
    dipole = 4 * np.pi * a**3 * answer[0] / MU0 * np.einsum("...i,...ij->...j", flux, slope)
    quadrupole = 2 * np.pi * a**5 * answer[1] / (3 * MU0) * np.einsum("...ij,...ijk->...k", slope, bend)
    return np.asarray(dipole + quadrupole)
