"""Training of a reduced model of iron with hysteresis: from solved paths of the currents to the model and its errors.

1. Paths are solved, batch by batch, until the model predicts the random paths of the next batch. Each path begins in a
   history.
2. The modes are those of all states of the paths. Sample points with positive weights reproduce the projected residuals
   of these states, each with the memory of its path, and the tangents of a few of them (`cubature`).
3. Random paths that the model is never trained on measure its error.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from fieldmap.currents import CurrentDomain
from fieldmap.histories import history_of_currents
from fieldmap.iron.elements.bh_law import PACKED
from fieldmap.iron.solvers.reduced import GalerkinModel, combinations, error_coordinates, same_lengths
from fieldmap.maps.forecast import WARM
from fieldmap.maps.training.cubature import Cubature, OfPoints, candidates
from fieldmap.maps.training.model_error import Errors, ModeFields, Trial
from fieldmap.maps.training.modes import enough, output_fields, proper_modes
from fieldmap.maps.training.paths import STEPS, CurrentPath, planned_paths, random_path
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.reduction import model_of_map
from fieldmap.maps.training.sequence import Round
from fieldmap.maps.training.solved_paths import PathSolver, SolvedPath, SolvedPaths
from fieldmap.maps.training.states import Snapshots, Solved
from fieldmap.maps.training.training import Trained
from fieldmap.progress import Forecast
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

# Random paths that are solved before the first model, and in each batch after that.
_FIRST, _AT_ONCE = 4, 2
# Projection error of a state onto the modes, in the energy norm, and error by the fields of the map that are left out,
# as multiples of the accuracy. A state with less energy than this share of the largest is compared with that share.
_MODES, _FIELDS, _LEAST_ENERGY = 0.2, 0.05, 1e-6
# Allowed change of the field of a state of the fit, root mean square, as a multiple of the accuracy; candidates for
# each point that may be chosen, and at least; points by which tangents are taken.
_FITTED, _CANDIDATES, _FEWEST_CANDIDATES, _FEW = 0.4, 6, 1000, 6000
# Weight of the energy of an error beside its field, as in `sampling`; number of states whose tangents are conditions.
_ENERGY, _TANGENTS = 0.3, 3
# The same of the errors of flux linkages.
_LINKAGE = 1.0
# Factor for weights between the states at which the largest are found.
_MARGIN = 1.1


def train_along_paths(
    solver: PathSolver,
    domain: CurrentDomain,
    plan: Plan,
    points: Array,
    paths: SolvedPaths,
    forecast: Forecast,
) -> Trained:
    """Train a reduced model of iron with hysteresis.

    Parameters
    ----------
    solver
        Of the whole iron, and the level of the histories.
    domain
        Of the currents.
    plan
        Limits and accuracy.
    points
        (n, 3), in the air, m: errors of the field are measured there.
    paths
        Solves paths and keeps them, so that a stopped run can go on.
    forecast
        Of the time.

    Raises
    ------
    NotConverged
        If the solver or the reduced model fails on a path.
    """
    for stage in ("extremes", "search"):
        forecast.expect(stage, 0.0)
    forecast.afresh(WARM)
    level = solver.level
    # The history "shaken" goes up to twice the level.
    largest = np.maximum(domain.largest, 2.0 * np.abs(level))
    trial, drawn = Trial(solver.solver, points, largest), 0

    def solve_more(
        count: int, stage: str, most: int, planned: Sequence[CurrentPath] = ()
    ) -> list[SolvedPath]:
        nonlocal drawn
        drawn += count
        fresh = (random_path(domain, level, number) for number in range(drawn - count, drawn))
        return paths.solve([*planned, *fresh], stage, most)

    known = solve_more(_FIRST, "training", plan.states, planned_paths(domain, level))
    rounds: list[Round] = []
    while True:
        reduction = _Reduction(solver, known, trial, plan, forecast)
        if rounds and (rounds[-1].errors.share <= plan.accuracy or paths.count >= plan.states):
            break
        before = paths.count
        new = solve_more(_AT_ONCE, "training", plan.states)
        rounds.append(Round(before, reduction.errors(new)))
        known = [*known, *new]
    trained_on = paths.count
    held_out = -(-plan.held_out // STEPS)
    tried = solve_more(held_out, "random", held_out * STEPS)
    forecast.at("modes", "error along solved paths", 0.5)
    errors = {"along random paths": reduction.errors(tried), "trained on": reduction.errors(known)}
    taken = {"states": trained_on, "modes": reduction.few.modes, "points": len(reduction.few.weights)}
    about = {
        "states_trained_on": trained_on,
        "states_trained_on_solved": trained_on,
        "corners_trained_on": 0,
        "states_tried": {name: asdict(found) for name, found in errors.items()},
        "current_error": stated_error(list(errors.values())),
        "rounds": [asdict(one) for one in rounds],
        "modes": taken["modes"],
        "sample_points": taken["points"],
        "error_parts": {"modes_leave": reduction.left, "taken": taken, "limits": reduction.limits},
        "report": known[0].report,
        "level_of_histories": level.tolist(),
        "linkage_error": {
            "share": reduction.linkage_error([*tried, *known]),
            "states": trained_on + held_out * STEPS,
        },
    }
    weights = np.abs(np.concatenate([reduction.weights(one) for one in (*known, *tried)])).max(axis=0)
    largest_weights = np.concatenate([largest, _MARGIN * weights])
    parts = reduction.model(domain), reduction.few.remanent, reduction.charge
    return Trained(*parts, largest_weights, about)


def stated_error(errors: Sequence[Errors]) -> dict[str, float]:
    """Errors of B, T, and gradient, T/m, stated for all paths: the largest share times the largest field of any state
    that was tried."""
    return {
        name: max(getattr(one, f"{name}_share") for one in errors)
        * max(getattr(one, f"largest_{name}") for one in errors)
        for name in ("flux_density", "gradient")
    }


class _Reduction:
    """A model on the modes of solved paths.

    Attributes
    ----------
    few : the model with the law at sample points.
    left : largest projection error of a state onto the modes, in the energy norm.
    output : (k, r), weights of the map's fields per amplitude.
    charge : (k, s), surface charge densities of these fields, T.
    limits : those of modes and points that reached their limit.
    """

    def __init__(
        self, solver: PathSolver, paths: Sequence[SolvedPath], trial: Trial, plan: Plan, forecast: Forecast
    ) -> None:
        self._solver, self._trial = solver, trial
        forecast.at("points", "modes of the paths")
        states = np.concatenate([one.potentials for one in paths]).T
        applied = solver.solver.energy_operator(solver.memory("shaken"))(states)
        energies = np.einsum("ns,ns->s", states, applied)
        sizes = np.sqrt(np.maximum(energies, _LEAST_ENERGY * energies.max()))
        states, applied = states / sizes, applied / sizes
        combined = proper_modes(states, applied, plan.modes)
        coordinates = applied.T @ (states @ combined)
        count = enough(coordinates, _MODES * plan.accuracy)
        left = energies / sizes**2 - (coordinates[:, :count] ** 2).sum(axis=1)
        self.left = float(np.sqrt(max(left.max(), 0.0)))
        basis = np.ascontiguousarray(states @ combined[:, :count])
        self._amplitudes = coordinates[:, :count] * sizes[:, None]
        charge = solver.solver.charge_density(basis)
        fields = ModeFields(trial, *trial.fields(charge))
        full = solver.solver.project(basis)
        self._moments_to_linkages = np.repeat(full.weights, 3)[:, None] * full.source
        self.few, too_few = self._sampled(full, fields, paths, plan, forecast)
        combination, self.output = output_fields(
            self._amplitudes, fields.rows, plan.fields, _FIELDS * plan.accuracy
        )
        self.charge = combination @ charge
        reached = {"modes": count >= plan.modes, "points": too_few}
        self.limits = [name for name, at_limit in reached.items() if at_limit]

    def weights(self, solved: SolvedPath) -> Array:
        """Weights (s, k) of the map's fields along a path."""
        before = history_of_currents(solved.path.history, self._solver.level)
        amplitudes = self.few.along(np.concatenate([before, solved.path.currents]))
        return amplitudes[len(before) :] @ self.output.T

    def errors(self, paths: Sequence[SolvedPath]) -> Errors:
        """Errors of the model along solved paths."""
        tried = Snapshots(self._solver.solver)
        for one in paths:
            nothing = np.zeros((one.potentials.shape[1], 0))
            for currents, potential in zip(one.path.currents, one.potentials, strict=True):
                tried.add(currents, Solved(potential, nothing, nothing))
        weights = np.concatenate([self.weights(one) for one in paths])
        return self._trial.errors(weights, self.charge, tried)

    def linkage_error(self, paths: Sequence[SolvedPath]) -> float:
        """Largest error of a flux linkage that the iron adds along solved paths, as a share of the path's largest."""
        shares = [0.0]
        for one in paths:
            memory = self._solver.memory(one.path.history)
            states = self._solver.solver.magnetised(memory, one.path.currents, one.potentials)
            theirs = np.array([polarised.ravel() @ self._moments_to_linkages for polarised, _ in states])
            before = history_of_currents(one.path.history, self._solver.level)
            ours = self.few.linkages_along(np.concatenate([before, one.path.currents]))[len(before) :]
            shares.append(float(np.abs(ours - theirs).max() / np.abs(theirs).max()))
        return max(shares)

    def model(self, domain: CurrentDomain) -> ReducedModel:
        """The model as data of a map. Its known state is that after the history "shaken"."""
        level = self._solver.level
        amplitudes = self.few.along(history_of_currents("shaken", level))[-1:]
        return model_of_map(
            self.few, self.output, level[None], amplitudes, domain, self.output @ amplitudes[0]
        )

    def _sampled(
        self,
        full: GalerkinModel,
        fields: ModeFields,
        paths: Sequence[SolvedPath],
        plan: Plan,
        forecast: Forecast,
    ) -> tuple[GalerkinModel, bool]:
        """The model at sample points, and whether as many as the plan allows are too few."""
        count, lengths = len(full.weights), same_lengths(fields.rows)
        some = np.sort(np.random.default_rng(0).choice(count, min(count, _FEW), replace=False))
        share = full.weights.sum() / full.weights[some].sum()
        currents = np.concatenate([one.path.currents for one in paths])
        by_strength = np.argsort(np.linalg.norm(currents, axis=1), kind="stable")
        with_tangent = by_strength[np.linspace(0, len(by_strength) - 1, _TANGENTS).astype(int)].tolist()
        totals, of_points, importance, tangents = [], [], np.zeros(count), []
        for k, (polarisation, derivative) in enumerate(self._magnetised(paths, forecast)):
            moments = full.weights[:, None] * polarisation
            factor = cholesky(full.air + share * _of_law(full, derivative, some), lower=True)
            combine = combinations(
                error_coordinates(factor, self._amplitudes[k], lengths, _ENERGY),
                share * cho_solve((factor, True), _of_law(full, derivative, some, full.source)),
                full.sums(moments)[full.modes :],
                _LINKAGE,
            )
            of_points.append(_contributions(full, moments, combine))
            totals.append(full.sums(moments) @ combine)
            squares = np.sum(moments**2, axis=1)
            importance += squares / (squares.sum() or 1.0)
            if k in with_tangent:
                tangents.append(_tangent(full, derivative))
        wanted = max(_FEWEST_CANDIDATES, _CANDIDATES * plan.points)
        cubature = Cubature(count, candidates(np.sqrt(importance), wanted))
        forecast.at("points", "sample points, conditions of their choice", 0.5)
        cubature.add(of_points, totals)
        for tangent in tangents:
            cubature.add_tangent(*tangent)
        forecast.at("points", "sample points", 0.7)
        factors, left = cubature.factors(_FITTED * plan.accuracy, plan.points)
        taken = np.flatnonzero(factors)
        points = cubature.candidates[taken]
        return full.sampled(points, factors[taken] * full.weights[points]), bool(left > 1.0)

    def _magnetised(self, paths: Sequence[SolvedPath], forecast: Forecast) -> Iterator[tuple[Array, Array]]:
        for k, one in enumerate(paths):
            text = f"sample points, from path {k + 1} of {len(paths)}"
            forecast.at("points", text, 0.5 * k / len(paths))
            memory = self._solver.memory(one.path.history)
            yield from self._solver.solver.magnetised(memory, one.path.currents, one.potentials)


def _contributions(full: GalerkinModel, moments: Array, combine: Array) -> OfPoints:
    def of(points: NDArray[np.int64]) -> Array:
        return full.sampled(points, full.weights[points]).contributions(moments[points], combine)

    return of


def _at(fields: Array, points: NDArray[np.int64]) -> Array:
    """Fields (3 p, k) at some of their points, (m, 3, k)."""
    return np.asarray(fields.reshape(len(fields) // 3, 3, -1)[points])


def _of_law(
    full: GalerkinModel, derivative: Array, points: NDArray[np.int64], fields: Array | None = None
) -> Array:
    """Share (r, r) of some points in the tangent; of fields (3 p, k) in the place of the modes' (r, k). derivative
    (p, 6): of the polarisation at all points."""
    gradients = _at(full.gradients, points)
    of = gradients if fields is None else _at(fields, points)
    rows = np.matmul(full.weights[points, None, None] * derivative[points][:, PACKED], of)
    return np.asarray(gradients.reshape(-1, full.modes).T @ rows.reshape(-1, rows.shape[2]))


def _tangent(full: GalerkinModel, derivative: Array) -> tuple[Array, OfPoints]:
    """Arguments of `Cubature.add_tangent` for a state with this derivative (p, 6) of its polarisation."""
    factor = cholesky(full.air + _of_law(full, derivative, np.arange(len(full.weights))), lower=True)

    def of(points: NDArray[np.int64]) -> Array:
        values, axes = np.linalg.eigh(full.weights[points, None, None] * derivative[points][:, PACKED])
        root = axes * np.sqrt(np.maximum(values, 0.0))[:, None]
        rows = np.matmul(np.swapaxes(root, 1, 2), _at(full.gradients, points))
        flat = solve_triangular(factor, rows.reshape(-1, full.modes).T, lower=True).T
        return np.asarray(flat.reshape(len(points), 3, -1))

    return full.share_of_law(factor), of
