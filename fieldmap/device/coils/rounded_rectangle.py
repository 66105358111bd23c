"""Coils wound round a rectangle with rounded corners (racetrack)."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.coils.base import Coil, RoundedKeys, require_room_for_the_winding
from fieldmap.device.coils.winding import WindingPath, rounded_path
from fieldmap.device.placement import Placement
from fieldmap.inputs.tables import MILLI, Length, broken


@dataclass(frozen=True, repr=False)
class RoundedRectangleCoil(Coil):
    """Rounded rectangle. half_width_x, half_width_y and corner_radius are those of the winding's middle line;
    `thickness` is the winding's width in the plane, `height` along the axis. corner_radius >= thickness/2."""

    kind: ClassVar[str] = "rounded_rectangle"

    name: str
    half_width_x: float
    half_width_y: float
    corner_radius: float
    thickness: float
    height: float
    turns: float
    polarity: int = 1
    placement: Placement = field(default_factory=Placement)
    resistance: float | None = None
    inductance: float | None = None

    def winding(self) -> WindingPath:
        """Four corners, and bars where the sides are longer than the corners."""
        x, y = self.half_width_x, self.half_width_y
        corners = np.array([[x, y], [-x, y], [-x, -y], [x, -y]], dtype=float)
        return rounded_path(self.name, corners, self.corner_radius, self.thickness, self.height)


class RoundedRectangleKeys(RoundedKeys):
    """Rounded rectangle (racetrack)."""

    rank: ClassVar[int] = 10

    kind: Literal["rounded_rectangle"] = Field(description="rounded rectangle, dimensions at the middle line")
    half_width_x_mm: Length = Field(description="half the width along local x, at the winding's middle line")
    half_width_y_mm: Length = Field(description="half the width along local y, at the winding's middle line")
    corner_radius_mm: Length = Field(description="radius of the corners, at the winding's middle line")

    @field_validator("corner_radius_mm")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        require_room_for_the_winding(value, info)
        halves = [info.data.get(f"half_width_{axis}_mm") for axis in "xy"]
        smallest = min((half for half in halves if half is not None), default=value)
        if value > smallest:
            raise broken(
                f"corner_radius_mm must not be larger than the smaller half width, {smallest:g}",
                f"{value:g}",
                'reduce it; for a round coil use kind = "circular"',
            )
        return value

    def to_model(self) -> RoundedRectangleCoil:
        """In SI."""
        return RoundedRectangleCoil(
            half_width_x=self.half_width_x_mm * MILLI,
            half_width_y=self.half_width_y_mm * MILLI,
            corner_radius=self.corner_radius_mm * MILLI,
            thickness=self.thickness_mm * MILLI,
            height=self.height_mm * MILLI,
            **self.common(),
        )
