"""Faces that look at each other across a gap which is thin against them: what crosses it is not to be trusted.

Flat, parallel gaps between pieces of iron are meshed as sheets (`fieldmap.iron.geometry.thin_gaps`). What is left are
gaps between curved or slanting faces, gaps that another one holds open, slots within one body, and bodies that are
meshes: there the elements of one side do not lie on those of the other.
"""

import numpy as np
from scipy.spatial import cKDTree

from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.typing import Array, Index

# A gap below this share of the width of a face is thin: forces across are off by two per cent and more.
_THIN = 1 / 5
# Cosine of normals that look at each other, and how far apart faces may lie along themselves, in their radii.
_FACING, _BESIDE = -0.9, 0.5
_NEIGHBOURS = 4


def thin_gap_warnings(iron: AssembledIron) -> tuple[str, ...]:
    """One for each pair of bodies, with the width of the gap and that of the faces there."""
    faces = iron.surface
    if len(faces.areas) < 2:
        return ()
    # Neighbours in place with the opposite normal: normals are three more coordinates, longer than any face.
    long = 4 * float(faces.radii.max())
    tree = cKDTree(np.column_stack([faces.centres, long * faces.normals]))
    _, near = tree.query(
        np.column_stack([faces.centres, -long * faces.normals]), k=min(_NEIGHBOURS, len(faces.areas))
    )
    mine = np.repeat(np.arange(len(near)), near.shape[1])
    other = near.ravel()
    across = faces.centres[other] - faces.centres[mine]
    gap = np.einsum("nd,nd->n", across, faces.normals[mine])
    beside = np.linalg.norm(across - gap[:, None] * faces.normals[mine], axis=1)
    width = np.sqrt(2 * np.minimum(faces.areas[mine], faces.areas[other]))
    facing = np.einsum("nd,nd->n", faces.normals[mine], faces.normals[other]) < _FACING
    reach = _BESIDE * np.maximum(faces.radii[mine], faces.radii[other])
    thin = facing & (gap > 0) & (gap < _THIN * width) & (beside < reach)
    topology, mesh = iron.topology, iron.mesh
    body = mesh.body[topology.owner[topology.surface, 0]]
    return _warnings(
        mesh.body_names, np.sort(body[np.column_stack([mine, other])[thin]], axis=1), gap[thin], width[thin]
    )


def _warnings(names: tuple[str, ...], pairs: Index, gap: Array, width: Array) -> tuple[str, ...]:
    warnings = []
    for a, b in np.unique(pairs, axis=0).tolist():
        here = (pairs == (a, b)).all(axis=1)
        least, size = 1e3 * float(gap[here].min()), 1e3 * float(np.median(width[here]))
        who = f"of '{names[a]}' and '{names[b]}'" if a != b else f"of '{names[a]}'"
        warnings.append(
            f"warning: faces {who} lie {least:.3g} mm apart, a thin gap for elements of {size:.2g} mm: flux and forces "
            f"across it may be some per cent off; smaller elements there, or flat faces, which are meshed as a sheet"
        )
    return tuple(warnings)
