"""Numbers that docs/thesis_dynamics.md prints as ours, compared with runs of the rows S16 and S18."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fieldmap.thesis.computation import PartResult, compute_part
from validation.row import Row

PAGE = Path(__file__).parents[2] / "docs" / "thesis_dynamics.md"
# Part -> (heading of the table, line, columns, name of the numbers).
STEP = ("peak time, s", "rise time, 10 to 90 %, s", "settling time, s", "overshoot, %")
PRINTED: dict[str, list[tuple[str, str, tuple[int, ...], str]]] = {
    "S16_records": [
        ("Table 5-2", gain, (4,), f"zero[{k}]") for k, gain in enumerate(("0.5", "0.334", "0.2"))
    ],
    "S18_vertical": [
        ("Table 7-1", line, (2,), name)
        for line, name in (
            (STEP[0], "peak_time"),
            (STEP[1], "rise_time"),
            ("until the reference is reached, s", "time_to_reference"),
            (STEP[2], "settling_time"),
            (STEP[3], "overshoot"),
            ("RMS at rest, mm", "rms_at_rest"),
        )
    ],
    "S18_horizontal": [
        ("Table 7-2", "rise time, s", (2, 4), "rise_time"),
        ("Table 7-2", "overshoot, %", (2, 4), "overshoot"),
        ("Table 7-2", "RMS at rest, mm", (2, 4), "rms_at_rest"),
    ],
    "S18_regulator": [
        *[("Table 7-3", line, (4,), f"regulator[{k}]") for k, line in enumerate(STEP)],
        *[("Table 7-3", line, (2,), f"pid[{k}]") for k, line in enumerate(STEP)],
        ("Table 7-3", "until the reference is reached, s", (4,), "time_to_reference"),
    ],
    "S18_heights": [("Table 7-4", "RMS, ours, mm", (1, 2, 3, 4, 5), "rms")],
}


def thesis_dynamics() -> Iterator[Row]:
    """The worst line of each table, in units of its last printed digit. Half a unit is for rounding, and half for the
    difference between two makings of the map. Needs the map of `fieldmap map division`."""
    for part, lines in PRINTED.items():
        result = compute_part(part)
        worst = 0.0
        for heading, line, columns, name in lines:
            for text, ours in zip(printed(heading, line, columns), _of(result, name), strict=True):
                worst = max(worst, abs(float(text) - ours) / _unit(text))
        what = "largest distance of the page's numbers from the run, units of the last digit"
        yield Row(result.title, what, worst, 1.0, "docs/thesis_dynamics.md", cpu_seconds=result.seconds)


def printed(heading: str, line: str, columns: tuple[int, ...]) -> list[str]:
    """Cells of a line of the first table below a heading of the page; column 0 is the line's name."""
    section = PAGE.read_text(encoding="utf-8").split(f"## {heading}", 1)[1].split("\n## ", 1)[0]
    for row in section.splitlines():
        cells = [cell.strip() for cell in row.strip().strip("|").split("|")]
        if cells[0] == line:
            return [cells[column] for column in columns]
    raise LookupError(f"{PAGE.name}, {heading}: no line {line!r}")


def _of(result: PartResult, name: str) -> np.ndarray:
    """Our numbers of this name, or of one entry of it."""
    found = [
        c.ours for c in result.comparisons if c.name == name or re.match(rf"{re.escape(name)}\[", c.name)
    ]
    return np.array(found, dtype=float)


def _unit(text: str) -> float:
    """Unit of the last digit.

    >>> _unit("0.186"), _unit("39")
    (0.001, 1.0)
    """
    return 10.0 ** -len(text.partition(".")[2])
