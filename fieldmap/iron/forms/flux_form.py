"""The iron by its flux, linear in every element: for any permeability, from barriers to magnets and saturating steel.

B is free of divergence and its normal component continuous, by construction; H is tangentially continuous only in the
mean: the complement of the potential form (`fieldmap.iron.forms.potential_form`), with errors of the other sign in
closed magnetic circuits. The potentials on the faces that tie the elements together (`FluxElements`) obey the same
equations as nodal potentials do, inside and to the air, and are found by the same solver.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from fieldmap.iron.forms.element_fields import linear_field
from fieldmap.iron.forms.flux_elements import FluxElements
from fieldmap.iron.forms.magnetisation import Magnetisation
from fieldmap.iron.forms.nodal_elements import NodalElements
from fieldmap.iron.forms.potential_form import ConvexForm
from fieldmap.iron.forms.state import ElementField
from fieldmap.iron.forms.weak_bodies import BodyNumbers, SurfaceFluxSystem
from fieldmap.iron.operators.assembled import AssembledIron

Array = NDArray[np.float64]
# Thin plates have modes of very small demagnetising factors: a barrier of 60 : 1 takes 85 steps.
_MAX_STEPS_OF_WEAK_BODIES = 250


class FluxForm(ConvexForm[FluxElements]):
    """One mesh in the flux form."""

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
