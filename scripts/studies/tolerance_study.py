"""Twenty devices refined to a tolerance, as a table: docs/theory/iron_tolerance.md, "Accuracy".

    python scripts/studies/tolerance_study.py [NAME ...]

Names, or parts of them, choose devices (`scripts/validation/tolerance_devices.py`). The message of a run that does not
reach the tolerance follows its line.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from validation.to_tolerance import run
from validation.tolerance_devices import all_devices

HEAD = "| device | asked | meshes | faces | tetrahedra | estimate of B, gradient | true errors | ended | s |"


def main() -> None:
    """Print a line for each device."""
    print(f"{HEAD}\n|{'---|' * 9}", flush=True)
    said = []
    for known in all_devices():
        if sys.argv[1:] and not any(name in known.name for name in sys.argv[1:]):
            continue
        one = run(known)
        last, error = one.report.steps[-1], one.estimate
        estimates = f"{100 * error.flux_density:.2g}, {100 * error.gradient:.2g} %"
        true = f"{100 * one.true[0]:.2g}, {100 * one.true[1]:.2g} %"
        counts = f"{len(one.report.steps)} | {last.faces} | {last.tetrahedra}"
        name = f"{known.name} ({known.truth})"
        print(
            f"| {name} | {100 * known.asked:g} % | {counts} | {estimates} | {true} | {one.report.ended} | "
            f"{one.seconds:.0f} |",
            flush=True,
        )
        if not one.report.reached:
            said.append(f"{known.name}: {one.said}")
    print("\n" + "\n".join(said))


if __name__ == "__main__":
    main()
