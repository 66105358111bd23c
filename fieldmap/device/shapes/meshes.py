"""Bodies given as meshes of tetrahedra."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.device.polygons import FourPoints
from fieldmap.device.shapes.base import Shape, ShapeOfFile
from fieldmap.device.tetrahedra import tetrahedra_fault
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, Text, broken
from fieldmap.typing import Array, Index, PathLike

Tetrahedra = Annotated[list[Annotated[list[int], Field(min_length=4, max_length=4)]], Field(min_length=1)]


def _require_solid(tetrahedra: list[list[int]], info: ValidationInfo) -> None:
    """Raise unless the tetrahedra fill a solid."""
    points = info.data.get("points_mm")
    fault = None if points is None else tetrahedra_fault(np.array(points), np.array(tetrahedra))
    if fault is not None:
        raise broken(*fault)


@dataclass(frozen=True, eq=False, repr=False)
class VolumeMesh(Shape):
    """Mesh of tetrahedra, used as it is.

    tetrahedra (m, 4) are numbers of `points` (n, 3), in m, from 0. The mesh is the only part of its body, which has no
    `mesh_size`.
    """

    kind: ClassVar[str] = "volume_mesh"
    has_own_mesh: ClassVar[bool] = True

    points: Annotated[Array, Key(FourPoints, "[[x, y, z], ...] nodes", "mm")]
    tetrahedra: Annotated[
        Index, Key(Tetrahedra, "[[i, j, k, l], ...] numbers of nodes from 0", check=_require_solid)
    ]

    @classmethod
    def from_file(cls, path: PathLike, unit: float = 1e-3, region: str | None = None) -> Self:
        """The tetrahedra of a mesh file, copied into the device; a `MeshFile` refers to the file instead.

        Parameters
        ----------
        path
            Path of the file.
        unit
            Length of the file's unit, m.
        region
            Region of the file; all of it unless given.

        Returns
        -------
        Self
            The shape.

        Raises
        ------
        InputError
            For a file that cannot be read, has no tetrahedra or lacks the region.
        """
        from fieldmap.device.mesh_files import read_mesh

        mesh = read_mesh(Path(path), region)
        return cls(unit * mesh.points, mesh.tets)

    def hull(self) -> Array:
        """See `Shape.hull`."""
        return np.asarray(self.points, dtype=float)

    def reflected(self, axis: int) -> Self:
        """See `Shape.reflected`."""
        points = np.array(self.points, dtype=float)
        points[:, axis] *= -1
        return replace(self, points=points, tetrahedra=np.asarray(self.tetrahedra)[:, [0, 2, 1, 3]])


@dataclass(frozen=True, repr=False)
class MeshFile(ShapeOfFile):
    """Tetrahedra of a mesh file, used as they are.

    Files of gmsh and VTK, and all others that meshio reads. `scale` turns the file's length unit into metres. region:
    name of a region of the file, or its number as a text; None for all cells. The mesh is the only part of its body,
    which has no `mesh_size`.
    """

    kind: ClassVar[str] = "mesh_file"
    has_own_mesh: ClassVar[bool] = True
    program: ClassVar[str] = "mesh"
    instead_of_mirror: ClassVar[str] = "read it by VolumeMesh.from_file, which can be"

    path: Annotated[Path, Key(Text, "path of the mesh file, relative to the device file", name="file")]
    scale: Annotated[float, Key(Length, "length of the mesh file's unit", "mm", "unit")] = 1e-3
    region: Annotated[
        str | None,
        Key(
            Text | None,
            'name of the cells that are this body, or their number in quotes, "7"; all if left out',
        ),
    ] = None
