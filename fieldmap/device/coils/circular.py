"""Circular coils."""

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from fieldmap.device.coils.base import Coil, Height, Inductance, Named, Polarity, Resistance, Turns
from fieldmap.device.coils.winding import WindingPath
from fieldmap.device.placement import Placement
from fieldmap.device.polygons import require_larger_radius
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class CircularCoil(Coil):
    """Circular coil.

    Rectangular winding section: inner_radius <= r <= outer_radius, |z| <= height/2.
    """

    kind: ClassVar[str] = "circular"

    name: Named
    inner_radius: Annotated[float, Key(Length, "inner radius of the winding", "mm")]
    outer_radius: Annotated[
        float, Key(Length, "outer radius of the winding", "mm", check=require_larger_radius)
    ]
    height: Height
    turns: Turns
    polarity: Polarity = 1
    placement: Placement = field(default_factory=Placement)
    resistance: Resistance = None
    inductance: Inductance = None

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
