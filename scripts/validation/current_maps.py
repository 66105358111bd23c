"""Maps over currents against fully solved states that no training saw: true errors beside those that the maps state."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import fieldmap as fm
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import FieldMap
from fieldmap.maps import read_recipe
from fieldmap.parallel import same_arithmetic
from fieldmap.store import read_info
from validation.row import Array, Row, largest_error, timed

STATES = 20
LARGEST = 10.0
# Tight beside the accuracy of the map.
TOLERANCE = 1e-4
ACCURACY, TIMES_BETTER = 1e-3, 100.0
SECONDS = 120.0


def eight_coils() -> Iterator[Row]:
    """Eight independent currents: 20 states at random and 20 corners solved directly, over the whole box."""
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


def _states() -> dict[str, Array]:
    """Currents (20, 8): not those that a training draws."""
    random = np.random.default_rng(11)
    return {
        "at random": random.uniform(-LARGEST, LARGEST, (STATES, 8)),
        "corners": LARGEST * random.choice([-1.0, 1.0], (STATES, 8)),
    }


def _errors(opened: FieldMap, solver: NonlinearSolver, currents: Array) -> Array:
    """Largest errors (2,) of flux density and gradient, each as a share of the largest of its state in the box."""
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
