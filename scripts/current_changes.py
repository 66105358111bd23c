"""What a change of the currents costs in a map of saturating iron, beside the way of the release before.

    python scripts/current_changes.py MAP [--sets N]

Prints microseconds of processor time, on one thread: of currents drawn at random from the map's domain, each without
knowledge of the others, and of currents along a closed path through the domain in 1000 steps, begun from the last ones;
with the derivatives by the currents; `currents_for` of the field at these currents; and how far each way is from the
same equations solved to 1e-10, as a share of the map's `current_error`. Prints figures, not verdicts.
"""

import argparse
import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import time  # noqa: E402
from collections.abc import Callable  # noqa: E402

import numba  # noqa: E402
import numpy as np  # noqa: E402

from fieldmap.kernels.map import current_solver as solver  # noqa: E402
from fieldmap.kernels.map.continuation import continued  # noqa: E402
from fieldmap.kernels.map.reduced_iron import blended_start, newton, sensitivities  # noqa: E402
from fieldmap.lookup import FieldMap, open_map  # noqa: E402
from fieldmap.lookup.current_model import CurrentModel  # noqa: E402
from fieldmap.lookup.current_solver import new_state  # noqa: E402
from fieldmap.store.reduced_model import ReducedModel  # noqa: E402

STEPS, REPETITIONS, PASSED = 1000, 5, 3


def path(model: ReducedModel) -> np.ndarray:
    """Currents (n, c) along a closed path through the domain."""
    angle = 2 * np.pi * np.arange(STEPS) / STEPS
    d = len(model.lower)
    phases = angle[:, None] * np.arange(1, d + 1) + np.arange(d)
    return model.domain.at(0.5 + 0.4 * np.sin(phases))


def microseconds(work: Callable[[], object], count: int) -> float:
    """Least processor time of several runs over count, after one that compiles."""
    work()
    seconds = []
    for _ in range(REPETITIONS):
        start = time.process_time_ns()
        work()
        seconds.append(time.process_time_ns() - start)
    return 1e-3 * min(seconds) / count


class Before:
    """The way of before: Newton's method from the tangents of the known states, or from the last states."""

    def __init__(self, model: ReducedModel) -> None:
        gradients = np.array(model.gradients)
        laws = map(np.array, (model.weights, model.law, *model.laws))
        self._iron = (gradients, gradients.astype(np.float32), *laws, np.array(model.air))
        self._constant, self._source = np.array(model.constant), np.array(model.source)
        self._fixed = np.array(model.fixed) if model.fixed.size else 0.0
        self._range = np.maximum(np.ptp(model.known_currents, axis=0), 1e-12)
        self.model = model
        self._slopes, self._factors = self._tangents(model.known_currents, model.known_amplitudes)
        self._passed: list[tuple[np.ndarray, np.ndarray]] = []
        self._factor = np.zeros_like(model.air)

    def _tangents(self, currents: np.ndarray, amplitudes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fixed = self._fixed if np.ndim(self._fixed) == 0 else self._fixed[:, None]
        sources = np.ascontiguousarray(self._source @ currents.T + fixed)
        return sensitivities(sources, *self._iron, np.array(amplitudes), self._source)

    def _solve(self, currents: np.ndarray, start: np.ndarray, factor: np.ndarray) -> np.ndarray:
        applied = self._source @ currents + self._fixed
        return newton(applied, *self._iron, self._constant, start, factor, 1e-6, 60)[0]

    def any(self, currents: np.ndarray) -> np.ndarray:
        """Weights of the iron's fields."""
        known = self.model.known_currents
        start = blended_start(currents, known, self.model.known_amplitudes, self._slopes, self._range)
        nearest = (((currents - known) / self._range) ** 2).sum(axis=1).argmin()
        return self.model.output @ self._solve(currents, start, self._factors[nearest].copy())

    def next(self, currents: np.ndarray) -> np.ndarray:
        """Weights of the iron's fields, begun from the last ones."""
        if not self._passed:
            self._passed.append(
                (currents, np.linalg.lstsq(self.model.output, self.any(currents), rcond=None)[0])
            )
        behind, states = (np.array(part) for part in zip(*self._passed[-PASSED:], strict=True))
        start, (weights, nodes) = np.empty(states.shape[1]), np.empty((2, len(behind)))
        continued(currents, behind, states, weights, nodes, start)
        found = self._solve(currents, start, self._factor)
        self._passed = [*self._passed[1 - PASSED :], (currents, found)]
        return self.model.output @ found

    def slopes(self, currents: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Derivatives of the weights."""
        return self.model.output @ self._tangents(currents[None], amplitudes[None])[0][0]


@numba.njit
def together(kernel_model, state, currents, follow, slopes, out):
    """Solve for all currents (n, c), each from the last one or from nothing, with slopes unless these are empty."""
    weights = np.empty(state.weights.size)
    for k in range(currents.shape[0]):
        if not follow:
            state.numbers[solver.COUNT] = 0.0
        if slopes.size:
            solver.current_slopes(kernel_model, state, currents[k], weights, slopes)
        else:
            solver.current_weights(kernel_model, state, currents[k], weights)
        out[k] = weights[currents.shape[1] :]


def misses(opened: FieldMap, weights: np.ndarray, exact: np.ndarray) -> str:
    """The largest difference of B and gradient on the corners and edges' middles of the box."""
    corner = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 3), axis=-1).reshape(-1, 3)
    points = opened.lower + corner * (opened.upper - opened.lower)
    coils = len(opened.coil_names)
    sets = coils + weights.shape[1]
    flux, slope = np.empty((len(points), sets, 3)), np.empty((len(points), sets, 3, 3))
    opened._evaluator.each_field(points, flux, slope)
    off = weights - exact
    b = np.linalg.norm(np.einsum("sf,pfi->spi", off, flux[:, coils:]), axis=-1).max()
    g = np.linalg.norm(np.einsum("sf,pfij->spij", off, slope[:, coils:]), axis=(-2, -1)).max()
    own = opened.current_error
    return "" if own is None else f"{b / own.flux_density:8.1e} {g / own.gradient:8.1e}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("map", help="file of a map of saturating iron")
    parser.add_argument("--sets", type=int, default=200, help="currents drawn at random")
    options = parser.parse_args()
    opened = open_map(options.map)
    model = opened.info.reduced_model
    if model is None:
        parser.error(f"{options.map}: a map of linear iron, which superposes")
    sets = model.domain.at(np.random.default_rng(5).random((options.sets, len(model.lower))))
    along = path(model)
    start = time.process_time()
    current_model = CurrentModel(model, opened.coil_names)
    compiled = current_model.compiled
    print(f"{len(model.weights)} points, {len(model.constant)} modes, {len(model.output)} fields")
    print(
        f"expansion of {len(compiled.terms)} terms, {time.process_time() - start:.2f} s of processor time\n"
    )
    before, state = Before(model), new_state(compiled)
    kernels = compiled, state
    results = {
        name: np.empty((len(rows), len(state.weights) - rows.shape[1]))
        for name, rows in (("any", sets), ("path", along))
    }
    none, slopes = np.empty((0, 0)), np.empty((len(state.weights), sets.shape[1]))
    exact = {}
    for name, rows in (("any", sets), ("path", along)):
        search = current_model.search()
        exact[name] = np.array([search.weights(i)[len(i) :] for i in rows])
    coils = sets.shape[1]
    print("us of processor time; error as a share of current_error, B and gradient")
    print(f"{'':34} {'before':>8} {'now':>8}   {'error before':>17}   {'error now':>17}")
    for name, rows, old, follow in (("any", sets, before.any, False), ("path", along, before.next, True)):
        found = np.array([old(i) for i in rows])
        if model.fixed.size:
            found = np.concatenate([found, np.ones((len(found), 1))], axis=1)
        was = microseconds(lambda old=old, rows=rows: [old(i) for i in rows], len(rows))
        out = results[name]
        now = microseconds(
            lambda rows=rows, follow=follow, out=out: together(*kernels, rows, follow, none, out), len(rows)
        )
        errors = [misses(opened, each, exact[name]) for each in (found, out)]
        words = {"any": "any currents", "path": "along a trajectory"}[name]
        print(f"{words:34} {was:8.1f} {now:8.1f}   {errors[0]:>17}   {errors[1]:>17}")
        both = microseconds(
            lambda rows=rows, follow=follow, out=out: together(*kernels, rows, follow, slopes, out), len(rows)
        )
        amplitudes = current_model.amplitudes(rows[0])
        more = microseconds(
            lambda rows=rows, a=amplitudes: [before.slopes(rows[0], a) for _ in range(20)], 20
        )
        print(f"{'  with derivatives':34} {was + more:8.1f} {both:8.1f}")
    python = microseconds(lambda: [current_model.weights(i) for i in sets], len(sets))
    print(f"{'any currents, from Python':34} {'':8} {python:8.1f}")
    point = 0.5 * (opened.lower + opened.upper)
    opened.at(sets[0])
    lookup = microseconds(lambda: [opened.field_and_gradient(point, sets[0]) for _ in range(1000)], 1000)
    print(f"{'field and gradient, same currents':34} {'':8} {lookup:8.1f}")
    moment = np.array([0.0, 0.0, 1.0])
    rows = microseconds(lambda: [opened.actuation(point, i, moment) for i in along[:50]], 50)
    print(f"{'actuation at a point, from Python':34} {'':8} {rows:8.1f}")
    if model.parametrisation.signal_count == coils:
        wanted = [opened.field(point, i) for i in along[:50]]
        inverse = microseconds(
            lambda: [
                opened.currents_for(point, field=b, start=i) for b, i in zip(wanted, along[1:51], strict=True)
            ],
            50,
        )
        print(f"{'currents_for a field, warm':34} {'':8} {inverse:8.1f}")


if __name__ == "__main__":
    main()
