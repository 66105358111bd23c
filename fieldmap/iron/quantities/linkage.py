"""Flux linkage and co-energy of the iron, from the fields inside it: docs/theory/forces.md (4), (5)."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0

from fieldmap.iron.forms.bh_law import law_values
from fieldmap.iron.forms.nodal_elements import CoilField, NodalElements
from fieldmap.iron.forms.potential_form import Magnetisation
from fieldmap.iron.meshing.mesh import IronMesh, volumes
from fieldmap.kernels.simplex_rules import tetrahedron_rule

Array = NDArray[np.float64]
_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def linkage_and_coenergy(
    elements: NodalElements, material: Magnetisation, potential: Array, field: CoilField, unit: CoilField
) -> tuple[Array, Array]:
    """What the iron adds to flux linkages (c, s) in Wb and to the co-energy (s,) in J, in the potential form.

    potential (n, s) and field: s solved sources; unit: the fields of one ampere in each of c coils. The linkage is
    the exact derivative of the discrete co-energy, so both agree on any mesh.
    """
    sources = potential.shape[1]
    linkage, coenergy = np.zeros((len(unit.bubble), sources)), np.zeros(sources)
    weight = 0.25 * elements.volume / mu_0
    values = np.column_stack([potential, field.bubble.T, unit.bubble.T])
    for gradient in _point_gradients(elements, values):
        t = field.constant + gradient[sources : 2 * sources]
        h = t - gradient[:sources]
        units = unit.constant + gradient[2 * sources :]
        for s in range(sources):
            strength = np.linalg.norm(h[s], axis=1)
            b, stored = law_values(material.tables, material.law, strength)
            slope = np.divide(b, strength, out=np.ones_like(b), where=strength > 1e-30)
            remanence = material.remanence[s]
            flux = slope[:, None] * h[s] + remanence
            added = flux - h[s]
            linkage[:, s] += np.einsum("e,ced,ed->c", weight, units, added)
            local = np.sum(remanence * h[s] - 0.5 * flux * h[s] + 0.5 * added * t[s], axis=1)
            coenergy[s] += weight @ (stored + local)
    return linkage, coenergy


def linkage_of_means(mesh: IronMesh, magnetisation: Array, load: Array) -> Array:
    """Flux linkages (c, s) in Wb of mu0 M (s, e, 3) in T, constant in every element: the flux form.

    load (c, e, 4): `FluxElements.load` of one ampere in each coil. A constant vector is the flux element field with
    the fluxes v . S_k through the faces S_k.
    """
    corners = mesh.points[mesh.tets]
    inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    last = np.swapaxes(inverse, 1, 2)
    gradients = np.concatenate([-last.sum(axis=1, keepdims=True), last], axis=1)
    area = -3 * volumes(mesh.points, mesh.tets)[:, None, None] * gradients
    return np.einsum("sed,ekd,cek->cs", magnetisation, area, load, optimize=True) / mu_0


def _point_gradients(elements: NodalElements, values: Array) -> Iterator[Array]:
    """Gradients (c, e, 3) of nodal values (n, c) at the four points of every element, one point after the other.

    Shape functions as in `fieldmap.kernels.quadratic_potential`: gradients (4 l_i - 1) g_i and 4 (l_a g_b + l_b g_a).
    """
    barycentric, _ = tetrahedron_rule(2)
    nodal = values[elements.nodes]
    for point in barycentric:
        combine = np.zeros((4, 10))
        combine[np.arange(4), np.arange(4)] = 4 * point - 1
        for m, (a, b) in enumerate(_PAIRS):
            combine[b, 4 + m] += 4 * point[a]
            combine[a, 4 + m] += 4 * point[b]
        yield np.einsum("kn,enc,ekd->ced", combine, nodal, elements.gradients, optimize=True)
