"""Thin gaps between bodies that touch, [[joint]]."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field, field_validator

from fieldmap.device import parts as model
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, MILLI, Name, Positive, Table, broken, text_like

LEAST_GAP_MM = 1e-3
BodyPattern = Annotated[
    str,
    text_like(
        r"^[A-Za-z0-9*?][A-Za-z0-9 _+\-*?]*$",
        "the name of a body, or a pattern with * and ? for several",
        "write it as at the [[body]]",
    ),
]


class JointKeys(Table):
    """A gap of air, glue or paper between two bodies that touch, which the drawing does not show."""

    attributes: ClassVar[Mapping[str, str]] = {}

    name: Name | None = Field(default=None, description="for key paths, such as joint.NAME.gap_mm")
    gap_mm: Annotated[float, Field(ge=0, le=LARGEST_LENGTH_MM)] = Field(
        description="thickness, cut out of the body whose end the joint is; 0: no joint"
    )
    between: list[BodyPattern] | None = Field(
        default=None,
        min_length=2,
        max_length=2,
        description=(
            "names of the two bodies; * and ? stand for any text. A pair takes the last joint that names it. Without"
            " this key: all contacts that no other joint names"
        ),
    )
    mu_r: Positive = Field(default=1.0, description="relative permeability of what is in the gap")

    @field_validator("gap_mm")
    @classmethod
    def _no_gap_or_a_micrometre(cls, value: float) -> float:
        if 0 < value < LEAST_GAP_MM:
            must_hold = f"gap_mm must be 0 or at least {LEAST_GAP_MM:g}"
            raise broken(
                must_hold, f"{value:g}", "no ground face is known to a micrometre: leave the joint out"
            )
        return value

    def to_model(self) -> model.Joint:
        """In SI."""
        between = None if self.between is None else (self.between[0], self.between[1])
        return model.Joint(self.gap_mm * MILLI, between, self.mu_r, self.name)
