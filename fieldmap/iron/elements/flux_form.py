"""The flux form: linear iron of any permeability, flux barriers too.

For bodies less permeable than air the surface flux is the unknown.

With stiffness K of the iron, air S and surface means M (`fieldmap.iron.operators.exterior`), both forms solve
(K + M^T S M) l = r. Where mu_r >= 1, K outweighs S and its factor is a good preconditioner. Where mu_r << 1 the
air outweighs the iron, and the unknown is the outward flux x = S M l, with l = K^-1 (r - M^T x):

    x + S T x = S M K^-1 r + S const,      T = M K^-1 M^T,      sum of x over each magnetic body = 0.

A factor 1 / nu of the faces' own bodies brings this operator close to a multiple of the identity: for a mode of
magnetisation with demagnetising factor D the left side is 1 + nu (1 - D) / D. K is singular for constants;
they follow from the zero net flux.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.flux_elements import FluxElements
from fieldmap.iron.elements.nodal_elements import NodalElements
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import ElementField, linear_field
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.exterior import Exterior
from fieldmap.iron.operators.linear_systems import block_gmres
from fieldmap.iron.operators.sparse_cholesky import Elimination
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class BodyNumbers(Record):
    """Which magnetic body (a connected piece) the surface faces (s,) and the unknowns (n,) belong to."""

    surface: NDArray[np.int64]
    unknowns: NDArray[np.int64]


class SurfaceFluxSystem:
    """K and S of one mesh and material; reluctivity (s,) is that of the elements below the surface faces."""

    def __init__(
        self,
        stiffness: csr_matrix,
        face_mean: csr_matrix,
        exterior: Exterior,
        body: BodyNumbers,
        reluctivity: Array,
    ) -> None:
        self._mean, self._exterior, self._body, self._stiffness = face_mean, exterior, body, stiffness
        # One unknown of each magnetic body is fixed at zero; its equation follows from the others.
        fixed = np.unique(body.unknowns, return_index=True)[1]
        self._free = np.setdiff1d(np.arange(len(body.unknowns)), fixed)
        inner = stiffness[self._free][:, self._free]
        self._factor = Elimination.of(inner).factor(inner.data)
        self._scale = 1 / np.maximum(1.0, reluctivity)[:, None]
        self._sums = (body.surface[:, None] == np.arange(len(fixed))).astype(float)
        self._flux_of_constants = exterior.flux(self._sums)
        self._net = np.linalg.inv(self._sums.T @ (self._scale * self._flux_of_constants))

    def solve(self, right: Array, tolerance: float, max_steps: int) -> tuple[Array, list[Array]]:
        """l (n, c) for r (n, c), whose sum over each body is zero; and the residual norms (c,) after each step.

        An error of x counts 1 / mu_r times in l: what the first pass leaves is solved for once more.
        """
        potential, history = self._pass(right, tolerance, max_steps)
        air = self._mean.T @ self._exterior.flux(self._mean @ potential)
        correction, more = self._pass(right - self._stiffness @ potential - air, tolerance, max_steps)
        return potential + correction, history + more

    def _pass(self, right: Array, tolerance: float, max_steps: int) -> tuple[Array, list[Array]]:
        def operator(flux: Array) -> Array:
            means = self._mean @ self._inside(self._mean.T @ flux)
            return self._without_net_flux(flux + self._exterior.flux(means))

        inside = self._inside(right)
        drive = self._without_net_flux(self._exterior.flux(self._mean @ inside))
        flux, history = block_gmres(operator, drive, tolerance, max_steps)
        potential = inside - self._inside(self._mean.T @ flux)
        net = self._sums.T @ self._exterior.flux(self._mean @ potential)
        constants = np.linalg.solve(self._sums.T @ self._flux_of_constants, -net)
        return potential + constants[self._body.unknowns], history

    def _inside(self, right: Array) -> Array:
        potential = np.zeros_like(right)
        potential[self._free] = self._factor.solve(right[self._free])
        return potential

    def _without_net_flux(self, flux: Array) -> Array:
        """Scale, and remove what constants make: the result has zero sum over each body, to rounding."""
        value = self._scale * flux
        return value - self._scale * self._flux_of_constants @ (self._net @ (self._sums.T @ value))


# Thin plates have modes of very small demagnetising factors: a barrier of 60 : 1 takes 85 steps.
_MAX_STEPS_OF_WEAK_BODIES = 250


class FluxForm(ConvexForm[FluxElements]):
    """One mesh in the flux form."""

    name = "flux"

    def __init__(self, iron: AssembledIron) -> None:
        nodal = NodalElements.from_mesh(iron.mesh, iron.topology)
        super().__init__(iron, FluxElements.from_mesh(nodal, iron.topology))

    def _linear_system(
        self, stiffness: csr_matrix, material: Magnetisation, right: Array, tolerance: float
    ) -> tuple[Array, list[Array]]:
        slope = material.tables.coefficients[material.tables.offset[material.law], 2]
        if slope.min() >= 1:
            return super()._linear_system(stiffness, material, right, tolerance)
        faces, unknowns = self.iron.topology, np.zeros(self.elements.count, np.int64)
        unknowns[self.elements.unknowns] = faces.group_of_tet[:, None]
        body = BodyNumbers(faces.group_of_surface, unknowns)
        below = slope[faces.owner[faces.surface, 0]]
        system = SurfaceFluxSystem(stiffness, self.elements.face_mean, self._exterior, body, 1 / below)
        return system.solve(right, tolerance, _MAX_STEPS_OF_WEAK_BODIES)

    def _inside(self, potential: Array, field: Array, material: Magnetisation) -> ElementField:
        return linear_field(self.elements.strength_at_points(potential, field, material), material)
