"""Current histories of iron with hysteresis, from the virgin state to the beginning of its use.

Depends on: arguments, numpy.
"""

import numpy as np

from fieldmap.arguments import check_choice
from fieldmap.typing import Array

HISTORIES = ("shaken", "demagnetised")
"""Names, the usual one first."""
SWINGS = np.array([-1.0, 1.0, -0.7, 0.7, -0.4, 0.4, -0.2, 0.2, -0.07, 0.0])
"""Turning points of the history "shaken": (current - level) / level."""


def history_of_currents(history: str, level: Array) -> Array:
    """Currents at the turning points of a history.

    Parameters
    ----------
    history
        "demagnetised": iron that was never magnetised, without currents. "shaken": demagnetised, then all currents
        swing about a level, first from zero to twice the level and then less and less, as when a controller catches
        its magnet.
    level
        Currents (c,) at which the history ends, A.

    Returns
    -------
    Array
        Currents (n, c), A; no rows for "demagnetised".

    Raises
    ------
    InputError
        For an unknown history.

    Examples
    --------
    >>> history_of_currents("shaken", np.array([2.0]))[:, 0].round(2).tolist()
    [0.0, 4.0, 0.6, 3.4, 1.2, 2.8, 1.6, 2.4, 1.86, 2.0]
    """
    check_choice("history", history, HISTORIES)
    swings = SWINGS if history == "shaken" else SWINGS[:0]
    return np.asarray((1.0 + swings)[:, None] * level)
