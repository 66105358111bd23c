"""Triangles of the surfaces of all iron bodies, and nothing inside them: the mesh of the surface form.

The mesher stops after the surface. Curved surfaces are rounded, and layers cut at sharp edges, as in the volume mesh
(`fieldmap.iron.mesh.mesh`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fieldmap.arguments import raise_all
from fieldmap.device.drawing import Outline
from fieldmap.device.model import Device
from fieldmap.device.surfaces import enclosed_volume
from fieldmap.errors import GeometryError, InputError, Problem
from fieldmap.iron.geometry.solids import device_label, glue_bodies
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.edge_grading import grade_edges, kinked_edges
from fieldmap.iron.mesh.mesh import LAYER_RATIO, BodyMesh, outline_of, rounded_vertices
from fieldmap.iron.mesh.mesher import mesh_solids
from fieldmap.iron.topology import connected
from fieldmap.kernels.iron.containment import solid_angle_sums
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

AIR = -1
"""The number of the air where bodies are numbered."""
_MILLIMETRES_CUBED = 1e-9
# Relative. Rounded bodies have nearly the true volume; with a larger difference the mesher has confused its domains.
_SAME_VOLUME = 0.2


@dataclass(frozen=True, eq=False, repr=False)
class IronSurface(BodyMesh):
    """Surfaces of all bodies; bodies that touch share triangles.

    points (n, 3) in m; triangles (m, 3); sides (m, 2): number of the solid that the normal leaves and of the one that
    it enters, -1 for air, which is never left; body (s,): index into `body_names` of every solid: a body may have
    several solids.
    """

    points: Array
    triangles: Index
    sides: Index
    body: Index
    body_names: tuple[str, ...]

    @cached_property
    def pieces(self) -> Index:
        """Number (s,) of the connected piece of iron to which each solid belongs."""
        return connected(self.sides[self.sides[:, 1] != AIR], len(self.body))

    @property
    def all_solids(self) -> Index:
        """Numbers (s,) of all solids."""
        return np.arange(len(self.body))

    def solids_of(self, name: str) -> Index:
        """Numbers (k,) of the solids of a named body."""
        return np.flatnonzero(self.body == self.body_names.index(name))

    def around(self, solids: Index) -> Index:
        """Triangles (k, 3) around some solids together, with outward normals, in the order of `faces_around`."""
        leaving, entering = self._around(solids)
        return np.vstack([self.triangles[leaving], self.triangles[entering][:, [0, 2, 1]]])

    def faces_around(self, solids: Index) -> Index:
        """Numbers (k,) of the triangles around some solids together."""
        return np.concatenate(self._around(solids))

    def _around(self, solids: Index) -> tuple[Index, Index]:
        inner = np.isin(self.sides, solids)
        return np.flatnonzero(inner[:, 0] & ~inner[:, 1]), np.flatnonzero(inner[:, 1] & ~inner[:, 0])

    def containing(self, points: Array) -> Index:
        """Number (n,) of the solid that contains each point (n, 3), -1 in the air."""
        found = np.full(len(points), AIR)
        for number, faces in enumerate(self._boundaries):
            lower, upper = faces.corners.min(axis=(0, 1)), faces.corners.max(axis=(0, 1))
            near = np.flatnonzero(((points >= lower) & (points <= upper)).all(axis=1) & (found == AIR))
            if len(near):
                geometry = (faces.corners, faces.normals, faces.areas, faces.centres, faces.radii)
                angles, at = np.empty(len(near)), np.ascontiguousarray(points[near])
                over_rows(solid_angle_sums, len(near), at, *geometry, angles, work=len(faces.areas))
                found[near[angles < -0.5]] = number
        return found

    @cached_property
    def _boundaries(self) -> tuple[ChargedFaces, ...]:
        """The boundary of every solid."""
        every = (self.around(np.array([number])) for number in self.all_solids)
        return tuple(ChargedFaces.from_nodes(self.points, triangles) for triangles in every)

    def outlines(self) -> tuple[Outline, ...]:
        """The surface of every body, with the faces that it shares with other bodies."""
        return tuple(
            outline_of(name, self.points, self.around(self.solids_of(name))) for name in self.body_names
        )


def generate_surface(device: Device, refinement: float = 1.0) -> IronSurface:
    """Mesh the surfaces of all iron bodies of a device; refinement as for `generate_mesh`.

    Raises GeometryError where the mesher fails, InputError for joints.
    """
    if device.joints:
        where = f"{device_label(device)}: {device.joints[0].description}"
        must_hold = "the surface form has no joints"
        raise InputError.of(where, must_hold, "a joint", 'use form="auto", "potential" or "flux"')
    shape = glue_bodies(device)
    mesh = mesh_solids(shape, device, refinement, surface_only=True)
    names = tuple(body.name for body in device.bodies)
    body = np.array([names.index(solid.name) for solid in shape.solids])
    triangles, sides = mesh.elements.copy(), mesh.solids.copy()
    midpoints = mesh.ends, mesh.midpoints
    turned = sides[:, 0] == AIR
    triangles[turned], sides[turned] = triangles[turned][:, [0, 2, 1]], sides[turned][:, ::-1]
    points = rounded_vertices(mesh.points, triangles, *midpoints)
    outer = triangles[sides[:, 1] == AIR]
    sharp = kinked_edges(points, np.sort(outer, axis=1), mesh.solid_edges, midpoints)
    size = np.array([b.edge_size or np.inf for b in device.bodies])
    layer = np.append(size[body], np.inf) / refinement**2
    points, triangles, parent = grade_edges(points, triangles, sharp, layer[sides].min(axis=1), LAYER_RATIO)
    used, number = np.unique(triangles, return_inverse=True)
    surface = IronSurface(points[used], number.reshape(-1, 3), sides[parent], body, names)
    _require_closed(surface, shape, device)
    return surface


def _require_closed(surface: IronSurface, shape, device: Device) -> None:
    """Raise GeometryError unless the triangles of each body enclose about the volume of its solids."""
    problems = []
    for number, piece in enumerate(shape.solids):
        name, solid = piece.name, _MILLIMETRES_CUBED * piece.mass
        meshed = enclosed_volume(surface.points, surface.around(np.array([number])))
        if not abs(meshed - solid) < _SAME_VOLUME * solid:
            where = f"{device_label(device)}, body '{name}'"
            must_hold = "its surface mesh must enclose each of its solids"
            received = f"{meshed:.4g} m^3 in place of {solid:.4g} m^3"
            problems.append(Problem(where, must_hold, received, "take smaller elements: mesh_size_mm"))
    raise_all(problems, GeometryError)
