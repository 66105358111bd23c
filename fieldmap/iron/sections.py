"""Flux through a plane cut out of iron: elements are clipped by the plane, and B . n summed over what is left.

Clipping works on triangles whose corners are barycentric coordinates of their element, so that the field inside the
element, which is of second order in the potential form, is integrated as it stands.
"""

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import check_names, raise_all
from fieldmap.device.model import Section
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.topology import area_vectors
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Points this close to the plane, relative to the size of the iron, lie in it.
SNAP = 1e-9
_DEGREE = 4
# Elements whose fields are evaluated at once, to bound memory.
_BATCH = 20_000


@dataclass(frozen=True, repr=False)
class SectionFlux(Record):
    """Flux in Wb through a section, its area in m^2, and the mean flux density along its normal, T."""

    name: str
    area: float
    flux: float

    @property
    def flux_density(self) -> float:
        """Mean normal flux density, T."""
        return self.flux / self.area


def named_section(sections: tuple[Section, ...], section: str | Section) -> Section:
    """The section itself, or that of a name. Raises InputError for a name that the device file does not have."""
    if isinstance(section, Section):
        return section
    by_name = {known.name: known for known in sections}
    must_hold = (
        f"must be a section of the device: {', '.join(by_name) or 'none: the file has no [[section]]'}"
    )
    remedy = "use one of these, or give a Section with its own origin and normal"
    check_names("section, name", [section], must_hold, by_name, remedy)
    return by_name[section]


def section_flux(
    mesh: IronMesh | None, state: IronState | None, section: Section, weights: Array
) -> SectionFlux:
    """Flux of the sources (columns of the state), weighted, through a section.

    Raises InputError for a section that cuts no iron, for unknown bodies and for a bad plane.
    """
    check_section(section, () if mesh is None else mesh.body_names)
    if mesh is None or state is None:
        raise no_iron_at(section)
    normal = np.asarray(section.normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    # A plane in the very surface of the iron cuts it from the other side.
    for side in (normal, -normal):
        cut, corners, areas = cut_by_plane(mesh, section, side)
        if areas.sum() > 0:
            break
    else:
        raise no_iron_at(section)
    rule, rule_weights = triangle_rule(_DEGREE)
    flux = 0.0
    for part in np.array_split(np.arange(len(areas)), 1 + len(areas) // _BATCH):
        points = np.einsum("qk,nkb->nqb", rule, corners[part])
        element = np.repeat(cut[part], len(rule_weights))
        b = state.flux_density_at(element, points.reshape(-1, 4))
        along = (np.tensordot(weights, b, 1) @ normal).reshape(len(part), -1)
        flux += float(areas[part] @ (along @ rule_weights))
    return SectionFlux(section.name, float(areas.sum()), flux)


def cut_by_plane(mesh: IronMesh, section: Section, normal: Array) -> tuple[Index, Array, Array]:
    """What the plane of a section cuts out of the elements of its bodies, within its half widths: triangles, by their
    element (k,), corners (k, 3, 4) in barycentric coordinates of it, and area (k,) in m^2."""
    extent = float(np.ptp(mesh.points, axis=0).max())
    height = (mesh.points - np.asarray(section.origin, dtype=float)) @ normal
    height[np.abs(height) < SNAP * extent] = 0.0
    mine = np.ones(len(mesh.tets), bool)
    if section.bodies:
        mine = np.isin(mesh.body, [mesh.body_names.index(name) for name in section.bodies])
    above = (height[mesh.tets] >= 0).sum(axis=1)
    element = np.flatnonzero(mine & (above > 0) & (above < 4))
    element, corners = _cut_elements(element, height[mesh.tets[element]])
    if section.half_widths is not None:
        for axis, side in ((a, s) for a in range(3) for s in (1, -1)):
            x = np.einsum("nkb,nbd->nkd", corners, mesh.points[mesh.tets[element]])
            margin = section.half_widths[axis] - side * (x[..., axis] - section.origin[axis])
            element, corners = clip_triangles(element, corners, margin)
    x = np.einsum("nkb,nbd->nkd", corners, mesh.points[mesh.tets[element]])
    area = 0.5 * np.linalg.norm(area_vectors(x), axis=1)
    return element, corners, area


def _cut_elements(element: Index, height: Array) -> tuple[Index, Array]:
    """Triangles (k, 3, 4) where the linear functions with these corner values (n, 4) of both signs vanish."""
    above = (height >= 0).sum(axis=1)
    # The side with fewer corners comes first; of two and two, the upper.
    order = np.argsort(np.where((above <= 2)[:, None], height < 0, height >= 0), axis=1, kind="stable")
    height, unit = np.take_along_axis(height, order, axis=1), np.eye(4)[order]
    single, double = np.flatnonzero(above != 2), np.flatnonzero(above == 2)
    lone = np.stack([_crossing(unit, height, single, 0, j) for j in (1, 2, 3)], axis=1)
    quad = [_crossing(unit, height, double, i, j) for i, j in ((0, 2), (0, 3), (1, 3), (1, 2))]
    halves = [np.stack([quad[0], quad[k], quad[k + 1]], axis=1) for k in (1, 2)]
    return element[np.concatenate([single, double, double])], np.concatenate([lone, *halves])


def _crossing(corners: Array, values: Array, rows: Index, i: int, j: int) -> Array:
    """Where linear functions with corner values (n, k) vanish between corners i and j of elements (n, k, 4)."""
    a, b = values[rows, i, None], values[rows, j, None]
    return (corners[rows, i] * b - corners[rows, j] * a) / (b - a)


def clip_triangles(element: Index, corners: Array, margin: Array) -> tuple[Index, Array]:
    """The part of triangles (k, 3, 4) where a linear function with corner values margin (k, 3) is not negative."""
    inside = margin >= 0
    count = inside.sum(axis=1)
    order = np.argsort(np.where((count == 2)[:, None], inside, ~inside), axis=1, kind="stable")
    margin = np.take_along_axis(margin, order, axis=1)
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)

    whole, one, two = (np.flatnonzero(count == n) for n in (3, 1, 2))
    tips = [_crossing(corners, margin, one, 0, k) for k in (1, 2)]
    tip = np.stack([corners[one, 0], *tips], axis=1)
    near, far = (_crossing(corners, margin, two, 0, k) for k in (1, 2))
    base = [
        np.stack([near, corners[two, 1], corners[two, 2]], axis=1),
        np.stack([near, corners[two, 2], far], axis=1),
    ]
    return element[np.concatenate([whole, one, two, two])], np.concatenate([corners[whole], tip, *base])


def no_iron_at(section: Section) -> InputError:
    """The error of a section that cuts no iron."""
    place = ", ".join(f"{1e3 * x:g}" for x in section.origin)
    must_hold = "its plane must cut iron" + (f" of {', '.join(section.bodies)}" if section.bodies else "")
    received = f"none at ({place}) mm" + ("" if section.half_widths is None else " within its half widths")
    remedy = "move the plane, widen it, or name other bodies"
    return InputError.of(f"section '{section.name}'", must_hold, received, remedy)


def check_section(section: Section, bodies: tuple[str, ...]) -> None:
    """Raise InputError for a bad plane and for names that are not among the bodies."""
    problems = []
    where = f"section '{section.name}'"
    for what, value in (("origin", section.origin), ("normal", section.normal)):
        vector = np.asarray(value, dtype=float)
        if vector.shape != (3,) or not np.isfinite(vector).all() or (what == "normal" and not vector.any()):
            remedy = "give three finite numbers" + (", not all zero" if what == "normal" else " in m")
            problems.append(Problem(f"{where}, {what}", "must be a vector (3,)", repr(value), remedy))
    widths = section.half_widths
    if widths is not None and (np.shape(widths) != (3,) or not (np.asarray(widths) > 0).all()):
        remedy = "give three numbers in m"
        problems.append(Problem(f"{where}, half widths", "must be three numbers > 0", repr(widths), remedy))
    problems += [
        Problem(f"{where}, bodies", f"must be bodies: {', '.join(bodies)}", repr(name), "use one of these")
        for name in section.bodies
        if name not in bodies
    ]
    raise_all(problems)
