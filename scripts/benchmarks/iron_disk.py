"""Error over seconds and over unknowns of this solver and of magpylib-material-response, on one iron disk."""

import sys
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.disk_case import Row, fieldmap_row, material_response_row

Array = NDArray[np.float64]
REFINEMENTS = (0.5, 0.7, 0.85, 1.0, 1.4)
# Cells across and layers of the other program, in the order in which its error falls fastest with time.
GRIDS = ((24, 2), (24, 3), (24, 4), (24, 6), (32, 6))
TARGET = 1e-3


def measure(quick: bool) -> dict[str, Any]:
    """Rows of both programs, and their comparison. A first solve compiles all kernels, outside the timing."""
    fieldmap_row(REFINEMENTS[0])
    ours = [fieldmap_row(r) for r in REFINEMENTS[: 2 if quick else None]]
    theirs, note = [], ""
    try:
        import magpylib_material_response as other

        note = f"magpylib-material-response {other.__version__}"
        theirs = [material_response_row(*grid) for grid in GRIDS[: 1 if quick else None]]
    except ModuleNotFoundError:
        note = "magpylib-material-response is not installed: pip install -e .[bench], or `make bench`"
        print(note, file=sys.stderr)
    return {
        "case": "iron disk, radius 66 mm, height 6 mm, mu_r 4000, under a coil of 840 ampere-turns",
        "other": note,
        "rows": [asdict(row) for row in (*ours, *theirs)],
        "ratios": comparison(ours, theirs),
    }


def seconds_at(rows: list[Row], error: float) -> tuple[float, float]:
    """Wall and processor seconds at an error, by log-log interpolation between rows; the coarsest mesh's if its error
    is smaller, NaN if all errors are larger."""
    if not rows or min(row.field_error for row in rows) > error:
        return float("nan"), float("nan")
    ordered = sorted(rows, key=lambda row: row.field_error)
    errors = np.log([row.field_error for row in ordered])
    times = np.log([[row.seconds, row.cpu_seconds] for row in ordered])
    wall, cpu = (float(np.exp(np.interp(np.log(error), errors, times[:, k]))) for k in range(2))
    return wall, cpu


def slope(rows: list[Row]) -> float:
    """Least-squares exponent p of error ~ (processor seconds)^-p."""
    x, y = (np.log([getattr(row, name) for row in rows]) for name in ("cpu_seconds", "field_error"))
    return float(-np.polyfit(x, y, 1)[0])


def comparison(ours: list[Row], theirs: list[Row]) -> list[str]:
    """Ratios of times at each error that the other program reaches, and at the target, measured or extrapolated."""
    lines = []
    for row in theirs:
        wall, cpu = seconds_at(ours, row.field_error)
        coarsest = "at least " if row.field_error > max(r.field_error for r in ours) else ""
        lines.append(
            f"at their error of {row.field_error:.1e} (theirs {row.seconds:.1f} s): {coarsest}{row.seconds / wall:.0f} "
            f"times less time, {row.cpu_seconds / cpu:.0f} times less processor time"
        )
    if not theirs:
        return lines
    best = min(theirs, key=lambda row: row.field_error)
    if best.field_error <= TARGET:
        (wall, cpu), (their_wall, their_cpu) = (seconds_at(rows, TARGET) for rows in (ours, theirs))
        lines.append(
            f"at {TARGET:g}: {their_wall / wall:.0f} times less, {their_cpu / cpu:.0f} in processor time"
        )
        return lines
    lines.append(
        f"they do not reach {TARGET:g}: {best.field_error:.1e} in {best.seconds:.0f} s is their best here"
    )
    if len(theirs) > 2 and min(row.field_error for row in ours) <= TARGET:
        power, (_, cpu) = slope(theirs), seconds_at(ours, TARGET)
        needed = best.cpu_seconds * (best.field_error / TARGET) ** (1 / power)
        lines.append(
            f"EXTRAPOLATED to {TARGET:g}: their error falls as processor time to the power -{power:.2f}, so "
            f"{needed:.0f} s of it against our measured {cpu:.1f} s: about {needed / cpu:.0f} times less"
        )
    return lines


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table and the ratios."""
    table = Table(
        title=result["case"],
        caption="s: mesh and solve, wall clock (processor); evaluation: 63 points, ours with the gradient; "
        "errors: largest over the points by the largest value",
    )
    table.add_column("program")
    table.add_column("mesh")
    for heading in ("unknowns", "s", "(cpu s)", "evaluation s", "error of B", "of gradient"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        gradient = "-" if row["gradient_error"] is None else f"{row['gradient_error']:.1e}"
        times = (f"{row['seconds']:.2f}", f"({row['cpu_seconds']:.2f})", f"{row['evaluation_seconds']:.3f}")
        table.add_row(
            row["program"], row["mesh"], str(row["unknowns"]), *times, f"{row['field_error']:.1e}", gradient
        )
    console.print(table)
    console.print(result["other"], highlight=False)
    for line in result["ratios"]:
        console.print(f"- {line}", highlight=False)
