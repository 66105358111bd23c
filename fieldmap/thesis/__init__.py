"""The numbers that the thesis prints, beside ours: one row per system, as data and a function.

What is printed lies in the data folder thesis/ (one TOML file per part of a row, every number with its place); what
we make of it lies here, one function per part. `compare` puts the two side by side. Depends on every room but `cli`
and `view`, each imported when its row is asked for.
"""

from fieldmap.curves import Curves, Series
from fieldmap.thesis.computation import Comparison, PartResult, attempt_rows, compare
from fieldmap.thesis.rows import PARTS, ROWS, Answers, Ours, row_names

__all__ = [
    "PARTS",
    "ROWS",
    "Answers",
    "Comparison",
    "Curves",
    "Ours",
    "PartResult",
    "Series",
    "attempt_rows",
    "compare",
    "row_names",
]
