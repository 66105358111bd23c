"""The iron on a basis of few potentials: what a reduced model is made of, and how far it is from the full solution.

The amplitudes of the basis solve the projected equation of the potential form (docs/theory/iron.md, (7)): the law
B(H) is evaluated at the points of the elements, as in the full model, and the functional stays convex.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from fieldmap.iron.elements.bh_law import LawTables
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import Magnetisation, PotentialForm
from fieldmap.kernels.iron.sample_gradients import sample_gradients
from fieldmap.kernels.map.reduced_iron import newton, tangent_factor
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class GalerkinModel:
    """Projected iron: r modes, c coils, p sample points, s surface faces.

    gradients (3 p, r) and source (3 p, c): gradients of the modes and the coils' field per ampere at the points, in
    T; weights (p,) in m^3; law (p,) and tables: the material there; air (r, r) and constant (r,), see
    `fieldmap.kernels.map.reduced_iron`; charge (r, s): density on the surface faces of every mode, T.
    """

    gradients: Array
    source: Array
    weights: Array
    law: NDArray[np.int64]
    tables: LawTables
    air: Array
    constant: Array
    charge: Array

    def solve(
        self, currents: Array, start: Array, tolerance: float = 1e-8, limit: int = 60
    ) -> tuple[Array, int]:
        """Amplitudes (r,) at currents (c,), and the Newton steps."""
        laws = (self.weights, self.law, *self.tables.arrays)
        factor = np.zeros_like(self.air)
        amplitude, steps, _ = newton(
            self.source @ currents,
            self.gradients,
            self._single,
            *laws,
            self.air,
            self.constant,
            start,
            factor,
            tolerance,
            limit,
        )
        return amplitude, steps

    @cached_property
    def _single(self) -> NDArray[np.float32]:
        return self.gradients.astype(np.float32)

    def energy_contributions(self, currents: Array, amplitude: Array) -> Array:
        """What every point adds to the residual of a state, (p, r), in coordinates in which the square of a residual
        is the energy of the error that it causes there, as a share of the state's own."""
        laws = (self.weights, self.law, *self.tables.arrays)
        source = self.source @ currents
        factor = tangent_factor(source, self.gradients, self._single, *laws, self.air, amplitude)
        # K = L L^T: R . K^-1 R = |L^-1 R|^2, and a . K a = |L^T a|^2.
        inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
        scale = np.linalg.norm(factor.T @ amplitude) or 1.0
        parts = self.contributions(currents, amplitude) @ (inverse.T / scale)
        return np.asarray(self.weights[:, None] * parts)

    def contributions(self, currents: Array, amplitude: Array) -> Array:
        """What every point adds to the residual, (p, r), per unit of its weight."""
        h = self.source @ currents - self.gradients @ amplitude
        h = h.reshape(-1, 3)
        size = np.linalg.norm(h, axis=1) + 1e-14
        b = self.tables.flux_density(size, self.law)
        magnetisation = ((b / size - 1.0)[:, None] * h)[:, :, None]
        return (magnetisation * self.gradients.reshape(len(h), 3, -1)).sum(axis=1)

    def sampled(self, points: NDArray[np.int64], weights: Array) -> "GalerkinModel":
        """The same model on some of its points with other weights (hyper-reduction)."""
        rows = (3 * points[:, None] + np.arange(3)).ravel()
        return GalerkinModel(
            np.ascontiguousarray(self.gradients[rows]),
            np.ascontiguousarray(self.source[rows]),
            weights,
            self.law[points],
            self.tables,
            self.air,
            self.constant,
            self.charge,
        )


def project(form: PotentialForm, material: Magnetisation, unit: CoilField, basis: Array) -> GalerkinModel:
    """Project the potential form on nodal potentials `basis` (n, r); `unit`: field of one ampere in every coil."""
    elements = form.elements
    values = np.ascontiguousarray(basis)
    gradients = sample_gradients(values, elements.nodes, elements.gradients)
    bubble = sample_gradients(np.ascontiguousarray(unit.bubble.T), elements.nodes, elements.gradients)
    source = bubble + np.moveaxis(unit.constant, 0, 2)[:, None]
    points = gradients.shape[0] * 4
    gradients = gradients.reshape(3 * points, -1)
    weights = np.repeat(0.25 * elements.volume, 4)
    weighted = np.repeat(weights, 3)[:, None] * gradients
    remanence = np.repeat(material.remanence[0], 4, axis=0).reshape(-1)
    air = gradients.T @ weighted + values.T @ form.air(values)
    return GalerkinModel(
        gradients,
        source.reshape(3 * points, -1),
        weights,
        np.repeat(material.law, 4),
        material.tables,
        0.5 * (air + air.T),
        weighted.T @ remanence,
        form.charge_density(values),
    )


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
