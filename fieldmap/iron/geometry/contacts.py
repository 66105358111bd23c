"""How solids lie to each other: overlaps, sound contact by faces, and contact at edges and points or almost (mm).

The surface of sound iron is a manifold: two of its faces meet at every edge, and the faces around every
corner follow each other in one fan. Contact only along an edge or at a point is not sound: flux would pass
through a bridge without width, and edge quantities of the mesh would have two meanings there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from fieldmap.iron.geometry.shapes import occ, xyz
from fieldmap.records import Record
from fieldmap.typing import Array

CONTACT_DISTANCE = 1e-7
"""mm. The kernel takes points nearer than this for one point (Open CASCADE's Precision::Confusion): surfaces
this near are in contact, and a common volume thinner than this is contact and no overlap."""


@dataclass(frozen=True, repr=False)
class NamedSolid(Record):
    """A solid with its kind, as "body", "winding" or "workspace", and its name in the device file."""

    kind: str
    name: str
    solid: occ.TopoDS_Shape

    def __str__(self) -> str:
        return f"{self.kind} '{self.name}'" if self.name else self.kind

    @property
    def has_volume(self) -> bool:
        """False for wires, sheets and points."""
        return bool(self.solid.solids)

    @cached_property
    def volume(self) -> float:
        """Volume, mm^3. Kept, because the kernel integrates it anew at each call."""
        return float(self.solid.mass)


@dataclass(frozen=True, eq=False, repr=False)
class Overlap(Record):
    """The common part of two solids: volume (mm^3) and the corners (3,) of the box around it (mm)."""

    first: NamedSolid
    second: NamedSolid
    volume: float
    lower: Array
    upper: Array

    def __str__(self) -> str:
        # The kernel's boxes are wider than their contents by its contact distance: 1e-6 mm is the last digit.
        corners = np.round([self.lower, self.upper], 6) + 0.0
        spans = (f"{axis} {a:.8g} to {b:.8g}" for axis, a, b in zip("xyz", *corners, strict=True))
        return f"{self.volume:.4g} mm^3 in common, within {', '.join(spans)} mm"


def bounds(solid: occ.TopoDS_Shape) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of the box around a solid, mm."""
    lower, upper = solid.bounding_box
    return xyz(lower), xyz(upper)


def bounds_nearer_than(a: occ.TopoDS_Shape, b: occ.TopoDS_Shape, distance: float) -> bool:
    """False where the boxes around two solids already are `distance` (mm) or more apart."""
    (a_lower, a_upper), (b_lower, b_upper) = bounds(a), bounds(b)
    return bool((a_lower - b_upper).max() < distance and (b_lower - a_upper).max() < distance)


def overlap_of(first: NamedSolid, second: NamedSolid) -> Overlap | None:
    """The common part of two solids, or None if they do not overlap."""
    if not bounds_nearer_than(first.solid, second.solid, 0.0):
        return None
    common = first.solid * second.solid
    volume = sum(piece.mass for piece in common.solids)
    # A layer as thin as the contact distance over the whole of the smaller solid's side is rounding.
    if volume <= CONTACT_DISTANCE * min(first.volume, second.volume) ** (2 / 3):
        return None
    return Overlap(first, second, float(volume), *bounds(common))


LEAST_GAP = 1e-3
"""mm. Narrower gaps are refused: no machined gap is known to a micrometre, a rounded number in the file
is likelier, and faces so near to each other are beyond what the solution's surface integrals resolve."""


@dataclass(frozen=True, eq=False, repr=False)
class Contact(Record):
    """Two shapes, one without volume, nearer than `LEAST_GAP`, mm; distance 0: one lies in the other or on it."""

    first: NamedSolid
    second: NamedSolid
    distance: float

    def __str__(self) -> str:
        return (
            f"a gap of {self.distance:.3g} mm" if self.distance else "no gap: one lies in the other or on it"
        )


def contact_of(first: NamedSolid, second: NamedSolid) -> Contact | None:
    """The contact of two shapes, or None if they are `LEAST_GAP` or more apart."""
    if not bounds_nearer_than(first.solid, second.solid, LEAST_GAP):
        return None
    distance = first.solid.Distance(second.solid)
    if distance >= LEAST_GAP:
        return None
    return Contact(first, second, 0.0 if distance <= CONTACT_DISTANCE else distance)


def overlaps(pairs: Iterable[tuple[NamedSolid, NamedSolid]]) -> tuple[Overlap, ...]:
    """The common parts of the pairs that overlap."""
    return tuple(overlap for pair in pairs if (overlap := overlap_of(*pair)) is not None)


def clashes(pairs: Iterable[tuple[NamedSolid, NamedSolid]]) -> tuple[Overlap | Contact, ...]:
    """Pairs that overlap; where one has no volume, pairs nearer than `LEAST_GAP`."""
    found = (
        overlap_of(one, other) if one.has_volume and other.has_volume else contact_of(one, other)
        for one, other in pairs
    )
    return tuple(clash for clash in found if clash is not None)


Point = tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class Pinch(Record):
    """A place where the iron's surface is no manifold. kind: "edge" or "point"; at: a point of it, mm."""

    names: tuple[str, ...]
    kind: str
    at: Point
    count: int


def pinches(glued: occ.TopoDS_Shape) -> tuple[Pinch, ...]:
    """Places where the surface of the glued solids is no manifold: one entry per kind and set of bodies."""
    owners: dict[occ.Face, list[str]] = defaultdict(list)
    for solid in glued.solids:
        for face in solid.faces:
            owners[face].append(solid.name)
    surface = {face: names[0] for face, names in owners.items() if len(names) == 1}
    # A face lists the seam of a cylinder twice, as it should: both its sides lie in the surface.
    faces_at: dict[occ.Edge, list[occ.Face]] = defaultdict(list)
    for face in surface:
        for edge in face.edges:
            faces_at[edge].append(face)
    # The pole of a sphere is an edge without length: a point.
    bad_edges = {edge for edge, faces in faces_at.items() if len(faces) > 2 and edge.mass > CONTACT_DISTANCE}
    explained = {corner for edge in bad_edges for corner in edge.vertices}
    places = [("edge", _middle(edge), {surface[f] for f in faces_at[edge]}) for edge in bad_edges]
    for corner, fans in _fans(surface, faces_at).items():
        if len(fans) > 1 and corner not in explained:
            names = {surface[face] for fan in fans for face in fan}
            places.append(("point", tuple(xyz(corner.p).tolist()), names))
    return _gathered(places)


def _fans(
    surface: Iterable[occ.Face], faces_at: dict[occ.Edge, list[occ.Face]]
) -> dict[occ.Vertex, list[set[occ.Face]]]:
    """For every corner the groups of surface faces around it that are connected through edges."""
    fans: dict[occ.Vertex, list[set[occ.Face]]] = defaultdict(list)
    for face in surface:
        for corner in set(face.vertices):
            fans[corner].append({face})
    for edge, faces in faces_at.items():
        for corner in set(edge.vertices):
            joined = [fan for fan in fans[corner] if fan & set(faces)]
            apart = [fan for fan in fans[corner] if not fan & set(faces)]
            fans[corner] = [*apart, set().union(*joined)]
    return fans


def _middle(edge: occ.Edge) -> Point:
    start, end = edge.parameter_interval
    return tuple(xyz(edge.Value((start + end) / 2)).tolist())


def _gathered(places: Sequence[tuple[str, Point, set[str]]]) -> tuple[Pinch, ...]:
    found: dict[tuple[str, tuple[str, ...]], list[Point]] = defaultdict(list)
    for kind, point, names in places:
        found[kind, tuple(sorted(names))].append(point)
    return tuple(
        Pinch(names, kind, min(points), len(points)) for (kind, names), points in sorted(found.items())
    )


def contact_areas(glued: occ.TopoDS_Shape) -> dict[tuple[str, str], float]:
    """Area, mm^2, of the faces that two bodies share, by their names."""
    first: dict[occ.Face, str] = {}
    areas: dict[tuple[str, str], float] = defaultdict(float)
    for solid in glued.solids:
        for face in solid.faces:
            other = first.setdefault(face, solid.name)
            if other != solid.name:
                areas[other, solid.name] += float(face.mass)
    return dict(areas)


def near_misses(solids: Sequence[NamedSolid], glued: occ.TopoDS_Shape) -> tuple[tuple[str, str, float], ...]:
    """Pairs of solids (named as in `glued`) nearer than LEAST_GAP, mm, that share no face, edge or corner, and their
    distance.

    Contact in a tangent line or point may leave no edge or corner behind: it is found here, at distance zero.
    """
    corners: dict[str, set[occ.Vertex]] = defaultdict(set)
    for piece in glued.solids:
        corners[piece.name].update(piece.vertices)
    found = []
    for a, b in combinations(solids, 2):
        if corners[a.name] & corners[b.name] or not bounds_nearer_than(a.solid, b.solid, LEAST_GAP):
            continue
        distance = a.solid.Distance(b.solid)
        if distance < LEAST_GAP:
            found.append((a.name, b.name, 0.0 if distance <= CONTACT_DISTANCE else distance))
    return tuple(found)
