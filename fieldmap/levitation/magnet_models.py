"""How a levitated magnet is modelled, by name: fixed dipole, aligned dipole, rigid magnet of finite size."""

from typing import Literal, Protocol

import numpy as np

from fieldmap.arguments import check_choice
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, Problem
from fieldmap.levitation.balance import Balance
from fieldmap.levitation.interface import LevitationField
from fieldmap.levitation.rigid_magnet import RigidBalance
from fieldmap.lookup.finite_magnet import volume_rule
from fieldmap.typing import Array

MagnetModel = Literal["fixed", "aligned", "rigid", "rigid upright"]
MODELS = ("fixed", "aligned", "rigid", "rigid upright")
RULE = 3
"""Level of the volume rule of a rigid magnet: exact for fields of degree 5 across it."""
UPRIGHT = 1e6
"""Lever, m, beyond which weight holds a magnet upright against any field."""
_HELD = {
    "fixed": "the magnet is a point dipole that keeps its vertical direction",
    "aligned": "the magnet is a point dipole that stays parallel to the local field",
    "rigid": "the magnet is rigid and of finite size, and turns about its centre until no torque is left",
    "rigid upright": "the magnet is rigid, of finite size, and stays upright",
}


class MagnetBalance(Protocol):
    """Magnetic force and weight of a magnet at fixed currents (`Balance`, `RigidBalance`)."""

    source: LevitationField
    currents: Array

    @property
    def weight(self) -> float:
        """Weight, N."""

    def moments(self, points: Array) -> Array:
        """Moment (n, 3), A m^2."""

    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3), N."""

    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at a position (3,), N/m."""


def magnet_balance(
    field_map: LevitationField,
    currents: Array,
    payload: Payload,
    near: Array,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
) -> MagnetBalance:
    """The force balance of a payload's magnet at currents (n_coils,), A.

    moment: "fixed", a dipole that stays vertical; "aligned", one that follows B; "rigid", the payload's magnet itself,
    integrated over its volume and turned until torque vanishes; "rigid upright", the same without turning. A fixed or
    rigid moment points up or down, whichever is lifted at the point near (3,). lever: of the body's centre of mass
    below the magnet's centre, m, for "rigid". Raises InputError for another name or a payload without a magnet.
    """
    check_choice("moment", moment, MODELS)
    point = np.asarray(near, dtype=float)[None, :]
    if moment == "aligned":
        return Balance(field_map, currents, payload.mass, payload.moment, None)
    sign = 1.0 if field_map.gradient(point, currents)[0, 2, 2] >= 0.0 else -1.0
    if moment == "fixed":
        held = np.array([0.0, 0.0, sign * payload.moment])
        return Balance(field_map, currents, payload.mass, payload.moment, held)
    if payload.magnet is None:
        must = "must have a magnet: its shape, size and remanence"
        raise InputError(
            Problem("payload.magnet", must, "None", "add [payload.magnet], or choose moment='fixed'")
        )
    turning = UPRIGHT if moment == "rigid upright" else lever
    return RigidBalance(field_map, currents, payload.mass, volume_rule(payload.magnet, RULE), turning, sign)


def model_assumptions(moment: MagnetModel, lever: float = 0.0) -> tuple[str, ...]:
    """What a model rests on, in words."""
    words = [_HELD[check_choice("moment", moment, MODELS)]]
    if moment == "rigid":
        words.append(f"the body's centre of mass lies {1e3 * lever:g} mm below the magnet's centre")
    return tuple(words)
