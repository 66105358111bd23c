"""From solved states of saturating iron to a reduced model, its fields' charges, and its errors on other states."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.errors import NotConverged, Problem
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.galerkin import GalerkinModel
from fieldmap.maps.reduction.basis import output_fields
from fieldmap.maps.reduction.cubature import empirical_cubature
from fieldmap.maps.reduction.domain import corners, held_out, sequence
from fieldmap.maps.reduction.greedy import SolvedModes
from fieldmap.maps.reduction.plan import Plan
from fieldmap.maps.reduction.snapshots import Snapshots
from fieldmap.maps.reduction.solving import Round, Solving, add_missing, solve_training, solve_tried
from fieldmap.maps.reduction.states import SolvedStates
from fieldmap.maps.reduction.trial import Errors, Trial
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.typing import Array

Say = Callable[[str, float], None]
# At how many currents of the domain the weights of the iron's fields are looked at, and how much larger they may be in
# between. They are smooth and largest at the rim, where the sequence is densest and the corners are.
_WEIGHED, _MARGIN = 128, 1.1


@dataclass(frozen=True, eq=False)
class Trained:
    """A reduced model; charge (k, s): density of its iron fields on the solver's surface faces, T; what it was
    trained on, how many of these are corners of the domain, and how the others were chosen; its errors on states
    that it was not trained on, by their kind; and the largest weights (c + k,) of the map's fields over the domain."""

    model: ReducedModel
    charge: Array
    snapshots: Snapshots
    corners: int
    rounds: tuple[Round, ...]
    errors: Mapping[str, Errors]
    largest_weights: Array


def train(
    solver: NonlinearSolver,
    domain: CurrentDomain,
    plan: Plan,
    points: Array,
    reference: Array,
    states: SolvedStates,
    say: Say,
) -> Trained:
    """Solve, reduce and try. points (n, 3): where the field matters, in the air; reference (c,): the currents at which
    the map states its total field; states: keeps what was solved, so that a stopped run goes on. Raises NotConverged
    if no state at all could be solved."""
    trial = Trial(solver, points)
    solving = Solving(solver, states, trial, plan, say)
    snapshots, rounds = solve_training(solving, domain)
    require_states(states)
    modes = SolvedModes(solver, snapshots, plan.modes)
    tried = _tried(solving, modes, domain)
    before = snapshots.solved
    tried["in corners"] = add_missing(modes, snapshots, tried["in corners"], plan.accuracy)
    if snapshots.solved > before:
        modes = SolvedModes(solver, snapshots, plan.modes)
    full, currents, amplitudes = modes.model, modes.currents, modes.amplitudes
    parts = _contributions(full, currents, amplitudes, say)
    chosen, factors = empirical_cubature(parts, plan.points)
    reduced = full.sampled(chosen, factors * full.weights[chosen])
    say("fields of the modes", 0.95)
    probes = _probes(*solver.surface.field_and_gradient(points, full.charge))
    combination, output = output_fields(amplitudes, probes, plan.fields)
    model = _model(reduced, output, currents, amplitudes, domain, reference)
    say("error on states not trained on", 0.98)
    charge = combination @ full.charge
    errors = {
        name: trial.errors(_weights(reduced, output, found.currents), charge, found)
        for name, found in tried.items()
        if found.solved
    }
    largest = _largest_weights(domain, reduced, output, np.concatenate([currents, corners(domain)]))
    return Trained(model, charge, snapshots, snapshots.solved - before, rounds, errors, largest)


def _tried(solving: Solving, modes: SolvedModes, domain: CurrentDomain) -> dict[str, Snapshots]:
    """States that the model is tried on, by their kind."""
    plan, states = solving.plan, solving.states
    at_random, in_corners = held_out(domain, plan.held_out), corners(domain)
    tried = {
        "at random": solve_tried(solving, modes, at_random, plan.states, "at random", 0.5),
        "in corners": solve_tried(
            solving, modes, in_corners, plan.states + len(at_random), "in corners", 0.7
        ),
    }
    require_states(states)
    require_some(tried, states)
    return tried


def _probes(flux: Array, gradient: Array) -> Array:
    """Fields (k, n, 3) and gradients (k, n, 3, 3) of the modes as one row each, both of the same size."""
    length = np.abs(flux).max() / np.abs(gradient).max()
    return np.concatenate([flux.reshape(len(flux), -1), length * gradient.reshape(len(flux), -1)], axis=1)


def _largest_weights(domain: CurrentDomain, reduced: GalerkinModel, output: Array, currents: Array) -> Array:
    """Largest currents (c,) of the domain, exactly, and largest weights (k,) of the iron's fields: those found at the
    currents (s, c) and at a sequence that fills the domain, and a margin for the places between."""
    places = np.concatenate([currents, sequence(domain, 0, _WEIGHED)])
    iron = np.abs(_weights(reduced, output, places)).max(axis=0)
    return np.concatenate([domain.largest, _MARGIN * iron])


def _contributions(full: GalerkinModel, currents: Array, amplitudes: Array, say: Say) -> Iterator[Array]:
    """What the points add to the residual of every state (p, r), one state after the other."""
    for number, (values, amplitude) in enumerate(zip(currents, amplitudes, strict=True)):
        say(
            f"sample points, from state {number + 1} of {len(currents)}", 0.88 + 0.05 * number / len(currents)
        )
        yield full.energy_contributions(values, amplitude)
    say("sample points, their choice", 0.93)


def _weights(reduced: GalerkinModel, output: Array, currents: Array) -> Array:
    """Weights (s, k) of the iron's fields at currents (s, c)."""
    start = np.zeros(output.shape[1])
    return np.array([output @ reduced.solve(values, start)[0] for values in currents])


def require_states(states: SolvedStates) -> None:
    """Raise NotConverged unless at least half of the states were solved."""
    if not states.count or len(states.failed) > states.count:
        raise NotConverged(
            Problem(
                "training of the current dependence",
                "at least half of the states must be solved",
                f"{len(states.failed)} of {states.count + len(states.failed)} failed; the first: "
                f"{next(iter(states.failed.values()))}",
                "make the range of the currents smaller, or refine the mesh",
            )
        )


def require_some(tried: Mapping[str, Snapshots], states: SolvedStates) -> None:
    """Raise NotConverged unless a state was solved that the model can be tried on: a map states its error."""
    if not any(found.solved for found in tried.values()):
        raise NotConverged(
            Problem(
                "training of the current dependence",
                "a state that the model is tried on must be solved",
                f"none; the last to fail: {list(states.failed.values())[-1]}",
                "raise held_out, make the range of the currents smaller, or refine the mesh",
            )
        )


def _model(
    reduced: GalerkinModel,
    output: Array,
    currents: Array,
    amplitudes: Array,
    domain: CurrentDomain,
    reference: Array,
) -> ReducedModel:
    amplitude, _ = reduced.solve(reference, amplitudes[0])
    offset, knots, coefficients = reduced.tables.arrays
    return ReducedModel(
        reduced.gradients,
        reduced.source,
        reduced.weights,
        reduced.law,
        offset,
        knots,
        coefficients,
        reduced.air,
        reduced.constant,
        output,
        currents,
        amplitudes,
        domain.lower,
        domain.upper,
        domain.parametrisation,
        output @ amplitude,
    )
