"""Whether solids overlap: by how much, and where (CAD kernel, mm)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from netgen import occ

from fieldmap.typing import Array

CONTACT_DISTANCE = 1e-7
"""mm. The kernel takes what is nearer than this for one point (Open CASCADE's Precision::Confusion): surfaces
this near are in contact, and a common volume thinner than this is contact and no overlap."""


@dataclass(frozen=True)
class NamedSolid:
    """A solid and what it is: kind "body", "winding" or "workspace", and its name in the device file."""

    kind: str
    name: str
    solid: occ.TopoDS_Shape

    def __str__(self) -> str:
        return f"{self.kind} '{self.name}'" if self.name else self.kind

    @property
    def volume(self) -> float:
        """Volume, mm^3."""
        return float(self.solid.mass)


@dataclass(frozen=True)
class Overlap:
    """What two solids have in common: volume (mm^3) and the corners (3,) of the box around it (mm)."""

    first: NamedSolid
    second: NamedSolid
    volume: float
    lower: Array
    upper: Array

    def __str__(self) -> str:
        # The kernel's boxes are wider than what they hold by its contact distance: 1e-6 mm is the last digit.
        corners = np.round([self.lower, self.upper], 6) + 0.0
        spans = (f"{axis} {a:.8g} to {b:.8g}" for axis, a, b in zip("xyz", *corners, strict=True))
        return f"{self.volume:.4g} mm^3 in common, within {', '.join(spans)} mm"


def bounds(solid: occ.TopoDS_Shape) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of the box around a solid, mm."""
    lower, upper = solid.bounding_box
    return np.array([lower.x, lower.y, lower.z]), np.array([upper.x, upper.y, upper.z])


def bounds_nearer_than(a: occ.TopoDS_Shape, b: occ.TopoDS_Shape, distance: float) -> bool:
    """False where the boxes around two solids already are `distance` (mm) or more apart."""
    (a_lower, a_upper), (b_lower, b_upper) = bounds(a), bounds(b)
    return bool((a_lower - b_upper).max() < distance and (b_lower - a_upper).max() < distance)


def overlap_of(first: NamedSolid, second: NamedSolid) -> Overlap | None:
    """What two solids have in common beyond contact, or None."""
    if not bounds_nearer_than(first.solid, second.solid, 0.0):
        return None
    common = first.solid * second.solid
    volume = sum(piece.mass for piece in common.solids)
    # A layer as thin as the contact distance over the whole of the smaller solid's side is rounding.
    if volume <= CONTACT_DISTANCE * min(first.volume, second.volume) ** (2 / 3):
        return None
    return Overlap(first, second, float(volume), *bounds(common))


def overlaps_among(solids: Sequence[NamedSolid]) -> tuple[Overlap, ...]:
    """All overlaps of the given solids with each other."""
    found = (overlap_of(a, b) for a, b in combinations(solids, 2))
    return tuple(overlap for overlap in found if overlap is not None)


def overlaps_between(some: Sequence[NamedSolid], others: Sequence[NamedSolid]) -> tuple[Overlap, ...]:
    """All overlaps of a solid of the first sequence with one of the second."""
    found = (overlap_of(a, b) for a, b in product(some, others))
    return tuple(overlap for overlap in found if overlap is not None)
