"""Training of a reduced model of iron that remembers: from solved ways of the currents to the model and its errors.

1. Ways are solved, batch by batch, until the model predicts the random ways of the next one. Each begins in a history.
2. The modes are those of all states of the ways. Sample points with positive weights reproduce the projected residuals
   of these states, each with the memory that its way has made, and the tangents of a few of them (`cubature`).
3. Random ways that the model is never trained on measure its error.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from fieldmap.currents import CurrentDomain
from fieldmap.histories import history_of_currents
from fieldmap.iron.solvers.reduced import GalerkinModel, error_coordinates, same_lengths
from fieldmap.maps.forecast import Forecast
from fieldmap.maps.training.cubature import Cubature, OfPoints, candidates
from fieldmap.maps.training.model_error import Errors, ModeFields, Trial
from fieldmap.maps.training.modes import enough, output_fields, proper_modes
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.sequence import Round
from fieldmap.maps.training.solved_ways import SolvedWay, SolvedWays, WayLeader
from fieldmap.maps.training.states import Snapshots
from fieldmap.maps.training.ways import STEPS, Way, planned_ways, random_way
from fieldmap.records import Record
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

# Random ways that are solved before the first model, and in each batch after that.
_FIRST, _AT_ONCE = 4, 2
# Projection error of a state onto the modes, in the energy norm, as a multiple of the accuracy; rest of the fields.
_MODES, _FIELDS = 0.2, 0.05
# Allowed change of the field of a state of the fit, root mean square, as a multiple of the accuracy; candidates for
# each point that may be chosen; points by which energies are taken.
_FITTED, _CANDIDATES, _FEW = 0.4, 6, 6000
# Weight of the energy of an error beside its field, as in `sampling`; states whose tangents are conditions.
_ENERGY, _TANGENTS = 0.3, 3
# Factor for weights between the states at which the largest are found.
_MARGIN = 1.1
# Where the six entries of a symmetric matrix stand.
_PACKED = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True, eq=False, repr=False)
class RememberingModel(Record):
    """The result of a training.

    Attributes
    ----------
    model : the reduced model.
    charge : (k, s), surface charge density of the iron's fields on s faces, T.
    largest_weights : (c + k,), largest weights of the map's fields on all ways that were solved.
    about : what was done and found, as plain Python for the report of the map.
    """

    model: ReducedModel
    charge: Array
    largest_weights: Array
    about: Mapping[str, Any]


def train_on_ways(
    leader: WayLeader, domain: CurrentDomain, plan: Plan, points: Array, ways: SolvedWays, forecast: Forecast
) -> RememberingModel:
    """Train a reduced model of iron that remembers.

    Parameters
    ----------
    leader
        The solver, and the level of the histories.
    domain
        Of the currents.
    plan
        Limits and accuracy.
    points
        (n, 3), in the air, m: errors of the field are measured there.
    ways
        Solves ways and keeps them, so that a stopped run can go on.
    forecast
        Of the time.

    Raises
    ------
    NotConverged
        If the solver or the reduced model fails on a way.
    """
    level = leader.level
    trial = Trial(leader.solver, points, np.maximum(domain.largest, 2.0 * np.abs(level)))
    drawn = 0

    def more(count: int) -> list[Way]:
        nonlocal drawn
        drawn += count
        return [random_way(domain, level, number) for number in range(drawn - count, drawn)]

    known = ways.solve([*planned_ways(domain, level), *more(_FIRST)], "training", plan.states)
    rounds: list[Round] = []
    while True:
        reduction = _Reduction(leader, known, trial, plan, forecast)
        if rounds and (rounds[-1].errors.share <= plan.accuracy or ways.count >= plan.states):
            break
        before = ways.count
        new = ways.solve(more(_AT_ONCE), "training", plan.states)
        rounds.append(Round(before, reduction.errors(new)))
        known = [*known, *new]
    trained_on = ways.count
    held_out = -(-plan.held_out // STEPS)
    tried = ways.solve(more(held_out), "random", held_out * STEPS)
    forecast.at("modes", "error on solved ways", 0.5)
    errors = {"on random ways": reduction.errors(tried), "trained on": reduction.errors(known)}
    about = {
        "states_trained_on": trained_on,
        "states_trained_on_solved": trained_on,
        "corners_trained_on": 0,
        "states_tried": {name: asdict(found) for name, found in errors.items()},
        "current_error": _stated(list(errors.values())),
        "rounds": [asdict(one) for one in rounds],
        "modes": reduction.few.modes,
        "sample_points": len(reduction.few.weights),
        "error_parts": {
            "modes_leave": reduction.left,
            "taken": {
                "states": trained_on,
                "modes": reduction.few.modes,
                "points": len(reduction.few.weights),
            },
            "limits": [name for name, reached in reduction.limits.items() if reached],
        },
        "report": known[0].report,
        "level_of_histories": level.tolist(),
    }
    weights = np.abs(np.concatenate([reduction.weights(one) for one in (*known, *tried)])).max(axis=0)
    largest = np.concatenate([np.maximum(domain.largest, 2.0 * np.abs(level)), _MARGIN * weights])
    return RememberingModel(reduction.reduced(domain), reduction.charge, largest, about)


def _stated(errors: Sequence[Errors]) -> dict[str, float]:
    """Errors of B, T, and gradient, T/m, that hold on other ways too: the largest shares at the strongest states."""
    return {
        name: max(getattr(one, f"{name}_share") for one in errors)
        * max(getattr(one, f"largest_{name}") for one in errors)
        for name in ("flux_density", "gradient")
    }


class _Reduction:
    """A model on the modes of solved ways.

    Attributes
    ----------
    few : the model with the law at sample points.
    left : largest projection error of a state onto the modes, in the energy norm.
    output : (k, r), weights of the map's fields per amplitude.
    charge : (k, s), surface charge densities of these fields, T.
    limits : which of modes and points reached their limit.
    """

    def __init__(
        self, leader: WayLeader, ways: Sequence[SolvedWay], trial: Trial, plan: Plan, forecast: Forecast
    ) -> None:
        self._leader, self._trial = leader, trial
        solver = leader.solver
        forecast.at("points", "modes of the ways")
        states = np.concatenate([way.potentials for way in ways]).T
        energy = solver.energy_operator(leader.memory("shaken"))
        applied = energy(states)
        sizes = np.sqrt(np.maximum(np.einsum("ns,ns->s", states, applied), 1e-300))
        # Without currents there is hardly a field: such a state counts as a small one.
        sizes = np.maximum(sizes, 1e-3 * sizes.max())
        combined = proper_modes(states / sizes, applied / sizes, plan.modes)
        coordinates = (applied / sizes).T @ (states / sizes @ combined)
        rest = np.einsum("ns,ns->s", states, applied) / sizes**2 - (coordinates**2).sum(axis=1)
        few = enough(coordinates, _MODES * plan.accuracy)
        self.left = float(np.sqrt(max(rest.max(), 0.0)))
        basis = np.ascontiguousarray((states / sizes) @ combined[:, :few])
        self.amplitudes = coordinates[:, :few] * sizes[:, None]
        self._full = solver.project(basis)
        charge = solver.charge_density(basis)
        self._fields = ModeFields(trial, *trial.fields(charge))
        self.few, points_used_up = self._sampled(ways, plan, forecast)
        combination, self.output = output_fields(
            self.amplitudes, self._fields.rows, plan.fields, _FIELDS * plan.accuracy
        )
        self.charge = combination @ charge
        self.limits = {"modes": few >= plan.modes, "points": bool(points_used_up)}

    def amplitudes_on(self, way: Way) -> Array:
        """Amplitudes (s, r) that the model finds along a way."""
        before = history_of_currents(way.history, self._leader.level)
        return self.few.led(np.concatenate([before, way.currents]))[len(before) :]

    def weights(self, way: SolvedWay) -> Array:
        """Weights (s, k) of the map's fields along a way."""
        return self.amplitudes_on(way.way) @ self.output.T

    def errors(self, ways: Sequence[SolvedWay]) -> Errors:
        """Errors of the model along solved ways."""
        tried = Snapshots(self._leader.solver)
        for way in ways:
            for currents, state in way.states:
                tried.add(currents, state)
        weights = np.concatenate([self.weights(way) for way in ways])
        return self._trial.errors(weights, self.charge, tried)

    def reduced(self, domain: CurrentDomain) -> ReducedModel:
        """The model as data of a map."""
        model, level = self.few, self._leader.level
        offset, knots, coefficients = model.tables.arrays
        at_level = model.led(history_of_currents("shaken", level))[-1]
        assert model.pinning is not None
        assert model.shares is not None
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
            output=self.output,
            known_currents=level[None],
            known_amplitudes=at_level[None],
            lower=domain.lower,
            upper=domain.upper,
            parametrisation=domain.parametrisation,
            reference_weights=self.output @ at_level,
            pinning=model.pinning,
            shares=model.shares,
        )

    def _sampled(
        self, ways: Sequence[SolvedWay], plan: Plan, forecast: Forecast
    ) -> tuple[GalerkinModel, bool]:
        """The model at sample points, and whether as many as the plan allows were not enough."""
        full, lengths = self._full, same_lengths(self._fields.rows)
        count = len(full.weights)
        some = np.sort(np.random.default_rng(0).choice(count, min(count, _FEW), replace=False))
        share = full.weights.sum() / full.weights[some].sum()
        currents = np.concatenate([way.way.currents for way in ways])
        strength = np.argsort(np.linalg.norm(currents, axis=1), kind="stable")
        with_tangent = set(strength[np.linspace(0, len(strength) - 1, _TANGENTS).astype(int)].tolist())
        totals, of_points, importance, tangents = [], [], np.zeros(count), []
        for k, (polarisation, derivative) in enumerate(self._magnetised(ways, forecast)):
            amplitude, moments = self.amplitudes[k], full.weights[:, None] * polarisation
            factor = cholesky(full.air + share * _of_law(full, derivative, some), lower=True)
            combine = error_coordinates(factor, amplitude, lengths, _ENERGY)
            of_points.append(_contributions(full, moments, combine))
            totals.append(full.residual(moments) @ combine)
            importance += np.linalg.norm(moments, axis=1) ** 2 / max(float((moments**2).sum()), 1e-300)
            if k in with_tangent:
                tangents.append(_tangent(full, derivative))
        chosen = candidates(np.sqrt(importance), min(count, max(1000, _CANDIDATES * plan.points)))
        cubature = Cubature(count, chosen)
        forecast.at("points", "sample points, conditions of their choice", 0.5)
        cubature.add(of_points, totals)
        for tangent in tangents:
            cubature.add_tangent(*tangent)
        forecast.at("points", "sample points", 0.7)
        factors, left = cubature.factors(_FITTED * plan.accuracy, plan.points)
        taken = np.flatnonzero(factors)
        points = cubature.candidates[taken]
        return full.sampled(points, factors[taken] * full.weights[points]), left > 1.0

    def _magnetised(self, ways: Sequence[SolvedWay], forecast: Forecast) -> Iterator[tuple[Array, Array]]:
        for k, way in enumerate(ways):
            forecast.at("points", f"sample points, from way {k + 1} of {len(ways)}", 0.5 * k / len(ways))
            memory = self._leader.memory(way.way.history)
            yield from self._leader.solver.magnetised(memory, way.way.currents, way.potentials)


def _contributions(full: GalerkinModel, moments: Array, combine: Array) -> OfPoints:
    def of(points: NDArray[np.int64]) -> Array:
        gradients = full.gradients.reshape(len(full.weights), 3, -1)[points] @ combine
        return np.asarray(np.einsum("pi,pik->pk", moments[points], gradients))

    return of


def _of_law(full: GalerkinModel, derivative: Array, points: NDArray[np.int64]) -> Array:
    """Share (r, r) of some points in the tangent; derivative (p, 6): of the polarisation at all points."""
    gradients = full.gradients.reshape(len(full.weights), 3, -1)[points]
    rows = np.matmul(full.weights[points, None, None] * derivative[points][:, _PACKED], gradients)
    return np.asarray(gradients.reshape(-1, full.modes).T @ rows.reshape(-1, full.modes))


def _tangent(full: GalerkinModel, derivative: Array) -> tuple[Array, OfPoints]:
    """Arguments of `Cubature.add_tangent` for a state with this derivative (p, 6) of its polarisation."""
    factor = cholesky(full.air + _of_law(full, derivative, np.arange(len(full.weights))), lower=True)
    of_air = solve_triangular(factor, solve_triangular(factor, full.air, lower=True).T, lower=True)

    def of(points: NDArray[np.int64]) -> Array:
        values, axes = np.linalg.eigh(full.weights[points, None, None] * derivative[points][:, _PACKED])
        root = axes * np.sqrt(np.maximum(values, 0.0))[:, None]
        gradients = full.gradients.reshape(len(full.weights), 3, -1)[points]
        rows = np.matmul(np.swapaxes(root, 1, 2), gradients)
        flat = solve_triangular(factor, rows.reshape(-1, full.modes).T, lower=True).T
        return np.asarray(flat.reshape(len(points), 3, -1))

    return np.eye(len(factor)) - of_air, of
