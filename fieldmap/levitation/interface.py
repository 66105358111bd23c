"""What a field must offer so that a magnet can be levitated in it."""

from typing import Protocol

from numpy.typing import ArrayLike

from fieldmap.typing import Array


class LevitationField(Protocol):
    """A field that depends on coil currents and holds inside an axis-parallel box (an opened map, for
    one)."""

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""

    @property
    def lower(self) -> Array:
        """Lower corner of the box (3,), m."""

    @property
    def upper(self) -> Array:
        """Upper corner of the box (3,), m."""

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""

    def second_gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
