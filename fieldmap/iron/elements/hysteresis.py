"""The potential form for iron with hysteresis: the same elements, and play cells at their points.

docs/theory/hysteresis.md. At a given history of the cells, B is the gradient by h of a convex function, as without
hysteresis. The functional, Newton's method and its line search are therefore those of the potential form.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.nodal_elements import WORK, CoilField, NodalElements
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import ElementField, LinearField
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.kernels.iron import hysteresis as law_kernel
from fieldmap.kernels.iron.hysteresis import tested_matrices, tested_vectors
from fieldmap.threads import over_rows
from fieldmap.typing import Array

_UNIT = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class HysteresisMagnetisation(Magnetisation):
    """A `Magnetisation` of one source with hysteresis.

    pinning (l, k): pinning fields of the k play cells in each law, T; weights (k,), their sum 1; reversible
    (e, 4, k, 3): reversible field of the cells at the points of every element, T.
    """

    pinning: Array
    weights: Array
    reversible: Array

    def response(self, h: Array) -> tuple[Array, Array]:
        """Polarisation (e, 4, 3), remanence of magnets included, and its derivative (e, 4, 6) at h (e, 4, 3), T."""
        polarisation, tangent = np.empty((h.size // 3, 3)), np.empty((h.size // 3, 6))
        arguments = (*self._arguments(h), polarisation, tangent)
        over_rows(law_kernel.respond, len(tangent), *arguments, work=40.0 * self.weights.size)
        return polarisation.reshape(h.shape) + self.remanence[0][:, None], tangent.reshape(*h.shape[:2], 6)

    def after(self, h: Array) -> "HysteresisMagnetisation":
        """The same iron after the field h (e, 4, 3)."""
        moved = np.empty_like(self.reversible)
        cells = moved.reshape(-1, *moved.shape[2:])
        arguments = (*self._arguments(h), cells)
        over_rows(law_kernel.advance, len(cells), *arguments, work=20.0 * self.weights.size)
        return replace(self, reversible=moved)

    def dissipated(self, after: "HysteresisMagnetisation", volume: Array) -> float:
        """Loss, T^2 m^3 (over mu0: J), on the path to a later state, for volumes (e,): pinning field times the distance
        by which the polarisation of every cell moved."""
        way = np.linalg.norm(self._cells(after.reversible) - self._cells(self.reversible), axis=-1)
        return float(np.einsum("e,eqk,ek,k->", 0.25 * volume, way, self.pinning[self.law], self.weights))

    def _cells(self, reversible: Array) -> Array:
        """Polarisation (e, 4, k, 3) of every cell."""
        size = np.linalg.norm(reversible, axis=-1)
        law = np.broadcast_to(self.law[:, None, None], size.shape).ravel()
        j = self.tables.flux_density(size.ravel(), law).reshape(size.shape) - size
        share = np.divide(j, size, out=np.zeros_like(j), where=size > 0.0)
        return np.asarray(share[..., None] * reversible)

    def _arguments(self, h: Array) -> tuple[Any, ...]:
        points = np.ascontiguousarray(h.reshape(-1, 3))
        reversible = self.reversible.reshape(len(points), -1, 3)
        return points, reversible, self.pinning, self.weights, np.repeat(self.law, 4), *self.tables.arrays


@dataclass(frozen=True, eq=False, repr=False)
class HysteresisElements(NodalElements):
    """Second-order nodal elements of iron with hysteresis; of other iron where the material has none.

    Residual, tangent and line search ask for the law at the same potential one after the other: the last is cached.
    """

    _last: list[tuple[Any, ...]] = field(default_factory=list, init=False, repr=False)

    def residual(self, potential: Array, field: CoilField, source: int, material: Magnetisation) -> Array:
        """Element vectors (e, 10) of int (b(h) - t) . grad N with h = t - grad phi, for phi (n,)."""
        if not isinstance(material, HysteresisMagnetisation):
            return super().residual(potential, field, source, material)
        _, slope, polarisation, _ = self.evaluated(potential, field, source, material)
        out = self._zeros()
        over_rows(tested_vectors, len(out), polarisation - slope, self.gradients, self.volume, out, work=WORK)
        return out

    def tangent(self, potential: Array, field: CoilField, source: int, material: Magnetisation) -> Array:
        """Element matrices (e, 10, 10) of int grad N_i . (db/dh) grad N_j at phi (n,)."""
        if not isinstance(material, HysteresisMagnetisation):
            return super().tangent(potential, field, source, material)
        tangent = self.evaluated(potential, field, source, material)[3]
        out = self._zeros(10)
        over_rows(tested_matrices, len(out), tangent + _UNIT, self.gradients, self.volume, out, work=2 * WORK)
        return out

    def mean_fields(
        self, potential: Array, field: CoilField, source: int, material: Magnetisation
    ) -> tuple[Array, Array]:
        """Mean flux density (e, 3) of every element and the largest mu0 H (e,) at its points, for phi (n,)."""
        if not isinstance(material, HysteresisMagnetisation):
            return super().mean_fields(potential, field, source, material)
        h, _, polarisation, _ = self.evaluated(potential, field, source, material)
        return (h + polarisation).mean(axis=1), np.linalg.norm(h, axis=2).max(axis=1)

    def evaluated(
        self, potential: Array, field: CoilField, source: int, material: HysteresisMagnetisation
    ) -> tuple[Array, Array, Array, Array]:
        """mu0 H, grad phi, polarisation (e, 4, 3) and its derivative (e, 4, 6) at the points, for phi (n,)."""
        if self._last:
            about, known, found = self._last[0]
            if about[0] is field and about[1] is material and np.array_equal(known, potential):
                return found
        h, slope = self.strength(potential, field, source)
        self._last[:] = [((field, material), potential.copy(), (h, slope, *material.response(h)))]
        return self._last[0][2]

    def strength(self, potential: Array, field: CoilField, source: int = 0) -> tuple[Array, Array]:
        """mu0 H and grad phi (e, 4, 3) at the points of every element, for phi (n,)."""
        values = np.ascontiguousarray(np.column_stack([potential, field.bubble[source]]))
        both = self.gradients_at_points(values)
        slope = np.ascontiguousarray(both[..., 0])
        return field.constant[source][:, None] + both[..., 1] - slope, slope


class HysteresisForm(ConvexForm[HysteresisElements]):
    """One mesh in the potential form, for iron with hysteresis."""

    name = "potential"

    def __init__(self, iron: AssembledIron) -> None:
        super().__init__(iron, HysteresisElements.from_mesh(iron.mesh, iron.topology))

    def _inside(self, potential: Array, field: Any, material: Magnetisation) -> ElementField:
        assert isinstance(material, HysteresisMagnetisation)
        h, _, polarisation, _ = self.elements.evaluated(potential[:, 0], field, 0, material)
        return LinearField((h + polarisation)[None], polarisation[None])
