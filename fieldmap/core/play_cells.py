"""Iron with hysteresis at given fields: play cells as the C core has them (docs/theory/hysteresis.md)."""

from typing import NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.records import tuple_line
from fieldmap.threads import over_rows
from fieldmap.typing import Array

# Of a cell, as `over_rows` counts it.
_WORK = 20.0


class PlayCells(NamedTuple):
    """Play cells, k at each of p points. All arrays are float64 and in C order; others raise TypeError.

    law (p,): number of the law of every point; offset (l + 1,), knots (n,), coefficients (n, 4): the laws, as in
    `fieldmap.kernels.iron.magnetisation_law`; pinning (l, k): pinning fields of the cells in each law, T; shares (k,),
    their sum 1.
    """

    law: Array
    offset: Array
    knots: Array
    coefficients: Array
    pinning: Array
    shares: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def respond(
        self,
        h: Array,
        before: Array,
        polarisation: Array,
        after: Array | None = None,
        susceptibility: Array | None = None,
    ) -> None:
        """Fill polarisation (p, 3), T, and unless they are None what the cells remember after h, after (p, k, 4), and
        the derivative of the polarisation by h, susceptibility (p, 6): xx, xy, xz, yy, yz, zz.

        h (p, 3): mu0 H, T; before (p, k, 4): what the cells remember. That is their reversible field, T, and the ratio
        of their polarisation to it; zeros at first. What is filled may have any shape of that size.
        """
        given = (self, h, before, polarisation, after, susceptibility)
        over_rows(LIBRARY.cells_respond, len(self.law), *given, work=_WORK * len(self.shares))
