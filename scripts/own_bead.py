"""Measure the figures of the bead in docs/own_controller.md: run the page's code block on the shipped recipe's map.

    fieldmap map eight_coils_bead
    python scripts/own_bead.py [--map maps/out/eight_coils_bead.h5]        (half a minute)

Prints processor seconds of 10 s, the least of some runs in turns, for the function in Python and in numba, on the iron
model and on iron linearised about the start; the time of a call of each function; and the distance from the path.
"""

import argparse
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from fieldmap.control import FunctionController
from fieldmap.dynamics import prepare, read_scenario

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "own_controller.md"
MAP = "maps/out/eight_coils_bead.h5"
REPEATS, ROUNDS, CALLS = 3, 5, 20_000


def the_block(map_file: str) -> dict[str, Any]:
    """Variables of the page's block after it ran on a map."""
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    (code,) = [block for block in blocks if MAP in block]
    names: dict[str, Any] = {}
    exec(compile(code.replace(MAP, map_file), str(PAGE), "exec"), names)
    return names


def off_path(run: Any, height: float) -> np.ndarray:
    """RMS distances (3,) from the circle, um, from 1 s on."""
    angle = 0.4 * np.pi * np.maximum(run.time - 1.0, 0.0)
    path = [1e-3 * (np.cos(angle) - 1.0), 1e-3 * np.sin(angle), height + 5e-4 * np.sin(2.0 * angle)]
    off = (run.sensed - np.stack(path, axis=1))[run.time >= 1.0]
    return np.asarray(1e6 * np.sqrt(np.mean(off**2, axis=0)))


def call_in_python(function: Any) -> float:
    """Processor seconds of a call from Python, the least of some rounds."""
    state, where = np.zeros(7), np.zeros(3)
    spent = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        for index in range(CALLS):
            function(1e-3 * index, where, where, state)
        spent.append((time.process_time() - begin) / CALLS)
    return min(spent)


def call_in_numba(function: Any) -> float:
    """Processor seconds of a call from compiled code, as the compiled loop of a simulation makes it."""

    @numba.njit
    def many(count: int, where: np.ndarray, state: np.ndarray) -> float:
        total = 0.0
        for index in range(count):
            lift, x, y = function(1e-3 * index, where, where, state)
            total += lift + x + y
        return total

    state, where, count = np.zeros(7), np.zeros(3), 100 * CALLS
    many(1, where, state)
    spent = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        many(count, where, state)
        spent.append((time.process_time() - begin) / count)
    return min(spent)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--map", default=MAP, help="map of eight_coils_bead")
    names = the_block(parser.parse_args().map)
    compiled: FunctionController = names["controller"]
    forms = {"Python": replace(compiled, function=names["hold"]), "numba": compiled}
    runs: dict[tuple[str, str], Any] = {}
    best: dict[tuple[str, str], float] = {}
    for iron in ("model", "linearised"):
        scenario = read_scenario("bead", {**names["changes"], "field.iron": iron})
        ready = {form: prepare(scenario, names["m"], controller=each) for form, each in forms.items()}
        for experiment in ready.values():
            experiment.warm()
        for _ in range(REPEATS):
            for form, experiment in ready.items():
                begin = time.process_time()
                runs[iron, form] = experiment.run()
                spent = time.process_time() - begin
                best[iron, form] = min(best.get((iron, form), np.inf), spent)
    for (iron, form), run in runs.items():
        off = ", ".join(f"{value:.1f}" for value in off_path(run, names["HEIGHT"]))
        largest = np.abs(run.currents).max()
        print(
            f"{iron:10} {form:6} {best[iron, form]:.2f} s; off {off} um RMS; at most {largest:.2f} A; {run.event}"
        )
    use = runs["model", "numba"].iron
    each = 1e6 * (best["model", "numba"] - best["linearised", "numba"]) / use.solves
    print(
        f"{use.solves} solves, {use.newton_steps / use.solves:.2f} Newton steps and {each:.0f} us each, "
        f"{use.unsolved} did not converge, {use.outside} beyond the map's currents"
    )
    same = np.array_equal(runs["model", "Python"].rows, runs["model", "numba"].rows)
    apart = np.abs(runs["model", "numba"].position - runs["linearised", "numba"].position).max()
    print(
        f"Python and numba: the same bits: {same}; model and linearised iron: up to {1e6 * apart:.2f} um apart"
    )
    calls = {"Python": call_in_python(names["hold"]), "numba": call_in_numba(compiled.function)}
    print(
        f"one call of the function: in Python {1e6 * calls['Python']:.2f} us, in numba {1e9 * calls['numba']:.1f} ns, "
        f"{calls['Python'] / calls['numba']:.0f} times as fast"
    )


if __name__ == "__main__":
    main()
