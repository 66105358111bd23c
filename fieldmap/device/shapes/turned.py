"""Solids of revolution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator

from fieldmap.device.polygons import Polygon, counter_clockwise, require_larger_radius, require_simple
from fieldmap.device.shapes.base import ROUND, Shape
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, broken
from fieldmap.typing import Array


def turned_hull(profile: Sequence[tuple[float, float]] | Array) -> Array:
    """Points on the circles that the corners of a profile describe.

    Parameters
    ----------
    profile
        Corners (r, z), m.

    Returns
    -------
    Array
        Points (n, 3), m.
    """
    angles = np.linspace(0.0, 2 * math.pi, ROUND, endpoint=False)
    return np.array([[r * math.cos(angle), r * math.sin(angle), z] for r, z in profile for angle in angles])


@dataclass(frozen=True, repr=False)
class Cylinder(Shape):
    """Solid cylinder, 0 <= z <= height."""

    kind: ClassVar[str] = "cylinder"

    radius: Annotated[float, Key(Length, "radius", "mm")]
    height: Annotated[float, Key(Length, "height along the local z axis", "mm")]

    def hull(self) -> Array:
        """See `Shape.hull`."""
        return turned_hull([(self.radius, 0.0), (self.radius, self.height)])


@dataclass(frozen=True, repr=False)
class Ring(Shape):
    """Hollow cylinder, 0 <= z <= height."""

    kind: ClassVar[str] = "ring"

    inner_radius: Annotated[float, Key(Length, "radius of the bore", "mm")]
    outer_radius: Annotated[float, Key(Length, "outer radius", "mm", check=require_larger_radius)]
    height: Annotated[float, Key(Length, "height along the local z axis", "mm")]

    def hull(self) -> Array:
        """See `Shape.hull`."""
        return turned_hull([(self.outer_radius, 0.0), (self.outer_radius, self.height)])


@dataclass(frozen=True, repr=False)
class Sphere(Shape):
    """Ball, centred at the local origin."""

    kind: ClassVar[str] = "sphere"

    radius: Annotated[float, Key(Length, "radius", "mm")]

    def hull(self) -> Array:
        """See `Shape.hull`."""
        angles = np.linspace(-math.pi / 2, math.pi / 2, ROUND // 2 + 1)
        return turned_hull(self.radius * np.column_stack([np.cos(angles), np.sin(angles)]))


def _outside_the_axis(points: list[list[float]]) -> list[list[float]]:
    wrong = [k + 1 for k, (r, _) in enumerate(points) if r < 0]
    if wrong:
        raise broken(
            "every r of the profile must be 0 or more",
            f"r = {points[wrong[0] - 1][0]:g} at corner {wrong[0]}",
            "give only the half of the section at r >= 0, as [r, z]; it is turned fully about the axis",
        )
    return require_simple(points)


HalfSection = Annotated[Polygon, AfterValidator(_outside_the_axis)]


@dataclass(frozen=True, eq=False, repr=False)
class RevolvedProfile(Shape):
    """Profile turned fully about the local z axis.

    points (n, 2): corners (r, z) of a simple polygon, r >= 0.
    """

    kind: ClassVar[str] = "revolved_profile"

    points: Annotated[
        Array,
        Key(HalfSection, "[[r, z], ...] corners of the half section, r >= 0", "mm", make=counter_clockwise),
    ]

    def hull(self) -> Array:
        """See `Shape.hull`."""
        return turned_hull(self.points)
