"""What an equilibrium search returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class SearchReport:
    """How an equilibrium was found: starts tried and how many of them converged, calls of the field, relative
    residual |F + m g| / weight, antisymmetric part of the stiffness relative to its norm (0 for an exactly
    curl-free field; an interpolated field has some), and the box searched (m)."""

    method: str
    starts: int
    converged: int
    evaluations: int
    relative_residual: float
    stiffness_asymmetry: float
    lower: Array
    upper: Array


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Balance of magnetic force and weight.

    position (3,): the magnet's centre, m. force_residual (3,): magnetic force plus weight, N.
    stiffness (3, 3): -dF_i/dx_j, N/m. eigenvalues (3,) ascending, N/m, of its symmetric part, and
    directions (3, 3) with the unit eigenvectors as columns; stable (3,): whether the magnet is pushed back
    along each of them. moment (3,) in A m^2, field (3,) in T and currents (n_coils,) in A, at the
    equilibrium. others (n, 3): further equilibria of the same currents found on the way, m. assumptions:
    what the numbers rest on.
    """

    position: Array
    force_residual: Array
    stiffness: Array
    eigenvalues: Array
    directions: Array
    stable: NDArray[np.bool_]
    moment: Array
    field: Array
    currents: Array
    others: Array
    assumptions: tuple[str, ...]
    report: SearchReport

    @property
    def trace(self) -> float:
        """Trace of the stiffness, N/m: 0 for a fixed dipole in a harmonic field (Earnshaw), <= 0 for an
        aligned one."""
        return float(np.trace(self.stiffness))

    @property
    def stable_axes(self) -> dict[str, bool]:
        """Whether a small displacement along x, y or z alone is pushed back along that axis (diagonal of K
        > 0)."""
        return {axis: bool(k > 0.0) for axis, k in zip("xyz", np.diag(self.stiffness), strict=True)}

    @property
    def angle_to_field(self) -> float:
        """Angle between moment and field, degrees. Beyond 90 a free magnet would turn over."""
        cosine = self.moment @ self.field / (np.linalg.norm(self.moment) * np.linalg.norm(self.field))
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
