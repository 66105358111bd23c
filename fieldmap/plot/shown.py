"""Contents of a scene: a device, a field at given currents in a box, results in the field, or a recorded run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from fieldmap.arguments import raise_all
from fieldmap.device.model import Device, Payload
from fieldmap.errors import InputError, Problem
from fieldmap.field import AnyField, Bounds, FieldAtCurrents, as_field
from fieldmap.levitation import EquilibriumSurface, ReachableSet, SearchedSet
from fieldmap.plain import Plain, plain_items
from fieldmap.plot.places import MM, pose
from fieldmap.records import Record
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.iron import IronMesh


@dataclass(frozen=True, eq=False, repr=False)
class ShownRun(Record):
    """Signals of one run: time (r,), s; position of the centre of mass (r, 3), m; quaternion (r, 4), body to map, w
    first; currents (r, n), A; wanted (r, 3): reference of the centre of mass, m. body: radius and height of a cylinder
    about the centre of mass, m, or None. event: the event that ended the run, or ""."""

    title: str
    device: Device
    time: Array
    position: Array
    quaternion: Array
    currents: Array
    wanted: Array
    body: tuple[float, float] | None
    event: str

    def pose(self, k: int) -> Array:
        """Matrix (4, 4) that moves the body, drawn about the origin in mm, to its pose at sample k."""
        turn = scipy.spatial.transform.Rotation.from_quat(self.quaternion[k], scalar_first=True)
        return pose(turn.as_matrix(), MM * self.position[k])


@dataclass(frozen=True, eq=False, repr=False)
class Shown(Record):
    """Everything that a scene may draw; None for contents that are missing.

    title: a line of text for the picture. field: at currents (n_coils,), A; a field of currents is fixed at these.
    lower, upper (3,): corners of the box, m. everywhere: whether the field is also valid outside the box and inside
    iron (a solution, not a map). flux_density (e, 3): of every element of the iron, T, and mesh: these elements.
    equilibrium: position of the magnet's centre (3,), m, or None. surface: its equilibria over the direction signals.
    reachable: forces or flux densities at one point. run: a recorded run. assumptions: of the field.
    """

    title: str
    device: Device | None = None
    field: AnyField | None = None
    currents: Array | None = None
    lower: Array | None = None
    upper: Array | None = None
    everywhere: bool = False
    mesh: IronMesh | None = None
    flux_density: Array | None = None
    payload: Payload | None = None
    equilibrium: Array | None = None
    surface: EquilibriumSurface | None = None
    reachable: ReachableSet | SearchedSet | None = None
    run: ShownRun | None = None
    assumptions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # A field of currents, such as an opened map, is fixed at the shown currents.
        if self.field is not None and not hasattr(self.field, "currents") and self.currents is not None:
            object.__setattr__(self, "field", as_field(self.field).at(self.currents))
        held = getattr(self.field, "currents", None)
        if held is not None and self.currents is not None and not np.array_equal(held, self.currents):
            received = f"{self.currents.tolist()}, while the field holds {np.asarray(held).tolist()}"
            remedy = "take the field at the currents that are shown: field.at(currents)"
            raise InputError.of("Shown(currents)", "must be those of the field", received, remedy)

    def need(self, *names: str) -> None:
        """Refuse missing contents.

        Parameters
        ----------
        *names
            Names of attributes.

        Raises
        ------
        InputError
            If one of them is None.
        """
        raise_all(
            Problem(
                self.title,
                f"must have {_NEEDS[name]}",
                "none",
                _REMEDIES.get(name, "name another device or map"),
            )
            for name in names
            if getattr(self, name) is None
        )

    @property
    def box(self) -> Bounds:
        """Lower and upper corner (3,), m."""
        return np.asarray(self.lower, dtype=float), np.asarray(self.upper, dtype=float)

    @property
    def payload_at(self) -> Array | None:
        """Where a picture of the device shows the payload (3,), m: in the equilibrium if it is known, else in the
        middle of the workspace; None without either."""
        if self.equilibrium is not None:
            return self.equilibrium
        space = None if self.device is None else self.device.workspace
        return None if space is None else np.mean(space.bounds, axis=0)

    def flux_density_at(self, points: Array) -> Array:
        """Flux density of the shown field.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        Array
            B (n, 3), T.
        """
        return np.asarray(self.state.field(points))

    def gradient_at(self, points: Array) -> Array:
        """Gradient of the shown field.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        Array
            dB_i/dx_j (n, 3, 3), T/m.
        """
        return np.asarray(self.state.gradient(points))

    @property
    def state(self) -> FieldAtCurrents:
        """The field at the shown currents."""
        assert isinstance(self.field, FieldAtCurrents)
        return self.field

    def to_dict(self) -> dict[str, Plain]:
        """Title, currents, box, and all results that exist, as plain Python."""
        known: dict[str, object] = {
            "title": self.title,
            "currents": self.currents,
            "lower": self.lower,
            "upper": self.upper,
            "equilibrium": self.equilibrium,
            "assumptions": self.assumptions or None,
            "tetrahedra": None if self.mesh is None else len(self.mesh.tets),
        }
        if self.surface is not None:
            for name in ("x_signals", "y_signals", "positions", "levels", "stable", "field_scale"):
                known[name] = getattr(self.surface, name)
            known["assumptions"] = (*self.assumptions, *self.surface.assumptions)
        if self.reachable is not None:
            known["reachable"] = self.reachable
        if self.run is not None:
            known["event"] = self.run.event
            known["duration"] = float(self.run.time[-1] - self.run.time[0])
            known["last_position"] = self.run.position[-1]
        return plain_items(**{name: value for name, value in known.items() if value is not None})


_NEEDS = {
    "device": "a device to draw",
    "field": "a field",
    "lower": "a workspace",
    "mesh": "iron with a mesh",
    "payload": "a payload",
    "equilibrium": "an equilibrium",
    "surface": "equilibria over the direction signals",
    "reachable": "a set of reachable forces",
    "run": "a recorded run",
}
_REMEDIES = {
    "run": "name a file that `fieldmap simulate -o RUN.h5` wrote",
    "device": "name the device file instead of the map",
    "mesh": "name a device with iron; a map does not hold its mesh",
    "lower": "add a [workspace] table to the device",
    "payload": "add a [payload] table to the device",
}
