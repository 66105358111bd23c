"""A trained model on fewer modes and points: those on which the field in the workspace depends.

Trained modes hold the solved states in the whole iron, and what new currents cost grows with points times modes, where
the tangent is summed with points times their square. The workspace sees less of the iron. Once trained, a state costs a
millisecond, so that hundreds are asked for, and with the tangent K of each the adjoint states K^-1 f for the fields f
of the map. What a basis leaves of a field is, to first order, the energy product of what it leaves of the state and of
the adjoint state (R. Becker and R. Rannacher, An optimal control approach to a posteriori error estimation, Acta
Numerica 10 (2001) 1, section 2): so it holds both, as proper modes of the two together. States that come out worse than
others count more in the next choice. The points are then chosen anew among those of the trained model, by what they add
to the fields of all these states.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import cho_solve, eigh

from fieldmap.currents import CurrentDomain
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.cubature import nonnegative_path
from fieldmap.maps.training.currents import drawn, extreme_signals, sequence
from fieldmap.maps.training.model_error import Off
from fieldmap.maps.training.modes import solved, solved_from
from fieldmap.parallel import results_of
from fieldmap.records import Record
from fieldmap.typing import Array

# States to choose by, and others to try the choice on, each with half of the extremes of the domain, so many at most.
# Where signals do not reach all currents, as many states beside the domain are chosen by: coils do not follow their
# signals at once. Each current of these is off by up to this share of the largest.
_STATES, _TRIED, _EXTREMES, _BESIDE, _SEED = 400, 200, 64, 0.05, 20262
# Modes come in whole vector registers.
_STEP = 8
# What fewer modes, and in the end fewer points too, may change of any state's field, over the accuracy. Where modes
# leave nearly all of it, half as many points again are needed, and eight modes more cost less.
_OF_MODES, _IN_ALL = 0.9, 1.1
# How much adjoint states count beside states, each with its own energies added up, and how often the states that come
# out worse are given more weight.
_ADJOINT, _ROUNDS = 0.07, 3
# How much the energy of the error counts for the points, beside its field: a tenth of what it does in the training, for
# there are many more states.
_ENERGY = 0.03
# What the points may change of a state's field, root mean square, over the accuracy: from coarse to fine, until it is
# fine enough.
_COARSE, _FINER, _FINEST = 0.5, 0.95, 0.02
# What the volume may be off where all that the points may change is spent on it.
_VOLUME = 1e-2
# States are solved to this share, and those of fewer modes only looked at.
_EXACT, _ROUGH = 1e-7, 1e-5

Few: TypeAlias = tuple[GalerkinModel, Array]


@dataclass(frozen=True, eq=False, repr=False)
class Condensed(Record):
    """A model whose modes are combinations of others': basis (r, q); changed: the largest change of the field at states
    that it was not made by, over the accuracy."""

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
) -> Condensed:
    """The model on fewer modes and points, or itself where fewer do not do.

    known: currents (s, c) and amplitudes (s, r) of states, from which others are solved. fields (r, k): numbers of the
    modes whose lengths tell how large a field is; off(currents (s, c), amplitudes (s, r), changes (s, r)): what changes
    of the amplitudes change of the fields there, as a share.
    """

    by, tried = _currents(domain)
    of_by, others = (solved_from(trained, known, currents, _EXACT) for currents in (by, tried))
    states = _States(trained, by, of_by, fields)

    def changed(model: GalerkinModel, basis: Array) -> float:
        changes = _changes(model, basis, tried, others, _EXACT)
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
    """The fewest modes, in whole steps, that are enough; None where all are needed."""
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
    """States of a model by which it is condensed: currents (s, c), amplitudes (s, r)."""

    def __init__(self, model: GalerkinModel, currents: Array, amplitudes: Array, fields: Array) -> None:
        self._model, self._currents, self._amplitudes, self._fields = model, currents, amplitudes, fields
        size = np.linalg.norm(amplitudes @ fields, axis=1)
        # A state without a field has no share of it.
        self._size = np.maximum(size, 1e-3 * size.max()) if size.any() else np.ones(len(size))

        def adjoint(k: int) -> Array:
            factor = model.tangent_factor(currents[k], amplitudes[k])
            return np.asarray(cho_solve((factor, True), fields)) / self._size[k]

        self._adjoint = np.array(list(results_of(adjoint, range(len(currents)))))

    def combined(self, count: int, off: Off) -> Few:
        """The model on `count` combinations of its modes, and these (r, count)."""
        # From equal weights, so that what is found does not depend on the counts of modes that were tried before.
        weights = np.ones(len(self._currents))
        for _ in range(_ROUNDS):
            model, basis = self._combined(count, weights)
            changes = _changes(model, basis, self._currents, self._amplitudes, _ROUGH)
            error = off(self._currents, self._amplitudes, changes)
            weights *= 0.5 + error / (error.mean() or 1.0)
            weights /= weights.mean()
        return self._combined(count, weights)

    def _combined(self, count: int, weights: Array) -> Few:
        root = np.sqrt(weights)
        rows = self._amplitudes * (root / self._size)[:, None]
        adjoint = np.concatenate(self._adjoint * root[:, None, None], axis=1)
        product = _one(rows.T @ rows) + _ADJOINT**2 * _one(adjoint @ adjoint.T)
        last = len(product)
        basis = np.ascontiguousarray(eigh(product, subset_by_index=(last - count, last - 1))[1][:, ::-1])
        return self._model.combined(basis), basis

    def conditions(self, model: GalerkinModel, basis: Array, accuracy: float) -> tuple[Array, Array, float]:
        """Normal equations of the points' weights, as factors on those that they have: products (p, p) and right-hand
        side (p,), and the length of what is wanted; in shares of the accuracy, for all states."""
        fields, volume = basis.T @ self._fields, model.weights / model.weights.sum()

        def of(k: int) -> Array:
            currents = self._currents[k]
            amplitude = model.solve(currents, basis.T @ self._amplitudes[k], _ROUGH)[0]
            combine = model.error_coordinates(currents, amplitude, fields, _ENERGY) / accuracy
            return np.ascontiguousarray(model.contributions(model.moments(currents, amplitude), combine).T)

        products, wanted, square = np.zeros((len(volume), len(volume))), np.zeros(len(volume)), 0.0
        for conditions in results_of(of, range(len(self._currents))):
            whole = conditions.sum(axis=1)
            products += conditions.T @ conditions
            wanted += whole @ conditions
            square += float(whole @ whole)
        weight = _COARSE**2 * len(self._currents) / _VOLUME**2
        products += weight * np.outer(volume, volume)
        return products, wanted + weight * volume, float(np.sqrt(square + weight))


def _currents(domain: CurrentDomain) -> tuple[Array, Array]:
    """Currents (s, c) of the states to choose by, and of those to try the choice on."""
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


def _changes(model: GalerkinModel, basis: Array, currents: Array, amplitudes: Array, exact: float) -> Array:
    """Of the amplitudes (s, r) at currents (s, c), where the model on a basis (r, q) gives them."""
    starts = [basis.T @ amplitude for amplitude in amplitudes]
    found = solved(model, currents, np.array(starts), exact)
    # One by one: a product of all at once rounds otherwise.
    return np.array([basis @ few for few in found]) - amplitudes


def _one(product: Array) -> Array:
    """A symmetric product (r, r) with the trace 1."""
    return product / (float(np.trace(product)) or 1.0)
