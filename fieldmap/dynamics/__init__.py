"""Motion of a levitated magnet on a map: rigid body, coils, instruments and controllers in one compiled loop.

Depends on: errors, arguments, kernels, device, store, lookup, levitation, control, instruments.
"""

from fieldmap.dynamics.motion import (
    FixedCurrentsRun,
    angular_momentum,
    energy,
    move,
    move_adaptively,
    state_of,
)
from fieldmap.dynamics.rigid_body import RigidBody, body_of_payload
from fieldmap.dynamics.surroundings import Drag, Plate, Walls

__all__ = [
    "Drag",
    "FixedCurrentsRun",
    "Plate",
    "RigidBody",
    "Walls",
    "angular_momentum",
    "body_of_payload",
    "energy",
    "move",
    "move_adaptively",
    "state_of",
]
