"""Maps over currents against fully solved states outside the training: true and stated errors."""

import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

import fieldmap as fm
from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import FieldMap
from fieldmap.maps import read_recipe
from fieldmap.parallel import same_arithmetic
from fieldmap.store import read_info, read_map
from validation.row import Array, Row, largest_error, timed
from validation.saturating.trial import (
    STATED_BOUND,
    Difference,
    equal_shares,
    extreme_shares,
    stated_errors,
    with_currents,
)

STATES = 20
LARGEST = 10.0
# Tolerance of the states, much smaller than the accuracy of the map.
TOLERANCE = 1e-4
ACCURACY, TIMES_BETTER = 1e-3, 100.0
SECONDS = 120.0
SHIPPED = (
    "workspace",
    "division",
    "division_quick",
    "saturating",
    "eight_coils",
    "eight_coils_bead",
    "five_coils",
)
_SEED = 43


def eight_coils() -> Iterator[Row]:
    """Eight independent currents: 20 random states and 20 corners solved directly, over the whole box."""
    with tempfile.TemporaryDirectory() as folder:
        path, wall, cpu = timed(lambda: fm.generate("eight_coils", Path(folder) / "map.h5"))
        report = read_info(path).provenance.solver_report
        opened = fm.open_map(path)
        recipe = read_recipe("eight_coils")
        solver = NonlinearSolver(fm.read_device(recipe.device), recipe.refinement)
        errors = {name: _errors(opened, solver, states) for name, states in _states().items()}
    tried = report["states_tried"].values()
    stated = [max(of[name] for of in tried) for name in ("flux_density_share", "gradient_share")]
    extremes = report["extremes"]
    found = (
        f"{report['states_solved']} states solved, {report['states_trained_on_solved']} of them to train on, "
        f"{extremes['solved']} of {extremes['looked_at']} extremes; {report['modes']} modes, "
        f"{report['sample_points']} points"
    )
    cost = (report["surface_faces"], 0, wall, cpu)
    case = "eight coils, each within 10 A"
    for name, both in errors.items():
        for what, value, bound in zip(("B", "gradient"), both, (ACCURACY, 2 * ACCURACY), strict=True):
            yield Row(case, f"error of {what}, {STATES} {name}", value, bound, "solved states", *cost, found)
    true = np.max(list(errors.values()), axis=0)
    for what, value, own in zip(("B", "gradient"), stated, true, strict=True):
        yield Row(case, f"stated error of {what}", value, None, "the map's own report", *cost, found)
        yield Row(case, f"true by stated error of {what}", own / value, 1.05, "solved states", *cost, found)
    better = ACCURACY / true[0]
    yield Row(case, "accuracy asked for by true error", better, TIMES_BETTER, "solved states", *cost, found)
    yield Row(case, "seconds of the whole map", wall, SECONDS, "two quiet cores", *cost, found)


def shipped_maps() -> Iterator[Row]:
    """Every shipped map of saturating iron, in maps/out, made if it is missing: states solved on the line of equal
    currents, at random and at extremes."""
    for name in SHIPPED:
        recipe, path = read_recipe(name), fm.generate(name)
        data = read_map(path)
        assert data.reduced_model is not None
        domain = data.reduced_model.domain
        difference = Difference(fm.read_device(recipe.device), recipe.refinement, data)
        stated = stated_errors(data)
        for kind, currents in _of_domain(domain).items():
            errors, wall, cpu = timed(partial(_differences, difference, currents))
            cost = (data.provenance.solver_report["surface_faces"], 0, wall, cpu)
            case, worst = f"{name}, {len(currents)} {kind}", currents[int(errors[:, 0].argmax())]
            note = f"worst at {', '.join(f'{current:.3g}' for current in worst)} A"
            for what, true, own in zip(("B", "gradient"), errors.max(axis=0), stated, strict=True):
                yield Row(case, f"true error of {what}", true, None, "solved states", *cost, note)
                ratio = true / own
                yield Row(
                    case, f"true by stated error of {what}", ratio, STATED_BOUND, "solved states", *cost
                )


def _differences(difference: Difference, currents: Array) -> Array:
    with same_arithmetic():
        return np.array([difference(values) for values in currents])


def _of_domain(domain: CurrentDomain) -> dict[str, Array]:
    """Currents (s, c) by kind, without the state of zero currents."""
    line, draw = with_currents(domain, equal_shares(domain, 24)), np.random.default_rng(_SEED)
    random = draw.random((200, len(domain.lower)))
    corners = draw.integers(0, 2, (80, len(domain.lower))).astype(float)
    # Every second corner is moved to a random point of an edge.
    edges = np.arange(1, len(corners), 2)
    corners[edges, draw.integers(0, len(domain.lower), len(edges))] = draw.random(len(edges))
    extremes = np.concatenate([extreme_shares(domain), with_currents(domain, corners)])
    first = np.sort(np.unique(extremes, axis=0, return_index=True)[1])
    kinds = {"of equal currents": line, "at random": random, "at extremes": extremes[first][:40]}
    return {kind: domain.at(shares) for kind, shares in kinds.items()}


def _states() -> dict[str, Array]:
    """Currents (20, 8), different from those that a training draws."""
    random = np.random.default_rng(11)
    return {
        "at random": random.uniform(-LARGEST, LARGEST, (STATES, 8)),
        "corners": LARGEST * random.choice([-1.0, 1.0], (STATES, 8)),
    }


def _errors(opened: FieldMap, solver: NonlinearSolver, currents: Array) -> Array:
    """Largest errors (2,) of flux density and gradient, each relative to the largest value of its state in the box."""
    shares = np.linspace(0.0, 1.0, 5)
    lower, upper = opened.bounds
    points = lower + np.stack(np.meshgrid(shares, shares, shares), axis=-1).reshape(-1, 3) * (upper - lower)
    rows = []
    with same_arithmetic():
        for values in currents:
            state = solver.solve(values, TOLERANCE)
            flux = largest_error(opened.field(points, values), state.field(points))
            rows.append([flux, largest_error(opened.gradient(points, values), state.gradient(points))])
    return np.max(rows, axis=0)
