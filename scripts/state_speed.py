"""What a state of saturating iron costs: assembly, first and neighbouring state, tangents; for two versions in turn.

    python scripts/state_speed.py                              # this checkout
    python scripts/state_speed.py --before ../before           # beside another one, in the same sitting

Each figure is the least of some runs: seconds of the clock and of the processors. Kernels are compiled before. Run it
on a quiet machine; the ratio of two versions means more than the seconds.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
# At what all coils carry, and at a neighbour: a change of the currents by up to a fifth.
FIRST = (1.5, 1.5, 1.5, 1.5, 1.5, 1.5)
NEXT = (1.7, 1.5, 1.3, 1.6, 1.4, 1.5)
MEASURED = ("assembly", "first state", "neighbouring state", "tangents along three signals")

CHILD = """
import json, sys
from time import perf_counter, process_time
import numpy as np
import fieldmap as fm
from fieldmap.currents import LiftAndDirections
from fieldmap.iron import NonlinearSolver

first, following, refinement, runs = json.loads(sys.argv[1])
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
    measure("neighbouring state", lambda: solver.solve(following, start=state))
    if hasattr(solver, "sensitivities"):
        along = LiftAndDirections(1.25).derivative([1.5, 0.0, 0.0])
        potential = state.state.potential[:, 0]
        measure("tangents along three signals", lambda: solver.sensitivities(np.array(first), potential, along))
print(json.dumps(found))
"""


def measured(package: Path, refinement: float, runs: int) -> dict[str, tuple[float, float]]:
    """Seconds of the clock and of the processors, by name, of the package in a checkout."""
    given = json.dumps([FIRST, NEXT, refinement, runs])
    environment = os.environ | {"PYTHONPATH": str(package.resolve())}
    # Without -P the folder in which it runs would come before the checkout.
    command = [sys.executable, "-P", "-c", CHILD, given]
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
    given = parser.parse_args()
    versions = {"now": ROOT} if given.before is None else {"before": given.before, "now": ROOT}
    found = {name: measured(package, given.refinement, given.runs) for name, package in versions.items()}
    print(f"{'seconds, clock / processors':32s}" + "".join(f"{name:>18s}" for name in versions))
    for what in MEASURED:
        cells = (found[name].get(what) for name in versions)
        print(
            f"{what:32s}"
            + "".join(f"{'':>18s}" if c is None else f"{c[0]:9.2f} / {c[1]:6.2f}" for c in cells)
        )


if __name__ == "__main__":
    main()
