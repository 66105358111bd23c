"""Time of saturating iron: assembly, first and neighbouring state, tangents, a linear unit, and a whole map by stages;
for two versions in turn.

    python scripts/studies/state_speed.py                              # this checkout
    python scripts/studies/state_speed.py --before ../before           # beside another one, in the same sitting
    python scripts/studies/state_speed.py --before ../before --map     # and a map over the currents of the division

Figures are wall and processor seconds, the least of some runs, or of one run for a map. Kernels are compiled before the
measurement. Run it on a quiet machine; the ratio of two versions means more than the seconds.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
# Currents of the first state, and of two neighbours: slightly more in all coils, and up or down by up to a seventh.
FIRST = (1.5, 1.5, 1.5, 1.5, 1.5, 1.5)
MORE = (1.6, 1.6, 1.6, 1.6, 1.6, 1.6)
OTHERS = (1.7, 1.5, 1.3, 1.6, 1.4, 1.5)
MEASURED = (
    "assembly",
    "first state",
    "state with a fifteenth more",
    "state with others, by a seventh",
    "tangents along three signals",
    "linear unit, seven coils",
)
# Part of a progress message -> stage that begins with it. Other messages belong to the present stage.
STAGES = {
    "geometry": "map: assembly",
    "choosing states": "map: choice of states",
    "of at most": "map: states to train on",
    "in corners": "map: states in corners",
    "at extremes": "map: states at extremes",
    "worst currents": "map: search for the worst",
    "sample points": "map: sample points",
    "at random": "map: states at random",
    "fields of the modes": "map: fields of the modes",
    "field at the nodes": "map: fields at the nodes",
    "certifying": "map: certificate",
}
# Recipe for both versions: the division of the thesis, over a part of the currents that the unit can carry.
RECIPE = """
format = 1
title = "Map of two versions"
device = "drive_unit"
spacing_mm = 4.0

[iron]
model = "saturating"
refinement = {refinement}

[currents]
lift_and_directions = {{ u_A = [1.0, 2.2], x = [-0.4, 0.4], y = [-0.3, 0.3], n = 1.25 }}
states = {states}
accuracy = {accuracy}
modes = 60
points = 700
held_out = {held_out}
"""

CHILD = """
import json, sys
from dataclasses import replace
from time import perf_counter, process_time
import numpy as np
import fieldmap as fm
from fieldmap.iron import NonlinearSolver

first, more, others, refinement, runs = json.loads(sys.argv[1])
device = fm.read_device("drive_unit")
found = {}

def measure(name, action):
    begin, processor = perf_counter(), process_time()
    value = action()
    spent = perf_counter() - begin, process_time() - processor
    found[name] = min(found.get(name, (1e9, 1e9)), spent)
    return value

NonlinearSolver(device, 0.4 * refinement).solve(first)
for _ in range(runs):
    solver = measure("assembly", lambda: NonlinearSolver(device, refinement))
    state = measure("first state", lambda: solver.solve(first))
    measure("state with a fifteenth more", lambda: solver.solve(more, start=state))
    measure("state with others, by a seventh", lambda: solver.solve(others, start=state))
    # Earlier versions have neither of these.
    if hasattr(solver, "sensitivities"):
        from fieldmap.currents import LiftAndDirections

        along = LiftAndDirections(1.25).derivative([1.5, 0.0, 0.0])
        potential = state.state.potential[:, 0]
        measure("tangents along three signals", lambda: solver.sensitivities(np.array(first), potential, along))
unit = fm.read_device("drive_unit_a3")
five = unit.coils[unit.coil_names.index("5")]
at = np.array([0.0, 0.0, float(five.placement.position[2])])
unit = replace(unit, coils=(*unit.coils, replace(five, name="7", placement=type(five.placement)(at, np.eye(3)))))
fm.solve_linear(unit, mu_r=4000.0, refinement=0.4 * refinement)
for _ in range(runs):
    measure("linear unit, seven coils", lambda: fm.solve_linear(unit, mu_r=4000.0, refinement=refinement))
print(json.dumps(found))
"""
OF_MAP = """
import json, sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
import fieldmap as fm

recipe, quick, stages = json.loads(sys.argv[1])
found, stage, since = {}, "", (perf_counter(), process_time())

def tell(message, share):
    global stage, since
    begins = next((name for words, name in stages.items() if words in message), stage)
    if begins == stage and message != "complete":
        return
    now = perf_counter(), process_time()
    if stage:
        before = found.get(stage, (0.0, 0.0))
        found[stage] = (before[0] + now[0] - since[0], before[1] + now[1] - since[1])
    stage, since = begins, now

with TemporaryDirectory() as folder:
    path = Path(folder) / "recipe.toml"
    path.write_text(quick)
    fm.generate(path, path.with_suffix(".h5"))
    path.write_text(recipe)
    begin = perf_counter(), process_time()
    fm.generate(path, path.with_suffix(".h5"), progress=tell)
    found["map: all of it"] = perf_counter() - begin[0], process_time() - begin[1]
print(json.dumps(found))
"""


def measured(package: Path, refinement: float, runs: int) -> dict[str, tuple[float, float]]:
    """Wall and processor seconds, by name, of the package in a checkout."""
    return _run(package, CHILD, [FIRST, MORE, OTHERS, refinement, runs])


def measured_map(package: Path, refinement: float) -> dict[str, tuple[float, float]]:
    """Wall and processor seconds of the stages of a map, by name."""
    recipe = RECIPE.format(refinement=refinement, states=60, held_out=20, accuracy=1.2e-3)
    quick = RECIPE.format(refinement=0.4 * refinement, states=6, held_out=2, accuracy=0.5)
    return _run(package, OF_MAP, [recipe, quick, STAGES])


def _run(package: Path, program: str, given: list[Any]) -> dict[str, tuple[float, float]]:
    environment = os.environ | {"PYTHONPATH": str(package.resolve())}
    # Without -P the current folder would come before the checkout on the path.
    command = [sys.executable, "-P", "-c", program, json.dumps(given)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return {name: (wall, processor) for name, (wall, processor) in json.loads(done.stdout).items()}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--before", type=Path, metavar="CHECKOUT", help="another version to measure beside this one"
    )
    parser.add_argument("--refinement", type=float, default=1.0, help="of the shipped mesh of the drive unit")
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--map", action="store_true", help="make a map too: some minutes for each version")
    given = parser.parse_args()
    versions = {"now": ROOT} if given.before is None else {"before": given.before, "now": ROOT}
    found = {name: measured(package, given.refinement, given.runs) for name, package in versions.items()}
    rows = MEASURED
    if given.map:
        for name, package in versions.items():
            found[name] |= measured_map(package, given.refinement)
        rows = (*MEASURED, *dict.fromkeys(STAGES.values()), "map: all of it")
    print(f"{'seconds, clock / processors':32s}" + "".join(f"{name:>18s}" for name in versions))
    for what in rows:
        cells = (found[name].get(what) for name in versions)
        print(
            f"{what:32s}"
            + "".join(f"{'':>18s}" if c is None else f"{c[0]:9.2f} / {c[1]:6.2f}" for c in cells)
        )


if __name__ == "__main__":
    main()
