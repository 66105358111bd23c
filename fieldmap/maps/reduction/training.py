"""From solved states of saturating iron to a reduced model, its fields' charges, and its error on held-out states."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron import NonlinearSolver
from fieldmap.iron.galerkin import GalerkinModel
from fieldmap.maps.reduction.basis import output_fields, proper_modes
from fieldmap.maps.reduction.cubature import empirical_cubature
from fieldmap.maps.reduction.domain import CurrentDomain
from fieldmap.maps.reduction.plan import Plan
from fieldmap.maps.reduction.states import SolvedStates
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.store import FieldError
from fieldmap.store.reduced_model import ReducedModel

Array = NDArray[np.float64]
Say = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Trained:
    """A reduced model; charge (k, s): density of its iron fields on the solver's surface faces, T; error on held-out
    states, absolute, and `scale`: the largest flux density and gradient of those states where it was measured."""

    model: ReducedModel
    charge: Array
    error: FieldError
    scale: FieldError


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
    the map states its total field; states: keeps what was solved, so that a stopped run goes on."""
    training, held_out = domain.training(plan.states), domain.held_out(plan.held_out)
    potentials = states.solve_all(solver, np.concatenate([training, held_out]), plan.tolerance, say)
    solved = np.asarray(np.isfinite(potentials).all(axis=1))
    count = plan.states
    currents, snapshots = training[solved[:count]], potentials[:count][solved[:count]].T
    say("modes of the solved states", 0.9)
    energy = solver.energy_operator(currents[0], snapshots[:, 0])
    basis = proper_modes(snapshots, energy, plan.modes)
    full = solver.project(basis)
    amplitudes = snapshots.T @ energy(basis)
    say("sample points", 0.93)
    pairs = zip(currents, amplitudes, strict=True)
    parts = (full.weights[:, None] * full.contributions(i, a) for i, a in pairs)
    chosen, factors = empirical_cubature(parts, plan.points)
    reduced = full.sampled(chosen, factors * full.weights[chosen])
    say("fields of the modes", 0.96)
    flux, gradient = solver.surface.field_and_gradient(points, full.charge)
    length = np.abs(flux).max() / np.abs(gradient).max()
    probes = np.concatenate([flux.reshape(len(flux), -1), length * gradient.reshape(len(flux), -1)], axis=1)
    combination, output = output_fields(amplitudes, probes, plan.fields)
    model = _model(reduced, output, currents, amplitudes, domain, reference)
    say("error on held-out states", 0.98)
    kept = solved[count:]
    error, scale = _held_out_error(
        solver, reduced, output, combination @ full.charge, held_out[kept], potentials[count:][kept], points
    )
    return Trained(model, combination @ full.charge, error, scale)


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
        np.array([] if domain.division_exponent is None else [domain.division_exponent]),
        output @ amplitude,
    )


def _held_out_error(
    solver: NonlinearSolver,
    reduced: GalerkinModel,
    output: Array,
    charge: Array,
    currents: Array,
    potentials: Array,
    points: Array,
) -> tuple[FieldError, FieldError]:
    """Largest difference of flux density and gradient from the solved states, and the largest of these."""
    surface = solver.surface
    ours = surface.field_and_gradient(points, charge)
    theirs = surface.field_and_gradient(points, solver.charge_density(potentials.T))
    bare = [unit_flux_density_and_gradient(coil, points) for coil in solver.device.coils]
    worst, largest = np.zeros(2), np.zeros(2)
    for k, values in enumerate(currents):
        weights = output @ reduced.solve(values, np.zeros(output.shape[1]))[0]
        for j in range(2):
            difference = np.tensordot(weights, ours[j], 1) - theirs[j][k]
            whole = theirs[j][k] + sum(i * unit[j] for i, unit in zip(values, bare, strict=True))
            worst[j] = max(worst[j], _largest(difference))
            largest[j] = max(largest[j], _largest(whole))
    return FieldError(*map(float, worst)), FieldError(*map(float, largest))


def _largest(values: Array) -> float:
    """Largest norm over the points of values (n, ...)."""
    return float(np.linalg.norm(values.reshape(len(values), -1), axis=1).max())
