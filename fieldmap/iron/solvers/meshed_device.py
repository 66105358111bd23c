"""The base class of the solvers of saturating iron, with hysteresis or without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fieldmap.device.model import Device
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import Magnetised, PotentialForm
from fieldmap.iron.geometry.checks import check_geometry
from fieldmap.iron.materials import materials_on, require_soft_bodies
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.reaction import TOLERANCE
from fieldmap.iron.report import Progress, Stages
from fieldmap.iron.solvers.reduced import GalerkinModel, project
from fieldmap.typing import Array


class MeshedDevice:
    """A device meshed and assembled once, in the potential form."""

    _form_class: type[PotentialForm] = PotentialForm
    _many_solutions = True
    has_iron = True

    def __init__(self, device: Device, refinement: float, progress: Progress | None, symmetry: str) -> None:
        self.device = device
        require_soft_bodies(device)
        stages = Stages(progress)
        stages.next("checking the geometry", 0.0)
        check_geometry(device)
        stages.next("meshing the iron", 0.02)
        mesh = generate_mesh(device, refinement, symmetry)
        stages.next("mutual potentials of the faces", 0.08)
        self._iron = assemble(mesh, self._many_solutions)
        stages.next("air operator", 0.7)
        self._form = self._form_class(self._iron)
        stages.next("field of the coils in the iron", 0.83)
        self._unit = self._form.elements.unit_fields(device.coils, mesh)
        stages.done("assembled")
        self._seconds = stages.seconds
        background = device.background
        self._background: CoilField | None = None
        if background is not None:
            self._background = self._form.elements.coil_field(lambda x: background.field(x)[None])
        materials = materials_on(device, mesh)
        remanence = np.array([material.remanence for material in materials])[mesh.body][None]
        self._material = Magnetisation(mesh.body, law_tables(materials), remanence)

    @property
    def surface(self) -> ChargedFaces:
        """The charged faces of the states and of the modes of `project`."""
        return self._iron.surface

    @property
    def matrix_bytes(self) -> int:
        """Memory of the mutual potentials of the faces and their inverse."""
        return self._iron.mutual.bytes

    def charge_density(self, potential: Array) -> Array:
        """Charge per area of `surface`.

        Parameters
        ----------
        potential
            Nodal potentials (n, k).

        Returns
        -------
        Array
            Charge densities (k, s), T.
        """
        return self._form.charge_density(potential)

    def project(self, basis: Array, air: Array | None = None) -> GalerkinModel:
        """The iron on a basis of nodal potentials.

        Parameters
        ----------
        basis
            Potentials (n, r), such as combinations of states' potentials.
        air
            The result of `air` for the basis, if it is known.

        Returns
        -------
        GalerkinModel
            The reduced model.
        """
        of_air = self.air(basis) if air is None else air
        return project(self._form, self._material, self._unit, self._background, basis, of_air)

    def air(self, potential: Array) -> Array:
        """S phi, the air's part of the residual, which is linear.

        Parameters
        ----------
        potential
            Nodal potentials (n, k).

        Returns
        -------
        Array
            S phi (n, k).
        """
        return self._form.exterior.apply(potential)

    def coil_field(self, currents: Array) -> CoilField:
        """The field of coils and background in the iron, as the forms take it.

        Parameters
        ----------
        currents
            Currents (c,), A.

        Returns
        -------
        CoilField
            The field.
        """
        own = self._unit.combined(currents[None])
        return own if self._background is None else own + self._background

    def magnetised_at(self, currents: Array, potential: Array) -> Magnetised:
        """The response of a state's charges to small fields of other sources.

        Parameters
        ----------
        currents
            Currents (c,), A.
        potential
            Nodal potential (n,) of the state.

        Returns
        -------
        Magnetised
            The response, as `fieldmap.iron.reaction` takes it.
        """
        tangent = self._form.tangent(potential, self.coil_field(currents), self._material)
        return self._form.magnetised(tangent, self._material, TOLERANCE)

    def _energy_operator(
        self, currents: Array, potential: Array, material: Magnetisation
    ) -> Callable[[Array], Array]:
        """The tangent at a state, iron and air: a function of nodal potentials (n, k), symmetric and positive."""
        tangent = self._form.tangent(potential, self.coil_field(currents), material)
        return lambda values: tangent @ values + self.air(values)
