"""Coils wound along a closed plane path of straight pieces with rounded corners."""

from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.coils.base import Coil, RoundedKeys, require_room_for_the_winding
from fieldmap.device.coils.winding import WindingPath, rounded_path
from fieldmap.device.dimensions import SimplePolygon
from fieldmap.device.placement import Placement
from fieldmap.device.polygons import reflected_polygon, rounding_fault, signed_area
from fieldmap.inputs.tables import MILLI, Length, broken, read_only
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class PathCoil(Coil):
    """Plane closed path: corner points (n, 2) of the middle line in order (counter-clockwise = positive
    current at polarity +1), every corner rounded with corner_radius >= thickness/2."""

    kind: ClassVar[str] = "path"

    name: str
    corners: Array
    corner_radius: float
    thickness: float
    height: float
    turns: float
    polarity: int = 1
    placement: Placement = field(default_factory=Placement)
    resistance: float | None = None
    inductance: float | None = None

    def reflected(self, axis: int) -> "PathCoil":
        """See `Coil.reflected`: the corners mirrored, counter-clockwise as before."""
        return replace(self, corners=read_only(reflected_polygon(self.corners.tolist(), axis)))

    def winding(self) -> WindingPath:
        """An arc at every corner, bars between them."""
        corners = np.asarray(self.corners, dtype=float)
        return rounded_path(self.name, corners, self.corner_radius, self.thickness, self.height)


class PathCoilKeys(RoundedKeys):
    """Closed plane path with rounded corners."""

    rank: ClassVar[int] = 20

    kind: Literal["path"] = Field(description="closed plane path with rounded corners")
    corners_mm: SimplePolygon = Field(
        description="[[x, y], ...] corners of the middle line, counter-clockwise"
    )
    corner_radius_mm: Length = Field(description="radius of every corner, at the winding's middle line")

    @field_validator("corners_mm")
    @classmethod
    def _counter_clockwise(cls, value: list[list[float]]) -> list[list[float]]:
        if signed_area(value) < 0:
            raise broken(
                "the corners must run counter-clockwise seen from local +z",
                "a clockwise path",
                "list the corners in the opposite order; set polarity = -1 to reverse the current",
            )
        return value

    @field_validator("corner_radius_mm")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        require_room_for_the_winding(value, info)
        corners = info.data.get("corners_mm")
        fault = None if corners is None else rounding_fault(corners, value)
        if fault is not None:
            raise broken(
                "every edge of the path must be long enough for the arcs at its two ends",
                fault,
                "reduce corner_radius_mm or move the corners apart",
            )
        return value

    def to_model(self) -> PathCoil:
        """In SI."""
        return PathCoil(
            corners=read_only(self.corners_mm, MILLI),
            corner_radius=self.corner_radius_mm * MILLI,
            thickness=self.thickness_mm * MILLI,
            height=self.height_mm * MILLI,
            **self.common(),
        )
