"""States that follow from solved ones by the symmetry of the iron, without solving."""

from dataclasses import dataclass

import numpy as np

from fieldmap.iron.elements.nodal_elements import NodalElements
from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.symmetry import Operation
from fieldmap.records import Record
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class StateImage(Record):
    """What one operation of the mesh does to a state: its currents and its nodal potential.

    The field strength is an axial vector, H'(M x) = det(M) M H(x), so the potential is multiplied by det(M) and moved
    with the nodes. Where there are no magnets, reversing all currents reverses the potential, `reversal`.
    """

    coils: Index
    coil_signs: Array
    nodes: Index
    potential_sign: float

    def currents(self, currents: Array) -> Array:
        """Currents (..., c) of the image of a state of currents (..., c)."""
        out = np.empty_like(currents)
        out[..., self.coils] = self.coil_signs * currents
        return out

    def potential(self, potential: Array) -> Array:
        """Nodal potential (n, ...) of the image of a state of potential (n, ...)."""
        out = np.empty_like(potential)
        out[self.nodes] = self.potential_sign * potential
        return out


def state_images(
    symmetry: MeshSymmetry | None, elements: NodalElements, magnets: bool
) -> tuple[StateImage, ...]:
    """The images under every operation that maps coils onto coils and magnets onto magnets.

    Without magnets each operation gives two images, one with all currents reversed; the identity gives none, or the
    reversal alone.
    """
    if symmetry is None:
        return ()
    images = []
    for k, operation in enumerate(symmetry.group.operations):
        if operation.coils is None or (magnets and not operation.keeps_magnets):
            continue
        nodes = elements.node_images(symmetry.node_images[k])
        senses = (1.0,) if magnets else (1.0, -1.0)
        images += [_image(operation, nodes, sense) for sense in senses if k or sense < 0]
    return tuple(images)


def _image(operation: Operation, nodes: Index, sense: float) -> StateImage:
    signs = sense * np.array(operation.coil_signs, float)
    return StateImage(np.array(operation.coils), signs, nodes, sense * operation.handedness)
