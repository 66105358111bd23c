"""A finished study as a table for people and rows for programs."""

from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.cli.printing import assumption_lines, facts, heading, print_page, table
from fieldmap.studies import StudyRun
from fieldmap.studies.quantities import Quantity, recorded

# Heads of the table's columns and their significant digits; what has none is in the data set only.
_HEADS = {
    "common_current": ("current", 4),
    "equilibrium_x": ("x", 3),
    "equilibrium_y": ("y", 3),
    "stiffness_x": ("k_x", 3),
    "stiffness_z": ("k_z", 3),
    "equilibrium_area": ("area", 3),
    "reach_height": ("reach", 4),
    "reachable_share": ("reachable", 3),
    "largest_flux_density": ("B iron", 3),
    "error_flux_density": ("error", 2),
}
_UNITS = {"N m-1": "N/m", "mm2": "mm^2", "1": ""}


def study_rows(run: StudyRun) -> list[dict[str, Any]]:
    """One row for each variant and set of currents, SI, numbers by the names of the data set."""
    rows = []
    for place, variant in _places(run):
        here = run.data.isel(place)
        for name in run.data.currents.values:
            at = here.sel(currents=name)
            numbers = {q.name: at[q.name].values for q in recorded(run.study.record.groups)}
            settings = {
                axis.name: axis.values[k] for axis, k in zip(run.study.axes, place.values(), strict=False)
            }
            about = settings or {"variant": variant}
            rows.append({**about, "currents": str(name), **numbers, "problem": str(at["problem"].item())})
    return rows


def _places(run: StudyRun) -> list[tuple[dict[str, int], str]]:
    """Where each variant lies in the data set, and its name."""
    names = [axis.name for axis in run.study.axes] or ["variant"]
    return [(dict(zip(names, v.place, strict=True)), v.name) for v in run.study.variants]


def print_study(run: StudyRun, files: list[Path]) -> None:
    """The scalar summaries, the reasons of what is missing, what the numbers rest on, and the files."""
    summaries = [q for q in recorded(run.study.record.groups) if q.name in _HEADS]
    rows_of_data = study_rows(run)
    shown = [q for q in summaries if any(_cell(q, row[q.name]) not in ("-", "0") for row in rows_of_data)]
    axes = [f"{axis.name}\n{_UNITS.get(axis.unit, axis.unit)}" for axis in run.study.axes] or ["variant"]
    several = len(run.study.current_sets) > 1
    columns = [*axes, *(["currents"] if several else []), *(_head(q) for q in shown)]
    rows = []
    for row in rows_of_data:
        about = [_setting(row[axis.name]) for axis in run.study.axes] or [str(row["variant"])]
        rows.append(
            [*about, *([row["currents"]] if several else []), *(_cell(q, row[q.name]) for q in shown)]
        )
    count = f"{len(run.study.variants)} variants of {run.study.device_document.data.get('name', 'a device')}"
    about = str(run.data.attrs["assumptions"]).split("\n")
    print_page(
        heading(run.study.title, count),
        table(columns, rows, left=len(axes) + several),
        facts([("failed", f"{name}: {text}") for name, reasons in run.failed.items() for text in reasons])
        if run.failed
        else None,
        facts([*_limits(run), *assumption_lines(about)]),
        facts([("written" if k == 0 else "", str(path)) for k, path in enumerate(files)]),
    )


def _setting(value: Any) -> str:
    return str(value) if isinstance(value, str) else f"{value:g}"


def _head(quantity: Quantity) -> str:
    unit = _UNITS.get(quantity.printed_unit, quantity.printed_unit)
    return f"{_HEADS[quantity.name][0]}\n{unit}"


def _cell(quantity: Quantity, value: Any) -> str:
    number = quantity.printed[0] * float(np.asarray(value))
    number = 0.0 if abs(number) < 1e-6 else number  # what rounding left
    if not np.isfinite(number):
        return "-"
    return f"{number:.{_HEADS[quantity.name][1]}g}"


def _limits(run: StudyRun) -> list[tuple[str, str]]:
    record = run.study.record
    lines = []
    if "equilibrium_area" in record.groups:
        lines.append(("eq. area", f"horizontal force below {100 * record.force_share:g} % of the weight"))
    if record.current_limit is not None and {"reach", "reachable_share"} & set(record.groups):
        lines.append(("reach", f"with at most {record.current_limit:g} A in every coil"))
    return lines
