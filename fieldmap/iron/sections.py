"""Flux through a plane section of iron, by the flux that the nodes' equations conserve.

B of the potential form is free of divergence only in the mean, in the equation of each node. In elements at an inner
corner it is wrong by tens of per cent. Take a function v that is 1 at the corners of elements above the plane, 0 at
corners below, and linear between. With the step s at the plane, a field without divergence has the flux

    int B . n dA  =  int B . grad v dV  +  int (s - v) B . n dS,

over the elements that the plane cuts, and over the faces of all of these to the air. The equations of the nodes
conserve the first integral. The second is small. It takes B . n on the iron's surface from the air, where it is known
best.

A section that ends within the iron, at a half width or at another body, has a border at which no equation conserves
flux. Then B is integrated over the cut, in triangles whose corners are barycentric coordinates of the element, and the
error of the flux is of the first order in the error of B.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import check_names, raise_all
from fieldmap.device.model import Section
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.mesh import IronMesh, volumes
from fieldmap.iron.topology import TET_FACES, area_vectors, barycentric_gradients, distinct_parts
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Points this close to the plane, relative to the size of the iron, lie in it.
SNAP = 1e-9
# The half widths leave an element whole if they take away less than this share of its cut.
_WHOLE = 1e-6
# Points on the surface are moved into the air by this share of a face's size.
_OUT = 1e-6
_DEGREE = 4

AirField = Callable[[Array], Array]
"""B (n, 3) in T at points (n, 3) in the air."""


@dataclass(frozen=True, repr=False)
class SectionFlux(Record):
    """Flux in Wb through a section, its area in m^2, and the mean flux density along its normal, T.

    error: estimated error of the flux, Wb (docs/theory/forces.md); None in the surface form, which has no estimate.
    """

    name: str
    area: float
    flux: float
    error: float | None

    @property
    def flux_density(self) -> float:
        """Mean normal flux density, T."""
        return self.flux / self.area


def named_section(sections: tuple[Section, ...], section: str | Section) -> Section:
    """The section itself, or the section of a name. Raises InputError for a name that the device file does not have."""
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
    mesh: IronMesh | None, state: IronState | None, section: Section, weights: Array, air: AirField
) -> SectionFlux:
    """Flux of the sources (columns of the state), weighted, through a section.

    Raises InputError for a section that cuts no iron, for unknown bodies and for a bad plane.
    """
    check_section(section, () if mesh is None else mesh.body_names)
    if mesh is None or state is None:
        raise no_iron_at(section)
    normal = np.asarray(section.normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    # Iron that ends in the plane is cut from one side only. If parts of the iron's surface lie in the plane beside the
    # section, the side with the smaller area of these is taken.
    sides = [cut_by_plane(mesh, section, side) for side in (normal, -normal)]
    turned, cut = min(enumerate(sides), key=lambda one: (one[1].area == 0.0, one[1].beside))
    if cut.area == 0.0:
        raise no_iron_at(section)
    b = np.tensordot(weights, state.flux_density, 1)
    error = relative_energy_error(mesh, b)
    if cut.ends_in_air:
        flux = _conserved(mesh, cut, b, air)
    else:
        flux, error = _integral(cut, state, weights), error**0.5
    passing = float(cut.areas @ np.abs(b[cut.elements] @ normal))
    return SectionFlux(section.name, cut.area, -flux if turned else flux, error * passing)


def relative_energy_error(mesh: IronMesh, flux_density: Array) -> float:
    """Estimated square of the error of B (e, 3) over the square of B, both integrated over all elements: B against its
    means about the nodes of each body (Zienkiewicz, Zhu, Int. J. Numer. Meth. Eng. 24 (1987) 337)."""
    volume, error = volumes(mesh.points, mesh.tets), 0.0
    for body in range(len(mesh.body_names)):
        mine = mesh.body == body
        number = np.unique(mesh.tets[mine], return_inverse=True)[1].reshape(-1, 4)
        share = np.repeat(volume[mine], 4)
        total = np.bincount(number.ravel(), share)
        for b in flux_density[mine].T:
            mean = np.bincount(number.ravel(), share * np.repeat(b, 4)) / total
            error += float(volume[mine] @ (mean[number].mean(axis=1) - b) ** 2)
    return error / max(float(volume @ (flux_density**2).sum(axis=1)), 1e-300)


@dataclass(frozen=True, eq=False, repr=False)
class PlaneCut(Record):
    """A plane in the elements of the bodies of a section.

    normal (3,); height (p,): of the mesh's points above the plane, m. Triangles of the cut within the half widths:
    elements (k,), corners (k, 3, 4) in barycentric coordinates, areas (k,) in m^2. layer (m,): elements between nodes
    above and below. faces (f, 3): of the layer to the air, opposite (f,): the fourth nodes of their elements; aside
    (f,): faces in the plane that are no part of the section; beside: area of these cuts, m^2. ends_in_air: whether the
    section ends in the surface of the iron everywhere.
    """

    normal: Array
    height: Array
    elements: Index
    corners: Array
    areas: Array
    layer: Index
    faces: Index
    opposite: Index
    aside: NDArray[np.bool_]
    beside: float
    ends_in_air: bool

    @property
    def area(self) -> float:
        """Area of the section, m^2."""
        return float(self.areas.sum())


def cut_by_plane(mesh: IronMesh, section: Section, normal: Array) -> PlaneCut:
    """The cut of a section's plane through the elements of its bodies, within its half widths. Points in the plane
    count as above it."""
    count, snap = len(mesh.tets), SNAP * float(np.ptp(mesh.points, axis=0).max())
    height = (mesh.points - np.asarray(section.origin, dtype=float)) @ normal
    height[np.abs(height) < snap] = 0.0
    chosen = np.isin(mesh.body, [mesh.body_names.index(name) for name in section.bodies or mesh.body_names])
    above, flat = (height[mesh.tets] >= 0).sum(axis=1), (height[mesh.tets] == 0).sum(axis=1)
    crossing = (above > 0) & (above < 4)
    element, corners = _cut_elements(np.flatnonzero(chosen & crossing), height[mesh.tets[chosen & crossing]])
    before = np.bincount(element, _areas(mesh, element, corners), count)
    if section.half_widths is not None:
        element, corners = _within(mesh, section.origin, section.half_widths, element, corners, snap)
    areas = _areas(mesh, element, corners)
    layer = np.zeros(count, bool)
    layer[element] = True
    clipped = np.bincount(element, areas, count) < (1 - _WHOLE) * before

    # Faces near the plane, one entry for each element at each of them.
    near = np.flatnonzero(crossing | (flat == 3))
    rows, _, number, times = distinct_parts(mesh.tets[near], TET_FACES)
    owner = np.repeat(near, 4)
    in_plane = (height[rows] == 0).all(axis=1)
    crossed = in_plane | ((height[rows] >= 0).any(axis=1) & (height[rows] < 0).any(axis=1))
    border = (in_plane & (np.bincount(number, chosen[owner]) == 1))[number]
    # Such faces are a section of their own only where the plane cuts nothing else.
    aside = np.isin(element, owner[border & chosen[owner] & (above[owner] < 4)]) & (areas > 0)
    aside &= bool(areas[~aside].any())
    border &= bool(aside.any())
    outer = layer[owner] & (np.bincount(number, layer[owner]) == 1)[number] & crossed[number]
    inner = outer & (times[number] > 1) & (border | ~in_plane[number])
    outer &= times[number] == 1
    kept = ~aside
    return PlaneCut(
        normal=normal,
        height=height,
        elements=element[kept],
        corners=corners[kept],
        areas=areas[kept],
        layer=np.flatnonzero(layer),
        faces=rows[number[outer]],
        opposite=mesh.tets[near].ravel()[outer],
        aside=border[outer],
        beside=float(areas[aside].sum()),
        ends_in_air=not (clipped & layer).any() and not inner.any(),
    )


def _conserved(mesh: IronMesh, cut: PlaneCut, b: Array, air: AirField) -> float:
    """Flux (Wb) through a section that ends in air, by the mean flux densities b (e, 3) of the elements."""
    tets, corners = mesh.tets[cut.layer], mesh.points[cut.faces]
    step = (cut.height >= 0).astype(float)
    slope = np.einsum("ni,nid->nd", step[tets], barycentric_gradients(mesh.points[tets]))
    flux = volumes(mesh.points, tets) @ np.einsum("nd,nd->n", b[cut.layer], slope)
    outward = area_vectors(corners)
    outward *= np.sign(np.einsum("nd,nd->n", corners[:, 0] - mesh.points[cut.opposite], outward))[:, None]
    twice = np.linalg.norm(outward, axis=1)
    outward /= twice[:, None]
    excess = np.where(cut.aside, 0.0, areas_above(corners, cut.height[cut.faces]))
    excess -= 0.5 * twice * step[cut.faces].mean(axis=1)
    field = air(corners.mean(axis=1) + _OUT * np.sqrt(twice)[:, None] * outward)
    return float(flux + excess @ np.einsum("nd,nd->n", field, outward))


def _integral(cut: PlaneCut, state: IronState, weights: Array) -> float:
    """Flux (Wb) through a section, by the field inside the elements."""
    rule, rule_weights = triangle_rule(_DEGREE)
    points = np.einsum("qk,nkb->nqb", rule, cut.corners)
    b = state.flux_density_at(np.repeat(cut.elements, len(rule_weights)), points.reshape(-1, 4))
    along = (np.tensordot(weights, b, 1) @ cut.normal).reshape(len(cut.areas), -1)
    return float(cut.areas @ (along @ rule_weights))


def areas_above(corners: Array, height: Array) -> Array:
    """Area (n,) of the part of triangles (n, 3, 3) where a linear function with corner values (n, 3) is positive."""
    low, middle, high = np.sort(height, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        tip = high**2 / ((high - low) * (high - middle))
        base = 1 - low**2 / ((low - middle) * (low - high))
    share = np.select([low >= 0, high <= 0, middle <= 0], [1.0, 0.0, tip], base)
    return 0.5 * np.linalg.norm(area_vectors(corners), axis=1) * share


def _areas(mesh: IronMesh, element: Index, corners: Array) -> Array:
    """Areas (k,), m^2, of triangles in barycentric coordinates."""
    x = np.einsum("nkb,nbd->nkd", corners, mesh.points[mesh.tets[element]])
    return 0.5 * np.linalg.norm(area_vectors(x), axis=1)


def _within(
    mesh: IronMesh, centre: Array, half_widths: Array, element: Index, corners: Array, snap: float
) -> tuple[Index, Array]:
    """The part of triangles (k, 3, 4) within half widths (3,) of a centre (3,)."""
    for axis, side in ((a, s) for a in range(3) for s in (1, -1)):
        x = np.einsum("nkb,nbd->nkd", corners, mesh.points[mesh.tets[element]])
        margin = half_widths[axis] - side * (x[..., axis] - centre[axis])
        margin[np.abs(margin) < snap] = 0.0
        element, corners = clip_triangles(element, corners, margin)
    return element, corners


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
    """Points where linear functions with corner values (n, k) vanish between corners i and j of elements (n, k, 4)."""
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
