"""A map's coefficients as the C core evaluates them."""

from typing import Any

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


class CoreMap:
    """The block of a map (fieldmap/core/block.h), ready for the functions of the core.

    components: of the Hermite form, 3, or 1 of the potential. constant: whether the last set is a field that no current
    drives, whose weight is 1. reaction: a map of the fields of the iron's reaction to magnets, of which the last
    `repelled` count negatively (fieldmap/core/reaction.h); what asks for a wrench then gets that of the reaction, too.
    Arrays are float64 and in C order; others raise TypeError. points (n, 3), m; weights (n, sets) or (1, sets) of the
    other sets, or None for a block of one set. Results are written to the arrays given for them, NaN where a point is
    not finite or lies outside a box whose rule is not to clamp. Methods return how many points lie outside. Several
    threads may call them at once.
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
        """How many fields the block holds."""
        return int(LIBRARY.map_sets(self.map))

    @property
    def block(self) -> Array:
        """The array in which its coefficients lie."""
        return self._given[0]

    def fields(self, points: Array, weights: Array | None, flux: Array, gradient: Array | None) -> int:
        """flux (n, 3), T, and gradient (n, 3, 3), T/m."""
        return int(LIBRARY.fields(self.map, points, weights, flux, gradient))

    def second_gradients(self, points: Array, weights: Array | None, second: Array) -> int:
        """second (n, 3, 3, 3), T/m^2."""
        return int(LIBRARY.second_gradients(self.map, points, weights, second))

    def potentials(self, points: Array, weights: Array | None, values: Array) -> int:
        """values (n,), T m: U with B = -grad U."""
        return int(LIBRARY.potentials(self.map, points, weights, values))

    def each_field(self, points: Array, flux: Array, gradient: Array | None) -> int:
        """flux (n, sets, 3) and gradient (n, sets, 3, 3) of every set at weight 1, the constant one too."""
        return int(LIBRARY.each_field(self.map, points, flux, gradient))

    def sum_sets(self, weights: Array, out: Array) -> None:
        """out (places * size,): the sets of every place, summed at weights (sets,)."""
        LIBRARY.sum_sets(self.map, weights, out)

    def field_at(self, point: Any, weights: Any) -> tuple[Array, Array] | None:
        """B (3,) and gradient (3, 3) at a point (3,), or None where it or the weights (sets,) do not fit, or it lies
        outside."""
        return LIBRARY.field_at(self.map, point, weights)

    def dipole_wrench_at(self, point: Any, moment: Any, weights: Any) -> Array | None:
        """Force, N, and torque, N m, (6,), on a dipole of moment (3,), A m^2; otherwise as `field_at`."""
        return LIBRARY.dipole_wrench_at(self.map, point, moment, weights)

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreMap, self._given
