"""The part of the iron problem that depends on the mesh alone; both forms start from it."""

import math
import os
import sys
from dataclasses import dataclass

from fieldmap.errors import InputError
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.operators.compressed import CompressedMutualPotential, predicted_bytes
from fieldmap.iron.operators.mutual import DenseMutualPotential, MutualPotential, SymmetricMutualPotential
from fieldmap.iron.topology import Faces, build_faces
from fieldmap.records import Record

# Bytes per pair of faces, dense: matrix and factor, both double if the single matrix is not positive definite; with a
# single factor there are 13 at peak and 12 afterwards.
_BYTES_PER_PAIR = 16
# Approximate bytes per face, compressed.
_COMPRESSED_PER_FACE = 12e3
# Part of the machine's memory that one solve may take.
_MEMORY_SHARE = 0.8
# Most faces for dense storage without symmetry. One linear solve of the drive unit with 12 700 faces takes the same
# processor time dense or compressed, dense with four times the memory. With one mirror dense takes half of the time, at
# 15 000 faces and at 21 000; there the bound limits memory, to 2.3 GB for any symmetry.
_DENSE_FACES = 12_000


@dataclass(frozen=True, eq=False, repr=False)
class AssembledIron(Record):
    """Mesh, its faces, the surface faces as charged triangles, and their mutual potentials with inverse."""

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
        """The part of the iron's symmetry that is used, in words for the report."""
        used = self.mesh.symmetry
        return "none" if used is None else f"{used.group}, used: {self.mutual.storage}"


def fits_into_memory(mesh: IronMesh) -> bool:
    """Whether the mutual potentials and their inverse fit, dense or compressed. True if the memory is not known."""
    have = memory_bytes()
    surface = _charged_faces(mesh, build_faces(mesh.points, mesh.tets))
    storage = chosen_storage(len(surface.areas), _operations(mesh))
    return have is None or _needed_bytes(mesh, surface, storage) < have


def chosen_storage(faces: int, operations: int) -> str:
    """How mutual potentials are stored: "dense" while that is quicker and fits into memory, otherwise "compressed".
    faces: number of surface faces; operations: number of operations of the mesh's symmetry."""
    have = memory_bytes()
    fits = have is None or _BYTES_PER_PAIR * faces**2 / operations < have
    # A symmetry of order g divides the work of the dense blocks by g^2; it does not reduce the work of compression.
    return "dense" if faces <= _DENSE_FACES * math.sqrt(operations) and fits else "compressed"


def assemble(mesh: IronMesh, many_solutions: bool = False) -> AssembledIron:
    """Mutual potentials of the surface faces, dense or compressed (`chosen_storage`).

    Dense costs 12 bytes times the square of the number of faces, and half a dense Cholesky factorisation; where the
    mesh has a symmetry of g operations, the memory is divided by g and the factorisation by its square. Compressed
    (`fieldmap.iron.operators.compressed`) costs about 12 kB per face and uses no symmetry.

    Parameters
    ----------
    mesh
        All iron bodies.
    many_solutions
        Prepare more, so that each of tens of solutions takes less (`DenseMutualPotential`).

    Returns
    -------
    AssembledIron
        The mesh with its faces and their mutual potentials.

    Raises
    ------
    InputError
        Before it starts, if the machine has too little memory.
    """
    topology = build_faces(mesh.points, mesh.tets)
    surface = _charged_faces(mesh, topology)
    count = len(surface.areas)
    storage = chosen_storage(count, _operations(mesh))
    remedy, needed = "use a smaller refinement or larger mesh sizes", _needed_bytes(mesh, surface, storage)
    what = f"its {storage} mutual potentials"
    require_memory("mesh of the iron", what, needed, f"{count} surface faces", remedy)
    mutual: MutualPotential
    if storage == "compressed":
        mutual = CompressedMutualPotential(surface)
    elif mesh.symmetry is not None:
        triangles = topology.nodes[topology.surface]
        mutual = SymmetricMutualPotential(surface, mesh.symmetry, triangles, many_solutions)
    else:
        mutual = DenseMutualPotential(surface.mutual_potential(), many_solutions)
    return AssembledIron(mesh, topology, surface, mutual)


def _operations(mesh: IronMesh) -> int:
    return 1 if mesh.symmetry is None else mesh.symmetry.group.order


def _charged_faces(mesh: IronMesh, topology: Faces) -> ChargedFaces:
    return ChargedFaces.from_nodes(mesh.points, topology.nodes[topology.surface])


def _needed_bytes(mesh: IronMesh, surface: ChargedFaces, storage: str) -> int:
    if storage == "compressed":
        return predicted_bytes(surface)
    return _BYTES_PER_PAIR * len(surface.areas) ** 2 // _operations(mesh)


def expected_bytes(faces: float, operations: int = 1) -> float:
    """Memory, bytes, of the mutual potentials of `faces` faces, with `operations` of the mesh's symmetry."""
    if chosen_storage(round(faces), operations) == "dense":
        return _BYTES_PER_PAIR * faces**2 / operations
    return _COMPRESSED_PER_FACE * faces


def memory_bytes() -> float | None:
    """The memory that one solve may take; None where it is not known."""
    if sys.platform == "win32":
        return None
    try:
        return _MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def require_memory(where: str, what: str, needed: float, received: str, remedy: str) -> None:
    """Raise InputError where a solve would need more bytes than it may take."""
    have = memory_bytes()
    if have is not None and needed >= have:
        must_hold = f"{what} must fit into {have / 1e9:.1f} GB of memory"
        raise InputError.of(where, must_hold, f"{received}, {needed / 1e9:.1f} GB", remedy)
