"""A magnetic body as the C core takes it: dipoles of fixed moment, and pieces of soft iron."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


class Soft(NamedTuple):
    """A piece of soft iron (fieldmap/core/soft_iron.h). centre (3,), m; axes (3, 3), its own axes as columns, frame
    of the body; factors (3,): demagnetising factors; volume: divided by mu0; reluctance: 1 / (mu_r - 1) of a constant
    permeability; law (4, knots): h, J, dJ/dh, T, and the integral of J dh, T^2, at knots; (4, 0) for a constant
    permeability."""

    centre: Array
    axes: Array
    factors: Array
    volume: float
    reluctance: float
    law: Array


class CoreBody:
    """Dipoles and pieces of soft iron of a body. dipoles (q, 6): point, m, and moment, A m^2, frame of the body.

    Arrays are float64 and in C order; any other array raises TypeError. Several threads may use a body at once. turn
    (3, 3): the axes of the body as columns.
    """

    def __init__(self, dipoles: Array, soft: Sequence[Soft] = ()) -> None:
        self._given = dipoles, tuple(soft)
        self.body = LIBRARY.magnetic_body(*self._given)

    def wrench_slopes(
        self,
        turn: Array,
        weights: Array,
        fields: tuple[Array, Array],
        reaction: tuple[int, Array, Array],
        wrench: Array,
        slopes: Array,
    ) -> None:
        """Fill wrench (6,), N and N m about the origin of the body, and slopes (6, k), its derivatives by weights
        (k,).

        fields: flux (points, k, 3), T, and gradient (points, k, 3, 3), T/m, of k fields at weight 1, at the dipoles
        and the pieces of soft iron. reaction: how many fields of the iron's reaction, the last ones, have the sign
        -1; then flux and gradient of these fields.
        """
        wrench_slopes(
            [self], np.zeros((1, 3)), turn[None], weights, fields, reaction, wrench[None], slopes[None]
        )

    def at_poses(
        self,
        turns: Array,
        fields: tuple[Array, Array],
        reaction: tuple[int, Array, Array],
        found: tuple[Array, Array, Array, Array | None],
    ) -> bool:
        """Fill `found` at n poses, turns (n, 3, 3): wrench (n, 6), energies (n,), J, moments (n, points, 3), A m^2,
        and, unless None, dm_i/dB_k (n, s, 3, 3) of the s pieces of soft iron, all in the frame of the map.

        fields: flux (n, points, 3), T, and gradient (n, points, 3, 3), T/m. reaction: as for `wrench_slopes`, flux
        (n, points, k, 3). Returns False if the moments of soft iron do not converge.
        """
        return bool(LIBRARY.body_at_poses(self.body, turns, *fields, *reaction, *found))

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreBody, self._given


def wrench_slopes(
    bodies: Sequence[CoreBody],
    places: Array,
    turns: Array,
    weights: Array,
    fields: tuple[Array, Array],
    reaction: tuple[int, Array, Array],
    wrench: Array,
    slopes: Array,
) -> bool:
    """Fill wrench (n, 6) on bodies that act on each other, at places (n, 3), m, and turns (n, 3, 3), and slopes (n,
    6, k). The arguments are as for `CoreBody.wrench_slopes`, with the points of the bodies one body after the other.
    Returns False if the moments of soft iron do not converge, because bodies overlap."""
    known = tuple(body.body for body in bodies)
    return bool(
        LIBRARY.bodies_wrench_slopes(known, places, turns, weights, *fields, *reaction, wrench, slopes)
    )
