"""Circular coils."""

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.coils.base import Coil, CoilKeys
from fieldmap.device.coils.winding import WindingPath
from fieldmap.device.dimensions import require_larger_radius
from fieldmap.device.placement import Placement
from fieldmap.inputs.tables import MILLI, Length
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class CircularCoil(Coil):
    """Rectangular winding section: inner_radius <= r <= outer_radius, |z| <= height/2."""

    kind: ClassVar[str] = "circular"

    name: str
    inner_radius: float
    outer_radius: float
    height: float
    turns: float
    polarity: int = 1
    placement: Placement = field(default_factory=Placement)
    resistance: float | None = None
    inductance: float | None = None

    def winding(self) -> WindingPath:
        """One arc of a full turn."""
        circle = np.array([[0.0, 0.0, 1.0, 0.0, math.pi, self.inner_radius, self.outer_radius, 1.0]])
        return WindingPath(circle, np.zeros((0, 5)), self.outer_radius - self.inner_radius, self.height)

    def unit_flux_density(self, points: Array, digits: float) -> Array:
        """As `Coil.unit_flux_density`, by the kernel that uses the symmetry about the axis."""
        from fieldmap.kernels.coils.ring import ring_flux_density

        return ring_flux_density(points, self.inner_radius, self.outer_radius, self.height, digits)

    def unit_flux_density_and_gradient(self, points: Array, digits: float) -> tuple[Array, Array]:
        """As `Coil.unit_flux_density_and_gradient`, by the kernel that uses the symmetry about the axis."""
        from fieldmap.kernels.coils.ring import ring_flux_density_and_gradient

        return ring_flux_density_and_gradient(
            points, self.inner_radius, self.outer_radius, self.height, digits
        )


class CircularCoilKeys(CoilKeys):
    """Circular coil."""

    rank: ClassVar[int] = 0

    kind: Literal["circular"] = Field(description="circular coil")
    inner_radius_mm: Length = Field(description="inner radius of the winding")
    outer_radius_mm: Length = Field(description="outer radius of the winding")
    height_mm: Length = Field(description="length of the winding along its axis")

    @field_validator("outer_radius_mm")
    @classmethod
    def _outside_the_bore(cls, value: float, info: ValidationInfo) -> float:
        require_larger_radius(value, info)
        return value

    def to_model(self) -> CircularCoil:
        """In SI."""
        return CircularCoil(
            inner_radius=self.inner_radius_mm * MILLI,
            outer_radius=self.outer_radius_mm * MILLI,
            height=self.height_mm * MILLI,
            **self.common(),
        )
