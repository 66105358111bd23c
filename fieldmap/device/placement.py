"""Where a shape or a coil stands: the frozen data, and the keys position_mm and rotation_deg."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field

from fieldmap.inputs.tables import MILLI, Point, Table, read_only
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Placement(Record):
    """global = rotation @ local + position.

    position (3,) in m; rotation (3, 3), orthonormal, determinant +1.
    """

    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))


Angle = Annotated[float, Field(ge=-360, le=360)]
Angles = Annotated[list[Angle], Field(min_length=3, max_length=3)]


def _cosine_and_sine(angle_deg: float) -> tuple[float, float]:
    """Exact at whole quarter turns, so that a body turned by 90 deg stays axis-parallel to the last bit."""
    if angle_deg % 90 == 0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(angle_deg // 90) % 4]
    return float(np.cos(np.deg2rad(angle_deg))), float(np.sin(np.deg2rad(angle_deg)))


def rotation_matrix(rotation_deg: list[float]) -> Array:
    """Turn about the fixed x axis, then the fixed y axis, then the fixed z axis: Rz @ Ry @ Rx, (3, 3).

    >>> rotation_matrix([0, 0, 90]) @ [1.0, 0.0, 0.0]
    array([0., 1., 0.])
    """
    (cx, sx), (cy, sy), (cz, sz) = (_cosine_and_sine(angle) for angle in rotation_deg)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x + 0.0  # + 0.0 turns -0.0 into 0.0


class PlacementKeys(Table):
    """Where the local frame stands in the device's frame."""

    position_mm: Point = Field(default=[0.0, 0.0, 0.0], description="[x, y, z] of the local origin")
    rotation_deg: Angles = Field(
        default=[0.0, 0.0, 0.0],
        description="[x, y, z] angles, turned about the fixed x, then the fixed y, then the fixed z axis",
    )

    def placement(self) -> Placement:
        """In SI."""
        rotation = read_only(rotation_matrix(self.rotation_deg).tolist())
        return Placement(read_only(self.position_mm, MILLI), rotation)
