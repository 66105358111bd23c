"""Named cross-sections through iron, [[section]]: where the mean flux density is told."""

from pydantic import Field, field_validator

from fieldmap.device import model
from fieldmap.device.schema.base import MILLI, Name, Point, Size, Table, Vector, broken, read_only


class SectionKeys(Table):
    """What a plane cuts out of iron."""

    name: Name = Field(description="the section's name, its own among the sections")
    centre_mm: Point = Field(description="[x, y, z] of a point of the plane")
    normal: Vector = Field(description="[x, y, z] along the flux that counts as positive; any length")
    bodies: list[Name] = Field(default=[], description="names of the bodies that are cut; all if left out")
    half_widths_mm: Size | None = Field(
        default=None, description="[x, y, z]: only what lies within these distances of the centre"
    )

    @field_validator("normal")
    @classmethod
    def _has_a_direction(cls, value: list[float]) -> list[float]:
        if not any(value):
            raise broken("the normal must have a direction", "[0, 0, 0]", "give for instance [0, 0, 1]")
        return value

    def to_model(self) -> model.Section:
        """In SI."""
        widths = None if self.half_widths_mm is None else read_only(self.half_widths_mm, MILLI)
        return model.Section(
            self.name, read_only(self.centre_mm, MILLI), read_only(self.normal), tuple(self.bodies), widths
        )
