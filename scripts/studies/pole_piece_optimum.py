"""Optimisation of the drive unit's pole disk, against the twelve disks of the study `pole_disk`: docs/optimise.md.

    python scripts/studies/pole_piece_optimum.py [--kept FOLDER]

First the problem of the study, from three starts: radius 56 to 88 mm, thickness 3 to 12 mm, the smallest equilibrium
area with equal currents that carry the weight. Then the shipped problem `pole_piece`: radius from 42 mm on, at most
3.3 A. Last a demand that no disk meets. Designs are kept in FOLDER; a second run prints the same table without solves.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from fieldmap.studies import (
    DesignProblem,
    NoFeasibleDesign,
    Optimum,
    read_design_problem,
    read_study,
    solve_problem,
)

# Radius and thickness, mm: the shipped disk, a large thick one, a small thin one.
STARTS = ((66.0, 6.0), (80.0, 10.0), (60.0, 3.5))
# Best of the twelve: 56 mm, 6 mm (docs/studies.md).
BEST_OF_TWELVE = (56.0, 6.0)
# Tolerance of the search without a limit, as a relative change of the area.
TOLERANCE = 1e-3
# Current limit, A, at which no disk carries the weight; and largest number of designs for that search.
TOO_LITTLE, DESIGNS = 3.0, 25


def as_in_the_study(problem: DesignProblem) -> DesignProblem:
    """The shipped problem within the ranges of the study, without the limit. In these ranges all cores stand on the
    disk, which makes all derivatives exact."""
    ranges = [[float(value) for value in axis.values] for axis in read_study("pole_disk").axes]
    variables = tuple(
        replace(one, lower=min(values), upper=max(values))
        for one, values in zip(problem.variables, ranges, strict=True)
    )
    return replace(problem, variables=variables, limits=(), method="SLSQP", tolerance=TOLERANCE)


def begun_at(problem: DesignProblem, start: tuple[float, float]) -> DesignProblem:
    """The problem with another start."""
    pairs = zip(problem.variables, start, strict=True)
    return replace(problem, variables=tuple(replace(one, start=value) for one, value in pairs))


def until_better(found: Optimum, area: float) -> int:
    """Number of solved designs up to the first with a smaller area; 0 if there is none."""
    areas = [step.numbers.get(found.objective, area) for step in found.path]
    return next((k for k, one in enumerate(areas, 1) if one < area), 0)


def row(name: str, start: tuple[float, float], found: Optimum) -> str:
    """One line of the table: best disk, its area on both meshes, and designs."""
    radius, thickness = found.values.values()
    finer = found.verified.objective if found.verified else float("nan")
    return (
        f"| {name} | {start[0]:g}, {start[1]:g} | {radius:.2f}, {thickness:.2f} | {1e6 * found.value:.4f} | "
        f"{1e6 * finer:.4f} | {len(found.path)} | {len(found.failed)} |"
    )


def from_three_starts(shipped: DesignProblem, folder: Path) -> None:
    """Optimise the objective of the study from three starts, and compare with the best of the twelve."""
    problem = as_in_the_study(shipped)
    twelve = replace(begun_at(problem, BEST_OF_TWELVE), solves=1)
    best = solve_problem(twelve, folder / "best_of_twelve.nc")
    print(row("best of the twelve", BEST_OF_TWELVE, best), flush=True)
    every = []
    for number, start in enumerate(STARTS):
        found = solve_problem(begun_at(problem, start), folder / f"start_{number}.nc")
        every.append(found)
        print(row("ranges of the study", start, found), flush=True)
        print(f"  better than the best of the twelve: design {until_better(found, best.value)}")
    areas = [found.value for found in every]
    print(f"  areas differ by {100 * (max(areas) / min(areas) - 1):.2f} %", end="")
    for key in problem.keys:
        values = [found.values[key] for found in every]
        print(f", {key} by {max(values) - min(values):.2f}", end="")
    print(flush=True)


def with_a_limit(shipped: DesignProblem, folder: Path) -> None:
    """Solve the shipped problem, and a problem with a limit that no disk meets."""
    target = folder / "pole_piece.nc"
    found = solve_problem(begun_at(shipped, STARTS[0]), target)
    print(row("at most 3.3 A", STARTS[0], found))
    (limit,) = found.limits
    print(f"  current {limit.value:.3f} A, on the finer mesh {limit.finer:.3f} A: holds {limit.holds}")
    print(f"  ended: {found.ended}", flush=True)
    (current,) = shipped.limits
    demand = replace(shipped, limits=(replace(current, upper=TOO_LITTLE),), solves=DESIGNS)
    try:
        solve_problem(begun_at(demand, STARTS[0]), target)
    except NoFeasibleDesign as error:
        print(f"at most {TOO_LITTLE:g} A: {error} ({len(error.path)} designs)")


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
    print("| problem | start, mm | best, mm | area, mm2 | on the finer mesh | designs | failed |")
    print(f"|{'---|' * 7}")
    from_three_starts(shipped, folder)
    with_a_limit(shipped, folder)


if __name__ == "__main__":
    main()
