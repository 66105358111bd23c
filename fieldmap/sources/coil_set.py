"""The field of coils alone: no iron, every coil's field proportional to its current."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.coils import Coil
from fieldmap.device.drawing import Outline, winding_outline
from fieldmap.field import Bounds, Currents, Field, coil_currents
from fieldmap.sources.coils import checked_points, unit_flux_density, unit_flux_density_and_gradient
from fieldmap.typing import Array


class CoilSet(Field):
    """Coils in air as a `fieldmap.field.Field`, in closed form and exact to rounding at any distance.

    coils: in the order of the currents. bounds: lower and upper corner (3,) in m of the box in which the field is
    used, for functions that look for one. Currents (n_coils,), or (n, n_coils) with one row for every point. B is
    finite and continuous everywhere; the gradient jumps at the surface of a winding (see
    `fieldmap.sources.unit_flux_density_and_gradient`), so that second gradients hold outside the windings.

    >>> import fieldmap as fm
    >>> coils = CoilSet(fm.read_device("loop_and_sphere").coils)
    >>> bool(coils.field([0.0, 0.0, 0.0], 1.0)[2] > 0.0)
    True
    """

    def __init__(self, coils: Sequence[Coil], bounds: Bounds | None = None) -> None:
        self.coils = tuple(coils)
        self._bounds = bounds

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return tuple(coil.name for coil in self.coils)

    @property
    def bounds(self) -> Bounds | None:
        """The box in which the field is used; None where none was given."""
        return self._bounds

    @property
    def proportional(self) -> bool:
        """True: the field is the sum of the coils' fields."""
        return True

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The assumptions of the field, in words."""
        return ("coils in air, uniform current density over each winding's section",)

    def field(self, points: ArrayLike, currents: Currents) -> Array:
        """Flux density at points.

        Raises
        ------
        InputError
            For points or currents that do not fit.
        """
        return self._summed(points, currents, unit_flux_density, (3,))

    def gradient(self, points: ArrayLike, currents: Currents) -> Array:
        """Gradient of the flux density at points.

        Raises
        ------
        InputError
            For points or currents that do not fit.
        """
        return self._summed(
            points, currents, lambda coil, x: unit_flux_density_and_gradient(coil, x)[1], (3, 3)
        )

    def outlines(self) -> tuple[Outline, ...]:
        """The windings."""
        return tuple(winding_outline(coil) for coil in self.coils)

    def _summed(
        self,
        points: ArrayLike,
        currents: Currents,
        unit: Callable[[Coil, Array], Array],
        shape: tuple[int, ...],
    ) -> Array:
        """Sum over the coils of current times unit(coil, points), of this shape at each point."""
        x = checked_points(points, "points")
        amperes = coil_currents(currents, self.coil_names, len(x))
        total = np.zeros((len(x), *shape))
        for coil, own in zip(self.coils, np.moveaxis(amperes, -1, 0), strict=True):
            if own.any():
                total += own.reshape(-1, *(1,) * len(shape)) * unit(coil, x)
        return total[0] if np.ndim(points) == 1 else total
