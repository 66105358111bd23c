"""Blocks and other prisms."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from fieldmap.device.polygons import SimplePolygon, counter_clockwise, reflected_polygon
from fieldmap.device.shapes.base import Shape
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, Size, read_only
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class Box(Shape):
    """Block, centred in x and y, 0 <= z <= size[2]."""

    kind: ClassVar[str] = "box"

    size: Annotated[tuple[float, float, float], Key(Size, "[x, y, z] edge lengths", "mm")]

    def __post_init__(self) -> None:
        # Boxes with a tuple can be compared, boxes with an array cannot.
        if isinstance(self.size, np.ndarray) and self.size.ndim == 1:
            object.__setattr__(self, "size", tuple(self.size.tolist()))

    def hull(self) -> Array:
        """See `Shape.hull`."""
        x, y, z = self.size
        return np.array([[i * x / 2, j * y / 2, k * z] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)])


@dataclass(frozen=True, eq=False, repr=False)
class ExtrudedPolygon(Shape):
    """Polygon in the local x-y plane, 0 <= z <= height.

    points (n, 2): corners of a simple polygon.
    """

    kind: ClassVar[str] = "extruded_polygon"

    points: Annotated[
        Array,
        Key(SimplePolygon, "[[x, y], ...] corners once round the outline", "mm", make=counter_clockwise),
    ]
    height: Annotated[float, Key(Length, "height along the local z axis", "mm")]

    def hull(self) -> Array:
        """See `Shape.hull`."""
        return np.array([[x, y, z] for x, y in self.points for z in (0.0, self.height)])

    def reflected(self, axis: int) -> Self:
        """See `Shape.reflected`."""
        return replace(self, points=read_only(reflected_polygon(self.points.tolist(), axis)))
