"""What is shown: a device or a map at given currents, and the box in which its field is looked at."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Device, Payload
from fieldmap.errors import InputError, Problem
from fieldmap.levitation import EquilibriumSurface
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.plot.trajectory import ShownRun


class ShownField(Protocol):
    """A field that can be asked anywhere in the box: an opened map, or a solution."""

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Everything a scene may draw; what is None cannot be drawn.

    title: a line of text for the picture. currents (n_coils,), A. lower, upper (3,): corners of the box, m. everywhere:
    the field also holds outside the box and inside iron (a solution, not a map). flux_density (e, 3): of every element
    of the iron, T, and mesh: these elements. equilibrium: position of the magnet's centre (3,), m, or None.
    surface: where it rests over the direction signals. run: a recorded run. assumptions: what the field rests on.
    """

    title: str
    device: Device | None = None
    field: ShownField | None = None
    currents: Array | None = None
    lower: Array | None = None
    upper: Array | None = None
    everywhere: bool = False
    mesh: Any = None
    flux_density: Array | None = None
    payload: Payload | None = None
    equilibrium: Any = None
    surface: EquilibriumSurface | None = None
    run: "ShownRun | None" = None
    assumptions: tuple[str, ...] = ()

    def need(self, *names: str) -> None:
        """Raise InputError for what is None though a scene needs it."""
        problems = [
            Problem(
                self.title,
                f"must have {_NEEDS[name]}",
                "none",
                _REMEDIES.get(name, "name another device or map"),
            )
            for name in names
            if getattr(self, name) is None
        ]
        if problems:
            raise InputError(*problems)

    def flux_density_at(self, points: Array) -> Array:
        """B (n, 3), T."""
        assert self.field is not None
        assert self.currents is not None
        return np.asarray(self.field.field(points, self.currents))

    def gradient_at(self, points: Array) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        assert self.field is not None
        assert self.currents is not None
        return np.asarray(self.field.gradient(points, self.currents))


_NEEDS = {
    "device": "a device to draw",
    "field": "a field",
    "lower": "a workspace",
    "mesh": "iron with a mesh",
    "payload": "a payload",
    "equilibrium": "an equilibrium",
    "surface": "places of rest over the direction signals",
    "run": "a recorded run",
}
_REMEDIES = {
    "run": "name a file that `fieldmap simulate -o RUN.h5` wrote",
    "device": "name the device file in the place of the map",
    "mesh": "name a device with iron; a map does not hold its mesh",
    "lower": "add a [workspace] table to the device",
    "payload": "add a [payload] table to the device",
}


def element_flux_density(solution: Any, currents: Array) -> Array:
    """B (e, 3) in T in every element of a solution's iron at currents (n_coils,), A."""
    state = solution.state
    if hasattr(state, "iron"):
        return np.asarray(state.iron.flux_density[0])
    weights = np.append(currents, 1.0) if solution.has_remanence else currents
    return np.einsum("c,ced->ed", weights, state.flux_density)
