"""Condensation: a trained model on fewer modes and points, as few as the field in the workspace needs.

The trained modes represent the solved states in the whole iron. The time of a solve grows with points times modes, and
where the tangent is summed with points times modes squared. The field in the workspace depends on less of the iron.

A solve of the trained model takes about a millisecond. So hundreds of states are solved, and with the tangent K of each
the adjoint states K^-1 f for the fields f of the map. To first order the error of a field on a smaller basis is the
energy product of two projection errors, of the state and of the adjoint state (R. Becker and R. Rannacher, An optimal
control approach to a posteriori error estimation, Acta Numerica 10 (2001) 1, section 2). The basis is therefore the
proper modes of states and adjoint states together. The choice is repeated with larger weights for the states with
larger errors. Then points are chosen among those of the trained model, by their contributions to the fields of all
states.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh

from fieldmap.currents import CurrentDomain
from fieldmap.iron.solvers.reduced import GalerkinModel, Weights
from fieldmap.maps.training.cubature import STATES_AT_ONCE, nonnegative_path, products_of_columns
from fieldmap.maps.training.currents import drawn, extreme_signals, sequence
from fieldmap.maps.training.model_error import Off
from fieldmap.maps.training.modes import solved, solved_from
from fieldmap.parallel import results_of
from fieldmap.records import Record
from fieldmap.typing import Array

# Number of states that the choice is made with, number of other states that test it, and the most extremes of the
# domain in each of the two sets; each set gets one half of the extremes.
_STATES, _TRIED, _EXTREMES = 400, 200, 64
# Where fewer signals than coils set the currents, the first set is doubled by states whose currents do not belong to
# any signals, because real currents follow the signals with a delay. Each differs by up to this share of the largest.
_BESIDE = 0.05
_SEED = 20262
# Numbers of modes are multiples of this, the width of a vector register.
_STEP = 8
# Largest change of the field of a tested state, as a multiple of the accuracy: by fewer modes, and by fewer modes and
# points together. If the modes used up nearly all of it, the points would have to be half as many again, which costs
# more than eight more modes.
_OF_MODES, _IN_ALL = 0.9, 1.1
# Weight of the adjoint states relative to the states, after both are divided by their total energies; number of times
# that the weights of single states are changed according to their errors.
_ADJOINT, _ROUNDS = 0.07, 3
# Weight of the energy of the error relative to its field, in the choice of points. It is a tenth of that in training,
# because there are many more states.
_ENERGY = 0.03
# Weight of the errors of flux linkages: with more of it there are points that the fields do not need. Where inductances
# are wanted, weights of both; these need modes that represent how states follow the currents, too: the weight of these
# derivatives relative to the states.
_LINKAGE, _WITH_INDUCTANCE, _SLOPES = 0.1, (0.3, 1.0), 0.5
# Root mean square, over the states, of the change of the field by fewer points, as a multiple of the accuracy: the
# first value tried, the factor to the next one, and the last one.
_COARSE, _FINER, _FINEST = 0.5, 0.95, 0.02
# Relative error of the volume that counts as much as an error of `_COARSE` in the fields.
_VOLUME = 1e-2
# Tolerances of solves: of states that errors are measured with, and of trial solves during the choice.
_EXACT, _ROUGH = 1e-7, 1e-5

Few: TypeAlias = tuple[GalerkinModel, Array]


@dataclass(frozen=True, eq=False, repr=False)
class Condensed(Record):
    """A condensed model.

    Attributes
    ----------
    model : with q modes.
    basis : (r, q), its modes as combinations of the r modes of the trained model.
    changed : largest change of the field at states that were not used for the choice, as a multiple of the accuracy.
    """

    model: GalerkinModel
    basis: Array
    changed: float


def condensed(
    trained: GalerkinModel,
    known: tuple[Array, Array],
    domain: CurrentDomain,
    fields: Array,
    off: Off,
    accuracy: float,
    inductance: bool = False,
) -> Condensed:
    """Condense a model to fewer modes and points.

    Parameters
    ----------
    trained
        The model.
    known
        Currents (s, c) and amplitudes (s, r) of solved states, from which other solves begin.
    domain
        Of the currents.
    fields
        (r, k), one row per mode; the Euclidean norm of amplitudes @ fields measures the size of a field.
    off
        off(currents (s, c), amplitudes (s, r), changes (s, r)) gives the relative change (s,) of the field
        that changes of the amplitudes make.
    accuracy
        Largest relative change of a field.
    inductance
        Whether the errors of inductances count.

    Returns
    -------
    Condensed
        The condensed model; the trained model with an identity as basis if fewer modes and points are not
        accurate enough.
    """

    by, tried = _currents(domain)
    of_by, others = (solved_from(trained, known, currents, _EXACT) for currents in (by, tried))
    states = _States(trained, by, of_by, fields, inductance)

    def changed(model: GalerkinModel, basis: Array) -> float:
        changes = _changes(model, basis, tried, others)
        return float(off(tried, others, changes).max()) / accuracy

    found = _fewest(
        trained.modes, lambda count: states.combined(count, off), lambda few: changed(*few) <= _OF_MODES
    )
    model, basis = found or (trained, np.eye(trained.modes))
    products, wanted, size = states.conditions(model, basis, accuracy)
    root = np.sqrt(len(by)) / size
    tolerance = _COARSE * root
    for factors, left in nonnegative_path(products, wanted, size):
        if left > tolerance:
            continue
        chosen = np.flatnonzero(factors)
        few = model.sampled(chosen, factors[chosen] * model.weights[chosen])
        change = changed(few, basis)
        if change <= _IN_ALL:
            return Condensed(few, basis, change)
        if left <= _FINEST * root:
            break
        tolerance = _FINER * left
    return Condensed(model, basis, 0.0 if found is None else changed(model, basis))


def _fewest(modes: int, combined: Callable[[int], Few], enough: Callable[[Few], bool]) -> Few | None:
    """The smallest multiple of `_STEP` modes that is enough, found by bisection; None if all are needed."""
    low, high, best = 0, -(-modes // _STEP), None
    while high - low > 1:
        middle = (low + high) // 2
        tried = combined(_STEP * middle)
        if enough(tried):
            high, best = middle, tried
        else:
            low = middle
    return best


class _States:
    """The states that modes and points are chosen with: currents (s, c), amplitudes (s, r), adjoint states."""

    def __init__(
        self, model: GalerkinModel, currents: Array, amplitudes: Array, fields: Array, inductance: bool
    ) -> None:
        self._model, self._currents, self._amplitudes, self._fields = model, currents, amplitudes, fields
        self._weights = Weights(_ENERGY, *(_WITH_INDUCTANCE if inductance else (_LINKAGE,)))
        size = np.linalg.norm(amplitudes @ fields, axis=1)
        # The least size avoids division by zero for a state without a field.
        self._size = np.maximum(size, 1e-3 * size.max()) if size.any() else np.ones(len(size))

        def about(k: int) -> tuple[Array, Array, Array]:
            factor, slopes = model.factor_and_slopes(currents[k], amplitudes[k])
            fallen = np.asarray(cho_solve((factor, True), fields)) / self._size[k]
            return fallen, slopes if inductance else slopes[:, :0], factor

        found = zip(*results_of(about, range(len(currents))), strict=True)
        self._adjoint, self._slopes, self._factors = (np.array(each) for each in found)

    def combined(self, count: int, off: Off) -> Few:
        """The model on `count` combinations of its modes, and the basis (r, count)."""
        # The weights begin equal, so that the result does not depend on numbers of modes that were tried before.
        weights = np.ones(len(self._currents))
        for _ in range(_ROUNDS):
            error = off(self._currents, self._amplitudes, self.projected(self._basis(count, weights)))
            weights *= 0.5 + error / (error.mean() or 1.0)
            weights /= weights.mean()
        basis = self._basis(count, weights)
        return self._model.combined(basis), basis

    def projected(self, basis: Array) -> Array:
        """Changes (s, r) of the amplitudes by a basis (r, q), to first order: what a projection in the norm of the
        state's tangent leaves. It takes a tenth of the time of solves on the basis."""

        def of(k: int) -> Array:
            along, amplitude = self._factors[k].T @ basis, self._amplitudes[k]
            few = cho_solve(cho_factor(along.T @ along), along.T @ (self._factors[k].T @ amplitude))
            return np.asarray(basis @ few - amplitude)

        return np.array(list(results_of(of, range(len(self._amplitudes)))))

    def _basis(self, count: int, weights: Array) -> Array:
        root = np.sqrt(weights)
        rows = self._amplitudes * (root / self._size)[:, None]
        adjoint = np.concatenate(self._adjoint * root[:, None, None], axis=1)
        slopes = np.concatenate(self._slopes * root[:, None, None], axis=1)
        product = _one(rows.T @ rows) + _ADJOINT**2 * _one(adjoint @ adjoint.T)
        product += _SLOPES**2 * _one(slopes @ slopes.T)
        last = len(product)
        return np.ascontiguousarray(eigh(product, subset_by_index=(last - count, last - 1))[1][:, ::-1])

    def conditions(self, model: GalerkinModel, basis: Array, accuracy: float) -> tuple[Array, Array, float]:
        """Normal equations for factors (p,) on the weights of the points.

        Returns
        -------
        tuple[Array, Array, float]
            Matrix (p, p), right-hand side (p,), and the norm of the wanted values. All are in multiples of
            the accuracy, summed over all states.
        """
        fields, volume = basis.T @ self._fields, model.weights / model.weights.sum()

        def of(k: int) -> Array:
            currents = self._currents[k]
            amplitude = model.solve(currents, basis.T @ self._amplitudes[k], _ROUGH)[0]
            conditions = model.conditions(currents, amplitude, fields, self._weights)
            return conditions.of_points(model).T / accuracy

        products, wanted, square = np.zeros((len(volume), len(volume))), np.zeros(len(volume)), 0.0
        numbers = range(len(self._currents))
        for first in numbers[::STATES_AT_ONCE]:
            conditions = np.concatenate(list(results_of(of, numbers[first : first + STATES_AT_ONCE])))
            whole = conditions.sum(axis=1)
            products += products_of_columns(conditions)
            wanted += whole @ conditions
            square += float(whole @ whole)
        weight = _COARSE**2 * len(self._currents) / _VOLUME**2
        products += weight * np.outer(volume, volume)
        return products, wanted + weight * volume, float(np.sqrt(square + weight))


def _currents(domain: CurrentDomain) -> tuple[Array, Array]:
    """Currents (s, c) of the states that the choice is made with, and of the states that test it."""
    of, random = domain.parametrisation, np.random.default_rng(_SEED)
    edges = of.currents(extreme_signals(domain))
    edges = edges[random.permutation(len(edges))]
    fill = of.currents(sequence(domain, _STATES // 2))
    by = np.concatenate([fill, drawn(domain, _STATES // 2, random), edges[0::2][:_EXTREMES]])
    tried = np.concatenate([drawn(domain, _TRIED, random), edges[1::2][:_EXTREMES]])
    if of.signal_count < of.coil_count:
        largest = np.abs(by).max(axis=1, keepdims=True)
        by = np.concatenate([by, by + _BESIDE * largest * random.uniform(-1.0, 1.0, by.shape)])
    return by, tried


def _changes(model: GalerkinModel, basis: Array, currents: Array, amplitudes: Array) -> Array:
    """Changes (s, r) of the amplitudes (s, r) at currents (s, c) by the model on a basis (r, q)."""
    starts = [basis.T @ amplitude for amplitude in amplitudes]
    found = solved(model, currents, np.array(starts), _EXACT)
    # Each state by itself: one product of all states would round differently for different numbers of states.
    return np.array([basis @ few for few in found]) - amplitudes


def _one(product: Array) -> Array:
    """A symmetric matrix (r, r) divided by its trace."""
    return product / (float(np.trace(product)) or 1.0)
