"""Functions of earlier versions, which fields of every kind have replaced. They warn, and go with the next release."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.deprecated import warn_renamed
from fieldmap.device.model import Payload
from fieldmap.field import STEP, AnyField, BaseField, Bounds, CompletedField, Field, FieldLike, as_field
from fieldmap.levitation.lift import LiftCurrent, lift_current
from fieldmap.typing import Array


def DifferencedField(  # noqa: N802
    solution: FieldLike, lower: ArrayLike, upper: ArrayLike, step: float = STEP
) -> CompletedField:
    """A solution as a `Field` in a box, with second gradients by central differences."""
    warn_renamed("fieldmap.levitation.DifferencedField", "fieldmap.field.as_field(solution, (lower, upper))")
    return CompletedField(solution, (np.asarray(lower, float), np.asarray(upper, float)), step)


def FixedCurrents(state: Any) -> Field:  # noqa: N802
    """A state of saturating iron as a `Field` that holds at its own currents."""
    warn_renamed("fieldmap.levitation.FixedCurrents", "fieldmap.field.as_field(state)")
    return as_field(state)


def lift_current_nonlinear(
    solve_at: Callable[[Array], AnyField],
    payload: Payload | None,
    position: ArrayLike,
    shares: ArrayLike,
    first: float = 1.0,
    tolerance: float = 1e-4,
    on_state: Callable[[float, float], None] | None = None,
) -> LiftCurrent:
    """`lift_current` of a function from currents (n_coils,) to a field that holds at these currents at least."""
    warn_renamed("fieldmap.levitation.lift_current_nonlinear", "fieldmap.levitation.lift_current(field, ...)")
    field = _FieldOfStates(solve_at, first * np.asarray(shares, dtype=float))
    return lift_current(field, payload, position, shares, first, tolerance, on_state)


class _FieldOfStates(BaseField):
    """A field that is solved for one set of currents at a time; the last one is cached."""

    def __init__(self, solve_at: Callable[[Array], AnyField], currents: Array) -> None:
        self._solve_at, self._currents, self._state = solve_at, currents, as_field(solve_at(currents))

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Those of the states."""
        return self._state.coil_names

    @property
    def bounds(self) -> Bounds | None:
        """That of the states."""
        return self._state.bounds

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T."""
        return self._at(currents).field(points, currents)

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self._at(currents).gradient(points, currents)

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
        return self._at(currents).second_gradient(points, currents)

    def _at(self, currents: Array) -> Field:
        if not np.array_equal(currents, self._currents):
            self._currents, self._state = currents, as_field(self._solve_at(currents))
        return self._state
