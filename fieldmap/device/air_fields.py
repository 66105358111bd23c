"""Fields in air of the currents and magnets that magpylib has, by kernels of this package where one exists.

| kind | flux density | gradient |
|---|---|---|
| Circle | loop kernel | loop kernel |
| Polyline | closed form of each segment (Hanson and Hirshman, Phys. Plasmas 9 (2002) 4410, eq. 8) | its complex step |
| TriangleSheet, TriangleStrip | mu0 K x field of the charged triangle: kernel of charged faces | the same |
| Cuboid, Tetrahedron, TriangularMesh, Triangle | charged faces J . n, and J inside | the same |
| Sphere, Dipole | closed form | closed form |
| Cylinder magnetised along its axis | current sheet kernel | the same |
| Cylinder across, CylinderSegment, any other object | magpylib | differences, `differenced` |

Flux density and gradient are NaN on a line current, on a current sheet and at a dipole (magpylib gives 0 on lines and
sheets). The gradient is infinite on the edges of a magnet; there the result is NaN or a number without meaning.
InputError is raised where a value from magpylib is not finite.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.constants import MU0
from fieldmap.device.air_sources import NEEDS, OTHER, AirSource
from fieldmap.device.tetrahedra import OUTWARD
from fieldmap.errors import InputError
from fieldmap.extras import needs
from fieldmap.kernels.coils.loop import loop_flux_density, loop_flux_density_and_gradient
from fieldmap.kernels.coils.sheet import sheet_flux_density, sheet_flux_density_and_gradient
from fieldmap.kernels.iron.charged_triangle import triangles_field, triangles_field_and_gradient
from fieldmap.typing import Array, Index

STEP = 2e-3
"""Step of the differences, as a share of the source's size."""

# Complex step of the gradient of line currents, m.
_IMAGINARY = 1e-30
# Larger values count as infinite: kernels that guard a distance of 0 return 1e200 and more.
_INFINITE = 1e100
# Pairs of a point and a segment or triangle that are computed at a time.
_ROWS = 20_000


def flux_density(source: AirSource, points: Array) -> Array:
    """B (n, 3), T, of a source with its own current at points (n, 3), m, in the frame of its placement."""
    return _placed(source, points, False)[0]


def flux_density_and_gradient(source: AirSource, points: Array) -> tuple[Array, Array]:
    """B (n, 3), T, and dB_i/dx_j (n, 3, 3), T/m; the table of this module lists the methods."""
    return _placed(source, points, True)


def _placed(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    local, rotation = _local(source, points)
    # The formulas divide by the distance. A value with an infinite component becomes NaN in all components.
    with np.errstate(all="ignore"):
        field, gradient = _FIELDS.get(source.kind, _by_magpylib)(source, local, both)
        field, gradient = field @ rotation.T, rotation @ gradient @ rotation.T
    field[~(np.abs(field) < _INFINITE).all(axis=1)] = np.nan
    gradient[~(np.abs(gradient) < _INFINITE).all(axis=(1, 2))] = np.nan
    return field, gradient


def _local(source: AirSource, points: Array) -> tuple[Array, Array]:
    if source.kind == OTHER:  # the magpylib object has its own position and orientation
        return points, np.eye(3)
    rotation = np.asarray(source.placement.rotation, dtype=float)
    return np.ascontiguousarray((points - source.placement.position) @ rotation), rotation


_None = np.zeros((0, 3, 3))
_LOOP = loop_flux_density, loop_flux_density_and_gradient
_SHEET = sheet_flux_density, sheet_flux_density_and_gradient
_TRIANGLES = triangles_field, triangles_field_and_gradient


def _by(
    kernels: tuple[Callable[..., Array], Callable[..., Any]], both: bool, *what: Any
) -> tuple[Array, Array]:
    """Field and gradient by a pair of kernels: one for the field alone, one for both."""
    return kernels[1](*what) if both else (kernels[0](*what), _None)


def _circle(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    field, gradient = _by(_LOOP, both, points, 0.5 * source.diameter)  # type: ignore[operator]
    return source.amperes * field, source.amperes * gradient


# ---- filaments ----


def segments_of(source: AirSource) -> tuple[Array, Array]:
    """First and last points (m, 3) of the segments of a Polyline; segments of zero length are left out."""
    start, end = source.vertices[:-1], source.vertices[1:]  # type: ignore[index]
    there = (start != end).any(axis=1)
    return start[there], end[there]


def _polyline(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    start, end = segments_of(source)
    factor = MU0 * source.amperes / (4 * np.pi)
    field = np.zeros(points.shape)
    gradient = np.zeros((len(points), 3, 3)) if both else _None
    rows = max(1, _ROWS // max(len(start), 1))
    for first in range(0, len(points), rows):
        here = slice(first, first + rows)
        field[here] = factor * _segments(points[here], start, end)
        for axis in range(3) if both else ():
            moved = points[here].astype(complex)
            moved[:, axis] += 1j * _IMAGINARY
            gradient[here, :, axis] = factor * _segments(moved, start, end).imag / _IMAGINARY
    return field, gradient


def _segments(points: Array, start: Array, end: Array) -> Array:
    """4 pi / mu0 times B per ampere, summed over all segments. Points may be complex."""
    one, other = points[:, None] - start, points[:, None] - end
    far = np.sqrt((one**2).sum(axis=2)) + np.sqrt((other**2).sum(axis=2))
    product = np.sqrt((one**2).sum(axis=2) * (other**2).sum(axis=2))
    length = np.linalg.norm(end - start, axis=1)
    # far^2 - length^2 = 2 (product + one . other): no difference of large numbers.
    apart = 2 * (product + (one * other).sum(axis=2))
    cross = np.cross((end - start) / length[:, None], one)
    on_line = np.abs(cross.real).max(axis=2) < 1e-15 * length
    # On the segment the field is infinite; on its continuation it is zero.
    within = (one.real * other.real).sum(axis=2) <= 0
    size = np.where(on_line, np.where(within, np.nan, 0.0), 2 * length * far / (product * apart))
    return (size[:, :, None] * cross).sum(axis=1)


# ---- triangles: sheets of current, and faces with magnetic charge ----


def sheet_of(source: AirSource) -> tuple[Array, Array]:
    """Corners (m, 3, 3) and current densities (m, 3), A/m, of a TriangleSheet or TriangleStrip."""
    vertices = source.vertices
    assert vertices is not None
    if source.kind == "TriangleStrip":
        corners = np.stack([vertices[:-2], vertices[1:-1], vertices[2:]], axis=1)
        along, side = corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0]
        area = np.linalg.norm(np.cross(side, along), axis=1)
        flat = area <= 1e-14 * (along**2).sum(axis=1)
        # The current runs parallel to the side from first to last corner, spread over the triangle's height.
        density = source.amperes * along / np.where(flat, 1.0, area)[:, None]
        return corners[~flat], density[~flat]
    corners = vertices[source.faces]
    normals = _normals(corners)
    density = np.asarray(source.current_densities, dtype=float)
    return corners, density - np.einsum("md,md->m", density, normals)[:, None] * normals


def _normals(corners: Array) -> Array:
    twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return twice / np.linalg.norm(twice, axis=1, keepdims=True)


def _sheet(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    """mu0 times the sum of K x E, with E the field of a triangle of unit charge."""
    corners, density = sheet_of(source)
    normals = _normals(corners)
    field, gradient = np.zeros(points.shape), np.zeros((len(points), 3, 3)) if both else _None
    on_sheet = _on_triangles(points, corners, normals)
    for axis in range(3):
        charge = np.ascontiguousarray(MU0 * density[:, axis] / (4 * np.pi))
        e, slope = _by(_TRIANGLES, both, points, corners, normals, charge)
        field += np.cross(np.eye(3)[axis], e)
        gradient += np.cross(np.eye(3)[axis], slope, axisb=1, axisc=1)
    field[on_sheet] = np.nan
    if both:
        gradient[on_sheet] = np.nan
    return field, gradient


def _on_triangles(points: Array, corners: Array, normals: Array) -> NDArray[np.bool_]:
    """Whether points (n, 3) lie on one of the triangles, to rounding."""
    on = np.zeros(len(points), bool)
    for corner, normal in zip(corners, normals, strict=True):
        size = np.linalg.norm(corner[1] - corner[0]) + np.linalg.norm(corner[2] - corner[0])
        near = np.abs((points - corner[0]) @ normal) < 1e-12 * size
        for k in range(3):
            inward = np.cross(normal, corner[(k + 1) % 3] - corner[k])
            near &= (points - corner[k]) @ inward > -1e-12 * size**2
        on |= near
    return on


def faces_of(source: AirSource) -> Array:
    """Corners (m, 3, 3) of the triangles of a magnet, counter-clockwise seen from outside, or of one Triangle."""
    if source.kind == "Cuboid":
        half = 0.5 * np.asarray(source.dimension)
        return _CUBE[_CUBE_FACES] * half
    vertices = np.asarray(source.vertices, dtype=float)
    if source.kind == "Triangle":
        return vertices[None]
    if source.kind == "Tetrahedron":
        volume = np.linalg.det(vertices[1:] - vertices[0])
        return vertices[OUTWARD if volume > 0 else OUTWARD[:, ::-1]]
    corners = vertices[source.faces]
    volume = np.einsum("md,md->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return corners if volume > 0 else corners[:, ::-1]


_CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_CUBE_FACES: Index = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def _charged(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    """Field of the charges J . n on the faces; inside the magnet J is added, as B = mu0 H + J."""
    corners = np.ascontiguousarray(faces_of(source))
    normals = _normals(corners)
    polarisation = np.asarray(source.polarization, dtype=float)
    charge = np.ascontiguousarray(normals @ polarisation / (4 * np.pi))
    field, gradient = _by(_TRIANGLES, both, points, corners, normals, charge)
    if source.kind != "Triangle":
        field[_inside(points, corners)] += polarisation
    return field, gradient


def _inside(points: Array, corners: Array) -> NDArray[np.bool_]:
    """Whether points (n, 3) lie inside a closed surface (m, 3, 3): its solid angle is then 4 pi, otherwise 0."""
    lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    inside = ((points > lower) & (points < upper)).all(axis=1)
    candidates = np.flatnonzero(inside)
    rows = max(1, _ROWS // len(corners))
    for first in range(0, len(candidates), rows):
        here = candidates[first : first + rows]
        a, b, c = np.moveaxis(corners - points[here][:, None, None], 2, 0)
        lengths = [np.linalg.norm(side, axis=2) for side in (a, b, c)]
        triple = np.einsum("nmd,nmd->nm", a, np.cross(b, c))
        pairs = [np.einsum("nmd,nmd->nm", *two) for two in ((a, b), (b, c), (c, a))]
        below = lengths[0] * lengths[1] * lengths[2] + pairs[0] * lengths[2] + pairs[1] * lengths[0]
        angle = 2 * np.arctan2(triple, below + pairs[2] * lengths[1]).sum(axis=1)
        inside[here] = np.abs(angle) > 2 * np.pi
    return inside


# ---- balls, dipoles, cylinders ----


def _dipole_of(moment: Array, points: Array, both: bool) -> tuple[Array, Array]:
    """B and gradient of mu0 times a moment (3,), T m^3 (Jackson 5.56); infinite at the dipole."""
    r2 = (points**2).sum(axis=1)[:, None]
    along = (points @ moment)[:, None]
    size = 1 / (4 * np.pi * r2**1.5)
    field = size * (3 * along * points / r2 - moment)
    if not both:
        return field, _None
    r2, along = r2[:, :, None], along[:, :, None]
    outer = moment[:, None] * points[:, None, :] + points[:, :, None] * moment
    bracket = outer + along * np.eye(3) - 5 * along * points[:, :, None] * points[:, None, :] / r2
    return field, 3 * size[:, :, None] / r2 * bracket


def _sphere(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    radius = 0.5 * source.diameter  # type: ignore[operator]
    polarisation = np.asarray(source.polarization, dtype=float)
    field, gradient = _dipole_of(4 / 3 * np.pi * radius**3 * polarisation, points, both)
    inside = (points**2).sum(axis=1) <= radius**2
    field[inside] = 2 / 3 * polarisation
    if both:
        gradient[inside] = 0.0
    return field, gradient


def _cylinder(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    polarisation = np.asarray(source.polarization, dtype=float)
    if polarisation[:2].any():
        return _by_magpylib(source, points, both)
    diameter, height = np.asarray(source.dimension, dtype=float)
    turns = polarisation[2] * height / MU0
    field, gradient = _by(_SHEET, both, points, 0.5 * diameter, height)
    return turns * field, turns * gradient


# ---- fields from magpylib ----


def magpylib_object(source: AirSource) -> Any:
    """The source as an object of magpylib at the origin, not rotated; for the kind "other" its `live` object."""
    if source.kind == OTHER:
        return source.live
    with needs("make", f"the field of a {source.kind}"):
        import magpylib
    values = {name: getattr(source, name) for name in NEEDS[source.kind]}
    if "angles" in values:
        values["dimension"] = (*values["dimension"], *values.pop("angles"))
    module = next(m for m in (magpylib.magnet, magpylib.current, magpylib.misc) if hasattr(m, source.kind))
    return getattr(module, source.kind)(**values)


def _by_magpylib(source: AirSource, points: Array, both: bool) -> tuple[Array, Array]:
    """Field of magpylib. Raises InputError where it is not finite."""
    thing = magpylib_object(source)

    def field(local: Array) -> Array:
        values = np.reshape(thing.getB(local), local.shape) if len(local) else local
        if not np.isfinite(values).all():
            received = f"{int((~np.isfinite(values)).any(axis=1).sum())} of {len(values)} that are not"
            remedy = "keep to where it is known"
            raise InputError.of(f"magpylib {type(thing).__name__}", "B must be finite", received, remedy)
        return values

    return field(points), differenced(field, points, STEP * float(source.extents.max())) if both else _None


def differenced(field: Callable[[Array], Array], points: Array, step: float) -> Array:
    """dB_i/dx_j (n, 3, 3) by central differences of fourth order.

    The relative error is about (step / distance from the surface)^4, plus the rounding error of B over the step. With
    `STEP` it is 1e-6 at a tenth of a magnet's size from its surface, and 1e-5 at single points where magpylib's B has
    an error of 1e-8.
    """
    offsets = np.array([-2.0, -1.0, 1.0, 2.0]) * step
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12 * step)
    places = points[:, None, None] + offsets[:, None] * np.eye(3)[:, None]
    values = field(np.ascontiguousarray(places.reshape(-1, 3))).reshape(len(points), 3, 4, 3)
    return np.einsum("njkd,k->ndj", values, weights)


_Fields = Callable[[AirSource, Array, bool], tuple[Array, Array]]
_FIELDS: dict[str, _Fields] = {
    "Circle": _circle,
    "Polyline": _polyline,
    "TriangleSheet": _sheet,
    "TriangleStrip": _sheet,
    "Cuboid": _charged,
    "Tetrahedron": _charged,
    "TriangularMesh": _charged,
    "Triangle": _charged,
    "Sphere": _sphere,
    "Dipole": lambda source, points, both: _dipole_of(MU0 * np.asarray(source.moment), points, both),
    "Cylinder": _cylinder,
}
