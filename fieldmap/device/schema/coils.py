"""Coils: axis along local z, winding centred at the local origin, rectangular winding section."""

from typing import Annotated, Any, Literal

from pydantic import Field, Tag, ValidationInfo, field_validator

from fieldmap.device import model
from fieldmap.device.polygons import rounding_fault, signed_area
from fieldmap.device.schema.placement import PlacementKeys
from fieldmap.device.schema.shapes import SimplePolygon, require_larger_radius
from fieldmap.inputs.tables import MILLI, Length, Positive, broken, chosen_by, read_only, text_like

# A coil's name becomes part of a record name in the map file: letters, digits and underscores only.
CoilName = Annotated[
    str,
    text_like(
        r"^[A-Za-z0-9_]+$",
        "a coil's name has letters, digits and underscores only",
        'rename it, for example "coil_1"',
    ),
]


class CoilKeys(PlacementKeys):
    """What every coil has."""

    name: CoilName = Field(description="the coil's name: letters, digits, underscores")
    turns: Positive = Field(description="number of turns")
    polarity: Literal[1, -1] = Field(
        default=1, description="1: positive current runs counter-clockwise seen from local +z; -1: clockwise"
    )
    resistance_ohm: Positive | None = Field(default=None, description="resistance of the winding")
    inductance_mH: Positive | None = Field(default=None, description="inductance, alone in its iron")

    def common(self) -> dict[str, Any]:
        """What every coil of the model has, in SI."""
        return {
            "name": self.name,
            "turns": float(self.turns),
            "polarity": self.polarity,
            "placement": self.placement(),
            "resistance": self.resistance_ohm,
            "inductance": None if self.inductance_mH is None else self.inductance_mH * MILLI,
        }


class CircularCoilKeys(CoilKeys):
    """Circular coil."""

    kind: Literal["circular"] = Field(description="circular coil")
    inner_radius_mm: Length = Field(description="inner radius of the winding")
    outer_radius_mm: Length = Field(description="outer radius of the winding")
    height_mm: Length = Field(description="length of the winding along its axis")

    @field_validator("outer_radius_mm")
    @classmethod
    def _outside_the_bore(cls, value: float, info: ValidationInfo) -> float:
        require_larger_radius(value, info)
        return value

    def to_model(self) -> model.CircularCoil:
        """In SI."""
        return model.CircularCoil(
            inner_radius=self.inner_radius_mm * MILLI,
            outer_radius=self.outer_radius_mm * MILLI,
            height=self.height_mm * MILLI,
            **self.common(),
        )


class _RoundedKeys(CoilKeys):
    thickness_mm: Length = Field(description="width of the winding in the coil's plane")
    height_mm: Length = Field(description="length of the winding along its axis")


def _require_room_for_the_winding(corner_radius: float, info: ValidationInfo) -> None:
    thickness = info.data.get("thickness_mm")
    if thickness is not None and corner_radius < thickness / 2:
        raise broken(
            f"corner_radius_mm must be at least thickness_mm/2 = {thickness / 2:g}",
            f"{corner_radius:g}",
            "give the radius of the winding's middle line: inner radius of the corner plus thickness/2",
        )


class RoundedRectangleKeys(_RoundedKeys):
    """Rounded rectangle (racetrack)."""

    kind: Literal["rounded_rectangle"] = Field(description="rounded rectangle, dimensions at the middle line")
    half_width_x_mm: Length = Field(description="half the width along local x, at the winding's middle line")
    half_width_y_mm: Length = Field(description="half the width along local y, at the winding's middle line")
    corner_radius_mm: Length = Field(description="radius of the corners, at the winding's middle line")

    @field_validator("corner_radius_mm")
    @classmethod
    def _fits(cls, value: float, info: ValidationInfo) -> float:
        _require_room_for_the_winding(value, info)
        halves = [info.data.get(f"half_width_{axis}_mm") for axis in "xy"]
        smallest = min((half for half in halves if half is not None), default=value)
        if value > smallest:
            raise broken(
                f"corner_radius_mm must not be larger than the smaller half width, {smallest:g}",
                f"{value:g}",
                'reduce it; for a round coil use kind = "circular"',
            )
        return value

    def to_model(self) -> model.RoundedRectangleCoil:
        """In SI."""
        return model.RoundedRectangleCoil(
            half_width_x=self.half_width_x_mm * MILLI,
            half_width_y=self.half_width_y_mm * MILLI,
            corner_radius=self.corner_radius_mm * MILLI,
            thickness=self.thickness_mm * MILLI,
            height=self.height_mm * MILLI,
            **self.common(),
        )


class PathCoilKeys(_RoundedKeys):
    """Closed plane path with rounded corners."""

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
        _require_room_for_the_winding(value, info)
        corners = info.data.get("corners_mm")
        fault = None if corners is None else rounding_fault(corners, value)
        if fault is not None:
            raise broken(
                "every edge of the path must be long enough for the arcs at its two ends",
                fault,
                "reduce corner_radius_mm or move the corners apart",
            )
        return value

    def to_model(self) -> model.PathCoil:
        """In SI."""
        return model.PathCoil(
            corners=read_only(self.corners_mm, MILLI),
            corner_radius=self.corner_radius_mm * MILLI,
            thickness=self.thickness_mm * MILLI,
            height=self.height_mm * MILLI,
            **self.common(),
        )


AnyCoil = Annotated[
    Annotated[CircularCoilKeys, Tag("circular")]
    | Annotated[RoundedRectangleKeys, Tag("rounded_rectangle")]
    | Annotated[PathCoilKeys, Tag("path")],
    chosen_by("kind"),
]
