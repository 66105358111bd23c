"""Stability margins of a loop from its open-loop frequency response."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.records import Record
from fieldmap.typing import Array

_REAL, _STEADY = 1e-2, 1e-4
"""Largest imaginary over real part at the lowest frequency of a curve that begins on the real axis; largest relative
change to the next frequency of a curve that begins at a finite value, and largest imaginary over real part at the
highest frequency, where only rounding keeps a curve off the real axis."""


@dataclass(frozen=True, repr=False)
class Margins(Record):
    """Stability margins at one output of the controller, with the other loops closed.

    gain_up, gain_down: factors of the output that bring a pole to the border of stability (infinite and 0 if none
    does); phase: lag or lead, deg, that does; crossover: frequency of the phase margin, Hz; both NaN for a loop without
    crossover. modulus: smallest distance of the loop's curve from -1, which bounds the other margins (0.5 is
    comfortable). unstable: this loop's share of the unstable modes; all shares are 0 if the machine is stable, or
    unstable only along axes that no output affects. If another axis is unstable, the margins are still those of this
    loop.
    """

    output: str
    gain_up: float
    gain_down: float
    phase: float
    crossover: float
    modulus: float
    unstable: float = 0.0


def margins_of_curves(frequencies: Array, curves: NDArray[Any]) -> Array:
    """gain_up, gain_down, phase, crossover and modulus of k curves, (5, k), as in `Margins`.

    Parameters
    ----------
    frequencies
        Rising (n,), Hz, to half the sampling rate.
    curves
        Loops opened at one place (k, n); 1 + curve is 0 at the border of stability.

    Returns
    -------
    Array
        The margins. They are those of a loop only if it is stable.
    """
    # The curve of an open loop is 0.
    log = np.log(np.maximum(np.abs(curves), np.finfo(float).tiny))
    angle = np.unwrap(np.angle(-curves))
    share = _crossing(log, 0.0)
    # Angles are those of -curve, which are 0 where the curve passes through -1.
    there = angle[:, :-1] + share * np.diff(angle)
    phases = np.where(log[:, 1:] * log[:, :-1] <= 0.0, np.abs(np.angle(np.exp(1j * there))), np.inf)
    nearest = phases.argmin(axis=1)[:, None]
    phase = np.rad2deg(np.take_along_axis(phases, nearest, axis=1)[:, 0])
    at = frequencies[nearest] * (frequencies[nearest + 1] / frequencies[nearest]) ** np.take_along_axis(
        share, nearest, axis=1
    )
    turns = np.floor(angle / (2.0 * np.pi))
    share = _crossing(angle, 2.0 * np.pi * np.maximum(turns[:, 1:], turns[:, :-1]))
    factor = np.exp(-log[:, :-1] - share * np.diff(log))
    crosses = np.diff(turns) != 0.0
    # A real pole reaches the border at an end of the curve, which becomes real there without crossing the real axis.
    steady = np.abs(np.diff(np.abs(curves[:, :2]), axis=1)[:, 0]) < _STEADY * np.abs(curves[:, 0])
    begins = steady & (-curves[:, 0].real > np.abs(curves[:, 0].imag) / _REAL)
    ends = -curves[:, -1].real > np.abs(curves[:, -1].imag) / _STEADY
    crosses = np.column_stack([crosses, begins, ends])
    factor = np.column_stack([factor, np.exp(-log[:, [0, -1]])])
    up = np.where(crosses & (factor > 1.0), factor, np.inf).min(axis=1)
    down = np.where(crosses & (factor <= 1.0), factor, 0.0).max(axis=1)
    none = np.isinf(phase)
    phase[none], at[none] = np.nan, np.nan
    return np.array([up, down, phase, at[:, 0], np.abs(1.0 + curves).min(axis=1)])


def _crossing(values: Array, level: Array | float) -> Array:
    """Fraction, 0 to 1, of each interval between neighbouring values (k, n) at which they meet a level."""
    change = np.diff(values)
    share = np.divide(level - values[:, :-1], change, out=np.zeros_like(change), where=change != 0.0)
    return np.clip(share, 0.0, 1.0)
