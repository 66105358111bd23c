"""Iron with hysteresis at given fields: the play cells of the C core (docs/theory/hysteresis.md)."""

from typing import NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.records import tuple_line
from fieldmap.threads import over_rows
from fieldmap.typing import Array

# Work of a cell in the units of `over_rows`.
_WORK = 20.0


class PlayCells(NamedTuple):
    """Play cells, k at each of p points. All arrays are float64 and in C order; any other array raises TypeError.

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
        """Fill polarisation (p, 3), T; and, unless None, after (p, k, 4), the memory of the cells after h, and
        susceptibility (p, 6), the derivative of the polarisation with respect to h: xx, xy, xz, yy, yz, zz.

        h (p, 3): mu0 H, T; before (p, k, 4): memory of the cells: reversible field, T, and ratio of the polarisation
        to it; zeros at first. Filled arrays may have any shape of the same size.
        """
        given = (self, h, before, polarisation, after, susceptibility)
        over_rows(LIBRARY.cells_respond, len(self.law), *given, work=_WORK * len(self.shares))
