"""The map with memory against the full solver, along paths and in small loops outside the training."""

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import PPoly

import fieldmap as fm
from fieldmap.constants import MU0
from fieldmap.currents import CurrentDomain, LiftAndDirections
from fieldmap.histories import history_of_currents
from fieldmap.iron import HysteresisSolver, IronMemory
from fieldmap.lookup import FieldMap
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.maps import read_recipe
from fieldmap.maps.fields import box_surface
from fieldmap.maps.training.paths import random_path
from fieldmap.store import ReducedModel
from validation.row import Array, Row

RECIPE = "remembering"
PATHS, FIRST_PATH = 10, 100_000
"""Number of random paths, and the number (seed) of the first, which no training uses."""
FLUX_DENSITY, GRADIENT, SLOPE = 5e-3, 8e-3, 0.03
"""Allowed errors of B and gradient relative to the largest value of the state, and of the slope of small loops."""
WIDTHS = (0.005, 0.02, 0.1)
HEAT, ENERGY, CYCLES = 0.01, 1e-6, (400, 800)
MANY, STEP_SECONDS = 1000, 0.5e-3
# Position of the magnet of the thesis, 10 mm below the sensor's zero.
_PLACE = np.array([0.0, 0.0, -0.087])


def remembering_map() -> Iterator[Row]:
    """Ten paths, small loops of each signal, a thousand paths of the model alone, and the time of a step."""
    recipe, opened = read_recipe(RECIPE), fm.open_map(fm.generate(RECIPE))
    reduced = opened.info.reduced_model
    assert reduced is not None
    domain, level = reduced.domain, reduced.known_currents[0]
    solver = HysteresisSolver(fm.read_device(recipe.device), None, recipe.refinement)
    report = opened.info.provenance.solver_report
    found = (
        f"{report['modes']} modes, {report['sample_points']} points, {report['states_solved']} states solved"
    )
    cost = (
        len(solver.surface.areas),
        0,
        report["generation_seconds"],
        report["generation_processor_seconds"],
    )
    errors = np.array(list(_along_paths(opened, solver, domain, level)))
    stated = opened.current_error
    assert stated is not None
    case = f"{recipe.device} with memory"
    for k, (what, bound) in enumerate((("B", FLUX_DENSITY), ("gradient", GRADIENT))):
        share = float(errors[:, k].max())
        yield Row(
            case, f"error of {what}, {PATHS} paths of 30 steps", share, bound, "full solver", *cost, found
        )
        own = float(errors[:, 2 + k].max() / (stated.flux_density, stated.gradient)[k])
        yield Row(case, f"true by stated error of {what}", own, 1.05, "full solver", *cost, found)
    heat, loss = errors[:, 4:].reshape(PATHS, -1, 2).sum(axis=1).T
    off = float(np.abs(heat / loss - 1.0).max())
    yield Row(case, f"error of the heat of a path, {PATHS} paths", off, HEAT, "full solver", *cost, found)
    off = _energy_left(opened, reduced)
    yield Row(
        case, "delivered less stored by heat, a cycle", off, ENERGY, "energy of the coils", *cost, found
    )
    off = _without_pinning(reduced)
    yield Row(case, "without pinning", off, 1e-9, "the model without cells", *cost, found)
    for name, value in _small_loops(opened, solver, level):
        yield Row(case, f"slope of the pull, {name}", value, SLOPE, "full solver", *cost, found)
    failed, seconds = _many_paths(opened, domain, level)
    yield Row(case, f"failures in {MANY} paths of 30 steps", failed, 0.5, "none allowed", *cost, found)
    yield Row(case, "seconds of a step along a path", seconds, STEP_SECONDS, "one thread", *cost, found)


def followed(solver: HysteresisSolver, path: Array, memory: IronMemory | None = None) -> IronMemory:
    """The iron after steps to currents (n, c)."""
    memory = memory or solver.demagnetised
    for currents in path:
        memory = solver.step(currents, memory).memory
    return memory


def _along_paths(
    opened: FieldMap, solver: HysteresisSolver, domain: CurrentDomain, level: Array
) -> Iterator[tuple[float, ...]]:
    """At each step errors of B and gradient, relative to the largest value of the state, and in T and T/m; and heat of
    map and solver, J."""
    points = box_surface(opened.info.grid)
    # A point on an edge of the box may lie outside it by rounding.
    points = np.clip(points, opened.lower, opened.upper)
    begin = {
        "shaken": followed(solver, history_of_currents("shaken", level)),
        "demagnetised": solver.demagnetised,
    }
    for number in range(FIRST_PATH, FIRST_PATH + PATHS):
        path = random_path(domain, level, number)
        memory, ours = begin[path.history], opened.memory(path.history)
        for currents in path.currents:
            state, before = solver.step(currents, memory), ours.dissipated
            memory, ours = state.memory, ours.step(currents)
            pairs = zip(ours.field_and_gradient(points, currents), _fields(state, points), strict=True)
            off = [(_largest(one - other), _largest(other)) for one, other in pairs]
            yield (*(a / b for a, b in off), *(a for a, _ in off), ours.dissipated - before, state.loss)


def _fields(state: object, points: Array) -> tuple[Array, Array]:
    return state.field(points), state.gradient(points)  # type: ignore[attr-defined]


def _largest(values: Array) -> float:
    return float(np.linalg.norm(values.reshape(len(values), -1), axis=1).max())


def _small_loops(opened: FieldMap, solver: HysteresisSolver, level: Array) -> Iterator[tuple[str, float]]:
    """Relative errors of the derivative of the force on a fixed magnet by each signal, in the second of two loops of
    each width."""
    divided = opened.parametrisation
    assert isinstance(divided, LiftAndDirections)
    start, rest = followed(solver, history_of_currents("shaken", level)), divided.nearest(level).values
    for axis, (name, scale) in enumerate((("u", float(rest[0])), ("x", 1.0), ("y", 1.0))):
        for width in WIDTHS:
            signals = np.tile(rest, (8, 1))
            signals[:, axis] += scale * width * np.array([0.5, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0])
            path = divided.currents(signals)
            memory, ours, pulls = start, opened.memory("shaken"), []
            for currents in path:
                state = solver.step(currents, memory)
                memory, ours = state.memory, ours.step(currents)
                # The force on an upright magnet is proportional to the gradient of Bz.
                theirs = state.gradient(_PLACE)[2]
                pulls.append((ours.gradient(_PLACE, currents)[2], theirs))
            pair = np.array(pulls)
            one, other = (pair[5] - pair[7])[:, (axis + 2) % 3]
            yield f"loops of {width:g} of {name}", float(abs(one / other - 1.0))


def _energy_left(opened: FieldMap, reduced: ReducedModel) -> float:
    """Relative error of the energy balance in a cycle of all currents: energy from the coils less stored energy, over
    the heat, less 1, from the cells in numpy. The second-order error of the trapezoidal rule is extrapolated."""
    errors = []
    for count in CYCLES:
        turn = 2.0 * np.pi * np.arange(count + 1)[:, None] / count
        path = opened.last_currents * (1.0 + 0.3 * np.sin(turn))
        memory, found = opened, []
        for currents in (*path, *path):
            memory = memory.step(currents)
            found.append((*_linkages_and_energy(memory, reduced), memory.dissipated))
        linkages, energy, heat = (np.array(part) for part in zip(*found[count + 1 :], strict=True))
        delivered = float(np.sum(0.5 * (path[1:] + path[:-1]) * np.diff(linkages, axis=0)))
        errors.append((delivered - energy[-1] + energy[0]) / (heat[-1] - heat[0]) - 1.0)
    return abs(4.0 * errors[1] - errors[0]) / 3.0


def _linkages_and_energy(memory: FieldMap, reduced: ReducedModel) -> tuple[Array, float]:
    """Flux linkages (c,), Wb, of the iron's field, and energy of iron and air, J."""
    points, cells = len(reduced.weights), len(reduced.shares)
    r = memory.remembered[-4 * points * cells :].reshape(points, cells, 4)[..., :3]
    size, j, stored = np.linalg.norm(r, axis=2), np.zeros((points, cells)), np.zeros((points, cells))
    for law, (first, end) in enumerate(pairwise(reduced.law_offset)):
        curve = PPoly(reduced.law_coefficients[first:end].T, np.append(reduced.law_knots[first:end], 1e3))
        at = reduced.law == law
        j[at] = curve(size[at]) - size[at]
        stored[at] = size[at] * j[at] - curve.antiderivative()(size[at]) + size[at] ** 2 / 2.0
    along = np.divide(j, size, out=np.zeros_like(j), where=size > 0.0)
    moments = (reduced.weights[:, None] * np.einsum("pk,pkd,k->pd", along, r, reduced.shares)).ravel()
    right = moments @ reduced.gradients.astype(np.float32).astype(float) + reduced.constant
    air = 0.5 * right @ np.linalg.solve(reduced.air, right)
    return moments @ reduced.source / MU0, float((reduced.weights @ stored @ reduced.shares + air) / MU0)


def _without_pinning(reduced: ReducedModel) -> float:
    """Largest relative difference between the weights of a model with zero pinning and of a model without cells."""
    free = replace(reduced, pinning=0.0 * reduced.pinning)
    bare = replace(reduced, pinning=np.zeros((0, 0)), shares=np.zeros(0))
    names = tuple(map(str, range(reduced.coil_count)))
    level, worst = reduced.known_currents[0], 0.0
    models = [CurrentModel(one, names).along(level[None]) for one in (free, bare)]
    for number in range(PATHS):
        for currents in random_path(reduced.domain, level, number).currents[:3]:
            one, other = (model.search().weights_and_slopes(currents)[0] for model in models)
            worst = max(worst, float(np.abs(one - other).max() / np.abs(other).max()))
    return worst


def _many_paths(opened: FieldMap, domain: CurrentDomain, level: Array) -> tuple[int, float]:
    """Number of failed paths, and processor seconds of a step along a smooth path."""
    failed = 0
    for number in range(2 * FIRST_PATH, 2 * FIRST_PATH + MANY):
        path = random_path(domain, level, number)
        try:
            model = opened.memory(path.history)._model
            assert model is not None
            model.along(path.currents)
        except fm.errors.NotConverged:
            failed += 1
    model = opened._model
    assert model is not None
    turns = 2.0 * np.pi * np.arange(1, 2001) / 400
    of = domain.parametrisation
    rest = of.nearest(level).values
    signals = np.tile(rest, (len(turns), 1))
    signals[:, 1], signals[:, 2] = 0.1 * np.sin(turns), 0.1 * np.sin(0.7 * turns)
    along = of.currents(signals)
    begin = time.process_time()
    model.along(along)
    return failed, (time.process_time() - begin) / len(turns)
