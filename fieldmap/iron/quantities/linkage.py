"""Flux linkage and co-energy of the iron, from the fields inside it: docs/theory/forces.md (4), (5)."""

import numpy as np

from fieldmap.constants import MU0
from fieldmap.iron.elements.bh_law import Magnetisation, law_slopes, law_values
from fieldmap.iron.elements.nodal_elements import CoilField
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.elements.state import PotentialField, shape_gradients
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from fieldmap.typing import Array


def linkage_and_coenergy(
    volume: Array, material: Magnetisation, strength: Array, coils: Array, unit: Array
) -> tuple[Array, Array]:
    """What the iron adds to flux linkages (c, s) in Wb and to the co-energy (s,) in J.

    At the four points of every element, in T: strength (s, e, 4, 3), mu0 H of s solved sources; coils (s, e, 4, 3):
    field of their coils alone; unit (c, e, 4, 3): field of one ampere in each of c coils. The linkage is the exact
    derivative of the discrete co-energy, so both agree on any mesh.
    """
    share = (0.25 * volume / MU0)[:, None]
    linkage, coenergy = np.zeros((len(unit), len(strength))), np.zeros(len(strength))
    per_coil = unit.reshape(len(unit), int(np.prod(unit.shape[1:])))
    for s, (h, t) in enumerate(zip(strength, coils, strict=True)):
        remanence = material.remanence[s][:, None]
        size = np.linalg.norm(h, axis=2)
        b, stored = law_values(material.tables, np.repeat(material.law, 4), size.ravel())
        slope = np.divide(b.reshape(size.shape), size, out=np.ones_like(size), where=size > 0.0)
        flux = slope[..., None] * h + remanence
        added = flux - h
        linkage[:, s] = per_coil @ (share[..., None] * added).ravel()
        local = np.sum(remanence * h - 0.5 * flux * h + 0.5 * added * t, axis=2)
        coenergy[s] = np.sum(share * (stored.reshape(size.shape) + local))
    return linkage, coenergy


def iron_differential_inductance(
    form: PotentialForm, material: Magnetisation, inside: PotentialField, unit: CoilField, tolerance: float
) -> Array:
    """What the iron adds to the matrix of linkage derivatives (c, c) in H, at a solved state.

    unit: the fields t_k of one ampere in each coil. With the tangent D = db/dh of the state, the potential follows the
    current of coil j by p_j, (K + S) p_j = int (D t_j - t_j) . grad v, and d lambda_k / d I_j = 1/mu0 int (D - 1)
    (t_j - grad p_j) . t_k. Raises NotConverged.
    """
    response = form.sensitivities(inside.potential[:, 0], inside.field, material, unit, tolerance)
    coils = len(unit.bubble)
    out = np.zeros((coils, coils))
    for shape, tangent, weight, t in _points(inside, unit):
        h = t - np.einsum("eia,eic->cea", shape, response[inside.elements.nodes])
        out += np.einsum("e,kea,jea->kj", weight, t, np.einsum("eab,jeb->jea", tangent, h) - h, optimize=True)
    return out / MU0


def _points(inside: PotentialField, unit: CoilField):
    """Shape gradients (e, 10, 3), tangents (e, 3, 3), weights (e,) and unit fields (c, e, 3) at the rule's points."""
    elements = inside.elements
    element = np.arange(len(elements.volume))
    for point, share in zip(*tetrahedron_rule(2), strict=True):
        barycentric = np.tile(point, (len(element), 1))
        shape = shape_gradients(barycentric, elements.gradients)
        h = inside.strength(element, barycentric)[0]
        size = np.linalg.norm(h, axis=1)
        chord, slope = law_slopes(inside.tables, inside.law, size)
        direction = np.divide(h, size[:, None], out=np.zeros_like(h), where=size[:, None] > 0.0)
        along = np.einsum("ea,eb->eab", direction, direction)
        tangent = chord[:, None, None] * np.eye(3) + (slope - chord)[:, None, None] * along
        t = unit.constant + np.einsum("eia,cei->cea", shape, unit.bubble[:, elements.nodes])
        yield shape, tangent, share * elements.volume, t
