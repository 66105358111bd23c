"""A table of the weights of a map's fields as the C core takes it: fieldmap/core/current_table.h."""

from typing import Any, NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

FOUND: int = LIBRARY.TABLE_FOUND
BESIDE: int = LIBRARY.TABLE_BESIDE
BEYOND: int = LIBRARY.TABLE_BEYOND
"""Status of the weights of a table: interpolated; the currents belong to no division; the division lies outside the
table, or the current of a coil exceeds the limit."""


class Table(NamedTuple):
    """exponent: of the division; limit: largest current of a coil, A, or infinity; mismatch: allowed difference
    between currents and their division, as a share of u; lower, upper (3,): range of the signals u, x, y. nodes: of
    u, x and y (nu,), (nx,), (ny,); knots: of their splines, four more each. coefficients (nu, nx, ny, k) of the
    splines; slopes (nu, nx, ny, 6, k), 1/A, or (0, 0, 0, 0, 0) for weights that are constant outside the table."""

    exponent: float
    limit: float
    mismatch: float
    lower: Array
    upper: Array
    knots: tuple[Array, Array, Array]
    nodes: tuple[Array, Array, Array]
    coefficients: Array
    slopes: Array


class CoreTable:
    """A table, ready for the functions of the core. Its arrays are float64 and in C order, and must not change."""

    def __init__(self, numbers: Table) -> None:
        self.numbers = numbers
        self.table = LIBRARY.current_table(numbers)

    def weights(self, currents: Array, weights: Array) -> int:
        """Fill weights (6 + k,) at currents (6,): the currents, then weights of the table. Returns the status."""
        return int(LIBRARY.table_weights(self.table, currents, weights))

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreTable, (self.numbers,)


def signals_of(currents: Array, exponent: float) -> tuple[float, float, float, float]:
    """Return u, x, y of the division nearest to currents (6,), and the largest difference as a share of u."""
    u, x, y, mismatch = LIBRARY.division_signals(currents, exponent)
    return u, x, y, mismatch
