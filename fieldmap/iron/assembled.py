"""The part of the iron problem that depends on the mesh alone; both forms start from it."""

from dataclasses import dataclass

from fieldmap.iron.mesh import IronMesh
from fieldmap.iron.mutual import MutualPotential
from fieldmap.iron.surface import ChargedFaces
from fieldmap.iron.topology import Faces, build_faces


@dataclass(frozen=True, eq=False)
class AssembledIron:
    """Mesh, its faces, the surface faces as charged triangles, and their mutual potentials with factor."""

    mesh: IronMesh
    topology: Faces
    surface: ChargedFaces
    mutual: MutualPotential

    @property
    def magnetic_bodies(self) -> int:
        """Number of connected pieces of iron."""
        return int(self.topology.group_of_tet.max()) + 1


def assemble(mesh: IronMesh) -> AssembledIron:
    """Costs 12 bytes times the square of the number of surface faces, and half a dense Cholesky factorisation."""
    topology = build_faces(mesh)
    surface = ChargedFaces.from_nodes(mesh.points, topology.nodes[topology.surface])
    return AssembledIron(mesh, topology, surface, MutualPotential(surface.mutual_potential()))
