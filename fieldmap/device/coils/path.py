"""Coils wound along a closed plane path of straight pieces with rounded corners."""

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ValidationInfo

from fieldmap.device.coils import base
from fieldmap.device.coils.winding import WindingPath, rounded_path
from fieldmap.device.placement import Placement
from fieldmap.device.polygons import SimplePolygon, reflected_polygon, rounding_fault, signed_area
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, broken, read_only
from fieldmap.typing import Array


def _require_counter_clockwise(corners: list[list[float]], info: ValidationInfo) -> None:
    if signed_area(corners) < 0:
        raise broken(
            "the corners must run counter-clockwise seen from local +z",
            "a clockwise path",
            "list the corners in the opposite order; set polarity = -1 to reverse the current",
        )


def _require_fit(corner_radius: float, info: ValidationInfo) -> None:
    base.require_room_for_the_winding(corner_radius, info)
    corners = info.data.get("corners_mm")
    fault = None if corners is None else rounding_fault(corners, corner_radius)
    if fault is not None:
        raise broken(
            "every edge of the path must be long enough for the arcs at its two ends",
            fault,
            "reduce corner_radius_mm or move the corners apart",
        )


@dataclass(frozen=True, eq=False, repr=False)
class PathCoil(base.Coil):
    """Closed plane path with rounded corners.

    Corner points (n, 2) of the middle line in order (counter-clockwise = positive
    current at polarity +1), every corner rounded with corner_radius >= thickness/2.
    """

    kind: ClassVar[str] = "path"

    name: base.Named
    corners: Annotated[
        Array,
        Key(
            SimplePolygon,
            "[[x, y], ...] corners of the middle line, counter-clockwise",
            "mm",
            check=_require_counter_clockwise,
        ),
    ]
    corner_radius: Annotated[
        float, Key(Length, "radius of every corner, at the winding's middle line", "mm", check=_require_fit)
    ]
    thickness: base.Thickness
    height: base.Height
    turns: base.Turns
    polarity: base.Polarity = 1
    placement: Placement = field(default_factory=Placement)
    resistance: base.Resistance = None
    inductance: base.Inductance = None

    def reflected(self, axis: int) -> "PathCoil":
        """See `Coil.reflected`: the corners mirrored, counter-clockwise as before."""
        return replace(self, corners=read_only(reflected_polygon(self.corners.tolist(), axis)))

    def winding(self) -> WindingPath:
        """An arc at every corner, bars between them."""
        corners = np.asarray(self.corners, dtype=float)
        return rounded_path(self.name, corners, self.corner_radius, self.thickness, self.height)
