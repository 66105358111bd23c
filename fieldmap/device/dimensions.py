"""Rules that shapes and coils share: polygons that do not cross themselves, radii in order."""

from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo

from fieldmap.device.polygons import polygon_fault, signed_area
from fieldmap.inputs.tables import PlanePoint, Point, broken

FourPoints = Annotated[list[Point], Field(min_length=4)]
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
