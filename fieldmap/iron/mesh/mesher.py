"""Meshes of glued solids by the mesher (netgen): tetrahedra, or triangles of the surfaces alone.

Meshing takes as long as all the rest of a small solve, and the same iron is solved many times: at other currents, with
other coils and materials, by another command. Meshes are therefore kept: the last ones in memory, and all in a folder
if the environment variable FIELDMAP_MESHES names one. The key of a mesh is a hash of the mesher's input, bit by bit,
and of its version.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fieldmap.device.another_process import crashed, run_by_another
from fieldmap.device.model import Device, MeshFile, StepFile, TriangleSurface, VolumeMesh
from fieldmap.errors import GeometryError, InputError
from fieldmap.extras import needs
from fieldmap.iron.geometry import shapes
from fieldmap.iron.topology import TET_EDGES, TRIANGLE_SIDES, distinct_rows
from fieldmap.records import Record
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import Array, Index

if TYPE_CHECKING:
    from fieldmap.iron.geometry.shapes import occ
from scipy.spatial import cKDTree

# Mean edge of the mesher's tetrahedra over the size that it was asked for (median over several meshes).
_EDGE_PER_SIZE = 1.14
# Ratio of neighbouring element sizes where a fine body meets a coarse one.
GRADING = 0.3
_NEIGHBOURS = 6


@dataclass(frozen=True, eq=False, repr=False)
class LocalSizes(Record):
    """Wanted element sizes (k,) at points (k, 3), m, and layers (l,), the thickness of the first layer at sharp edges
    near edge_points (l, 3). The mesher lets elements grow with the distance from the points."""

    points: Array
    sizes: Array
    edge_points: Array
    layers: Array

    def asked_at(self, places: Array) -> Array:
        """Largest sizes (n,) of elements at places (n, 3): the nearest points' sizes, growing with the distance."""
        if len(self.points) == 0:
            return np.full(len(places), np.inf)
        distance, nearest = cKDTree(self.points).query(
            places, list(range(1, min(_NEIGHBOURS, len(self.points)) + 1))
        )
        return np.asarray((self.sizes[nearest] + GRADING * distance).min(axis=1), np.float64)

    def first_layer(self, places: Array) -> Array:
        """Thickness (n,) at places (n, 3), from the nearest edge point."""
        if len(self.edge_points) == 0:
            return np.full(len(places), np.inf)
        _, nearest = cKDTree(self.edge_points).query(places)
        return self.layers[nearest]


@dataclass(frozen=True, eq=False, repr=False)
class MesherCells(Record):
    """The mesher's own tetrahedra. number (m,): the mesher's tetrahedron around each tetrahedron of the mesh; centres
    (k, 3), m; sizes (k,), m: the size to ask the mesher for to get such a tetrahedron.

    In thin walls the mesher makes edges longer than asked for; there the size is the one asked for, so that a smaller
    one has an effect."""

    number: Index
    centres: Array
    sizes: Array

    @classmethod
    def of(
        cls, points: Array, tets: Index, number: Index, largest: Array, local: LocalSizes | None = None
    ) -> MesherCells:
        """The cells of the mesher's points and tets (k, 4), for which sizes `largest` (k,) and `local` were asked."""
        corners = points[tets]
        edges = np.linalg.norm(corners[:, TET_EDGES[:, 0]] - corners[:, TET_EDGES[:, 1]], axis=2)
        centres = corners.mean(axis=1)
        asked = largest if local is None else np.minimum(largest, local.asked_at(centres))
        return cls(number, centres, np.minimum(edges.mean(axis=1) / _EDGE_PER_SIZE, asked))


FOLDER: Final = "FIELDMAP_MESHES"
"""The environment variable that names the folder in which meshes are kept from run to run."""
_MOST_BYTES = 64_000_000
_MILLIMETRE = 1e-3
# A circle gets at least 2 pi CURVATURE_SAFETY segments, whatever the element size of its body.
_CURVATURE_SAFETY = 2.4
# Shapes that another program has made.
_FOREIGN = (StepFile, TriangleSurface, MeshFile, VolumeMesh)
# Edges by the number of an element's corners, in the order of the mesher's second-order nodes.
_EDGES = {4: TET_EDGES, 3: TRIANGLE_SIDES[::-1]}


@dataclass(frozen=True, eq=False, repr=False)
class MesherMesh(Record):
    """The mesh of solids.

    points (n, 3), m; elements (m, 4), tetrahedra, or (m, 3), triangles of the surfaces; solids: number of the solid of
    a tetrahedron, (m,), or of the solids on both sides of a triangle, (m, 2), -1 for air; solid_edges (k, 2): segments
    along the edges of the solids; ends (e, 2): of all edges of elements, sorted, lexicographic; midpoints (e, 3) of
    these edges on the true surface.
    """

    points: Array
    elements: Index
    solids: Index
    solid_edges: Index
    ends: Index
    midpoints: Array

    def __post_init__(self) -> None:
        for array in self.arrays.values():
            array.flags.writeable = False

    @property
    def arrays(self) -> dict[str, Any]:
        """The arrays by their names."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class KeptMeshes:
    """Meshes by their keys: the last ones used, no more than `most_bytes` together, but always one."""

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._meshes: OrderedDict[str, MesherMesh] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._meshes)

    def get(self, key: str, make: Callable[[], MesherMesh]) -> MesherMesh:
        """The mesh of this key: from memory, from the folder, or made."""
        with self._lock:
            mesh = self._meshes.get(key)
        if mesh is None:
            folder = os.environ.get(FOLDER)
            mesh = make() if not folder else _from_folder(Path(folder), key, make)
        self._keep(key, mesh)
        return mesh

    def forget(self) -> None:
        """Drop all meshes from memory."""
        with self._lock:
            self._meshes.clear()

    def _keep(self, key: str, mesh: MesherMesh) -> None:
        with self._lock:
            self._meshes[key] = mesh
            self._meshes.move_to_end(key)
            while len(self._meshes) > 1 and sum(map(_size, self._meshes.values())) > self._most_bytes:
                self._meshes.popitem(last=False)


KEPT: Final = KeptMeshes()


def mesh_solids(
    shape: occ.TopoDS_Shape,
    device: Device,
    refinement: float,
    local: LocalSizes | None = None,
    surface_only: bool = False,
) -> MesherMesh:
    """The mesh of glued solids, which have the names of the device's bodies.

    refinement: divides the sizes of the bodies; local: further sizes, at points; surface_only: make triangles and no
    tetrahedra. The arrays are shared and cannot be written to. Raises GeometryError where the mesher fails,
    InputError for a folder of meshes that cannot be made.
    """
    sizes = {body.name: (body.mesh_size or 0.0) / _MILLIMETRE / refinement for body in device.bodies}

    where = f"the iron of {device.name}"
    foreign = any(isinstance(part.shape.primitive, _FOREIGN) for body in device.bodies for part in body.parts)

    def make() -> MesherMesh:
        asked = (shape, where, sizes, refinement, local, surface_only)
        made = _made_apart(*asked) if foreign else None
        return _arrays(_generated(*asked), surface_only) if made is None else made

    return KEPT.get(_key(shape, sizes, refinement, local, surface_only), make)


def _key(
    shape: occ.TopoDS_Shape,
    sizes: dict[str, float],
    refinement: float,
    local: LocalSizes | None,
    surface_only: bool,
) -> str:
    """Hash of the mesher's input: solids bit by bit, sizes, constants of this module, and version."""
    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "solids")
        shape.WriteBrep(file, withTriangles=False, binary=True)
        digest = hashlib.sha256(Path(file).read_bytes())
    solids = [(solid.name, sizes[solid.name]) for solid in shape.solids]
    settings = (refinement, max(sizes.values()), surface_only, GRADING, _CURVATURE_SAFETY)
    digest.update(repr((version("netgen-mesher"), solids, settings)).encode())
    if local is not None:
        digest.update(np.column_stack([local.points, local.sizes]).tobytes())
    return digest.hexdigest()


_APART = "import sys; from fieldmap.iron.mesh.mesher import mesh_in_folder; mesh_in_folder(sys.argv[1])"


def _made_apart(
    shape: occ.TopoDS_Shape,
    where: str,
    sizes: dict[str, float],
    refinement: float,
    local: LocalSizes | None,
    surface_only: bool,
) -> MesherMesh | None:
    """The mesh, made by another process: on surfaces of other programs the mesher may crash in spite of all checks.
    None if the other process makes no mesh. Raises GeometryError if it crashes or refuses."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shape.WriteBrep(str(folder / "solids.brep"), withTriangles=False)
        near: dict[str, Any] = {} if local is None else {"points": local.points, "sizes": local.sizes}
        solids = [(solid.name, sizes[solid.name]) for solid in shape.solids]
        asked = {"where": where, "solids": solids, "refinement": refinement, "surface_only": surface_only}
        (folder / "asked.json").write_text(json.dumps(asked), encoding="utf-8")
        np.savez(folder / "near.npz", **near)
        done = run_by_another(_APART, name)
        if done is not None and crashed(done):
            must_hold = "must be solids that can be meshed"
            remedy = "repair the surface in the program that made it: thin slivers, faces that overlap or cut"
            raise GeometryError.of(where, must_hold, "solids on which the mesher crashes", remedy)
        if (folder / "refused.json").is_file():
            raise GeometryError.of(*json.loads((folder / "refused.json").read_text(encoding="utf-8")))
        if not (folder / "mesh.npz").is_file():
            return None
        with np.load(folder / "mesh.npz") as stored:
            return MesherMesh(**stored)


def mesh_in_folder(name: str) -> None:
    """Make the mesh for `_made_apart`, in the other process."""
    folder = Path(name)
    asked = json.loads((folder / "asked.json").read_text(encoding="utf-8"))
    shape = shapes.occ.OCCGeometry(str(folder / "solids.brep")).shape
    for solid, (body, _) in zip(shape.solids, asked["solids"], strict=True):
        solid.name = body
    none = np.zeros((0, 3))
    with np.load(folder / "near.npz") as near:
        local = LocalSizes(near["points"], near["sizes"], none, none[:, 0]) if near.files else None
    settings = (asked["where"], dict(asked["solids"]), asked["refinement"], local, asked["surface_only"])
    try:
        mesh = _arrays(_generated(shape, *settings), asked["surface_only"])
    except GeometryError as error:
        (problem,) = error.problems
        told = [problem.where, problem.must_hold, problem.received, problem.remedy]
        (folder / "refused.json").write_text(json.dumps(told), encoding="utf-8")
        return
    np.savez(folder / "mesh.npz", **mesh.arrays)


def _generated(
    shape: occ.TopoDS_Shape,
    where: str,
    sizes: dict[str, float],
    refinement: float,
    local: LocalSizes | None,
    surface_only: bool,
) -> Any:
    """The mesher's own mesh, mm."""
    with needs("make", where):
        from netgen.meshing import MeshingParameters, MeshingStep
        from netgen.occ import OCCGeometry

    for solid in shape.solids:
        solid.maxh = sizes[solid.name]
    until = {"perfstepsend": MeshingStep.MESHSURFACE} if surface_only else {}
    # Not parallel: the same mesh for a third to four fifths of the processor time, because waiting threads spin.
    wanted = MeshingParameters(
        maxh=max(sizes.values()),
        grading=GRADING,
        curvaturesafety=_CURVATURE_SAFETY * refinement,
        parallel_meshing=False,
        **until,
    )
    if local is not None:
        for point, size in zip(local.points / _MILLIMETRE, local.sizes / _MILLIMETRE, strict=True):
            wanted.RestrictH(*point, size)
    try:
        return OCCGeometry(shape).GenerateMesh(mp=wanted)
    except Exception as error:  # the mesher's exception type is not exported
        must_hold = "must have a mesh at these sizes"
        received = f"the mesher stopped with {str(error).strip() or type(error).__name__!r}, refinement {refinement:g}"
        # Those of neighbouring sizes often fail as well.
        larger = f"a refinement of {1.2 * refinement:.2g} or more"
        remedy = f"take smaller elements: {larger}, or a smaller mesh_size_mm of the bodies that touch"
        raise GeometryError.of(where, must_hold, received, remedy) from error


def _arrays(mesh: Any, surface_only: bool) -> MesherMesh:
    """The mesh as arrays. The mesher's domains are the glued solids in their order, from 1; 0 is the air."""
    corners = 3 if surface_only else 4
    elements = (mesh.Elements2D() if surface_only else mesh.Elements3D()).NumPy()
    index = elements["index"] - 1
    if surface_only:
        faces = np.array([[face.domin, face.domout] for face in mesh.FaceDescriptors()])
        solids = faces[index].astype(np.int64) - 1
    else:
        solids = index.astype(np.int64)
    straight = elements["nodes"].astype(np.int64)[:, :corners] - 1
    points = _points(mesh)
    solid_edges = mesh.Elements1D().NumPy()["nodes"].astype(np.int64)[:, :2] - 1
    mesh.SecondOrder()
    elements = (mesh.Elements2D() if surface_only else mesh.Elements3D()).NumPy()
    pairs = _EDGES[corners]
    nodes = elements["nodes"].astype(np.int64)[:, : corners + len(pairs)] - 1
    ends, first, _, _ = distinct_rows(np.sort(nodes[:, pairs].reshape(-1, 2), axis=1))
    midpoints = _points(mesh)[nodes[:, corners:].reshape(-1)[first]]
    return MesherMesh(points, straight, solids, solid_edges, ends, midpoints)


def _points(mesh: Any) -> Array:
    """Points (n, 3) of the mesh, m."""
    return np.array([point.p for point in mesh.Points()]) * _MILLIMETRE


def _size(mesh: MesherMesh) -> int:
    return sum(array.nbytes for array in mesh.arrays.values())


def _from_folder(folder: Path, key: str, make: Callable[[], MesherMesh]) -> MesherMesh:
    """The mesh from a file; made and written if no file can be read. Raises InputError for a folder that cannot be
    made, before a mesh is made."""
    file = folder / f"{key}.npz"
    try:
        with open(file, "rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return MesherMesh(**stored)
    except Exception:  # a damaged or missing file of zipped arrays raises a dozen kinds
        pass
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        must_hold = "must name a folder that is there or can be made"
        remedy = f"name another, or unset {FOLDER}"
        received = f"{folder}: {error.strerror}"
        raise InputError.of(f"the variable {FOLDER}", must_hold, received, remedy) from None
    mesh = make()
    with whole_file(file, "kept mesh") as partial:
        np.savez(partial, **mesh.arrays)
    return mesh
