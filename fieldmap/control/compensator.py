"""Compensation of the dip in height when a body moves sideways: a short push of the vertical reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_not_negative, check_numbers, check_positive, check_signal
from fieldmap.typing import Array


def compensated_reference(
    height: ArrayLike,
    horizontal: ArrayLike,
    Ts: float,
    push: float,
    duration: float,
) -> Array:
    """The vertical reference (n,), less `push` for `duration` after each change of a horizontal reference (n,).

    height: vertical reference in the downward frame of the sensor, (n,) or one number, m. horizontal: reference of
    the moving axis, (n,). The push has the sign of the change: less for a rising horizontal reference, more for a
    falling one. A change during a push begins a new one. Ts, duration in s; push in m.

    >>> reference = compensated_reference(0.010, [0, 0, 1e-4, 1e-4, 1e-4, 1e-4], 5e-3, push=5e-5, duration=0.010)
    >>> (1e3 * reference).round(3).tolist()
    [10.0, 10.0, 9.95, 9.95, 10.0, 10.0]
    """
    check_positive("compensated_reference", Ts=Ts)
    check_numbers("compensated_reference", push=push)
    check_not_negative("compensated_reference", duration=duration)
    sideways = np.atleast_1d(check_signal("compensated_reference(horizontal)", horizontal))
    target = np.broadcast_to(check_signal("compensated_reference(height)", height), sideways.shape)
    steps = np.sign(np.diff(sideways, prepend=sideways[0]))
    index = np.arange(steps.size)
    last = np.maximum.accumulate(np.where(steps != 0.0, index, -1))
    length = round(duration / Ts)
    active = (last >= 0) & (index - last < length)
    return target - push * np.where(active, steps[last], 0.0)
