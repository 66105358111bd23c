"""Run-time cost of a map of saturating iron: new currents, their derivatives, one wrench, currents for a force.

Measured on the maps `eight_coils` and `workspace` (the drive unit) in maps/out. New currents are anywhere in the
domain, solved from zero, or along a path that goes round the domain once in 400 steps. All are solved to the tolerance
of compiled callers, and their fields are compared with fields of solves to 1e-10. A wrench at one point is computed
directly, and from arrays of field and gradient; currents for a force are found without a start, and from the currents
of a force 2 % smaller. Times are processor microseconds, the least of several runs.
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
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.currents import IndependentCurrents
from fieldmap.errors import Infeasible
from fieldmap.field import dipole_wrench
from fieldmap.lookup import FieldMap, compiled_currents

FOLDER, MAPS = Path("maps/out"), ("eight_coils", "workspace")
MOMENT = np.array([0.0, 0.0, 0.8])
EXACT = 1e-10


@dataclass(frozen=True)
class Row:
    """us: time of one call; off: largest difference of the fields from those of exact solves, relative to the largest,
    None without comparison."""

    map: str
    what: str
    us: float
    off: float | None = None


class Solves:
    """Weights of the iron's fields by the C core, to a tolerance, by default that of compiled callers."""

    def __init__(self, field: FieldMap, tolerance: float | None = None) -> None:
        model = compiled_currents(field)
        self.state = CoreIron(core_numbers(model)).state()
        self.tolerance = model.tolerance if tolerance is None else tolerance
        self.coils, self.fields = model.source.shape[1], len(model.output)
        self.weights = np.empty(self.coils + self.fields + (model.fixed.size > 0))
        self.slopes = np.empty((len(self.weights), self.coils))

    def at(self, currents: np.ndarray, slopes: bool, fresh: bool) -> np.ndarray:
        """The weights, or their derivatives; solved from zero (fresh) or from the last currents."""
        by_currents = self.slopes if slopes else None
        self.state.solve(currents, self.weights, by_currents, tolerance=self.tolerance, fresh=fresh)
        found = self.slopes if slopes else self.weights
        return found[self.coils : self.coils + self.fields]


def timed(call: Callable[[Any], Any], asked: list[Any], repeats: int) -> float:
    """us of one call."""
    best = np.inf
    for _ in range(repeats):
        begin = time.process_time()
        for x in asked:
            call(x)
        best = min(best, 1e6 * (time.process_time() - begin) / len(asked))
    return best


def rows_of(path: Path, quick: bool) -> list[Row]:
    """All rows of a map."""
    m, name = fm.open_map(path), path.stem
    assert m.info.reduced_model is not None
    domain, count, repeats = m.info.reduced_model.domain, 20 if quick else 200, 2 if quick else 5
    d = len(domain.lower)
    anywhere = list(domain.at(np.random.default_rng(1).random((count, d))))
    angles = 2.0 * np.pi * (np.arange(count)[:, None] / 400.0 * (1.0 + np.arange(d) % 3) + np.arange(d) / d)
    path_of = list(domain.at(0.5 + 0.35 * np.sin(angles)))
    solves, exact = Solves(m), Solves(m, EXACT)
    # Fields of the iron at some points are compared, not weights, which may differ where their fields are small.
    points = np.random.default_rng(3).uniform(m.lower, m.upper, (30, 3))
    flux = np.empty((30, solves.coils + solves.fields, 3))
    m._evaluator.each_field(points, flux, np.empty((*flux.shape, 3)))
    of_iron = flux[:, solves.coils : solves.coils + solves.fields]
    found = []
    for slopes in (False, True):
        for fresh, ways in ((True, anywhere), (False, path_of)):

            def now(currents: np.ndarray, slopes: bool = slopes, fresh: bool = fresh) -> np.ndarray:
                return solves.at(currents, slopes, fresh)

            given = np.array([now(currents).copy() for currents in ways])
            truth = np.array([exact.at(currents, slopes, True).copy() for currents in ways])
            fields, off = (np.tensordot(of_iron, each, (1, 1)) for each in (truth, given - truth))
            what = ("with derivatives, " if slopes else "new currents ") + (
                "anywhere" if fresh else "along a path"
            )
            share = float(np.abs(off).max() / np.abs(fields).max())
            found.append(Row(name, what, timed(now, ways, repeats), share))
    return [
        *found,
        *_wrench(m, name, repeats),
        *_currents_for(m, name, anywhere[: 5 if quick else 20], repeats),
    ]


def _wrench(m: FieldMap, name: str, repeats: int) -> list[Row]:
    """Wrenches at one point after another, at constant currents."""
    assert m.info.reduced_model is not None
    currents = m.info.reduced_model.domain.middle
    points = list(np.random.default_rng(2).uniform(m.lower, m.upper, (1000, 3)))

    def by_arrays(point: np.ndarray) -> np.ndarray:
        return np.asarray(dipole_wrench(*m.field_and_gradient(point[None], currents), MOMENT)[0])

    return [
        Row(name, "wrench at one point", timed(lambda p: m.wrench(p, MOMENT, currents), points, repeats)),
        Row(name, "the same by way of the arrays", timed(by_arrays, points, repeats)),
    ]


def _currents_for(m: FieldMap, name: str, known: list[np.ndarray], repeats: int) -> list[Row]:
    """Currents for a force 2 % larger than at known currents, from zero and from these. Independent currents only."""
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

    few = min(repeats, 2)
    what = (("currents_for, from nothing", anew), ("from currents of a force 2 % less", warm))
    return [Row(name, of, timed(call, asked, few)) for of, call in what] if asked else []


def measure(quick: bool) -> dict[str, Any]:
    """Measure every map that exists."""
    there = [FOLDER / f"{name}.h5" for name in MAPS if (FOLDER / f"{name}.h5").is_file()]
    missing = [name for name in MAPS if FOLDER / f"{name}.h5" not in there]
    rows = [asdict(row) for path in there for row in rows_of(path, quick)]
    return {"rows": rows, "missing": [f"no {FOLDER / name}.h5: fieldmap map {name}" for name in missing]}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the rows."""
    table = Table("map", "what", "us", "off")
    for row in result["rows"]:
        off = "" if row["off"] is None else f"{row['off']:.0e}"
        table.add_row(row["map"], row["what"], f"{row['us']:.1f}", off)
    console.print(table)
    for line in result["missing"]:
        console.print(line, highlight=False)
