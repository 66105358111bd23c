"""Rules of the dimensions of shapes and of coils: polygons that do not cross themselves, closed surfaces, radii in
order."""

from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo

from fieldmap.device.polygons import polygon_fault, signed_area
from fieldmap.device.surfaces import surface_fault
from fieldmap.device.tetrahedra import tetrahedra_fault
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, PlanePoint, Point, broken, text_like

FourPoints = Annotated[list[Point], Field(min_length=4)]
Triangles = Annotated[list[Annotated[list[int], Field(min_length=3, max_length=3)]], Field(min_length=4)]
Tetrahedra = Annotated[list[Annotated[list[int], Field(min_length=4, max_length=4)]], Field(min_length=1)]
Polygon = Annotated[list[PlanePoint], Field(min_length=3)]


def require_simple(points: list[list[float]]) -> list[list[float]]:
    """Raise unless the corners make a polygon that does not meet itself."""
    fault = polygon_fault(points)
    if fault is not None:
        raise broken(
            "the corners must make a simple polygon: no repeated corner, no edge that meets another one",
            fault,
            "list the corners once round the outline, in order, without repeating the first one",
        )
    return points


SimplePolygon = Annotated[Polygon, AfterValidator(require_simple)]


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


def require_closed(triangles: list[list[int]], info: ValidationInfo) -> None:
    """Raise unless the triangles bound a solid."""
    points = info.data.get("points_mm")
    fault = None if points is None else surface_fault(np.array(points), np.array(triangles))
    if fault is not None:
        raise broken(*fault)


def require_solid(tetrahedra: list[list[int]], info: ValidationInfo) -> None:
    """Raise unless the tetrahedra fill a solid."""
    points = info.data.get("points_mm")
    fault = None if points is None else tetrahedra_fault(np.array(points), np.array(tetrahedra))
    if fault is not None:
        raise broken(*fault)


def counter_clockwise(points: list[list[float]]) -> list[list[float]]:
    """The same polygon with its corners in counter-clockwise order."""
    return points if signed_area(points) > 0 else points[::-1]


def require_larger_radius(outer: float, info: ValidationInfo) -> None:
    """Raise unless the outer radius is larger than the inner one that was read before it."""
    inner = info.data.get("inner_radius_mm")
    if inner is not None and outer <= inner:
        raise broken(
            f"outer_radius_mm must be larger than inner_radius_mm = {inner:g}",
            f"{outer:g}",
            "swap the two, or correct one (both are radii, not diameters)",
        )


def require_above_lower(upper: list[float], info: ValidationInfo) -> None:
    """Raise unless every entry of upper_mm lies above that of lower_mm."""
    lower = info.data.get("lower_mm", [])
    empty = [axis for axis, low, high in zip("xyz", lower, upper, strict=False) if high <= low]
    if empty:
        raise broken(
            "the box must not be empty: every entry of upper_mm above that of lower_mm",
            f"upper_mm = {upper} with lower_mm = {lower} (along {', '.join(empty)})",
            "swap the two corners, or correct them; z is up, so -140 lies below -76",
        )


def require_direction(normal: list[float], info: ValidationInfo) -> None:
    """Raise for a vector without length."""
    if not any(normal):
        raise broken("the normal must have a direction", "[0, 0, 0]", "give for instance [0, 0, 1]")


LEAST_GAP_MM = 1e-3


def _no_gap_or_a_micrometre(gap: float) -> float:
    if 0 < gap < LEAST_GAP_MM:
        must_hold = f"gap_mm must be 0 or at least {LEAST_GAP_MM:g}"
        raise broken(must_hold, f"{gap:g}", "no ground face is known to a micrometre: leave the joint out")
    return gap


Gap = Annotated[Annotated[float, Field(ge=0, le=LARGEST_LENGTH_MM)], AfterValidator(_no_gap_or_a_micrometre)]
BodyPattern = Annotated[
    str,
    text_like(
        r"^[A-Za-z0-9*?][A-Za-z0-9 _+\-*?]*$",
        "the name of a body, or a pattern with * and ? for several",
        "write it as at the [[body]]",
    ),
]
PairOfPatterns = Annotated[list[BodyPattern], Field(min_length=2, max_length=2)]
