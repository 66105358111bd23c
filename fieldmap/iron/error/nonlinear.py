"""The estimated error of a state of saturating iron: the same currents in the flux form, and on a coarser mesh."""

from dataclasses import dataclass

from fieldmap.device.model import Coil, Device
from fieldmap.errors import NotConverged
from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.error.estimate import ErrorEstimate, estimate_error, workspace_surface
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class _StateFields:
    """Fields of one state outside the iron, as `fieldmap.iron.error.estimate` asks for them."""

    coils: tuple[Coil, ...]
    currents: Array
    iron: IronState

    @property
    def sources(self) -> tuple[str, ...]:
        """There is one: all currents together."""
        return ("these currents",)

    def unit_fields(self, points: Array) -> tuple[Array, Array]:
        """Field (1, n, 3) and gradient (1, n, 3, 3) at points (n, 3)."""
        b, g = self.iron.faces.field_and_gradient(points, self.iron.density)
        for coil, current in zip(self.coils, self.currents, strict=True):
            coil_b, coil_g = unit_flux_density_and_gradient(coil, points)
            b[0] += current * coil_b
            g[0] += current * coil_g
        return b, g


class Complement:
    """The flux form of a mesh, for states that the potential form has solved on it."""

    def __init__(self, iron: AssembledIron) -> None:
        self._form = FluxForm(iron)

    def solve(
        self, material: Magnetisation, field: CoilField, potential: Array, tolerance: float
    ) -> IronState:
        """The state of the same sources, by Newton from the nodal potential (k, 1). Raises NotConverged."""
        elements = self._form.elements
        values = elements.nodal.coil_field_at_points(field)
        try:
            start = elements.from_nodal(potential)
            return self._form.solve(material, values, tolerance, start).iron
        except NotConverged:
            return self._form.solve(material, values, tolerance).iron


def state_error(
    device: Device, currents: Array, iron: IronState, coarser: IronState, complement: IronState
) -> ErrorEstimate:
    """Estimate for `iron` in the workspace, from the same currents on a coarser mesh and in the flux form."""
    fine, coarse, other = (
        _StateFields(device.coils, currents, state) for state in (iron, coarser, complement)
    )
    return estimate_error(workspace_surface(device), fine, coarse, other)
