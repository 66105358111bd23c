"""What a map of saturating iron costs at run time: new currents, their derivatives, one wrench, currents for a force.

On the maps `eight_coils` and `workspace` (the drive unit) in maps/out. New currents anywhere in the domain, each from
nothing, and along a path of which 400 steps go round the domain once. Beside them the older way, as releases before had
it: Newton's method of the training (`fieldmap.kernels.iron.reduced_iron.newton`), from the nearest of the solved states
that the map remembers or from the step before, to 1e-6, and derivatives from scratch; a wrench at one point by way of
the arrays; currents for a force without a start. Microseconds of one processor, the least of several runs in which both
take turns.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import fieldmap as fm
from fieldmap.core.iron import CoreIron
from fieldmap.currents import IndependentCurrents
from fieldmap.errors import Infeasible
from fieldmap.field import dipole_wrench
from fieldmap.kernels.iron.matrix_vector import times
from fieldmap.kernels.iron.reduced_iron import newton, sensitivities
from fieldmap.lookup import FieldMap, compiled_currents
from fieldmap.lookup.current_solver import core_numbers

FOLDER, MAPS = Path("maps/out"), ("eight_coils", "workspace")
MOMENT = np.array([0.0, 0.0, 0.8])
OLDER_TOLERANCE, MOST_STEPS = 1e-6, 60


@dataclass(frozen=True)
class Row:
    """us of one call, the older way and now; difference: largest of the fields or forces that both give, relative to
    the largest."""

    map: str
    what: str
    older: float
    now: float
    difference: float


class Older:
    """Weights of the iron's fields as releases before found them."""

    def __init__(self, field: FieldMap) -> None:
        assert field.info.reduced_model is not None
        self.model = model = field.info.reduced_model
        gradients = np.array(model.gradients)
        laws = map(np.array, (model.weights, model.law, *model.laws))
        self.iron = (gradients, gradients.astype(np.float32), *laws, np.array(model.air))
        self.source, self.constant = np.array(model.source), np.array(model.constant)
        self.range = np.maximum(np.ptp(model.known_currents, axis=0), 1e-12)
        sources = np.ascontiguousarray(self.source @ model.known_currents.T)
        known = np.array(model.known_amplitudes)
        self.factors = sensitivities(sources, *self.iron, known, self.source)[1]
        self.last: tuple[np.ndarray, np.ndarray] | None = None

    def nearest(self, currents: np.ndarray) -> np.ndarray:
        """From the nearest solved state."""
        off = ((currents - self.model.known_currents) / self.range) ** 2
        k = int(off.sum(axis=1).argmin())
        return self._solved(currents, self.model.known_amplitudes[k].copy(), self.factors[k].copy())

    def next(self, currents: np.ndarray) -> np.ndarray:
        """From the one before."""
        if self.last is None:
            return self.nearest(currents)
        return self._solved(currents, *self.last)

    def with_slopes(self, solve: Callable[[np.ndarray], np.ndarray], currents: np.ndarray) -> np.ndarray:
        """And their derivatives (f, c)."""
        solve(currents)
        assert self.last is not None
        source = (self.source @ currents)[:, None]
        found = sensitivities(source, *self.iron, self.last[0][None], self.source)[0][0]
        return np.asarray(self.model.output @ found)

    def _solved(self, currents: np.ndarray, start: np.ndarray, factor: np.ndarray) -> np.ndarray:
        applied = times(self.source, currents)
        found, _, _ = newton(applied, *self.iron, self.constant, start, factor, OLDER_TOLERANCE, MOST_STEPS)
        self.last = found, factor
        return np.asarray(self.model.output @ found)


class Now:
    """The same by the C core, to the tolerance of compiled callers."""

    def __init__(self, field: FieldMap) -> None:
        model = compiled_currents(field)
        self.state, self.tolerance = CoreIron(core_numbers(model)).state(), model.tolerance
        self.coils, self.fields = model.source.shape[1], len(model.output)
        self.weights = np.empty(self.coils + self.fields + (model.fixed.size > 0))
        self.slopes = np.empty((len(self.weights), self.coils))

    def anew(self, currents: np.ndarray) -> np.ndarray:
        """From nothing."""
        return self._solved(currents, None, True)[self.coils : self.coils + self.fields]

    def next(self, currents: np.ndarray) -> np.ndarray:
        """From the ones before."""
        return self._solved(currents, None, False)[self.coils : self.coils + self.fields]

    def slopes_anew(self, currents: np.ndarray) -> np.ndarray:
        """From nothing, with derivatives."""
        self._solved(currents, self.slopes, True)
        return self.slopes[self.coils : self.coils + self.fields]

    def slopes_next(self, currents: np.ndarray) -> np.ndarray:
        """From the ones before, with derivatives."""
        self._solved(currents, self.slopes, False)
        return self.slopes[self.coils : self.coils + self.fields]

    def _solved(self, currents: np.ndarray, slopes: np.ndarray | None, fresh: bool) -> np.ndarray:
        self.state.solve(currents, self.weights, slopes, tolerance=self.tolerance, fresh=fresh)
        return self.weights


def timed(
    older: Callable[[Any], Any],
    now: Callable[[Any], Any],
    asked: list[Any],
    repeats: int,
    shown: Callable[[np.ndarray], np.ndarray] = lambda found: found,
) -> tuple[float, float, float]:
    """us of one call of each, and the largest difference of what is shown of what they give."""
    a, b = (np.array([shown(np.copy(call(x))) for x in asked]) for call in (older, now))
    best = [np.inf, np.inf]
    for _ in range(repeats):
        for k, call in enumerate((older, now)):
            begin = time.process_time()
            for x in asked:
                call(x)
            best[k] = min(best[k], 1e6 * (time.process_time() - begin) / len(asked))
    return best[0], best[1], float(np.abs(a - b).max() / np.abs(a).max())


def rows_of(path: Path, quick: bool) -> list[Row]:
    """All rows of a map."""
    m, name = fm.open_map(path), path.stem
    assert m.info.reduced_model is not None
    domain, count, repeats = m.info.reduced_model.domain, 20 if quick else 200, 2 if quick else 5
    d = len(domain.lower)
    anywhere = list(domain.at(np.random.default_rng(1).random((count, d))))
    angles = 2.0 * np.pi * (np.arange(count)[:, None] / 400.0 * (1.0 + np.arange(d) % 3) + np.arange(d) / d)
    path_of = list(domain.at(0.5 + 0.35 * np.sin(angles)))
    older, now = Older(m), Now(m)
    # Of the iron at some points: weights alone may differ where their fields are small.
    points = np.random.default_rng(3).uniform(m.lower, m.upper, (30, 3))
    flux = np.empty((30, now.coils + now.fields, 3))
    m._evaluator.each_field(points, flux, np.empty((*flux.shape, 3)))
    of_iron = flux[:, now.coils : now.coils + now.fields]
    asked = (
        ("new currents anywhere", older.nearest, now.anew, anywhere),
        ("new currents along a path", older.next, now.next, path_of),
        (
            "with derivatives, anywhere",
            lambda i: older.with_slopes(older.nearest, i),
            now.slopes_anew,
            anywhere,
        ),
        (
            "with derivatives, along a path",
            lambda i: older.with_slopes(older.next, i),
            now.slopes_next,
            path_of,
        ),
    )
    found = [
        Row(name, what, *timed(before, after, ways, repeats, lambda w: np.tensordot(w, of_iron, (0, 1))))
        for what, before, after, ways in asked
    ]
    return [
        *found,
        _wrench(m, name, repeats),
        *_currents_for(m, name, anywhere[: 5 if quick else 20], repeats),
    ]


def _wrench(m: FieldMap, name: str, repeats: int) -> Row:
    """At one point after another, the currents the same."""
    assert m.info.reduced_model is not None
    currents = m.info.reduced_model.domain.middle
    points = list(np.random.default_rng(2).uniform(m.lower, m.upper, (1000, 3)))

    def by_arrays(point: np.ndarray) -> np.ndarray:
        return np.asarray(dipole_wrench(*m.field_and_gradient(point[None], currents), MOMENT)[0])

    return Row(
        name,
        "wrench at one point",
        *timed(by_arrays, lambda p: m.wrench(p, MOMENT, currents), points, repeats),
    )


def _currents_for(m: FieldMap, name: str, known: list[np.ndarray], repeats: int) -> list[Row]:
    """A force that known currents give, and 2 % more: from nothing, and from these currents. Of free currents only."""
    if not isinstance(m.parametrisation, IndependentCurrents):
        return []
    point, asked = 0.5 * (m.lower + m.upper), []
    for currents in known:
        force = m.wrench(point, MOMENT, currents)[:3] * 1.02
        try:
            m.currents_for(point, force, MOMENT, start=currents)
        except Infeasible:
            continue
        asked.append((force, currents))

    def anew(one: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return m.wrench(point, MOMENT, m.currents_for(point, one[0], MOMENT))[:3]

    def warm(one: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return m.wrench(point, MOMENT, m.currents_for(point, one[0], MOMENT, start=one[1]))[:3]

    what = "currents_for: from nothing, and from currents of a force 2 % less"
    return [Row(name, what, *timed(anew, warm, asked, min(repeats, 2)))] if asked else []


def measure(quick: bool) -> dict[str, Any]:
    """Every map that is there."""
    there = [FOLDER / f"{name}.h5" for name in MAPS if (FOLDER / f"{name}.h5").is_file()]
    missing = [name for name in MAPS if FOLDER / f"{name}.h5" not in there]
    rows = [asdict(row) for path in there for row in rows_of(path, quick)]
    return {"rows": rows, "missing": [f"no {FOLDER / name}.h5: fieldmap map {name}" for name in missing]}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the rows."""
    table = Table("map", "what", "older way, us", "now, us", "times", "difference")
    for row in result["rows"]:
        ratio = row["older"] / row["now"]
        figures = f"{row['older']:.1f}", f"{row['now']:.1f}", f"{ratio:.1f}", f"{row['difference']:.0e}"
        table.add_row(row["map"], row["what"], *figures)
    console.print(table)
    for line in result["missing"]:
        console.print(line, highlight=False)
