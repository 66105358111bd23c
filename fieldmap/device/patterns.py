"""Copies and mirror images of the tables of a device file: their keys, and where a copy stands."""

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.placement import MOST_COPIES, Axis, mirrored_keys, moved_keys, turned_keys
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, Coordinate, Point, Table, broken

Place = tuple[list[float], list[float]]
"""position_mm and rotation_deg."""


class Repeat(Table):
    """Copies of a table. Other keys are lists of values, one for each copy."""

    count: Annotated[int, Field(ge=1, le=MOST_COPIES)] | None = Field(
        default=None,
        validate_default=True,
        description="how many; as many as the lists have values if left out",
    )
    about: Axis | None = Field(default=None, description="axis that they are turned about")
    step_deg: Annotated[float, Field(ge=-LARGEST_LENGTH_MM, le=LARGEST_LENGTH_MM)] | None = Field(
        default=None, description="from one to the next; a full turn divided by count if left out"
    )
    centre_mm: Point | None = Field(default=None, description="[x, y, z] of a point of the axis")
    step_mm: Point | None = Field(default=None, description="[x, y, z] from one to the next")

    @field_validator("count")
    @classmethod
    def _is_known(cls, count: int | None) -> int | None:
        if count is None:
            must_hold = f"count must be a whole number from 1 to {MOST_COPIES}"
            raise broken(must_hold, "nothing", "write for instance count = 6")
        return count

    @field_validator("step_deg", "centre_mm")
    @classmethod
    def _belongs_to_an_axis(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("about", "") is None:
            raise broken("step_deg and centre_mm belong to about", "no about", 'add about = "z"')
        return value

    def place(self, k: int, position_mm: list[float], rotation_deg: list[float]) -> Place:
        """Where the k-th copy stands, from 0."""
        if self.about is not None:
            assert self.count is not None
            step = 360.0 / self.count if self.step_deg is None else self.step_deg
            centre = self.centre_mm or [0.0, 0.0, 0.0]
            position_mm, rotation_deg = turned_keys(position_mm, rotation_deg, self.about, k * step, centre)
        if self.step_mm is not None:
            position_mm = moved_keys(position_mm, [k * x for x in self.step_mm])
        return position_mm, rotation_deg


class Image(Table):
    """A mirror image."""

    plane: Axis = Field(description="axis that the mirror is square to")
    at_mm: Coordinate = Field(default=0.0, description="where the mirror crosses that axis")
    name: str | None = Field(
        default=None, description="of the image; {name} stands for the name of the table"
    )

    @property
    def axis(self) -> int:
        """The local axis, 0 or 1, of a shape that changes its sign."""
        return 1 if self.plane == "y" else 0

    def place(self, position_mm: list[float], rotation_deg: list[float]) -> Place:
        """Where the image stands."""
        return mirrored_keys(position_mm, rotation_deg, self.plane, self.at_mm)[:2]
