"""The drive unit's pole disk, optimised from several starts, beside the twelve disks of the study `pole_disk`.

    python scripts/pole_piece_optimum.py [--kept FOLDER]

First as the study has it: radius 56 to 88 mm, thickness 3 to 12 mm, the smallest equilibrium area with equal currents
that carry. Then the shipped problem `pole_piece`: radius from 42 mm on, at most 3.3 A on the mesh of the device file.
Designs are kept in FOLDER; a second run prints the same table and solves nothing.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

from fieldmap.studies import DesignProblem, Optimum, read_design_problem, solve_problem

# Radius and thickness, mm: the shipped disk, a large thick one, a small thin one.
STARTS = ((66.0, 6.0), (80.0, 10.0), (60.0, 3.5))
# Best of the twelve: 56 mm, 6 mm (docs/studies.md), on the mesh of the search.
BEST_OF_TWELVE = (56.0, 6.0)
# Of the search without a limit: relative change of the area.
TOLERANCE = 1e-2


def as_in_the_study(problem: DesignProblem) -> DesignProblem:
    """The shipped problem within the ranges of the study, without the limit."""
    radius, thickness = problem.variables
    return replace(
        problem,
        variables=(replace(radius, lower=56.0), thickness),
        limits=(),
        tolerance=TOLERANCE,
        check_refinement=1.4,
    )


def begun_at(problem: DesignProblem, start: tuple[float, float]) -> DesignProblem:
    """The problem with another start."""
    pairs = zip(problem.variables, start, strict=True)
    return replace(problem, variables=tuple(replace(one, start=value) for one, value in pairs))


def row(name: str, start: tuple[float, float], found: Optimum, seconds: float) -> str:
    """One line of the table."""
    radius, thickness = found.values.values()
    check = found.verified
    assert check is not None
    failed = len(found.failed)
    current = (
        "" if not found.limits else f" | {found.limits[0].value:.3f} | {found.limits[0].finer or 0.0:.3f}"
    )
    held = "" if not found.limits else f" | {'holds' if check.holds else 'fails'}"
    return (
        f"{name} | {start[0]:g}, {start[1]:g} | {radius:.2f}, {thickness:.2f} | {1e6 * found.value:.4f} | "
        f"{1e6 * check.objective:.4f}{current}{held} | {len(found.path)} ({failed} failed) | {seconds:.0f}"
    )


def main() -> None:
    """Print the tables."""
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument(
        "--kept", type=Path, default=Path("maps/out/pole_piece"), help="folder of the designs"
    )
    folder = arguments.parse_args().kept
    shipped = read_design_problem("pole_piece")
    print(
        "problem | start, mm | best, mm | area, mm2 | on the finer mesh | [current, A | finer, A | limit] | designs | s"
    )
    for name, problem in (("ranges of the study", as_in_the_study(shipped)), ("at most 3.3 A", shipped)):
        for number, start in enumerate(STARTS):
            before = time.process_time()
            target = folder / f"{name.replace(' ', '_')}_{number}.nc"
            found = solve_problem(begun_at(problem, start), target)
            print(row(name, start, found, time.process_time() - before), flush=True)
    best = as_in_the_study(shipped)
    found = solve_problem(replace(begun_at(best, BEST_OF_TWELVE), solves=1), folder / "best_of_the_study.nc")
    print(row("best of the twelve", BEST_OF_TWELVE, found, 0.0))


if __name__ == "__main__":
    main()
