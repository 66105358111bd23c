"""From solved states of saturating iron to a reduced model, its fields' charges, and its errors on other states.

The story in short: states are solved until the model predicts new ones (`sequence`); extremes, states at random and
those of a search for the worst are tried (`search`), and what falls short is trained on; the model is condensed to what
the workspace sees (`condensation`), and what that changes most is tried again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.errors import NotConverged
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel, same_lengths
from fieldmap.maps.forecast import Forecast, expect_modes
from fieldmap.maps.training.condensation import Condensed, condensed
from fieldmap.maps.training.currents import STARTS, extreme_signals, held_out, sequence
from fieldmap.maps.training.model_error import Errors
from fieldmap.maps.training.modes import output_fields, solved
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.reduction import Reduction
from fieldmap.maps.training.search import (
    ExtremesTried,
    allowed,
    search_condensed,
    search_worst,
    try_extremes,
)
from fieldmap.maps.training.sequence import MOST_MODES, Round, Training
from fieldmap.maps.training.states import Snapshots, Solved, SolvedStates
from fieldmap.records import Record
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

# What the fields of the map may leave of a state's field, over the accuracy; where the recipe names fewer than that
# takes; and as many as there may be.
_FIELDS, _FIELDS_AT_MOST, _MOST_FIELDS = 0.05, 0.3, 100
# Fields that make less of any state are rough, and worse for the nodes of the map than for its error.
_ROUGH_FIELDS = 1e-4
_SEARCHED = "searched for"
# How often at most a model is made anew of states of the search for the worst currents that fell short, and how often
# of those of the search of the condensed model.
_AGAIN, _AGAIN_CONDENSED = 8, 2
# What fewer modes and points may change, over what they may at first: less where a solved state falls short by it.
_CONDENSED = (1.0, 0.5, 0.2)
# At how many extremes of the domain, and other currents, the weights of the iron's fields are looked at, and
# how much larger they may be in between. They are smooth and largest at the rim, where both are.
_WEIGHED, _MARGIN, _RANDOM_SEED = 128, 1.1, 11


@dataclass(frozen=True)
class Condensation(Record):
    """Modes and sample points that were trained, and what fewer of them change of the field of any state, at most,
    over the accuracy: the largest found."""

    modes: int
    points: int
    changed: float


@dataclass(frozen=True, repr=False)
class ErrorParts(Record):
    """What the error of a map's model is made of, as shares of B: states, what solved states and their modes leave of
    the worst states tried, with the law at all points; points, the largest change by sample points, and condensation
    that by fewer modes and points.

    taken: how many states, modes, points and fields were trained; limits: of which of them there could not be more.
    modes_leave: of the energy's root of a solved state; in_vain: whether that is too much for any choice of points, so
    that few were tried.
    """

    states: float
    points: float
    condensation: float
    taken: Mapping[str, int]
    limits: tuple[str, ...]
    modes_leave: float
    in_vain: bool


@dataclass(frozen=True, eq=False, repr=False)
class Trained(Record):
    """A reduced model; charge (k, s): density of its iron fields on the solver's surface faces, T; what it was
    trained on, what was done about the extremes of the domain, and how the other states were chosen; what it was
    condensed from; its errors at solved states, by their kind; the largest weights (c + k,) of the
    map's fields over the domain; and what its error is made of."""

    model: ReducedModel
    charge: Array
    snapshots: Snapshots
    extremes: ExtremesTried
    rounds: tuple[Round, ...]
    condensation: Condensation
    errors: Mapping[str, Errors]
    largest_weights: Array
    parts: ErrorParts


def train(
    solver: NonlinearSolver,
    domain: CurrentDomain,
    plan: Plan,
    points: Array,
    reference: Array,
    states: SolvedStates,
    forecast: Forecast,
) -> Trained:
    """Solve, reduce and try. points (n, 3): where the field matters, in the air; reference (c,): the currents at which
    the map states its total field; states: keeps what was solved, so that a stopped run goes on. Raises NotConverged
    if no state at all could be solved."""
    training = Training(solver, domain, plan, points, states, forecast)
    tries = Tries()
    while True:
        reduction = _trained_and_tried(training, tries)
        require_some(tries.found, states)
        found = _condensed_and_tried(training, reduction, tries)
        # Where states at random fall short, or too many others do, more of these do not help.
        again = tries.none_short and tries.condensed < _AGAIN_CONDENSED
        short = _fall_short(training, reduction, [found.tried[_SEARCHED]]) if again else []
        if not short:
            break
        _train_on(training, reduction, short)
        tries.found[_SEARCHED] = found.tried[_SEARCHED]
        tries.condensed += 1
    modes, few = reduction.modes, found.few
    assert tries.extremes is not None
    return Trained(
        _model(few.model, found.output, modes.currents, modes.amplitudes @ few.basis, domain, reference),
        found.charge,
        training.known,
        tries.extremes,
        tuple(training.rounds),
        Condensation(reduction.sampled.modes, len(reduction.sampled.weights), few.changed),
        found.errors,
        _largest_weights(domain, few.model, found.output, modes.currents),
        _error_parts(training, reduction, found),
    )


class Tries:
    """What a model was tried on while it was trained.

    found: states that it was not trained on, by their kind; extremes: what was done about the extremes; none_short:
    whether all of them came out as they must; searches: how often the worst currents were searched for, and condensed:
    how often states that the search of the condensed model found were trained on.
    """

    def __init__(self) -> None:
        self.found: dict[str, Snapshots] = {}
        self.extremes: ExtremesTried | None = None
        self.none_short = False
        self.searches = self.condensed = 0


def _trained_and_tried(training: Training, tries: Tries) -> Reduction:
    """Train until no state that is tried falls short, or no more may be solved."""
    tried, plan = tries.found, training.plan
    # States at random fall short, which worst.
    more, worst = not tried, -1
    while True:
        if more:
            training.go_on()
        require_states(training.states)
        # Sample points are dear: they are not chosen again before the modes hold the state that was worst.
        while (
            more
            and tried
            and not training.at_its_end
            and training.off_of_modes(training.modes(), tried["at random"], worst) > allowed(training)
        ):
            training.go_on()
        reduction, tried["at extremes"], extremes = try_extremes(training)
        expect_modes(training.forecast, len(reduction.sampled.weights), reduction.sampled.modes)
        first, random = plan.states + extremes.looked_at, held_out(training.domain, plan.held_out)
        tried["at random"] = training.solve_tried(reduction.potential, random, first, "at random", "random")
        # Four states that happen to be predicted well do not tell that all are: where one of those at random is not,
        # the sequence goes on. They are never trained on.
        off = reduction.off(tried["at random"])
        more, worst = bool(off.max(initial=0.0) > allowed(training)), int(off.argmax()) if len(off) else -1
        short: list[tuple[Array, Solved]] = []
        # The search is for errors of which neither tells.
        if not more:
            number = first + len(random) + tries.searches * STARTS
            before = tried.get(_SEARCHED, Snapshots(training.solver))
            tried[_SEARCHED], looked_at = search_worst(training, reduction, number, before)
            extremes = replace(extremes, searched=looked_at)
            short = _fall_short(training, reduction, [tried["at extremes"], tried[_SEARCHED]])
            tries.searches += 1
        tries.extremes = extremes if tries.extremes is None else tries.extremes.and_again(extremes)
        tries.none_short = not (more or short)
        at_the_end = reduction.in_vain or (more and training.at_its_end) or tries.searches >= _AGAIN
        if tries.none_short or at_the_end:
            return reduction
        _train_on(training, reduction, short)


def _train_on(training: Training, reduction: Reduction, short: Sequence[tuple[Array, Solved]]) -> None:
    """Train on states that a model lacked, on more modes if it has as many as there may be."""
    if reduction.sampled.modes >= training.most_modes:
        training.more_modes()
    for currents, state in short:
        training.known.add(currents, state)


def _fall_short(
    training: Training, reduction: Reduction, tried: Sequence[Snapshots]
) -> list[tuple[Array, Solved]]:
    """Solved states, images left out, that a model is to be trained on, with their currents: if any is off by more than
    is allowed, all that are off by more than the accuracy."""
    off = [reduction.off(some) for some in tried]
    if max(of_some.max(initial=0.0) for of_some in off) <= allowed(training):
        return []
    found = []
    for some, of_some in zip(tried, off, strict=True):
        lacking = np.flatnonzero(of_some > training.plan.accuracy)
        found += [(some.currents[k], some.state(int(k))) for k in lacking if some.own[k]]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class CondensedAndTried(Record):
    """A condensed model; output (k, q): the map's fields by its modes; charge (k, s): densities of these fields on the
    surface faces; changed: what condensation changes of a state's field at most, as a share; all states that were
    tried, by their kind, and the errors there."""

    few: Condensed
    output: Array
    charge: Array
    changed: float
    tried: Mapping[str, Snapshots]
    errors: Mapping[str, Errors]


def _condensed_and_tried(training: Training, reduction: Reduction, tries: Tries) -> CondensedAndTried:
    """Condense a model until the states that it changes most come out as they must, or the fault is the model's own."""
    plan, forecast = training.plan, training.forecast
    forecast.at("modes", "fields of the modes")
    combination, of_modes = _fields_of_map(reduction, training.domain, plan)
    charge = combination @ reduction.charge
    forecast.at("modes", "modes and points that the workspace sees")
    # What is trained on may be off as well, by points and by what is condensed.
    own = training.known.some(np.flatnonzero(training.known.own))
    tried = tries.found | {"trained on": own}
    for number, share in enumerate(_CONDENSED):
        accuracy = share * plan.accuracy
        if reduction.in_vain:
            few = Condensed(reduction.sampled, np.eye(reduction.sampled.modes), 0.0)
        else:
            few = condense(reduction, training.domain, combination, of_modes, accuracy)
        attempt = tries.condensed * len(_CONDENSED) + number
        found = search_condensed(training, reduction, few, attempt)
        tried[_SEARCHED] = found.with_earlier(tried.get(_SEARCHED, Snapshots(training.solver)))
        of_trained = max(float(reduction.off(some).max(initial=0.0)) for some in tried.values())
        forecast.at("modes", "error on solved states", 0.95)
        output = of_modes @ few.basis
        errors = {
            name: training.trial.errors(weights(few.model, output, some.currents), charge, some)
            for name, some in tried.items()
            if some.solved
        }
        largest = max(found.share for found in errors.values())
        # Where the trained model is off by more itself, no other choice helps.
        if of_trained > allowed(training) or largest <= allowed(training):
            break
    return CondensedAndTried(few, output, charge, accuracy * few.changed, tried, errors)


def _fields_of_map(reduction: Reduction, domain: CurrentDomain, plan: Plan) -> tuple[Array, Array]:
    """The iron's fields that the map keeps, as combinations (k, r) of those of the modes, and their weights by those
    of the modes (k, r)."""
    # States that are not solved need fields that those solved do not.
    amplitudes = np.concatenate([reduction.modes.amplitudes, reduction.amplitudes(_places(domain))])
    rows = reduction.fields.rows
    found = output_fields(amplitudes, rows, plan.fields, _FIELDS * plan.accuracy)
    if len(found[1]) < plan.fields:
        return found
    # More than the recipe names where these leave a part of the error that counts.
    leave = max(_FIELDS_AT_MOST * plan.accuracy, _ROUGH_FIELDS)
    more = output_fields(amplitudes, rows, _MOST_FIELDS, leave)
    return max(found, more, key=lambda both: len(both[1]))


def condense(
    reduction: Reduction, domain: CurrentDomain, combination: Array, output: Array, accuracy: float
) -> Condensed:
    """The model at the sample points on fewer modes and points, as the fields of the map (k, r) see it, which are
    combinations (k, r) of those of the modes."""
    fields = reduction.fields.combined(combination)

    def off(currents: Array, amplitudes: Array, changes: Array) -> Array:
        return fields.changed(currents, amplitudes @ output.T, changes @ output.T)

    lengths = output.T @ same_lengths(fields.rows)
    known = reduction.modes.currents, reduction.modes.amplitudes
    return condensed(reduction.sampled, known, domain, lengths, off, accuracy)


def _error_parts(training: Training, reduction: Reduction, condensed: CondensedAndTried) -> ErrorParts:
    of_states, of_points = 0.0, reduction.points.changed
    for some in condensed.tried.values():
        if some.solved:
            off = reduction.off(some)
            number = int(off.argmax())
            own = training.off_of_modes(reduction.modes, some, number)
            # What the law at all points would not leave of the worst state is due to the points.
            of_states, of_points = max(of_states, own), max(of_points, float(off[number]) - own)
    modes, fields = reduction.sampled.modes, len(condensed.output)
    # How many were trained, and whether there could not be more.
    parts = {
        "states": (training.taken, training.at_its_end),
        "modes": (modes, modes >= max(training.most_modes, MOST_MODES)),
        "points": (len(reduction.sampled.weights), not (reduction.points.enough or reduction.in_vain)),
        "fields": (fields, fields >= _MOST_FIELDS),
    }
    return ErrorParts(
        of_states,
        of_points,
        condensed.changed,
        {name: taken for name, (taken, _) in parts.items()},
        tuple(name for name, (_, at_limit) in parts.items() if at_limit),
        reduction.modes.left,
        reduction.in_vain,
    )


def _largest_weights(domain: CurrentDomain, model: GalerkinModel, output: Array, known: Array) -> Array:
    """Largest currents (c,) of the domain, exactly, and largest weights (k,) of the iron's fields: those found at
    known currents (s, c) and all over it, and a margin for the places between."""
    places = np.concatenate([known, _places(domain)])
    return np.concatenate([domain.largest, _MARGIN * np.abs(weights(model, output, places)).max(axis=0)])


def _places(domain: CurrentDomain) -> Array:
    """Currents (s, c): extremes of the domain, in a random order and not all of many, and as many that fill it."""
    extremes = np.random.default_rng(_RANDOM_SEED).permutation(extreme_signals(domain))[:_WEIGHED]
    return domain.parametrisation.currents(np.concatenate([extremes, sequence(domain, _WEIGHED)]))


def weights(model: GalerkinModel, output: Array, currents: Array) -> Array:
    """Weights (s, k) of the iron's fields at currents (s, c)."""
    found = solved(model, currents, np.zeros((len(currents), output.shape[1])))
    # One by one: a product of all at once rounds otherwise.
    return np.array([output @ amplitude for amplitude in found])


def require_states(states: SolvedStates) -> None:
    """Raise NotConverged unless at least half of the states were solved."""
    if not states.count or len(states.failed) > states.count:
        first = next(iter(states.failed.values()))
        received = f"{len(states.failed)} of {states.count + len(states.failed)} failed; the first: {first}"
        remedy = "make the range of the currents smaller, or refine the mesh"
        raise _not_trained("at least half of the states must be solved", received, remedy)


def require_some(tried: Mapping[str, Snapshots], states: SolvedStates) -> None:
    """Raise NotConverged unless a state was solved that the model can be tried on: a map states its error."""
    if not any(found.solved for found in tried.values()):
        received = f"none; the last to fail: {list(states.failed.values())[-1]}"
        remedy = "raise held_out, make the range of the currents smaller, or refine the mesh"
        raise _not_trained("a state that the model is tried on must be solved", received, remedy)


def _not_trained(must_hold: str, received: str, remedy: str) -> NotConverged:
    return NotConverged.of("training of the current dependence", must_hold, received, remedy)


def _model(
    model: GalerkinModel,
    output: Array,
    currents: Array,
    amplitudes: Array,
    domain: CurrentDomain,
    reference: Array,
) -> ReducedModel:
    offset, knots, coefficients = model.tables.arrays
    return ReducedModel(
        gradients=model.gradients,
        source=model.source,
        weights=model.weights,
        law=model.law,
        law_offset=offset,
        law_knots=knots,
        law_coefficients=coefficients,
        air=model.air,
        constant=model.constant,
        output=output,
        known_currents=currents,
        known_amplitudes=amplitudes,
        lower=domain.lower,
        upper=domain.upper,
        parametrisation=domain.parametrisation,
        reference_weights=output @ model.solve(reference, amplitudes[0])[0],
        fixed=np.zeros(0) if model.fixed is None else model.fixed,
    )
