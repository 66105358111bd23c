"""Surfaces of iron bodies, mm: simple shapes drawn exactly, everything else through the iron's own mesh."""

from dataclasses import replace

import numpy as np
import pyvista as pv

from fieldmap.device.model import (
    Body,
    Box,
    Cylinder,
    Device,
    ExtrudedPolygon,
    Part,
    Placement,
    RevolvedProfile,
    Ring,
    Shape,
    Sphere,
)
from fieldmap.plot.sweeps import revolved

MM = 1e3
SEGMENTS = 96


def body_surface(device: Device, body: Body) -> pv.PolyData:
    """Surface of one body in the global frame, mm.

    Parts that are only added are drawn as they are; a body with a cut or a STEP file is meshed first.
    """
    simple = all(part.operation == "add" and _local_surface(part.shape) is not None for part in body.parts)
    if simple:
        return pv.merge([_part_surface(part) for part in body.parts], merge_points=False)
    return _meshed_surface(device, body)


def placed(surface: pv.PolyData, placement: Placement) -> pv.PolyData:
    """The surface, mm, turned and moved."""
    matrix = np.eye(4)
    matrix[:3, :3] = placement.rotation
    matrix[:3, 3] = MM * np.asarray(placement.position)
    return surface.transform(matrix, inplace=False)


def _part_surface(part: Part) -> pv.PolyData:
    surface = _local_surface(part.shape)
    assert surface is not None
    return placed(surface, part.placement)


def _local_surface(shape: Shape) -> pv.PolyData | None:
    """The shape in its local frame, mm, or None where it is no simple one."""
    match shape:
        case Cylinder(radius, height):
            return pv.Cylinder(
                center=(0, 0, MM * height / 2),
                direction=(0, 0, 1),
                radius=MM * radius,
                height=MM * height,
                resolution=SEGMENTS,
            )
        case Ring(inner, outer, height):
            return revolved(
                MM * np.array([[inner, 0], [outer, 0], [outer, height], [inner, height]]), SEGMENTS
            )
        case Box(size):
            x, y, z = (MM * edge for edge in size)
            return pv.Box((-x / 2, x / 2, -y / 2, y / 2, 0, z))
        case Sphere(radius):
            return pv.Sphere(radius=MM * radius, theta_resolution=SEGMENTS, phi_resolution=SEGMENTS // 2)
        case RevolvedProfile():
            return revolved(MM * shape.points, SEGMENTS)
        case ExtrudedPolygon():
            corners = np.column_stack([MM * shape.points, np.zeros(len(shape.points))])
            outline = pv.PolyData(corners, faces=[len(corners), *range(len(corners))]).triangulate()
            solid = outline.extrude((0, 0, MM * shape.height), capping=True).triangulate().clean()
            # Extrusion leaves sides and caps facing different ways.
            return solid.compute_normals(point_normals=False, auto_orient_normals=True)
    return None


def _meshed_surface(device: Device, body: Body) -> pv.PolyData:
    from fieldmap.iron import generate_mesh

    mesh = generate_mesh(replace(device, bodies=(replace(body, edge_size=None),)))
    cells = np.column_stack([np.full(len(mesh.tets), 4), mesh.tets])
    kinds = np.full(len(mesh.tets), pv.CellType.TETRA, dtype=np.uint8)
    return pv.UnstructuredGrid(cells.ravel(), kinds, MM * mesh.points).extract_surface(algorithm=None)
