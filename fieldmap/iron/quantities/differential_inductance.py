"""How flux linkages answer small changes of the currents, by the tangent of the solved state: theory/forces.md (10)."""

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0

from fieldmap.iron.forms.bh_law import law_slopes
from fieldmap.iron.forms.element_fields import PotentialField, shape_gradients
from fieldmap.iron.forms.nodal_elements import CoilField
from fieldmap.iron.forms.potential_form import Magnetisation, PotentialForm
from fieldmap.kernels.simplex_rules import tetrahedron_rule

Array = NDArray[np.float64]


def iron_differential_inductance(
    form: PotentialForm, material: Magnetisation, inside: PotentialField, unit: CoilField, tolerance: float
) -> Array:
    """What the iron adds to the matrix of linkage derivatives (c, c) in H, at a solved state.

    unit: the fields t_k of one ampere in each coil. With the tangent D = db/dh of the state, the potential follows the
    current of coil j by p_j, (K + S) p_j = int (D t_j - t_j) . grad v, and d lambda_k / d I_j = 1/mu0 int (D - 1)
    (t_j - grad p_j) . t_k. Raises NotConverged.
    """
    points = list(_points(inside, unit))
    right = np.zeros((inside.elements.count, len(unit.bubble)))
    for shape, tangent, weight, t in points:
        pushed = np.einsum("eab,ceb->cea", tangent, t) - t
        local = np.einsum("e,eia,cea->eic", weight, shape, pushed)
        np.add.at(right, inside.elements.nodes.ravel(), local.reshape(-1, right.shape[1]))
    response = form.solve_tangent(inside.potential, inside.field, material, right, tolerance)
    out = np.zeros((right.shape[1],) * 2)
    for shape, tangent, weight, t in points:
        h = t - np.einsum("eia,eic->cea", shape, response[inside.elements.nodes])
        out += np.einsum("e,kea,jea->kj", weight, t, np.einsum("eab,jeb->jea", tangent, h) - h, optimize=True)
    return out / mu_0


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
        direction = np.divide(h, size[:, None], out=np.zeros_like(h), where=size[:, None] > 1e-30)
        along = np.einsum("ea,eb->eab", direction, direction)
        tangent = chord[:, None, None] * np.eye(3) + (slope - chord)[:, None, None] * along
        t = unit.constant + np.einsum("eia,cei->cea", shape, unit.bubble[:, elements.nodes])
        yield shape, tangent, share * elements.volume, t
