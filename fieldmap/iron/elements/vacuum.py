"""The iron's elements as air, for the term N of the exterior (`fieldmap.iron.operators.exterior`).

N^-1 takes away what the charges of the surface do inside the iron, were it air; both are to know the same inside. At
the rim of a sheet that is thinner than its elements are wide they do not. A potential that differs between both sides
of the rim costs the elements of the sheet, in which it falls off over their whole width h, h / (3 g) and more, while
charges feel the logarithm of h / g. N^-1 would take away the sheet's own stiffness there, and flux would crowd through
its rim (a magnet 10 um above a plate: 1.4 to 2.6 times the true flux density in the outermost elements). Elements at
such a rim are therefore softer in N, by g / h; where they are as narrow as the gap they are air.
"""

import numpy as np

from fieldmap.iron.elements.bh_law import Magnetisation, straight_laws
from fieldmap.iron.mesh.mesh import volumes
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.typing import Array, Index

_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def vacuum(iron: AssembledIron) -> Magnetisation:
    """Air in all elements, for one source; less permeable where it stands for the rims of sheets."""
    elements, permeability = _rims(iron)
    law = np.zeros(len(iron.mesh.tets), np.int64)
    law[elements] = 1 + np.arange(len(elements))
    tables = straight_laws(np.concatenate([[1.0], permeability]))
    return Magnetisation(law, tables, np.zeros((1, len(law), 3)))


def _rims(iron: AssembledIron) -> tuple[Index, Array]:
    """Elements (k,) at the rims of sheets, and g / h (k,), at most 1."""
    mesh, topology = iron.mesh, iron.topology
    first = len(mesh.body_names) - len(mesh.sheets)
    outer = np.zeros(len(mesh.points), bool)
    outer[topology.nodes[topology.surface]] = True
    rim = np.flatnonzero((mesh.body >= first) & outer[mesh.tets].any(axis=1))
    gap = np.array([sheet.gap for sheet in mesh.sheets] or [0.0])[mesh.body[rim] - first]
    corners = mesh.points[mesh.tets[rim]]
    sides = np.linalg.norm(corners[:, _PAIRS[:, 0]] - corners[:, _PAIRS[:, 1]], axis=2)
    # A third of a prism of height g: its volume is g / 3 times half the longest side times the width across it.
    width = 6 * volumes(mesh.points, mesh.tets[rim]) / (gap * sides.max(axis=1))
    return rim, np.minimum(1.0, gap / width)
