"""Histories of iron with hysteresis: currents from where it never was magnetised to where a use begins.

Depends on: arguments, numpy.
"""

import numpy as np

from fieldmap.arguments import check_choice
from fieldmap.typing import Array

HISTORIES = ("shaken", "demagnetised")
"""Names, the usual one first."""
SWINGS = np.array([-1.0, 1.0, -0.7, 0.7, -0.4, 0.4, -0.2, 0.2, -0.07, 0.0])
"""Of the history "shaken": currents less their level, over the level, from turn to turn."""


def history_of_currents(history: str, level: Array) -> Array:
    """Currents at which the path of a history turns.

    Parameters
    ----------
    history
        "demagnetised": iron that was never magnetised, without currents. "shaken": demagnetised, then all currents
        swing about a level, from zero to twice the level and less and less, as those of a controller that catches its
        magnet.
    level
        Currents (c,) at which the history ends, A.

    Returns
    -------
    Array
        Currents (n, c), A; no rows for "demagnetised".

    Raises
    ------
    InputError
        For a history that is not known.

    Examples
    --------
    >>> history_of_currents("shaken", np.array([2.0]))[:, 0].round(2).tolist()
    [0.0, 4.0, 0.6, 3.4, 1.2, 2.8, 1.6, 2.4, 1.86, 2.0]
    """
    check_choice("history", history, HISTORIES)
    swings = SWINGS if history == "shaken" else SWINGS[:0]
    return np.asarray((1.0 + swings)[:, None] * level)
