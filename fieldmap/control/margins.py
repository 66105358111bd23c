"""Margins of a loop, from the curve of what comes back to one place of it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.records import Record
from fieldmap.typing import Array

_REAL, _STEADY = 1e-2, 1e-4
"""Slope, imaginary over real, at the lowest frequency up to which a curve comes from the real axis; change from there
to the next frequency up to which it comes from a finite value, and slope of rounding."""


@dataclass(frozen=True, repr=False)
class Margins(Record):
    """How far a pole is from the border of stability at one output of the controller, the other loops being closed.

    gain_up, gain_down: factors of that output which bring a pole there (infinite and 0 where none does); phase: deg,
    that lag or lead brings it there; crossover: frequency at which the phase is taken, Hz; modulus: smallest distance
    of the loop's curve from -1, which one number bounds all of them (0.5 is comfortable). NaN where a loop has no
    crossover. unstable: this loop's share of the unstable modes; all shares are 0 where the machine is stable, or
    unstable along axes that no output feels. Where another axis is unstable, the margins are still those of this loop.
    """

    output: str
    gain_up: float
    gain_down: float
    phase: float
    crossover: float
    modulus: float
    unstable: float = 0.0


def margins_of_curves(frequencies: Array, curves: NDArray[Any]) -> Array:
    """gain_up, gain_down, phase, crossover and modulus, as in `Margins`, of k curves, (5, k).

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
    # Of an open loop the curve is 0.
    log = np.log(np.maximum(np.abs(curves), np.finfo(float).tiny))
    angle = np.unwrap(np.angle(-curves))
    share = _crossing(log, 0.0)
    # Distance of the angle from that of -1, which is where -curve is 1.
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
    # A real pole comes to the border at one end of the curve, where the curve becomes real without passing through.
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
    """Where values (k, n) between neighbours meet a level, as a share of the way from 0 to 1."""
    change = np.diff(values)
    share = np.divide(level - values[:, :-1], change, out=np.zeros_like(change), where=change != 0.0)
    return np.clip(share, 0.0, 1.0)
