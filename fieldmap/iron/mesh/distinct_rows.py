"""Distinct edges and faces of a mesh: rows of node numbers, each once."""

from typing import NamedTuple

import numpy as np

from fieldmap.records import tuple_line
from fieldmap.typing import Index


class DistinctRows(NamedTuple):
    """rows (m, k), sorted; first, times (m,): where each is first and how often; number (n,): of each row given."""

    rows: Index
    first: Index
    number: Index
    times: Index

    def __repr__(self) -> str:
        return tuple_line(self)


def distinct_rows(rows: Index) -> DistinctRows:
    """The distinct rows among rows (n, k) of numbers from 0 on, in lexicographic order.

    `numpy.unique(rows, axis=0)` compares rows byte by byte; here a row is one number, its digits in a base beyond the
    largest, and sorting takes a tenth of the time. Raises OverflowError where that number has more than 63 bits.

    >>> found = distinct_rows(np.array([[1, 2], [0, 5], [1, 2]]))
    >>> found.rows.tolist(), found.first.tolist(), found.number.tolist(), found.times.tolist()
    ([[0, 5], [1, 2]], [1, 0], [1, 0, 1], [1, 2])
    """
    base = int(rows.max(initial=0)) + 1
    width = rows.shape[1]
    if base**width > 2**63:
        raise OverflowError(f"{width} numbers below {base} do not fit into 63 bits")
    digits = base ** np.arange(width - 1, -1, -1, dtype=np.int64)
    keys, first, number, times = np.unique(
        rows.astype(np.int64) @ digits, return_index=True, return_inverse=True, return_counts=True
    )
    return DistinctRows(keys[:, None] // digits % base, first, number, times)
