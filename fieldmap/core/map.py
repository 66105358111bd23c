"""A map's coefficients as the C core evaluates them."""

from typing import Any

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


class CoreMap:
    """The block of a map (fieldmap/core/block.h), prepared for the functions of the core.

    components: of a Hermite form, 3 for flux density or 1 for the potential. constant: whether the last set is a
    field that no current drives, with weight 1. reaction: a map of the fields of the iron's reaction to magnets; its
    last `repelled` fields have the sign -1 (fieldmap/core/reaction.h), and wrenches then include the reaction. Arrays
    are float64 and in C order; any other array raises TypeError. points (n, 3), m; weights (n, sets) or (1, sets) of
    the sets without the constant one, or None for a block of one set. Methods fill the arrays of results, with NaN
    where a point is not finite or lies outside a box that does not clamp, and return the number of points outside.
    Several threads may call them at once.
    """

    def __init__(
        self,
        block: Array,
        components: int = 3,
        constant: bool = False,
        reaction: "CoreMap | None" = None,
        repelled: int = 0,
    ) -> None:
        self._given = block, components, constant, reaction, repelled
        self.map = LIBRARY.map_of_block(block, components, constant)
        if reaction is not None:
            self.map = LIBRARY.reacting_map(self.map, reaction.block, repelled)

    @property
    def sets(self) -> int:
        """Number of fields of the block."""
        return int(LIBRARY.map_sets(self.map))

    @property
    def block(self) -> Array:
        """The array of the coefficients."""
        return self._given[0]

    def fields(self, points: Array, weights: Array | None, flux: Array, gradient: Array | None) -> int:
        """Fill flux (n, 3), T, and gradient (n, 3, 3), T/m."""
        return int(LIBRARY.fields(self.map, points, weights, flux, gradient))

    def second_gradients(self, points: Array, weights: Array | None, second: Array) -> int:
        """Fill second (n, 3, 3, 3), T/m^2."""
        return int(LIBRARY.second_gradients(self.map, points, weights, second))

    def potentials(self, points: Array, weights: Array | None, values: Array) -> int:
        """Fill values (n,), T m, with U, where B = -grad U."""
        return int(LIBRARY.potentials(self.map, points, weights, values))

    def each_field(self, points: Array, flux: Array, gradient: Array | None) -> int:
        """Fill flux (n, sets, 3) and gradient (n, sets, 3, 3) of every set, also the constant one, at weight 1."""
        return int(LIBRARY.each_field(self.map, points, flux, gradient))

    def sum_sets(self, weights: Array, out: Array) -> None:
        """Fill out (places * size,) with the sum of the sets at every place, with weights (sets,)."""
        LIBRARY.sum_sets(self.map, weights, out)

    def field_at(self, point: Any, weights: Any) -> tuple[Array, Array] | None:
        """Return B (3,) and gradient (3, 3) at a point (3,), or None if the point or the weights (sets,) have a wrong
        shape or the point lies outside."""
        return LIBRARY.field_at(self.map, point, weights)

    def dipole_wrench_at(self, point: Any, moment: Any, weights: Any) -> Array | None:
        """Return force, N, and torque, N m, (6,), on a dipole of moment (3,), A m^2; otherwise as `field_at`."""
        return LIBRARY.dipole_wrench_at(self.map, point, moment, weights)

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreMap, self._given
