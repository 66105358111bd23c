"""Device shapes as solids of the CAD kernel (Open CASCADE through netgen).

Inside the kernel lengths are millimetres: its tolerances are absolute (1e-7), too coarse for a
model in metres. Devices are in metres: the factor is
applied here.
"""

from __future__ import annotations

import numpy as np

from fieldmap.device.model import (
    Box,
    Cylinder,
    ExtrudedPolygon,
    MeshFile,
    Placement,
    RevolvedProfile,
    Ring,
    Shape,
    Sphere,
    StepFile,
    TriangleSurface,
    VolumeMesh,
)
from fieldmap.device.polygons import polygon_fault, signed_area
from fieldmap.device.surfaces import crossing_triangles, enclosed_volume, surface_fault
from fieldmap.iron.geometry.cad_kernel import occ
from fieldmap.iron.geometry.step_files import solid_of_step_file
from fieldmap.typing import Array

MILLIMETRES = 1e3
"""Millimetres in a metre."""


def place(solid: occ.TopoDS_Shape, placement: Placement) -> occ.TopoDS_Shape:
    """`solid` turned by the placement's rotation and moved to its position. ValueError if not finite."""
    origin = np.asarray(placement.position, dtype=float) * MILLIMETRES
    rotation = np.asarray(placement.rotation, dtype=float)
    if not (np.isfinite(origin).all() and np.isfinite(rotation).all()):
        raise ValueError("a position and rotation must be finite numbers")
    frame = occ.Axes(point(*origin), n=occ.Dir(*rotation[:, 2]), h=occ.Dir(*rotation[:, 0]))
    # Transformation(frame) takes global coordinates to those of the frame; its inverse places.
    return occ.gp_Trsf.Transformation(frame).Inverted()(solid)


def local_solid(shape: Shape) -> occ.TopoDS_Shape:
    """The solid of a shape in its local frame, mm. Raises one of kernel_errors() where it cannot be built."""
    match shape:
        case Cylinder(radius, height):
            return cylinder(radius, 0.0, height)
        case Ring(inner, outer, height):
            return ring(inner, outer, 0.0, height)
        case Box(size):
            x, y, z = positive(size=size)
            return occ.Box(point(-x / 2, -y / 2, 0.0), point(x / 2, y / 2, z))
        case Sphere(radius):
            return occ.Sphere(point(0.0, 0.0, 0.0), *positive(radius=radius))
        case ExtrudedPolygon(points, height):
            return _extruded(points, height)
        case RevolvedProfile(points):
            return _revolved(points)
        case StepFile(path, scale):
            return solid_of_step_file(path, scale)
        case TriangleSurface():
            return _inside_surface(shape)
        case VolumeMesh() | MeshFile():
            raise ValueError("a mesh must be a body of its own")


# ---- the pieces ----


def positive(**lengths: float | Array | tuple[float, ...]) -> Array:
    """The lengths in millimetres. Raises ValueError unless all are finite and above zero."""
    values = np.concatenate([np.atleast_1d(np.asarray(value, dtype=float)) for value in lengths.values()])
    if not np.isfinite(values).all() or values.min() <= 0.0:
        given = ", ".join(f"{name} = {value} m" for name, value in lengths.items())
        raise ValueError(f"every length must be above zero: {given}")
    return values * MILLIMETRES


def point(x: float, y: float, z: float) -> occ.gp_Pnt:
    """A point of the kernel, mm."""
    return occ.Pnt(float(x), float(y), float(z))


def cylinder(radius: float, base: float, height: float) -> occ.TopoDS_Shape:
    """Cylinder about the z axis, base <= z <= base + height. Lengths in m."""
    r, h = positive(radius=radius, height=height)
    return occ.Cylinder(point(0.0, 0.0, base * MILLIMETRES), occ.Z, r, h)


def ring(inner: float, outer: float, base: float, height: float) -> occ.TopoDS_Shape:
    """Hollow cylinder about the z axis, base <= z <= base + height; full where inner = 0. Lengths in m."""
    solid = cylinder(outer, base, height)
    if inner == 0.0:
        return solid
    if not 0.0 < inner < outer:
        raise ValueError(f"the inner radius {inner} m must lie between zero and the outer radius {outer} m")
    return solid - cylinder(inner, base, height)


def segment(start: Array, end: Array) -> occ.Edge:
    """Straight edge between two points (3,), mm."""
    return occ.Segment(point(*start), point(*end))


def polygon_face(points: Array) -> occ.TopoDS_Shape:
    """Plane face with straight sides; points (n, 3) in mm."""
    return occ.Face(occ.Wire([segment(points[i - 1], points[i]) for i in range(len(points))]))


def checked_polygon(points: Array, what: str) -> Array:
    """The corners (n, 2) in mm, counter-clockwise. Raises ValueError unless they form a simple polygon."""
    corners = np.asarray(points, dtype=float)
    if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise ValueError(f"{what} must be given by finite points (n, 2)")
    fault = polygon_fault(corners.tolist())
    if fault is not None:
        raise ValueError(f"{what} must be a simple polygon: {fault}")
    corners = corners * MILLIMETRES
    return corners if signed_area(corners.tolist()) > 0 else corners[::-1]


def _extruded(points: Array, height: float) -> occ.TopoDS_Shape:
    corners = checked_polygon(points, "the extruded outline")
    (h,) = positive(height=height)
    face = polygon_face(np.column_stack([corners, np.zeros(len(corners))]))
    return occ.Prism(face, occ.Vec(0.0, 0.0, float(h)))


def _revolved(points: Array) -> occ.TopoDS_Shape:
    corners = checked_polygon(points, "the revolved profile")
    if corners[:, 0].min() < 0.0:
        raise ValueError(f"the revolved profile must keep r >= 0; its least r is {corners[:, 0].min():g} mm")
    on_axis = corners[:, 0] == 0.0
    alone = on_axis & ~np.roll(on_axis, 1) & ~np.roll(on_axis, -1)
    if alone.any():
        z = corners[alone, 1][0]
        raise ValueError(f"the revolved profile touches the axis at one point only (z = {z:g} mm)")
    face = polygon_face(np.column_stack([corners[:, 0], np.zeros(len(corners)), corners[:, 1]]))
    return occ.Revolve(face, occ.Axis(point(0.0, 0.0, 0.0), occ.Z), 360.0)


def _inside_surface(shape: TriangleSurface) -> occ.TopoDS_Shape:
    """Triangles sewn together; those that lie in one plane become one face."""
    points, triangles = np.asarray(shape.points, dtype=float), np.asarray(shape.triangles)
    fault = surface_fault(points, triangles)
    if fault is not None:
        raise ValueError(f"{fault[0]}: {fault[1]}")
    crossing = crossing_triangles(points, triangles)
    if crossing is not None:
        raise ValueError(f"the surface must not cut itself: triangles {crossing[0]} and {crossing[1]} do")
    corners = points * MILLIMETRES
    faces = [polygon_face(corners[triangle]) for triangle in triangles]
    solid = occ.Solid(occ.Sew(faces)).UnifySameDomain()
    volume = enclosed_volume(corners, triangles)
    if abs(solid.mass - volume) > 1e-6 * volume:
        raise ValueError(
            f"the surface bounds no single solid: {solid.mass:.6g} mm^3 in place of {volume:.6g} mm^3"
        )
    return solid
