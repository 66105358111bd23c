"""Proper modes of solved states, the few fields of the map that they make, and the states that they represent worst."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.currents import nearest_of
from fieldmap.maps.training.states import Snapshots, Solved
from fieldmap.parallel import results_of
from fieldmap.typing import Array

# Directions with a smaller share of the energy are rounding errors.
_NEGLIGIBLE = 1e-13


def proper_modes(states: Array, applied: Array, most: int) -> Array:
    """Proper orthogonal modes by the method of snapshots (Sirovich, Quart. Appl. Math. 45 (1987) 561).

    Parameters
    ----------
    states
        (n, s).
    applied
        (n, s), the symmetric positive operator of the energy times the states.
    most
        Most modes.

    Returns
    -------
    Array
        (s, r): the modes are states @ these; they are orthonormal in the energy, that of the largest energy
        first.
    """
    gram = states.T @ applied
    last = len(gram) - 1
    values, vectors = eigh(0.5 * (gram + gram.T), subset_by_index=(max(last + 1 - most, 0), last))
    order = np.argsort(values)[::-1]
    order = order[values[order] > _NEGLIGIBLE * values[order[0]]]
    return np.asarray(vectors[:, order] / np.sqrt(values[order]))


def enough(coordinates: Array, tolerance: float) -> int:
    """Number of leading columns of the coordinates (s, r) after which every row has a rest of at most `tolerance`; at
    least one. The coordinates belong to orthonormal directions."""
    left = np.cumsum(coordinates[:, ::-1] ** 2, axis=1)[:, ::-1].max(axis=0)
    return max(1, int((left > tolerance**2).sum()))


def output_fields(amplitudes: Array, fields: Array, most: int, tolerance: float) -> tuple[Array, Array]:
    """Few fields whose sums represent the fields of all states.

    Field j is combination[j] @ fields. A state of amplitudes a has the field sum_j (weights @ a)_j field_j, with an
    error of the order of singular value k + 1 of the states' fields.

    Parameters
    ----------
    amplitudes
        (s, r), of the states.
    fields
        (r, m), m numbers that describe the field of each mode.
    most
        Most fields.
    tolerance
        Largest error of a state's field, as a share of it; fewer fields are returned if they reach this.

    Returns
    -------
    tuple[Array, Array]
        Combination (k, r) and weights (k, r). The largest weight of each field over the states is one.
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
    k = min(k, enough(own / np.where(size > 0.0, size, 1.0), tolerance))
    combination = (left[:, :k] / singular[:k]).T @ root
    weights = (inverse @ left[:, :k] * singular[:k]).T
    scale = np.abs(amplitudes @ weights.T).max(axis=0)
    return combination * scale[:, None], weights / scale[:, None]


# Default tolerance of Newton's method. Amplitudes need not be more accurate than the modes, and the last step of the
# method makes them more accurate than this.
_TOLERANCE = 1e-3
# Randomised subspace iteration, for many columns: number of combinations beyond the number of modes, number of passes
# over all columns, and the seed. Up to `_AS_THEY_ARE` times as many columns as combinations are used without it, if
# they have at most `_NUMBERS` numbers.
_MORE, _PASSES, _SEED, _AS_THEY_ARE, _NUMBERS = 40, 3, 20265, 4, 2**26


class SolvedModes:
    """The reduced model on the modes of the solved states and their tangents, with the law at all points.

    Its attribute `left` is the largest projection error of a state or tangent, as a share of it in the energy norm.

    Parameters
    ----------
    solver
        Of the whole iron.
    snapshots
        Solved states.
    most
        Most modes.
    tolerance
        Allowed projection error; fewer modes are taken if they reach it.
    """

    def __init__(self, solver: NonlinearSolver, snapshots: Snapshots, most: int, tolerance: float) -> None:
        self.currents = snapshots.currents
        self._solver, self._first = solver, snapshots.state(0).potential
        columns = _Columns(solver, snapshots)
        block, air = columns.block(most + _MORE)
        combined = proper_modes(block, columns.tangent @ block + air, most)
        basis, of_air = block @ combined, air @ combined
        coordinates = columns.products(columns.tangent @ basis + of_air)
        few = enough(coordinates, tolerance)
        self.basis, self.air = basis[:, :few].copy(), of_air[:, :few].copy()
        coordinates = coordinates[:, :few]
        rest = columns.energies - (coordinates**2).sum(axis=1)
        self.left = float(np.sqrt(max(rest.max(), 0.0)))
        self.model: GalerkinModel = solver.project(self.basis, self.air)
        self.amplitudes = coordinates[columns.first] * columns.sizes[:, None]

    def amplitude(self, currents: Array, tolerance: float = _TOLERANCE) -> Array:
        """Amplitudes (r,) at currents (c,)."""
        start = self.amplitudes[nearest_of(currents, self.currents)]
        return self.model.solve(currents, start, tolerance)[0]

    def missing(self, tried: Snapshots, accuracy: float) -> NDArray[np.int64]:
        """Indices of the solved states that must be added to these modes to represent all of them within `accuracy`.

        The choice is greedy: the next state is always the one with the largest projection error, in the energy norm,
        onto the modes and the states chosen before. Of several states that need the same mode only one is taken.
        """
        energy = self._solver.energy_operator(self.currents[0], self._first)
        states = tried.potentials / np.sqrt(np.einsum("ns,ns->s", tried.potentials, energy(tried.potentials)))
        applied = energy(states)
        left = states - self.basis @ (self.basis.T @ applied)
        return pivots(left.T @ energy(left), left.shape[1], accuracy**2)


def solved(model: GalerkinModel, currents: Array, starts: Array, tolerance: float = 1e-7) -> Array:
    """Amplitudes (s, r) of a model at currents (s, c), from starts (s, r)."""
    pairs = list(zip(currents, starts, strict=True))
    found = list(results_of(lambda pair: model.solve(pair[0], pair[1], tolerance)[0], pairs))
    return np.array(found).reshape(starts.shape)


def solved_from(
    model: GalerkinModel, known: tuple[Array, Array], currents: Array, tolerance: float = 1e-7
) -> Array:
    """Amplitudes (s, r) at currents (s, c), each from the nearest of known currents (t, c) and amplitudes (t, r)."""
    near = [nearest_of(values, known[0]) for values in currents]
    return solved(model, currents, known[1][near], tolerance)


class _Columns:
    """Solved states and their tangents as columns of a matrix, divided by the size of the state.

    The matrix is never formed as a whole: methods go through it state by state, because images of states are made only
    when they are needed.

    Attributes
    ----------
    tangent : the contribution of the iron to the energy operator, the tangent matrix at the first state.
    energies : energy of each column; one for a state.
    first : indices of the columns that are states.
    sizes : energy norms of the states.
    """

    def __init__(self, solver: NonlinearSolver, snapshots: Snapshots) -> None:
        self._snapshots = snapshots
        self.tangent = solver.tangent(snapshots.currents[0], snapshots.state(0).potential)
        sizes, energies = [], []
        for state in snapshots.states:
            vectors = _vectors(state)
            energy = np.einsum("nk,nk->k", vectors, self.tangent @ vectors + state.air)
            largest = energy.max(initial=0.0)
            # Errors are shares of a state's own field, so all states get the same energy. A state without currents has
            # none and is divided by its largest tangent.
            sizes.append(np.sqrt(energy[0] if energy[0] > _NEGLIGIBLE * largest else largest) or 1.0)
            energies.append(energy / sizes[-1] ** 2)
        self.sizes, self.energies = np.array(sizes), np.concatenate(energies)
        ends = np.cumsum([len(energy) for energy in energies])
        self.first = np.concatenate([[0], ends[:-1]])
        self._places = [slice(*ends_of) for ends_of in zip(self.first, ends, strict=True)]

    def block(self, most: int) -> tuple[Array, Array]:
        """Columns (n, b) that span nearly all of the energy, and the air operator times them.

        They are all columns, or `most` combinations of them if there are many.

        N. Halko, P.-G. Martinsson, J. A. Tropp, SIAM Review 53 (2011) 217, algorithm 4.4.
        """
        count = len(self.energies)
        if count <= _AS_THEY_ARE * most and count * self.tangent.shape[0] <= _NUMBERS:
            pairs = list(zip(self._snapshots.states, self.sizes, strict=True))
            vectors = np.concatenate([_vectors(state) / size for state, size in pairs], axis=1)
            return vectors, np.concatenate([state.air / size for state, size in pairs], axis=1)
        factors = np.random.default_rng(_SEED).standard_normal((count, most))
        for _ in range(_PASSES):
            vectors, air = self._combined(factors)
            factors = np.linalg.qr(self.products(self.tangent @ vectors + air))[0]
        return self._combined(factors)

    def products(self, applied: Array) -> Array:
        """Scalar products (s, k) of all columns with the columns of `applied` (n, k)."""
        return np.concatenate(
            [
                _vectors(state).T @ applied / size
                for state, size in zip(self._snapshots.states, self.sizes, strict=True)
            ]
        )

    def _combined(self, factors: Array) -> tuple[Array, Array]:
        """All columns times factors (s, k), and the air operator times these."""
        vectors, air = np.zeros((2, self.tangent.shape[0], factors.shape[1]))
        for state, place, size in zip(self._snapshots.states, self._places, self.sizes, strict=True):
            vectors += _vectors(state) @ (factors[place] / size)
            air += state.air @ (factors[place] / size)
        return vectors, air


def _vectors(state: Solved) -> Array:
    return np.column_stack([state.potential, state.tangents])


def pivots(product: Array, count: int, least: float = 0.0) -> NDArray[np.int64]:
    """Indices of the first `count` pivots of the pivoted Cholesky factorisation of a symmetric positive matrix (m, m).

    They come in order of their values; a pivot that is not above `least` ends them.
    """
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
