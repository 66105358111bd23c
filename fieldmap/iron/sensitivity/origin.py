"""What a solved state keeps of its device, so that it can tell derivatives: not its matrices, which are many times
larger than the state. They are used as long as their solver lives, and made anew from the state's mesh otherwise."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from functools import partial
from typing import Any

from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import LawTables, law_tables, straight_laws
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.elements.state import PotentialField
from fieldmap.iron.materials import body_properties, materials_on
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.sensitivity.adjoint import IronProblem, derivatives
from fieldmap.iron.sensitivity.changes import Parameters
from fieldmap.iron.sensitivity.derivatives import Derivatives
from fieldmap.iron.sensitivity.quantities import Quantity
from fieldmap.iron.solution import SolvedState
from fieldmap.records import shortened
from fieldmap.sources import unit_flux_densities
from fieldmap.typing import Array


class Origin:
    """The device of states. linear: whether its iron was solved as linear, with mu_r in the place of its soft bodies'
    own where that is given."""

    def __init__(self, device: Device, linear: bool, mu_r: float | None = None) -> None:
        self.device, self.linear, self.mu_r = device, linear, mu_r
        self._solver: Any = None
        self._own: IronProblem | None = None

    def hold(self, problem: IronProblem) -> None:
        """Use these equations as long as somebody else holds them."""
        self._solver = weakref.ref(problem)

    def __repr__(self) -> str:
        iron = "linear" if self.linear else "saturating"
        return shortened(f"Origin({self.device.name}, {iron} iron)")

    def __getstate__(self) -> dict[str, Any]:
        return {
            "device": self.device,
            "linear": self.linear,
            "mu_r": self.mu_r,
            "_solver": None,
            "_own": None,
        }

    def derivative(
        self,
        state: SolvedState,
        quantity: Quantity,
        parameters: Sequence[str],
        followed: Parameters | None = None,
    ) -> Derivatives:
        """See `SolvedState.derivative`; followed: what of the device follows the keys, where its own file does not
        tell."""
        keys = (parameters,) if isinstance(parameters, str) else tuple(parameters)
        return derivatives(self.device, state, self._problem(state), quantity, keys, followed)

    def _problem(self, state: SolvedState) -> IronProblem | None:
        if state.iron is None:
            return None
        inside = state.iron.inside
        if state.mesh is None or not isinstance(inside, PotentialField):
            must_hold, remedy = "derivatives are those of the potential form", 'solve with form="potential"'
            raise InputError(Problem("derivative", must_hold, f"the {state.report.form} form", remedy))
        known = self._solver() if self._solver is not None else self._own
        if known is None or known.form.elements is not inside.elements:
            known = self._own = self._assembled(state.mesh, inside)
        return known

    def _assembled(self, mesh: IronMesh, inside: PotentialField) -> IronProblem:
        form = PotentialForm(assemble(mesh))
        # Of the same mesh, so that they are equal; one of the two need not be kept.
        form.elements = inside.elements
        coils = self.device.coils
        unit = inside.elements.coil_field(lambda x: unit_flux_densities(coils, x), mesh.symmetry)
        return IronProblem(form, unit, partial(self.laws, mesh=mesh))

    def laws(self, device: Device, mesh: IronMesh) -> tuple[LawTables, Array]:
        """Tables and remanence (b, 3) of the bodies of a device, and of the sheets between them, on a mesh."""
        return laws_of(device, mesh, self.linear, self.mu_r)


def laws_of(device: Device, mesh: IronMesh, linear: bool, mu_r: float | None) -> tuple[LawTables, Array]:
    """Tables of laws and remanence (b, 3) of bodies and of the sheets between them."""
    properties = body_properties(device, mu_r).on(mesh)
    if linear:
        return straight_laws(properties.mu_r), properties.remanence
    return law_tables(materials_on(device, mesh)), properties.remanence
