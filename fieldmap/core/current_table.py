"""A table of the weights of a map's fields as the C core takes it: fieldmap/core/current_table.h."""

from typing import Any, NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

FOUND: int = LIBRARY.TABLE_FOUND
BESIDE: int = LIBRARY.TABLE_BESIDE
BEYOND: int = LIBRARY.TABLE_BEYOND
"""How good the weights of a table are: of a division in it; of currents beside every division; of a division beyond
the table, or with a coil beyond the limit."""


class Table(NamedTuple):
    """exponent: of the division; limit: of a coil's current, A, or infinity; mismatch: share of the lift by which
    currents may be off their division; lower, upper (3,): of the signals u, x, y. nodes: of u, x and y (nu,), (nx,),
    (ny,); knots: of their splines, four more each. coefficients (nu, nx, ny, k) of the splines; slopes (nu, nx, ny, 6,
    k), 1/A, or (0, 0, 0, 0, 0) for none: outside the table the weights stay."""

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
        """Fill weights (6 + k,) at currents (6,): the currents, then those of the table; how good they are."""
        return int(LIBRARY.table_weights(self.table, currents, weights))

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreTable, (self.numbers,)


def signals_of(currents: Array, exponent: float) -> tuple[float, float, float, float]:
    """u, x, y of the division nearest to currents (6,), and by what share of u it is off."""
    u, x, y, mismatch = LIBRARY.division_signals(currents, exponent)
    return u, x, y, mismatch
