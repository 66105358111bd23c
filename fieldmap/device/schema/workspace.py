"""Where the payload may go, [workspace], and known values to hold results against, [[reference]]."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, Tag, ValidationInfo, field_validator

from fieldmap.device import parts as model
from fieldmap.inputs.tables import (
    MILLI,
    Length,
    Name,
    Point,
    Positive,
    Size,
    Table,
    Text,
    Vector,
    broken,
    chosen_by,
    chosen_with,
    read_only,
)


def above_lower(value: list[float], info: ValidationInfo) -> list[float]:
    """upper_mm, if every entry of it lies above that of lower_mm."""
    lower = info.data.get("lower_mm", [])
    empty = [axis for axis, low, high in zip("xyz", lower, value, strict=False) if high <= low]
    if empty:
        raise broken(
            "the box must not be empty: every entry of upper_mm above that of lower_mm",
            f"upper_mm = {value} with lower_mm = {lower} (along {', '.join(empty)})",
            "swap the two corners, or correct them; z is up, so -140 lies below -76",
        )
    return value


class WorkspaceBoxKeys(Table):
    """Axis-parallel box."""

    shape: Literal["box"] = Field(description="axis-parallel box")
    lower_mm: Point = Field(description="[x, y, z] of the corner with the smallest coordinates")
    upper_mm: Point = Field(description="[x, y, z] of the opposite corner")

    _not_empty = field_validator("upper_mm")(above_lower)

    def to_model(self) -> model.WorkspaceBox:
        """In SI."""
        return model.WorkspaceBox(read_only(self.lower_mm, MILLI), read_only(self.upper_mm, MILLI))


class WorkspaceCylinderKeys(Table):
    """Upright cylinder."""

    shape: Literal["cylinder"] = Field(description="upright cylinder")
    base_mm: Point = Field(description="[x, y, z] of the centre of its lower face")
    radius_mm: Length = Field(description="radius")
    height_mm: Length = Field(description="height")

    def to_model(self) -> model.WorkspaceCylinder:
        """In SI."""
        base = read_only(self.base_mm, MILLI)
        return model.WorkspaceCylinder(base, self.radius_mm * MILLI, self.height_mm * MILLI)


AnyWorkspace = Annotated[
    Annotated[WorkspaceBoxKeys, Tag("box")] | Annotated[WorkspaceCylinderKeys, Tag("cylinder")],
    chosen_by("shape"),
]


class _ReferenceKeys(Table):
    at_mm: Point = Field(description="[x, y, z] of the point")
    currents_A: list[float] = Field(description="one current for each coil, in the file's order")
    mu_r: Positive | None = Field(
        default=None, description="relative permeability of the iron for which the value holds"
    )
    tolerance: Positive | None = Field(default=None, description="relative uncertainty of the value")
    source: Text = Field(description="where the value comes from")

    def _reference(self, quantity: str, value: float) -> model.Reference:
        return model.Reference(
            quantity=quantity,
            at=read_only(self.at_mm, MILLI),
            currents=read_only(self.currents_A),
            value=float(value),
            source=self.source,
            mu_r=self.mu_r,
            tolerance=self.tolerance,
        )


class FluxDensityReference(_ReferenceKeys):
    """A known component of B."""

    quantity: Literal["Bx", "By", "Bz"] = Field(description="component of the flux density")
    value_T: float = Field(description="its value")

    def to_model(self) -> model.Reference:
        """In SI."""
        return self._reference(self.quantity, self.value_T)


class GradientReference(_ReferenceKeys):
    """A known entry of the gradient of B."""

    quantity: Literal[
        "dBx/dx", "dBx/dy", "dBx/dz", "dBy/dx", "dBy/dy", "dBy/dz", "dBz/dx", "dBz/dy", "dBz/dz"
    ] = Field(description="entry of the gradient")
    value_T_per_m: float = Field(description="its value")

    def to_model(self) -> model.Reference:
        """In SI."""
        return self._reference(self.quantity, self.value_T_per_m)


QUANTITIES = ("Bx", "By", "Bz", *(f"dB{i}/d{j}" for i in "xyz" for j in "xyz"))


def _kind_of_reference(table: dict[str, Any]) -> Any:
    quantity = table.get("quantity")
    if quantity not in QUANTITIES:
        return quantity
    return "flux density" if quantity.startswith("B") else "gradient"


AnyReference = Annotated[
    Annotated[FluxDensityReference, Tag("flux density")] | Annotated[GradientReference, Tag("gradient")],
    chosen_with(_kind_of_reference, "quantity"),
]


class SectionKeys(Table):
    """What a plane cuts out of iron."""

    attributes: ClassVar[Mapping[str, str]] = {"centre_mm": "origin"}

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
