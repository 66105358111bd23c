"""A map's fields at many points, by as many processes as there are."""

from collections.abc import Iterator, Sequence

import numpy as np

from fieldmap.iron import SolverReport
from fieldmap.maps.interpolation import UnitFields
from fieldmap.parallel import Common, Workers
from fieldmap.store.grid import Array

Pair = tuple[Array, Array]
# Points of one piece of work: about as many as the nodes of a part of the file.
_POINTS = 1000


class DividedFields:
    """`fields`, their points divided among workers. The division depends on the points alone, so that who evaluates
    them changes no bit."""

    def __init__(self, fields: UnitFields, workers: Workers) -> None:
        self._report, self.workers = fields.report, workers
        self._common = Common.of(fields)

    @property
    def report(self) -> SolverReport:
        """Of the solver."""
        return self._report

    def unit_fields(self, points: Array) -> Pair:
        """Flux density (n_fields, n, 3) and gradient (n_fields, n, 3, 3), per ampere or at weight 1."""
        parts = [points[first : first + _POINTS] for first in range(0, len(points), _POINTS)]
        pairs = self.workers.results(_unit_fields, parts, self._common)
        flux, gradient = (np.concatenate(arrays, axis=1) for arrays in zip(*pairs, strict=True))
        return flux, gradient

    def of_parts(self, parts: Sequence[Array]) -> Iterator[tuple[int, Pair]]:
        """Number of a part, points (n, 3), and the fields there, as they are done."""
        for outcome in self.workers.map(_unit_fields, parts, self._common):
            yield outcome.index, outcome.result()


def _unit_fields(fields: UnitFields, points: Array) -> Pair:
    return fields.unit_fields(points)
