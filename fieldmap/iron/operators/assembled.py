"""The part of the iron problem that depends on the mesh alone; both forms start from it."""

import os
from dataclasses import dataclass

from fieldmap.errors import InputError, Problem
from fieldmap.iron.meshing.mesh import IronMesh
from fieldmap.iron.meshing.topology import Faces, build_faces
from fieldmap.iron.operators.mutual import DenseMutualPotential, MutualPotential
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.iron.operators.symmetric_mutual import SymmetricMutualPotential

# Double matrix, single factor, and one single copy while it is factored.
_BYTES_PER_PAIR = 16
# Part of the machine's memory that one solve may take.
_MEMORY_SHARE = 0.8


def _needed_bytes(mesh: IronMesh, faces: int) -> int:
    operations = 1 if mesh.symmetry is None else mesh.symmetry.group.order
    return _BYTES_PER_PAIR * faces**2 // operations


def _memory_bytes() -> float | None:
    try:
        return _MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


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

    @property
    def symmetry(self) -> str:
        """What of the iron's symmetry is used, in words for the report."""
        used = self.mesh.symmetry
        return "none" if used is None else f"{used.group}, used: {self.mutual.storage}"


def fits_into_memory(mesh: IronMesh) -> bool:
    """Whether the dense matrix and its factor fit. Where the machine does not tell its memory, they are let be."""
    have = _memory_bytes()
    return have is None or _needed_bytes(mesh, len(build_faces(mesh).surface)) < have


def assemble(mesh: IronMesh) -> AssembledIron:
    """Costs 12 bytes times the square of the number of surface faces, and half a dense Cholesky factorisation.

    Where the mesh has a symmetry of g operations, the memory is divided by g and the factorisation by its square.
    Raises InputError before it starts if the machine has too little memory for that.
    """
    topology = build_faces(mesh)
    count, have = len(topology.surface), _memory_bytes()
    if have is not None and _needed_bytes(mesh, count) > have:
        raise InputError(
            Problem(
                "mesh of the iron",
                f"its dense matrix must fit into {have / 1e9:.1f} GB of memory",
                f"{count} surface faces, {_needed_bytes(mesh, count) / 1e9:.1f} GB",
                "use a smaller refinement or larger mesh sizes",
            )
        )
    triangles = topology.nodes[topology.surface]
    surface = ChargedFaces.from_nodes(mesh.points, triangles)
    mutual: MutualPotential
    if mesh.symmetry is None:
        mutual = DenseMutualPotential(surface.mutual_potential())
    else:
        mutual = SymmetricMutualPotential(surface, mesh.symmetry, triangles)
    return AssembledIron(mesh, topology, surface, mutual)
