"""Comparison of the numbers that the thesis prints with ours: one row per system, as data and functions.

The row files in printed_numbers/ declare each printed number with its place, and the function that computes ours; the
modules of this package hold these functions. They use the public API of the other packages, as a reader's own script
would, and only the command line imports this package. `compare` returns the printed numbers and ours.
"""

from fieldmap.curves import Curves, Series
from fieldmap.thesis.computation import Answers, Comparison, Ours, PartResult, attempt_rows, compare
from fieldmap.thesis.printed import part_names, read_rows, row_names

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
