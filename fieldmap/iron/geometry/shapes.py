"""Device shapes, STEP files, windings and workspaces as solids of the CAD kernel (Open CASCADE through netgen).

Inside the kernel lengths are millimetres: its tolerances are absolute (1e-7), too coarse for a model in metres. Devices
are in metres: the factor is applied here. The device file states the length unit of a STEP file. The kernel is
imported at its first use, so that solutions can be read and pictures drawn without it.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fieldmap.device import model
from fieldmap.device.another_process import read_by_another
from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.polygons import polygon_fault, signed_area
from fieldmap.device.surfaces import crossing_fault, enclosed_volume, shells_of, surface_fault
from fieldmap.errors import InputError
from fieldmap.extras import needs
from fieldmap.typing import Array, Index

if TYPE_CHECKING:
    from netgen import occ as occ


class _OnFirstUse:
    """`netgen.occ`; an attribute of it raises MissingExtraError where the mesher is not installed."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        with needs("make", "bodies and windings as solids"):
            from netgen import occ
        value = getattr(occ, name)
        # Kept: finding it again takes longer than many calls of the kernel.
        setattr(self, name, value)
        return value


if not TYPE_CHECKING:
    occ = _OnFirstUse()


def named(solid: occ.TopoDS_Shape, name: str) -> occ.TopoDS_Shape:
    """The solid, with this name on all of its pieces."""
    for piece in solid.solids:
        piece.name = name
    return solid


def xyz(point: occ.gp_Pnt) -> Array:
    """Coordinates (3,) of a point of the kernel, mm."""
    return np.array([point.x, point.y, point.z])


def kernel_errors() -> tuple[type[Exception], ...]:
    """The exceptions raised where a solid cannot be built: the kernel's, and ValueError by `shapes`."""
    return RuntimeError, occ.OCCException, ValueError


_SI_LENGTH = re.compile(r"SI_UNIT\s*\(\s*([$.\w]+)\s*,\s*\.METRE\.")
_SI_PREFIX = {"$": 1.0, ".MILLI.": 1e-3, ".CENTI.": 1e-2, ".DECI.": 1e-1, ".MICRO.": 1e-6, ".KILO.": 1e3}
# Program for another process: writes a STEP file's solid in the kernel's format, or an empty file if there is none.
_TO_BREP = """
from netgen import occ
limit()
pieces = list(occ.OCCGeometry(path).shape.solids)
if len(pieces) > 1:
    pieces = [occ.Fuse(pieces).UnifySameDomain()]
if pieces:
    pieces[0].WriteBrep(out, withTriangles=False)
else:
    open(out, "w").close()
"""
_CONVERTED = re.compile(r"CONVERSION_BASED_UNIT\s*\(\s*'\s*(\w+)")
_CONVERTED_UNIT = {"INCH": 0.0254, "FOOT": 0.3048}


def declared_step_unit(path: Path) -> float | None:
    """The length unit that a STEP file (ISO 10303-21) declares, in metres; None where it declares none.

    Raises ValueError where the file cannot be read, or declares an unknown length unit or several ones.
    """
    entities = [e for e in _text(path).split(";") if "LENGTH_UNIT" in e]
    converted = {name.upper() for e in entities for name in _CONVERTED.findall(e)}
    prefixes = {prefix for e in entities for prefix in _SI_LENGTH.findall(e)}
    # A converted unit is defined through an SI unit, which is then only its base.
    names, table = (converted, _CONVERTED_UNIT) if converted else (prefixes, _SI_PREFIX)
    if len(names) > 1 or not names <= table.keys():
        raise ValueError(f"the STEP file {path} must declare one known length unit, not {sorted(names)}")
    return table[names.pop()] if names else None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="latin-1")
    except OSError as error:
        raise ValueError(f"the STEP file {path} cannot be opened ({error.strerror})") from error


def _is_whole(path: Path) -> bool:
    """True where a file has the first and last word of a STEP file."""
    text = _text(path).strip()
    return text.startswith("ISO-10303-21;") and text.endswith("END-ISO-10303-21;")


def solid_of_step_file(path: Path, scale: float) -> occ.TopoDS_Shape:
    """The solid of a STEP file, mm: numbers in the file times `scale` are metres. Several solids are joined.

    The device file's scale decides; the kernel's own conversion from the unit that the STEP file declares is undone.
    Another process reads the file and hands the solid over, because the kernel's reader may crash on a damaged file.
    Raises ValueError where the file cannot be read or holds no solid.
    """
    if not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f"the scale of a STEP file must be above zero, not {scale}")
    unit = declared_step_unit(path)
    if not _is_whole(path):  # asked first, because the kernel's reader prints its complaints
        raise ValueError(f"{path} is not a whole STEP file (from ISO-10303-21 to END-ISO-10303-21)")
    solid = _solid_of_brep(read_by_another(path, _TO_BREP), path)
    # The kernel has turned the declared unit into mm, and takes numbers without a unit as mm.
    factor = scale / (1e-3 if unit is None else unit)
    return solid if abs(factor - 1.0) < 1e-12 else solid.Scale(occ.Pnt(0.0, 0.0, 0.0), factor)


def _solid_of_brep(brep: bytes | None, path: Path) -> occ.TopoDS_Shape:
    """A new solid for each call; path: of the STEP file, for messages."""
    if brep is None:
        raise ValueError(f"the STEP file {path} cannot be read")
    if not brep:
        raise ValueError(f"the STEP file {path} holds no solid (surfaces and curves have no volume)")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "solid.brep"
        copy.write_bytes(brep)
        try:
            return occ.OCCGeometry(str(copy)).shape
        except Exception as error:  # the reader's exception type is not exported
            raise ValueError(f"the STEP file {path} cannot be read") from error


MILLIMETRES = 1e3
"""Millimetres in a metre."""


def place(solid: occ.TopoDS_Shape, placement: model.Placement) -> occ.TopoDS_Shape:
    """`solid` turned by the placement's rotation and moved to its position. ValueError if not finite."""
    origin = np.asarray(placement.position, dtype=float) * MILLIMETRES
    rotation = np.asarray(placement.rotation, dtype=float)
    if not (np.isfinite(origin).all() and np.isfinite(rotation).all()):
        raise ValueError("a position and rotation must be finite numbers")
    frame = occ.Axes(point(*origin), n=occ.Dir(*rotation[:, 2]), h=occ.Dir(*rotation[:, 0]))
    # Transformation(frame) takes global coordinates to coordinates in the frame; its inverse places the solid.
    return occ.gp_Trsf.Transformation(frame).Inverted()(solid)


def local_solid(shape: model.Shape) -> occ.TopoDS_Shape:
    """The solid of a shape in its local frame, mm. Raises one of kernel_errors() where it cannot be built."""
    match shape.primitive:
        case model.Cylinder(radius, height):
            return cylinder(radius, 0.0, height)
        case model.Ring(inner, outer, height):
            return ring(inner, outer, 0.0, height)
        case model.Box(size):
            x, y, z = positive(size=size)
            return occ.Box(point(-x / 2, -y / 2, 0.0), point(x / 2, y / 2, z))
        case model.Sphere(radius):
            return occ.Sphere(point(0.0, 0.0, 0.0), *positive(radius=radius))
        case model.ExtrudedPolygon(points, height):
            return _extruded(points, height)
        case model.RevolvedProfile(points):
            return _revolved(points)
        case model.StepFile(path, scale):
            return solid_of_step_file(path, scale)
        case model.TriangleSurface() as surface:
            return _inside_surface(surface)
        case model.VolumeMesh() | model.MeshFile():
            raise ValueError("a mesh must be a body of its own")
    raise TypeError(f"{type(shape).__name__}.primitive is no shape that is known here")


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


def _inside_surface(shape: model.TriangleSurface) -> occ.TopoDS_Shape:
    """Triangles sewn together; those that lie in one plane become one face."""
    points, triangles = np.asarray(shape.points, dtype=float), np.asarray(shape.triangles)
    corners = points * MILLIMETRES
    fault = surface_fault(points, triangles) or crossing_fault(points, triangles)
    if fault is not None:
        raise ValueError(f"{fault[0]}: {fault[1]}")
    solid, volume = inside_shells(corners, triangles), enclosed_volume(corners, triangles)
    if abs(solid.mass - volume) > 1e-6 * volume:
        count = len(shells_of(triangles))
        raise ValueError(
            f"the surface bounds no single solid: {solid.mass:.6g} mm^3 in place of {volume:.6g} mm^3"
            + (f"; its {count} shells overlap, or a cavity is not within the solid" if count > 1 else "")
        )
    return solid


def inside_shells(points: Array, triangles: Index) -> occ.TopoDS_Shape:
    """The solid within closed shells, points in mm. The largest is built first: a cavity before a solid inside it."""
    shells = [triangles[numbers] for numbers in shells_of(triangles)]
    signed = sorted(
        ((enclosed_volume(points, shell), shell) for shell in shells), key=lambda one: -abs(one[0])
    )
    pieces = [
        occ.Solid(
            occ.Sew([polygon_face(points[face]) for face in (shell if volume > 0 else shell[:, ::-1])])
        ).UnifySameDomain()
        for volume, shell in signed
    ]
    solid = pieces[0]
    for (volume, _), piece in zip(signed[1:], pieces[1:], strict=True):
        solid = solid + piece if volume > 0 else solid - piece
    return solid


RELATIVE_LENGTH = 1e-9
"""Lengths below this fraction of the winding's size are rounding."""

SHORTEST_EDGE = 1e-6
"""Edges below this length, mm, are rounding and left out; ten times the kernel's contact distance."""


def winding_solid(coil: Coil) -> occ.TopoDS_Shape:
    """The space that a coil's winding fills, in the global frame; its name is the coil's.

    Raises one of `fieldmap.iron.geometry.shapes.kernel_errors` where the winding cannot be built.
    """
    try:
        path = coil.winding()
    except InputError as error:
        faults = (f"{problem.must_hold}: {problem.received}" for problem in error.problems)
        raise ValueError("; ".join(faults)) from error
    return named(place(_wound(path), coil.placement), coil.name)


def workspace_solid(workspace: model.WorkspaceBox | model.WorkspaceCylinder) -> occ.TopoDS_Shape:
    """The workspace as a solid. Raises ValueError where it is empty."""
    if isinstance(workspace, model.WorkspaceBox):
        lower = np.asarray(workspace.lower, dtype=float) * MILLIMETRES
        upper = lower + positive(extent=np.asarray(workspace.upper, dtype=float) - workspace.lower)
        return occ.Box(point(*lower), point(*upper))
    return place(cylinder(workspace.radius, 0.0, workspace.height), model.Placement(position=workspace.base))


def _wound(path: WindingPath) -> occ.TopoDS_Shape:
    """The winding in its local frame, mm."""
    if path.is_circle:
        inner, outer = path.arcs[0, 5:7]
        return _wound_in_circles(inner, outer, path.height)
    _, height = positive(thickness=path.thickness, height=path.height)
    if not (np.isfinite(path.arcs).all() and np.isfinite(path.bars).all()):
        raise ValueError("the dimensions of a winding must be finite numbers")
    half = 0.5 * path.thickness
    for offset, fault in (
        (0.0, "the winding's middle line must not meet itself"),
        (half, "the winding is so thick that its turns run into each other"),
        (-half, "the winding is so thick that its turns run into each other"),
    ):
        if polygon_fault(_corners(path, offset).tolist()) is not None:
            raise ValueError(fault)
    right, left = (_face(path, side * half, -height / 2) for side in (1.0, -1.0))
    # The faces are cut in the plane, then extruded: to cut one solid from another takes six times as long.
    face = right - left if path.turning > 0 else left - right
    return occ.Prism(face, occ.Vec(0.0, 0.0, float(height)))


def _wound_in_circles(inner: float, outer: float, height: float) -> occ.TopoDS_Shape:
    if not 0.0 < inner < outer:
        # `ring` makes a full cylinder, or raises.
        return ring(inner, outer, -height / 2, height)
    r_inner, r_outer, h = positive(inner=inner, outer=outer, height=height)
    base = point(0.0, 0.0, -h / 2)
    hole, disc = (occ.Face(occ.Wire([occ.Circle(base, occ.Z, r)])) for r in (r_inner, r_outer))
    return occ.Prism(disc - hole, occ.Vec(0.0, 0.0, float(h)))


def _corners(path: WindingPath, offset: float) -> Array:
    """Points (n, 2) along the outline in order: the ends and the middle of every arc, once each."""
    points = np.concatenate([points for points, _ in path.outline(offset, 3)])
    apart = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    return points[apart > RELATIVE_LENGTH * np.ptp(points, axis=0).max()]


def _face(path: WindingPath, offset: float, level: float) -> occ.TopoDS_Shape:
    """Plane face at z = `level` (mm) inside the outline at `offset` (m) to the right of the middle line."""
    pieces = [points * MILLIMETRES for points, _ in path.outline(offset, 3)]
    last = pieces[-1][-1]
    edges = []
    for piece in pieces:
        if np.linalg.norm(piece[-1] - last) <= SHORTEST_EDGE:
            continue
        # Every edge begins at the very point where the one before it ends.
        through = [point(*np.append(p, level)) for p in (last, *piece[1:])]
        edges.append(occ.Segment(*through) if len(through) == 2 else occ.ArcOfCircle(*through))
        last = piece[-1]
    return occ.Face(occ.Wire(edges))
