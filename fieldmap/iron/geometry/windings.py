"""Windings and workspaces as solids of the CAD kernel."""

from __future__ import annotations

import numpy as np

from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.model import Placement, WorkspaceBox, WorkspaceCylinder
from fieldmap.device.polygons import polygon_fault
from fieldmap.errors import InputError
from fieldmap.iron.geometry.cad_kernel import occ
from fieldmap.iron.geometry.shapes import MILLIMETRES, cylinder, place, point, positive, ring
from fieldmap.typing import Array

RELATIVE_LENGTH = 1e-9
"""Lengths below this fraction of the winding's size are rounding."""

SHORTEST_EDGE = 1e-6
"""Edges below this length, mm, are rounding and left out; ten times what the kernel takes for one point."""


def winding_solid(coil: Coil) -> occ.TopoDS_Shape:
    """The space that a coil's winding fills, in the global frame; its name is the coil's.

    Raises one of `fieldmap.iron.geometry.cad_kernel.kernel_errors` where the winding cannot be built.
    """
    try:
        path = coil.winding()
    except InputError as error:
        faults = (f"{problem.must_hold}: {problem.received}" for problem in error.problems)
        raise ValueError("; ".join(faults)) from error
    solid = place(_wound(path), coil.placement)
    for piece in solid.solids:
        piece.name = coil.name
    return solid


def workspace_solid(workspace: WorkspaceBox | WorkspaceCylinder) -> occ.TopoDS_Shape:
    """The workspace as a solid. Raises ValueError where it is empty."""
    if isinstance(workspace, WorkspaceBox):
        lower = np.asarray(workspace.lower, dtype=float) * MILLIMETRES
        upper = lower + positive(extent=np.asarray(workspace.upper, dtype=float) - workspace.lower)
        return occ.Box(point(*lower), point(*upper))
    return place(cylinder(workspace.radius, 0.0, workspace.height), Placement(position=workspace.base))


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
    # Cut in the plane, then drawn up: to cut one solid from another takes six times as long.
    face = right - left if path.turning > 0 else left - right
    return occ.Prism(face, occ.Vec(0.0, 0.0, float(height)))


def _wound_in_circles(inner: float, outer: float, height: float) -> occ.TopoDS_Shape:
    if not 0.0 < inner < outer:
        # Full, or refused.
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
