"""Modes of solved states, the few fields they make in the workspace, and which states they lack most."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.states import Snapshots
from fieldmap.typing import Array

# Directions whose share of the energy is below rounding.
_NEGLIGIBLE = 1e-13


def proper_modes(states: Array, apply: Callable[[Array], Array], most: int) -> Array:
    """At most `most` orthonormal modes (n, r) that hold the largest share of the energy of `states` (n, s).

    apply(x (n, s)) is the symmetric positive operator of the energy product. Sirovich, Quart. Appl. Math. 45 (1987)
    561: the method of snapshots.
    """
    gram = states.T @ apply(states)
    values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    order = np.argsort(values)[::-1][:most]
    order = order[values[order] > _NEGLIGIBLE * values[order[0]]]
    return np.asarray(states @ (vectors[:, order] / np.sqrt(values[order])))


def output_fields(amplitudes: Array, fields: Array, most: int) -> tuple[Array, Array]:
    """Combinations of the modes whose fields are enough for all states: `combination` (k, r) and `weights` (k, r).

    amplitudes (s, r) of the states, fields (r, m) of the modes at m numbers of interest. Field j is
    combination[j] @ fields; a state of amplitudes a has the field sum_j (weights @ a)_j field_j, up to the k + 1st
    singular value of the states' fields. Every weight is of order one at the largest state.
    """
    count, modes = amplitudes.shape
    values, vectors = np.linalg.eigh(amplitudes.T @ amplitudes / count)
    values = np.maximum(values, 1e-16 * values[-1])
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    left, singular, _ = np.linalg.svd(root @ fields, full_matrices=False)
    k = min(most, modes, int((singular > 1e-12 * singular[0]).sum()))
    combination = (left[:, :k] / singular[:k]).T @ root
    weights = (inverse @ left[:, :k] * singular[:k]).T
    scale = np.abs(amplitudes @ weights.T).max(axis=0)
    return combination * scale[:, None], weights / scale[:, None]


# Amplitudes need only be as good as the modes; the last step of Newton's method goes past this.
_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Proposal:
    """currents (k, c) of the states to solve next, their estimates (k,), the first the largest of the pool, and nodal
    potentials (n, k) to begin with."""

    currents: Array
    estimates: Array
    starts: Array


class SolvedModes:
    """The iron on the modes of the solved states, with the law at all points."""

    def __init__(self, solver: NonlinearSolver, snapshots: Snapshots, most: int) -> None:
        self.currents, states = snapshots.currents, snapshots.potentials
        energy = solver.energy_operator(self.currents[0], states[:, 0])
        # Every state counts alike, whatever its currents: errors are stated as shares of a state's own field.
        sizes = np.sqrt(np.einsum("ns,ns->s", states, energy(states)))
        self.basis = proper_modes(states / np.where(sizes > 0.0, sizes, 1.0), energy, most)
        self.model: GalerkinModel = solver.project(self.basis)
        self.amplitudes = states.T @ energy(self.basis)
        self._solver, self._first = solver, states[:, 0]

    def amplitude(self, currents: Array) -> Array:
        """Amplitudes (r,) at currents (c,)."""
        near = int(np.argmin(np.linalg.norm(self.currents - currents, axis=1)))
        return self.model.solve(currents, self.amplitudes[near], _TOLERANCE)[0]

    def propose(self, pool: Array, count: int) -> Proposal:
        """`count` of the states of a pool (m, c).

        The estimate of a state is the energy of what its residual asks for, relative to that of the state. Of states
        that lack the same mode only one is taken: the next is always the one whose correction is largest after those
        chosen are projected out (a pivoted Cholesky factorisation of the corrections' energy product).
        """
        amplitudes = np.array([self.amplitude(values) for values in pool])
        estimate = self._solver.residual_estimate(self.currents[0], self._first, self.basis)
        pairs = zip(pool, amplitudes, strict=True)
        residuals = np.array([estimate.residual(self._solver.coil_field(i), a) for i, a in pairs]).T
        # The modes are orthonormal in the energy.
        residuals /= np.linalg.norm(amplitudes, axis=1)
        product = residuals.T @ estimate.correction(residuals)
        chosen = pivots(0.5 * (product + product.T), count)
        estimates = np.sqrt(np.maximum(np.diag(product), 0.0))
        starts = self.basis @ amplitudes[chosen].T
        return Proposal(pool[chosen], estimates[chosen], starts)

    def missing(self, tried: Snapshots, accuracy: float) -> NDArray[np.int64]:
        """Which of some solved states these modes need, so that they hold all within `accuracy` in the energy.

        Chosen as in `propose`, by what is left of the states when they are projected onto the modes.
        """
        energy = self._solver.energy_operator(self.currents[0], self._first)
        states = tried.potentials / np.sqrt(np.einsum("ns,ns->s", tried.potentials, energy(tried.potentials)))
        applied = energy(states)
        left = states - self.basis @ (self.basis.T @ applied)
        return pivots(left.T @ energy(left), left.shape[1], accuracy**2)


def pivots(product: Array, count: int, least: float = 0.0) -> NDArray[np.int64]:
    """The first `count` pivots of a Cholesky factorisation of a symmetric positive matrix (m, m), largest first, as
    long as they are above `least`."""
    rest = np.diag(product).copy()
    columns = np.zeros((len(product), 0))
    chosen: list[int] = []
    for _ in range(min(count, len(product))):
        best = int(np.argmax(rest))
        if rest[best] <= least:
            break
        column = (product[:, best] - columns @ columns[best]) / np.sqrt(rest[best])
        columns = np.column_stack([columns, column])
        rest = rest - column**2
        rest[[*chosen, best]] = 0.0
        chosen.append(best)
    return np.array(chosen, np.int64)
