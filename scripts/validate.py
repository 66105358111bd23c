"""Compare the solver with all known references, in one table with pass or fail. `make validate`.

    python scripts/validate.py [--only STUDY ...] [--json]

Errors are the largest over the points, relative to the largest value of the same quantity there, unless the row says
otherwise. Rows without a bound are for information. Wall seconds are meaningful on two quiet cores only; processor
seconds are printed, too. The exit code is 1 if a bound is broken or a row could not be run.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace

from rich.console import Console
from rich.table import Table
from validation import (
    axisymmetric,
    closed_forms,
    convergence,
    current_maps,
    current_steps,
    drive_units,
    electrical_side,
    fuzz,
    joints,
    large_maps,
    mag_manip_program,
    many_coils,
    many_maps,
    map_files,
    progress,
    reaction,
    remembering,
    saturating_machines,
    thesis_dynamics,
    thesis_statics,
    thin_gaps,
    to_tolerance,
)
from validation.row import Row

from fieldmap.errors import FieldmapError

# Each study with its processor seconds, measured once, for the estimate of the time left.
STUDIES: dict[str, tuple[Callable[[], Iterator[Row]], float]] = {
    "spheres": (closed_forms.spheres, 6),
    "shell": (closed_forms.shell, 2),
    "cylinders": (closed_forms.cylinders, 2),
    "sphere_and_coil": (closed_forms.sphere_and_coil, 4),
    "joints": (joints.joints, 90),
    "thin_gaps": (thin_gaps.thin_gaps, 120),
    "to_tolerance": (to_tolerance.to_tolerance, 400),
    "axisymmetric": (axisymmetric.linear, 110),
    "saturated": (axisymmetric.saturated, 30),
    "six_cores": (drive_units.six_cores, 220),
    "unit_linear": (drive_units.unit_linear, 600),
    "unit_other_form": (drive_units.unit_other_form, 30),
    "unit_saturated": (drive_units.unit_saturated, 220),
    "eight_coils": (current_maps.eight_coils, 150),
    "many_coils": (many_coils.many_coils, 300),
    "shipped_maps": (current_maps.shipped_maps, 2400),
    "reaction": (reaction.reaction, 400),
    "current_steps": (current_steps.current_steps, 300),
    "remembering_map": (remembering.remembering_map, 1800),
    "saturating_machines": (saturating_machines.saturating_machines, 900),
    "mesh": (convergence.mesh, 40),
    "spacing": (convergence.spacing, 2),
    "corrupted_maps": (map_files.corrupted_maps, 100),
    "killed_runs": (map_files.killed_runs, 90),
    "killed_training": (map_files.killed_training, 250),
    "killed_workers": (map_files.killed_workers, 400),
    "killed_schedulers": (map_files.killed_schedulers, 200),
    "many_maps": (many_maps.many_maps, 130),
    "progress": (progress.of_progress, 350),
    "fuzz": (fuzz.fuzz, 1500),
    "large_maps": (large_maps.large_maps, 1500),
    "mag_manip": (mag_manip_program.mag_manip, 240),
    "thesis_dynamics": (thesis_dynamics.thesis_dynamics, 60),
    "electrical_side": (electrical_side.electrical_side, 150),
    "thesis_statics": (thesis_statics.thesis_statics, 900),
}


def run(names: list[str], say: Callable[[str], None]) -> Iterator[Row]:
    """Rows of the named studies. A study that fails gives a row with the error, and the others continue."""
    begin, done = time.perf_counter(), 0.0
    expected = sum(STUDIES[name][1] for name in names)
    for number, name in enumerate(names, start=1):
        study, cost = STUDIES[name]
        pace = (time.perf_counter() - begin) / done if done else 1.0
        say(f"[{number}/{len(names)}] {name}: about {pace * (expected - done) / 60:.0f} min left")
        try:
            for row in study():
                say(
                    f"    {row.case}: {row.quantity} {row.value:.2g} {row.verdict} ({row.cpu_seconds:.0f} cpu s)"
                )
                yield replace(row, study=name)
        except (FieldmapError, MemoryError) as error:
            nothing = float("nan")
            yield Row(name, "the study", nothing, None, "-", note=str(error), study=name)
        done += cost


def show(rows: list[Row], console: Console) -> None:
    """Print the table and the totals."""
    load = f"; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores" if hasattr(os, "getloadavg") else ""
    table = Table(title="validation", caption=f"s: wall clock (processor){load} at the end")
    for heading in ("case", "quantity"):
        table.add_column(heading)
    for heading in ("measured", "bound", "", "faces", "steps", "s (cpu)"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("reference")
    for row in rows:
        numbers = (f"{row.value:.2g}", "-" if row.bound is None else f"{row.bound:g}", row.verdict)
        cost = (f"{row.faces}", f"{row.steps}", f"{row.seconds:.0f} ({row.cpu_seconds:.0f})")
        table.add_row(row.case, row.quantity, *numbers, *cost, row.note or row.source)
    console.print(table)
    for study in dict.fromkeys(row.study for row in rows if row.figures):
        console.print(_figures(study, [row.figures for row in rows if row.study == study and row.figures]))
    verdicts = ("pass", "FAIL", "NOT RUN", "skipped")
    count = {verdict: sum(row.verdict == verdict for row in rows) for verdict in verdicts}
    console.print(", ".join(f"{number} {verdict}" for verdict, number in count.items()), highlight=False)


def _figures(study: str, rows: list[dict[str, str]]) -> Table:
    """Table of rows with several numbers."""
    table = Table(title=study)
    for number, heading in enumerate(rows[0]):
        table.add_column(heading, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row.values())
    return table


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=STUDIES, default=list(STUDIES), metavar="STUDY")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    options = parser.parse_args()
    console = Console(stderr=True, width=None if sys.stderr.isatty() else 140)
    if hasattr(os, "getloadavg"):
        load = f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start"
        console.print(load, highlight=False)
    rows = list(run(options.only, lambda text: console.print(text, highlight=False)))
    if options.json:
        print(json.dumps([{**asdict(row), "verdict": row.verdict} for row in rows], indent=2))
    else:
        show(rows, Console(width=None if sys.stdout.isatty() else 170))
    return int(any(row.verdict in ("FAIL", "NOT RUN") for row in rows))


if __name__ == "__main__":
    sys.exit(main())
