"""How far a state on few modes is from the full solution, without solving: its residual, and what it says."""

import numpy as np

from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import Magnetisation, PotentialForm
from fieldmap.typing import Array


class ResidualEstimate:
    """Residuals of potentials `basis` @ a (n,), r modes, and the corrections that follow from them.

    The correction is what the residual asks for at the tangent of one state, the air being replaced by its capacity:
    the first step of the solver's own iteration. Its energy, relative to the state's, ranks states; it is an error up
    to a factor that depends on how much more permeable the iron is than in that state.
    """

    def __init__(
        self,
        form: PotentialForm,
        material: Magnetisation,
        field: CoilField,
        potential: Array,
        basis: Array,
    ) -> None:
        self._form, self._material = form, material
        self._factor = form.preconditioner(material, field, potential)
        self._basis, self._air = basis, form.air(basis)

    def residual(self, field: CoilField, amplitude: Array) -> Array:
        """R (n,) of the state of coil field `field` and amplitudes (r,)."""
        inner = self._form.inner_residual(self._basis @ amplitude, field, self._material)
        return np.asarray(inner - self._air @ amplitude)

    def correction(self, residual: Array) -> Array:
        """(n, k) for residuals (n, k)."""
        return self._factor.solve(residual)
