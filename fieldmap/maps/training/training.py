"""Training of a reduced model of saturating iron: from solved states to the model, its fields, and its errors.

1. States are solved until the model predicts new ones (`sequence`).
2. The model is tested at extremes, at random currents, and at currents that a search for the largest errors finds
   (`search`). It is trained on the states with too large errors.
3. The model is condensed to the modes and points that the field in the workspace needs (`condensation`). It is tested
   again at the states that this changes most.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fieldmap.constants import MU0
from fieldmap.currents import CurrentDomain
from fieldmap.errors import NotConverged
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel, same_lengths
from fieldmap.maps.forecast import ERRORS, expect_choices
from fieldmap.maps.training.condensation import Condensed, condensed
from fieldmap.maps.training.currents import extreme_signals, held_out, sequence
from fieldmap.maps.training.model_error import Errors
from fieldmap.maps.training.modes import output_fields, solved, solved_from
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.reduction import Reduction, model_of_map
from fieldmap.maps.training.room import require_room
from fieldmap.maps.training.search import (
    SEARCHED,
    ExtremesTried,
    allowed,
    search_condensed,
    search_worst,
    try_extremes,
)
from fieldmap.maps.training.sequence import Training, modes_at_first, most_modes_of
from fieldmap.maps.training.states import Snapshots, Solved, SolvedStates, Stored
from fieldmap.parallel import results_of
from fieldmap.progress import Forecast
from fieldmap.records import Record
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

# Allowed error of a state's field by the number of fields of the map, as a multiple of the accuracy: with the fields of
# the recipe, and if these are too few, with up to `_MOST_FIELDS`, or `_FIELDS_PER_SIGNAL` for each signal: iron that
# does not saturate needs one for each current already.
_FIELDS, _FIELDS_AT_MOST, _MOST_FIELDS, _FIELDS_PER_SIGNAL = 0.05, 0.3, 100, 2
# Fields with a smaller share of any state are rough. They make the interpolation error of the map larger than they make
# the error of the model smaller.
_ROUGH_FIELDS = 1e-4
_SEARCHED = "searched for"
# Of solves whose flux linkages are compared with the solver's; number of states at which inductances are, if the recipe
# does not ask for them.
_EXACT_LINKAGE, _INDUCTANCES = 1e-8, 4
# Most repetitions of the training with states of the search for the worst currents, and with states of the search of
# the condensed model.
_AGAIN, _AGAIN_CONDENSED = 8, 2
# Allowed change by condensation, as multiples of the accuracy: the next is tried if an error is too large.
_CONDENSED = (1.0, 0.5, 0.2)
# Number of extremes, and of other currents, at which the weights of the iron's fields are evaluated to find the largest
# ones, and the factor for larger weights in between. The weights are smooth and largest at the boundary of the domain,
# where many of these currents lie.
_WEIGHED, _MARGIN, _RANDOM_SEED = 128, 1.1, 11


@dataclass(frozen=True, eq=False, repr=False)
class Trained(Record):
    """The result of a training.

    Attributes
    ----------
    model : the reduced model.
    remanent : (c,), as `GalerkinModel` has it.
    charge : (k, s), surface charge density of the iron's fields on s faces, T.
    largest_weights : (c + k,), largest weights of the map's fields over the domain.
    about : what was done and found, as plain Python for the report of the map: what was solved and tried, errors at
        tested states by their kind, parts of the error, and the solver's report of one state.
    """

    model: ReducedModel
    remanent: Array
    charge: Array
    largest_weights: Array
    about: Mapping[str, Any]


def train(
    solver: NonlinearSolver,
    domain: CurrentDomain,
    plan: Plan,
    points: Array,
    reference: Array,
    states: SolvedStates,
    forecast: Forecast,
) -> Trained:
    """Train a reduced model.

    Parameters
    ----------
    solver
        Of the whole iron.
    domain
        Of the currents.
    plan
        Limits and accuracy.
    points
        (n, 3), in the air, m: errors of the field are measured there.
    reference
        (c,), currents at which the map states its total field, A.
    states
        Solves states and keeps them, so that a stopped run can go on.
    forecast
        Of the time.

    Raises
    ------
    NotConverged
        If less than half of the states, or no state to test the model, could be solved.
    InputError
        If the machine has no room for so many currents, before a state is solved.
    """
    require_room(solver, domain, plan, partial(modes_at_first, plan), states.free_disk)
    training = Training(solver, domain, plan, points, states, forecast)
    tries = Tries()
    while True:
        reduction = _trained_and_tried(training, tries)
        require_some(tries.found, states)
        found = _condensed_and_tried(training, reduction, tries)
        # The states that the search of the condensed model found are trained on only if all other states came out well.
        again = tries.none_short and tries.condensed < _AGAIN_CONDENSED
        short = _fall_short(training, reduction, [found.tried[_SEARCHED]]) if again else []
        if not short:
            break
        _train_on(training, reduction, short)
        tries.found[_SEARCHED] = found.tried[_SEARCHED]
        tries.condensed += 1
    modes, few = reduction.modes, found.few
    assert tries.extremes is not None
    amplitudes = modes.amplitudes @ few.basis
    at_reference = found.output @ few.model.solve(reference, amplitudes[0])[0]
    model = model_of_map(few.model, found.output, modes.currents, amplitudes, domain, at_reference)
    middle = solver.solve(domain.middle, plan.tolerance, training.known.nearest(domain.middle))
    trained = reduction.sampled
    about = {
        "states_trained_on": len(model.known_currents),
        "states_trained_on_solved": training.known.solved,
        "corners_trained_on": tries.extremes.trained_on,
        "extremes": asdict(tries.extremes),
        "error_parts": _error_parts(training, reduction, found),
        "states_tried": {name: asdict(errors) for name, errors in found.errors.items()},
        "rounds": [asdict(one) for one in training.rounds],
        "modes": len(model.constant),
        "sample_points": len(model.weights),
        "report": asdict(middle.report),
        "states_failed": {str(number): reason for number, reason in states.failed.items()},
        # changed: largest change of a state's field that was found, as a multiple of the accuracy.
        "condensed_from": {"modes": trained.modes, "points": len(trained.weights), "changed": few.changed},
    }
    random = found.tried["at random"]
    about["linkage_error"] = linkage_error(
        few.model, (modes.currents, amplitudes), solver, random, plan.inductance
    )
    largest = _largest_weights(domain, few.model, found.output, modes.currents)
    return Trained(model, few.model.remanent, found.charge, largest, about)


class Tries:
    """The tests of a model during its training.

    Attributes
    ----------
    found : tested states that it was not trained on, by their kind.
    extremes : what was done at the extremes of the domain.
    none_short : whether the errors at all tested states were small enough.
    searches : number of searches for the worst currents.
    condensed : number of trainings on states that the search of the condensed model found.
    """

    def __init__(self) -> None:
        self.found: dict[str, Snapshots] = {}
        self.extremes: ExtremesTried | None = None
        self.none_short = False
        self.searches = self.condensed = 0


def _trained_and_tried(training: Training, tries: Tries) -> Reduction:
    """Train until the errors at all tested states are small enough, or no more states may be solved."""
    tried, plan = tries.found, training.plan
    # more: errors at random states are too large; worst: number of the random state with the largest error.
    more, worst = not tried, -1
    while True:
        if more:
            training.go_on()
        require_states(training.states)
        # The choice of sample points is slow. It is not repeated before the modes represent the state that was worst.
        while (
            more
            and tried
            and not training.at_its_end
            and training.off_of_modes(training.modes(), tried["at random"], worst) > allowed(training)
        ):
            training.go_on()
        reduction, tried["at extremes"], extremes = try_extremes(training)
        sampled = reduction.sampled
        amounts = training.solver.unknowns, len(training.known.currents), sampled.modes, len(sampled.weights)
        expect_choices(training.forecast, training.seconds_of_state, *amounts)
        first, random = plan.states + extremes.looked_at, held_out(training.domain, plan.held_out)
        tried["at random"] = training.solve_tried(reduction.potential, random, first, "at random", "random")
        # A round of four states may be predicted well by chance. If the error at a random state is too large, the
        # sequence goes on. The model is never trained on the random states.
        off = reduction.off(tried["at random"])
        more, worst = bool(off.max(initial=0.0) > allowed(training)), int(off.argmax()) if len(off) else -1
        short: list[tuple[Array, Solved | Stored]] = []
        # The search finds errors that extremes and random states do not show.
        if not more:
            number = first + len(random) + tries.searches * SEARCHED
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


def _train_on(
    training: Training, reduction: Reduction, short: Sequence[tuple[Array, Solved | Stored]]
) -> None:
    """Add states to the training. If the model has the most modes already, raise their limit; if the modes represent
    one of these states too badly, take more."""
    if reduction.sampled.modes >= training.most_modes:
        training.more_modes()
    for currents, state in short:
        training.known.add(currents, state)
    if short:
        training.finer_modes([currents for currents, _ in short])


def _fall_short(
    training: Training, reduction: Reduction, tried: Sequence[Snapshots]
) -> list[tuple[Array, Solved | Stored]]:
    """States that the model must be trained on, with their currents; images are left out.

    If an error at any of the tested states is larger than allowed, these are all states with errors above the accuracy.
    Otherwise there are none.
    """
    off = [reduction.off(some) for some in tried]
    if max(of_some.max(initial=0.0) for of_some in off) <= allowed(training):
        return []
    found = []
    for some, of_some in zip(tried, off, strict=True):
        lacking = np.flatnonzero(of_some > training.plan.accuracy)
        found += [(some.currents[k], some.held(int(k))) for k in lacking if some.own[k]]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class CondensedAndTried(Record):
    """A condensed model after its tests.

    Attributes
    ----------
    few : the condensed model.
    output : (k, q), weights of the map's fields per amplitude of its modes.
    charge : (k, s), surface charge densities of these fields, T.
    changed : largest relative change of a state's field by condensation.
    tried : tested states by their kind.
    before : errors (s,) of the model before condensation at these states, by their kind.
    errors : errors at these states by their kind.
    """

    few: Condensed
    output: Array
    charge: Array
    changed: float
    tried: Mapping[str, Snapshots]
    before: Mapping[str, Array]
    errors: Mapping[str, Errors]


def _condensed_and_tried(training: Training, reduction: Reduction, tries: Tries) -> CondensedAndTried:
    """Condense a model, less and less, until the errors at the states that it changes most are small enough.

    It also ends if the errors of the model were too large before.
    """
    plan, forecast = training.plan, training.forecast
    forecast.at("modes", "fields of the modes")
    combination, of_modes = _fields_of_map(reduction, training.domain, plan)
    charge = combination @ reduction.charge
    # Sample points and condensation make errors at the training states as well.
    own = training.known.some(np.flatnonzero(training.known.own))
    tried, once = tries.found | {"trained on": own}, forecast.expected("modes")
    for number, share in enumerate(_CONDENSED):
        accuracy = share * plan.accuracy
        # Each attempt is expected to take as long as the first.
        whole = (number + 1) * once
        forecast.expect("modes", whole)
        forecast.at("modes", "modes and points that the workspace sees", number * once, whole)
        if reduction.in_vain:
            few = Condensed(reduction.sampled, np.eye(reduction.sampled.modes), 0.0)
        else:
            few = condense(reduction, training.domain, combination, of_modes, accuracy, plan.inductance)
        attempt = tries.condensed * len(_CONDENSED) + number
        found = search_condensed(training, reduction, few, attempt)
        tried[_SEARCHED] = found.with_earlier(tried.get(_SEARCHED, Snapshots(training.solver)))
        before = {name: reduction.off(some) for name, some in tried.items()}
        forecast.at("modes", "error on solved states", whole - ERRORS * training.seconds_of_state, whole)
        output = of_modes @ few.basis
        errors = {
            name: training.trial.errors(weights(few.model, output, some.currents), charge, some)
            for name, some in tried.items()
            if some.solved
        }
        largest = max(found.share for found in errors.values())
        # If the error of the trained model is too large by itself, less condensation does not help.
        of_trained = max(float(off.max(initial=0.0)) for off in before.values())
        if of_trained > allowed(training) or largest <= allowed(training):
            break
    return CondensedAndTried(few, output, charge, accuracy * few.changed, tried, before, errors)


def _fields_of_map(reduction: Reduction, domain: CurrentDomain, plan: Plan) -> tuple[Array, Array]:
    """The fields of the iron that the map keeps.

    Returns
    -------
    tuple[Array, Array]
        The fields as combinations (k, r) of the fields of the modes, and their weights (k, r) per amplitude
        of the modes.
    """
    # States that were not solved are included, because they can need fields that solved states do not.
    amplitudes = np.concatenate([reduction.modes.amplitudes, reduction.amplitudes(_places(domain))])
    rows = reduction.fields.rows
    found = output_fields(amplitudes, rows, plan.fields, _FIELDS * plan.accuracy)
    if len(found[1]) < plan.fields:
        return found
    # If the fields of the recipe leave a considerable error, the map gets more of them.
    leave = max(_FIELDS_AT_MOST * plan.accuracy, _ROUGH_FIELDS)
    more = output_fields(amplitudes, rows, _most_fields(domain), leave)
    return max(found, more, key=lambda both: len(both[1]))


def _most_fields(domain: CurrentDomain) -> int:
    return max(_MOST_FIELDS, _FIELDS_PER_SIGNAL * domain.parametrisation.signal_count)


def condense(
    reduction: Reduction,
    domain: CurrentDomain,
    combination: Array,
    output: Array,
    accuracy: float,
    inductance: bool = False,
) -> Condensed:
    """Condense a model, with errors measured in the fields of the map.

    Parameters
    ----------
    reduction
        The trained model.
    domain
        Of the currents.
    combination
        (k, r), the fields of the map as combinations of the fields of the modes.
    output
        (k, r), weights of these fields per amplitude of the modes.
    accuracy
        Largest relative change of a field.
    inductance
        Whether the errors of inductances count.
    """
    fields = reduction.fields.combined(combination)

    def off(currents: Array, amplitudes: Array, changes: Array) -> Array:
        return fields.changed(currents, amplitudes @ output.T, changes @ output.T)

    lengths = output.T @ same_lengths(fields.rows)
    known = reduction.modes.currents, reduction.modes.amplitudes
    return condensed(reduction.sampled, known, domain, lengths, off, accuracy, inductance)


def _error_parts(training: Training, reduction: Reduction, condensed: CondensedAndTried) -> dict[str, Any]:
    """Parts of the error of a map's model, as shares of B.

    states: error of the modes, with the law at all points, at the worst tested states; points, condensation: largest
    change of a field by them; taken: numbers of states, modes, points and fields; limits: those of the four that
    reached their limits; modes_leave: largest projection error of a training state onto the modes, in the energy norm;
    in_vain: whether that is too large for any choice of points, so that only few choices were tried.
    """
    of_states, of_points = 0.0, reduction.points.changed
    for name, some in condensed.tried.items():
        if some.solved:
            off = condensed.before[name]
            number = int(off.argmax())
            own = training.off_of_modes(reduction.modes, some, number)
            # The model with the law at all points has a smaller error. The difference is due to the points.
            of_states, of_points = max(of_states, own), max(of_points, float(off[number]) - own)
    modes, fields = reduction.sampled.modes, len(condensed.output)
    # Number of each, and whether it reached its limit.
    parts = {
        "states": (training.taken, training.at_its_end),
        "modes": (modes, modes >= max(training.most_modes, most_modes_of(training.domain))),
        "points": (len(reduction.sampled.weights), not (reduction.points.enough or reduction.in_vain)),
        "fields": (fields, fields >= _most_fields(training.domain)),
    }
    return {
        "states": of_states,
        "points": of_points,
        "condensation": condensed.changed,
        "taken": {name: taken for name, (taken, _) in parts.items()},
        "limits": tuple(name for name, (_, at_limit) in parts.items() if at_limit),
        "modes_leave": reduction.modes.left,
        "in_vain": reduction.in_vain,
    }


def linkage_error(
    model: GalerkinModel,
    known: tuple[Array, Array],
    solver: NonlinearSolver,
    tried: Snapshots,
    inductance: bool = False,
) -> dict[str, float]:
    """Errors of a model's flux linkages and inductances at solved states.

    Parameters
    ----------
    model
        The model.
    known
        Currents (s, c) and amplitudes (s, r) of states from which its solves begin.
    solver
        Of the whole iron.
    tried
        The states.
    inductance
        Whether inductances are compared at all states, or at the first four.

    Returns
    -------
    dict[str, float]
        share: largest error of a linkage that the iron adds, relative to the largest of the state, at `states` states;
        inductance_share: the same of inductances, at the first `inductance_states` of them.
    """
    states = list(zip(tried.currents, solved_from(model, known, tried.currents, _EXACT_LINKAGE), strict=True))
    potentials, (one, other) = tried.potentials, np.triu_indices(len(tried.currents[0]))

    def of_linkage(k: int) -> float:
        currents, amplitude = states[k]
        ours = (model.sums(model.moments(currents, amplitude))[model.modes :] + model.remanent) / MU0
        return _off(ours, solver.iron_linkage(currents, potentials[:, k]))

    def of_inductance(k: int) -> float:
        currents, amplitude = states[k]
        ours = model.inductance(currents, amplitude, model.factor_and_slopes(currents, amplitude)[1]) / MU0
        return _off(ours, solver.iron_inductance(currents, potentials[:, k])[one, other])

    numbers = range(len(states))
    compared = numbers if inductance else numbers[:_INDUCTANCES]
    return {
        "share": max(results_of(of_linkage, numbers)),
        "states": len(numbers),
        "inductance_share": max(results_of(of_inductance, compared)),
        "inductance_states": len(compared),
    }


def _off(ours: Array, theirs: Array) -> float:
    """Largest difference relative to the largest number."""
    return float(np.abs(ours - theirs).max() / (np.abs(theirs).max() or 1.0))


def _largest_weights(domain: CurrentDomain, model: GalerkinModel, output: Array, known: Array) -> Array:
    """Largest currents (c,) of the domain, which are exact, and largest weights (k,) of the fields of the iron.

    The weights are evaluated at known currents (s, c) and over the domain; a margin covers the currents in between.
    """
    places = np.concatenate([known, _places(domain)])
    return np.concatenate([domain.largest, _MARGIN * np.abs(weights(model, output, places)).max(axis=0)])


def _places(domain: CurrentDomain) -> Array:
    """Currents (s, c) over the domain: at most `_WEIGHED` extremes, chosen at random, and `_WEIGHED` that fill it."""
    extremes = np.random.default_rng(_RANDOM_SEED).permutation(extreme_signals(domain))[:_WEIGHED]
    return domain.parametrisation.currents(np.concatenate([extremes, sequence(domain, _WEIGHED)]))


def weights(model: GalerkinModel, output: Array, currents: Array) -> Array:
    """Weights (s, k) of the iron's fields at currents (s, c)."""
    found = solved(model, currents, np.zeros((len(currents), output.shape[1])))
    # Each state by itself: one product of all states would round differently for different numbers of states.
    return np.array([output @ amplitude for amplitude in found])


def require_states(states: SolvedStates) -> None:
    """Raise NotConverged unless at least half of the states were solved."""
    if not states.count or len(states.failed) > states.count:
        first = next(iter(states.failed.values()))
        received = f"{len(states.failed)} of {states.count + len(states.failed)} failed; the first: {first}"
        remedy = "make the range of the currents smaller, or refine the mesh"
        raise _not_trained("at least half of the states must be solved", received, remedy)


def require_some(tried: Mapping[str, Snapshots], states: SolvedStates) -> None:
    """Raise NotConverged if no state to test the model was solved: a map must state its error."""
    if not any(found.solved for found in tried.values()):
        received = f"none; the last to fail: {list(states.failed.values())[-1]}"
        remedy = "raise held_out, make the range of the currents smaller, or refine the mesh"
        raise _not_trained("a state that the model is tried on must be solved", received, remedy)


def _not_trained(must_hold: str, received: str, remedy: str) -> NotConverged:
    return NotConverged.of("training of the current dependence", must_hold, received, remedy)
