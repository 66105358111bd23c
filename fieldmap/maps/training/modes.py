"""Modes of solved states, the few fields they make in the workspace, and which states they lack most."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.states import Snapshots
from fieldmap.typing import Array

# Directions whose share of the energy is below rounding.
_NEGLIGIBLE = 1e-13


def proper_modes(states: Array, applied: Array, most: int, tolerance: float = 0.0) -> Array:
    """Combinations (s, r) of `states` (n, s) that are orthonormal modes, at most `most`, with the largest shares of the
    energy of all; applied (n, s): the symmetric positive operator of the energy on the states. tolerance: no more of
    them than leave at most this of any state, in the norm of the energy.

    Sirovich, Quart. Appl. Math. 45 (1987) 561: the method of snapshots.
    """
    gram = states.T @ applied
    last = len(gram) - 1
    values, vectors = eigh(0.5 * (gram + gram.T), subset_by_index=(max(last + 1 - most, 0), last))
    order = np.argsort(values)[::-1]
    order = order[values[order] > _NEGLIGIBLE * values[order[0]]]
    order = order[: _enough(vectors[:, order] * np.sqrt(values[order]), tolerance)]
    return np.asarray(vectors[:, order] / np.sqrt(values[order]))


def _enough(coordinates: Array, tolerance: float) -> int:
    """How many of the orthonormal directions leave at most `tolerance` of every row of coordinates (s, r), one at
    least."""
    left = np.cumsum(coordinates[:, ::-1] ** 2, axis=1)[:, ::-1].max(axis=0)
    return max(1, int((left > tolerance**2).sum()))


def output_fields(amplitudes: Array, fields: Array, most: int, tolerance: float = 0.0) -> tuple[Array, Array]:
    """Combinations of the modes whose fields are enough for all states: `combination` (k, r) and `weights` (k, r).

    amplitudes (s, r) of the states, fields (r, m) of the modes at m numbers of interest. Field j is
    combination[j] @ fields; a state of amplitudes a has the field sum_j (weights @ a)_j field_j, up to the k + 1st
    singular value of the states' fields. Every weight is of order one at the largest state. tolerance: no more fields
    than leave at most this share of any state's own.
    """
    count, modes = amplitudes.shape
    values, vectors = np.linalg.eigh(amplitudes.T @ amplitudes / count)
    values = np.maximum(values, 1e-16 * values[-1])
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    left, singular, _ = np.linalg.svd(root @ fields, full_matrices=False)
    k = min(most, modes, int((singular > 1e-12 * singular[0]).sum()))
    own = amplitudes @ inverse @ left * singular
    size = np.linalg.norm(own, axis=1, keepdims=True)
    k = min(k, _enough(own / np.where(size > 0.0, size, 1.0), tolerance))
    combination = (left[:, :k] / singular[:k]).T @ root
    weights = (inverse @ left[:, :k] * singular[:k]).T
    scale = np.abs(amplitudes @ weights.T).max(axis=0)
    return combination * scale[:, None], weights / scale[:, None]


# Amplitudes need only be as good as the modes; the last step of Newton's method goes past this.
_TOLERANCE = 1e-3


class SolvedModes:
    """The iron on the modes of the solved states and their tangents, with the law at all points.

    most: modes; tolerance: no more of them than leave at most this share of any state or tangent. left: the largest
    share that they leave, in the norm of the energy.
    """

    def __init__(
        self, solver: NonlinearSolver, snapshots: Snapshots, most: int, tolerance: float = 0.0
    ) -> None:
        self.currents, found = snapshots.currents, snapshots.states
        # The energy is that of the tangent at the first state.
        tangent = solver.tangent(self.currents[0], found[0].potential)
        columns, air, applied_to = [], [], []
        for state in found:
            vectors = np.column_stack([state.potential, state.tangents])
            # Every state counts alike, whatever its currents: errors are stated as shares of a state's own field. One
            # without currents counts by the largest of its tangents.
            product = tangent @ vectors + state.air
            energy = np.einsum("nk,nk->k", vectors, product)
            largest = energy.max(initial=0.0)
            size = np.sqrt(energy[0] if energy[0] > _NEGLIGIBLE * largest else largest) or 1.0
            columns.append(vectors / size)
            air.append(state.air / size)
            applied_to.append(product / size)
        vectors, of_air = np.concatenate(columns, axis=1), np.concatenate(air, axis=1)
        applied = np.concatenate(applied_to, axis=1)
        combined = proper_modes(vectors, applied, most, tolerance)
        self.basis, self.air = vectors @ combined, of_air @ combined
        energy = np.einsum("ns,ns->s", vectors, applied)
        rest = energy - ((applied.T @ self.basis) ** 2).sum(axis=1)
        self.left = float(np.sqrt(max(rest.max(), 0.0)))
        self.model: GalerkinModel = solver.project(self.basis, self.air)
        self.amplitudes = snapshots.potentials.T @ (applied @ combined)
        self._solver, self._first = solver, found[0].potential

    def amplitude(self, currents: Array, tolerance: float = _TOLERANCE) -> Array:
        """Amplitudes (r,) at currents (c,)."""
        near = int(np.argmin(np.linalg.norm(self.currents - currents, axis=1)))
        return self.model.solve(currents, self.amplitudes[near], tolerance)[0]

    def missing(self, tried: Snapshots, accuracy: float) -> NDArray[np.int64]:
        """Which of some solved states these modes need, so that they hold all within `accuracy` in the energy.

        Of states that lack the same mode only one is taken: the next is always the one of which most is left when it is
        projected onto the modes and those chosen.
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
