"""S14: where the unit's magnet comes to rest as the direction signals change, under stated rules and with nothing
fitted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.current_division import divide_currents
from fieldmap.device.model import Payload
from fieldmap.errors import OutsideMapError
from fieldmap.levitation import (
    GRAVITY,
    LevitationField,
    MagnetModel,
    equilibrium_at,
    magnet_height,
    thesis_lift_current,
)
from fieldmap.thesis.unit_rays import UnitRays
from fieldmap.thesis.unit_states import UnitStates
from fieldmap.typing import Array

Rule = Literal["constant", "held"]
FAR = 0.34
"""Direction signals beyond this are solved as states: the map is off by 0.1 to 0.2 mm there."""

COMMON = (
    "iron: drive_unit with its B-H table, one state for each set of currents, no hysteresis, no eddy currents",
    "h, the depth of the magnet's centre below the point that the sensor reads, is not known: scanned, never fitted",
    "positions count from the place at signal 0, as a sensor does that was set to zero there",
)
RULES: dict[str, str] = {
    "constant": "the current level stays what (7-18) says on the axis; the vertical force is left unbalanced",
    "held": "the level rises so that the lift stays what it is at the origin at the current of (7-18): the vertical "
    "controller, which holds z_s; the scale of the force that makes it carry the weight there drops out",
}
MAP_WORDS = "n = 1.25 and signals up to 0.3: map `division`; otherwise solved states"


@dataclass(frozen=True, eq=False)
class Shift:
    """Places (k, 2), m, of the magnet at signals (k,), counted from `origin` (2,), the place at signal 0; levels (k,),
    A: mean current; largest (k,), A: that of the coil with most; all_stable: whether every one is pushed back."""

    signals: Array
    places: Array
    origin: Array
    levels: Array
    largest: Array
    all_stable: bool

    @property
    def along(self) -> Array:
        """Shift (k,), m, along the axis that moves most."""
        return self.places[:, int(np.ptp(self.places, axis=0).argmax())]


@cache
def unit_states() -> UnitStates:
    """States of the unit at the shipped mesh, kept in maps/out."""
    return UnitStates()


@cache
def unit_rays() -> UnitRays:
    """The unit for any currents."""
    return UnitRays(unit_states())


def payload() -> Payload:
    """The microrobot."""
    carried = unit_states().device.payload
    assert carried is not None
    return carried


def lift_share(field: LevitationField, z_s: float, h: float, current: float) -> float:
    """Lift over weight on the axis at a current in each coil, A; z_s and h in mm."""
    point = np.array([[0.0, 0.0, magnet_height(z_s, 1e-3 * h)]])
    carried = payload()
    force = carried.moment * field.gradient(point, np.full(6, current))[0, 2, 2]
    return float(force / (carried.mass * GRAVITY))


def shift(
    fields: Sequence[LevitationField],
    signals: ArrayLike,
    axis: Literal["x", "y"] = "x",
    n: float = 1.25,
    z_s: float = 10.0,
    h: float = 15.0,
    rule: Rule = "held",
    level: float | None = None,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
    far: float = FAR,
) -> Shift:
    """The magnet followed from signal 0 through signals of one sign, in rising size.

    fields: where to take the field from, in order of preference; the next one where currents are beyond a map's
    domain, the last one for signals beyond `far`. z_s, h: mm. level: current in each coil at the origin, A; (7-18)
    unless given. Raises NoEquilibrium, OutsideMapError.
    """
    start_level = thesis_lift_current(z_s) if level is None else level
    wanted = np.concatenate([[0.0], np.asarray(signals, dtype=float)])
    place, height = np.zeros(2), magnet_height(z_s, 1e-3 * h)
    found, scale, u = [], 1.0, start_level
    for signal in wanted:
        chosen = fields[-1:] if abs(signal) > far else fields
        held = rule == "held" and signal != 0.0
        point, u = _first(
            chosen,
            lambda level, s=signal: (_divided(level, s, axis, n), height),
            (place, u if held else start_level, held, scale, moment, lever),
        )
        if signal == 0.0:
            scale = payload().mass * GRAVITY / point.lift
        place = point.position[:2]
        found.append((place.copy(), u, np.abs(_divided(u, signal, axis, n)).max(), point.kind == "stable"))
    places = np.array([row[0] for row in found])
    levels, largest = (np.array([row[k] for row in found]) for k in (1, 2))
    stable = all(row[3] for row in found)
    return Shift(wanted[1:], places[1:] - places[0], places[0], levels[1:], largest[1:], stable)


def _first(fields: Sequence[LevitationField], path, about):
    """`equilibrium_at` in the first field that holds at the currents of the search."""
    for field in fields[:-1]:
        try:
            return equilibrium_at(field, payload(), path, *about)
        except OutsideMapError:
            continue
    return equilibrium_at(fields[-1], payload(), path, *about)


def _divided(level: float, signal: float, axis: str, n: float) -> Array:
    x, y = (signal, 0.0) if axis == "x" else (0.0, signal)
    return divide_currents(level, x, y, n)
