"""Solved iron: charges for the air, and the field inside the elements.

In the potential form h is linear in each element, in the flux form b.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import LawTables, Magnetisation, law_values
from fieldmap.iron.elements.nodal_elements import CoilField, NodalElements
from fieldmap.iron.elements.separated import SeparatedState
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index


class ElementField(Protocol):
    """The field inside elements, as exactly as a form knows it."""

    def flux_density(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3) in T of every source at points (n, 4), in barycentric coordinates of elements (n,)."""
        ...

    def polarisation(self, element: Index, barycentric: Array) -> Array:
        """mu0 M (c, n, 3) in T; otherwise as `flux_density`."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class IronState(Record):
    """Solved iron for one or several sources (columns c).

    faces: the m charged faces; density (c, m) in T: mu0 times magnetic charge per area; flux_density (c, e, 3):
    mean of every element, T; iterations: steps of the solver; residuals: its history, relative, worst column;
    inside: the field within elements, None for states that were read back from a file; separated: the same iron with
    air in thin drawn gaps, where the mesh has sheets in them.
    """

    faces: ChargedFaces
    density: Array
    flux_density: Array
    iterations: int
    residuals: tuple[float, ...]
    inside: ElementField | None = None
    separated: SeparatedState | None = None

    def flux_density_at(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3) at points (n, 4) of elements (n,), see `ElementField`; where that is not kept, their means."""
        if self.inside is None:
            return self.flux_density[:, element]
        return self.inside.flux_density(element, barycentric)

    def mean_polarisation(self, element: Index, weights: Array) -> Array:
        """Mean mu0 M (n, 3) in T of elements (n,), of the sources with these weights (c,).

        Raises InputError for a state that was read back from a file, which keeps charges and flux densities only.
        """
        if self.inside is None:
            received, remedy = "a solution read back from a file", "solve the device again"
            problem = Problem("magnetisation", "the field inside the iron is needed", received, remedy)
            raise InputError(problem)
        mean = np.zeros((len(element), 3))
        for point, share in zip(*tetrahedron_rule(2), strict=True):
            value = self.inside.polarisation(element, np.tile(point, (len(element), 1)))
            mean += share * np.tensordot(weights, value, 1)
        return mean


_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


@dataclass(frozen=True, eq=False, repr=False)
class PotentialField(Record):
    """h = t - grad phi and b = b(h) + b_r: potential (n, c), coil field t, law (e,), remanence (c, e, 3) in T."""

    elements: NodalElements
    potential: Array
    field: CoilField
    law: Index
    tables: LawTables
    remanence: Array

    def flux_density(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3), see `fieldmap.iron.elements.state.ElementField`."""
        return np.stack([b for _, b in self._fields(element, barycentric)])

    def polarisation(self, element: Index, barycentric: Array) -> Array:
        """mu0 M = B - mu0 H (c, n, 3)."""
        return np.stack([b - h for h, b in self._fields(element, barycentric)])

    def strength(self, element: Index, barycentric: Array) -> Array:
        """mu0 H (c, n, 3)."""
        return np.stack([h for h, _ in self._fields(element, barycentric)])

    def _fields(self, element: Index, barycentric: Array):
        shape = shape_gradients(barycentric, self.elements.gradients[element])
        nodes = self.elements.nodes[element]
        for c in range(self.potential.shape[1]):
            value = (self.field.bubble[c] - self.potential[:, c])[nodes]
            h = self.field.constant[c, element] + np.einsum("ni,nid->nd", value, shape)
            size = np.linalg.norm(h, axis=1)
            b, _ = law_values(self.tables, self.law[element], size)
            ratio = np.divide(b, size, out=np.ones_like(b), where=size > 0.0)
            yield h, ratio[:, None] * h + self.remanence[c, element]


@dataclass(frozen=True, eq=False, repr=False)
class LinearField(Record):
    """Flux density and polarisation, linear in each element, by their values (c, e, 4, 3) in T at the four points of
    the degree-2 rule."""

    flux_density_at_points: Array
    polarisation_at_points: Array

    def flux_density(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3)."""
        return _interpolated(self.flux_density_at_points, element, barycentric)

    def polarisation(self, element: Index, barycentric: Array) -> Array:
        """mu0 M (c, n, 3)."""
        return _interpolated(self.polarisation_at_points, element, barycentric)


def linear_field(strength: Array, material: Magnetisation) -> LinearField:
    """Of mu0 H (c, e, 4, 3) in T at the points of every element."""
    size = np.linalg.norm(strength, axis=3)
    law = np.broadcast_to(material.law[:, None], size.shape).ravel()
    b = law_values(material.tables, law, size.ravel())[0].reshape(size.shape)
    ratio = np.divide(b, size, out=np.ones_like(b), where=size > 0.0)
    flux_density = ratio[..., None] * strength + material.remanence[:, :, None]
    return LinearField(flux_density, flux_density - strength)


def _interpolated(values: Array, element: Index, barycentric: Array) -> Array:
    at_points = barycentric @ np.linalg.inv(tetrahedron_rule(2)[0])
    return np.einsum("nq,cnqd->cnd", at_points, values[:, element])


def shape_gradients(barycentric: Array, gradients: Array) -> Array:
    """Gradients (n, 10, 3) of the second-order shape functions at points (n, 4) of elements with gradients (n, 4, 3).

    (4 l_i - 1) g_i for corners, 4 (l_a g_b + l_b g_a) for middles, as in `fieldmap.kernels.iron.quadratic_potential`.
    """
    out = np.empty((len(barycentric), 10, 3))
    out[:, :4] = (4 * barycentric - 1)[:, :, None] * gradients
    for m, (a, b) in enumerate(_PAIRS):
        out[:, 4 + m] = 4 * (
            barycentric[:, a, None] * gradients[:, b] + barycentric[:, b, None] * gradients[:, a]
        )
    return out
