"""Coils wound round a rectangle with rounded corners (racetrack)."""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ValidationInfo

from fieldmap.device.coils import base
from fieldmap.device.coils.winding import WindingPath, rounded_path
from fieldmap.device.placement import Placement
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, broken


def _require_fit(corner_radius: float, info: ValidationInfo) -> None:
    base.require_room_for_the_winding(corner_radius, info)
    halves = [info.data.get(f"half_width_{axis}_mm") for axis in "xy"]
    smallest = min((half for half in halves if half is not None), default=corner_radius)
    if corner_radius > smallest:
        raise broken(
            f"corner_radius_mm must not be larger than the smaller half width, {smallest:g}",
            f"{corner_radius:g}",
            'reduce it; for a round coil use kind = "circular"',
        )


@dataclass(frozen=True, repr=False)
class RoundedRectangleCoil(base.Coil):
    """Rounded rectangle (racetrack), dimensions at the middle line.

    half_width_x, half_width_y and corner_radius are those of the winding's middle line; `thickness` is the winding's
    width in the plane, `height` along the axis. corner_radius >= thickness/2.
    """

    kind: ClassVar[str] = "rounded_rectangle"

    name: base.Named
    half_width_x: Annotated[
        float, Key(Length, "half the width along local x, at the winding's middle line", "mm")
    ]
    half_width_y: Annotated[
        float, Key(Length, "half the width along local y, at the winding's middle line", "mm")
    ]
    corner_radius: Annotated[
        float, Key(Length, "radius of the corners, at the winding's middle line", "mm", check=_require_fit)
    ]
    thickness: base.Thickness
    height: base.Height
    turns: base.Turns
    polarity: base.Polarity = 1
    placement: Placement = field(default_factory=Placement)
    resistance: base.Resistance = None
    inductance: base.Inductance = None

    def winding(self) -> WindingPath:
        """Four corners, and bars where the sides are longer than the corners."""
        x, y = self.half_width_x, self.half_width_y
        corners = np.array([[x, y], [-x, y], [-x, -y], [x, -y]], dtype=float)
        return rounded_path(self.name, corners, self.corner_radius, self.thickness, self.height)
