"""The numbers that the thesis prints, beside ours: one row per system, as data and functions.

The row files in printed_numbers/ declare what is printed, with its place, and which function computes ours; the modules
of this package hold these functions. They use the public API of the other packages, as a reader's own script would, and
only the command line imports this package. `compare` puts printed numbers and ours side by side.
"""

from fieldmap.curves import Curves, Series
from fieldmap.deprecated import warn_renamed
from fieldmap.thesis.computation import Comparison, PartResult, attempt_rows, compare
from fieldmap.thesis.printed import read_rows
from fieldmap.thesis.rows import Answers, Ours, part_names, row_names

__all__ = [
    "Answers",
    "Comparison",
    "Curves",
    "Ours",
    "PartResult",
    "Series",
    "attempt_rows",
    "compare",
    "part_names",
    "read_rows",
    "row_names",
]


def __getattr__(name: str) -> dict[str, str]:
    """Tables that row files have replaced: functions of the parts, and systems of the rows."""
    if name == "PARTS":
        warn_renamed(f"{__name__}.PARTS", f"{__name__}.read_rows()")
        parts = {part: of for row in read_rows().values() for part, of in row.parts.items()}
        return {part: f"fieldmap.thesis.{of.ours.replace('.', ':')}" for part, of in parts.items()}
    if name == "ROWS":
        warn_renamed(f"{__name__}.ROWS", f"{__name__}.read_rows()")
        return {row: of.system for row, of in read_rows().items()}
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
