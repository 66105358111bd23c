"""The iron magnetised by unit dipoles in the workspace: how much every face and element counts for the field there.

The field of the iron at a point, in one direction, is a linear functional of its charges. The operator is symmetric, so
that the dual solution of this functional is the same iron in the field of a dipole at that point, in that direction.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.forms.magnetisation import Magnetisation
from fieldmap.iron.forms.permeability import BodyProperties, straight_laws
from fieldmap.iron.forms.potential_form import ConvexForm
from fieldmap.iron.forms.state import IronState
from fieldmap.iron.operators.surface import ChargedFaces

Array = NDArray[np.float64]
_COUNT = 3
# Indicators need no more digits than these.
_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class WorkspaceDipoles:
    """Dipoles at points (p, 3) in the air, along x, y and z at each; mu0 times their moment is 1 T m^3."""

    points: Array

    @classmethod
    def near_iron(cls, candidates: Array, iron: ChargedFaces) -> "WorkspaceDipoles":
        """At three of the candidates (n, 3): the one nearest to the iron, and others of the nearest third that lie
        far from it and from each other."""
        distance = np.array([np.linalg.norm(iron.centres - x, axis=1).min() for x in candidates])
        near = candidates[np.argsort(distance, kind="stable")[: max(_COUNT, len(candidates) // 3)]]
        chosen = near[:1]
        for _ in range(_COUNT - 1):
            apart = np.linalg.norm(near[:, None] - chosen, axis=2).min(axis=1)
            chosen = np.vstack([chosen, near[apart.argmax()]])
        return cls(chosen)

    def flux_densities(self, x: Array) -> Array:
        """Fields (3 p, n, 3) of all dipoles at points x (n, 3), T; not at the dipoles themselves."""
        offset = x - self.points[:, None]
        r = np.linalg.norm(offset, axis=2)[:, :, None, None]
        # (p, n, i, j): component j of the field of the moment along i; symmetric.
        tensor = 3 * offset[:, :, :, None] * offset[:, :, None, :] / r**2 - np.eye(3)
        return np.moveaxis(tensor / (4 * np.pi * r**3), 2, 1).reshape(-1, len(x), 3)

    def magnetise(self, problem: ConvexForm[Any], properties: BodyProperties) -> IronState:
        """The iron in the field of every dipole alone."""
        elements, body = problem.elements, problem.iron.mesh.body
        field = elements.coil_field(self.flux_densities)
        remanence = np.zeros((3 * len(self.points), len(body), 3))
        material = Magnetisation(body, straight_laws(properties.mu_r), remanence)
        return problem.solve_linear(material, field, _TOLERANCE).iron
