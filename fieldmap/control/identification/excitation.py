"""Pseudo-random binary signals: maximal length shift registers of any order."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_count, check_numbers
from fieldmap.typing import Array

LONGEST = 2**26  # samples: half a gigabyte

# Feedback taps besides the register's last stage; primitive polynomials x^n + x^i + ... + 1 over two elements, from
# P. Alfke, "Efficient shift registers, LFSR counters, and long pseudo-random sequence generators", Xilinx XAPP 052
# (1996), table 3; the tests prove every one of them primitive. Order 2 is x^2 + x + 1.
TAPS: dict[int, tuple[int, ...]] = {
    2: (1,), 3: (2,), 4: (3,), 5: (3,), 6: (5,), 7: (6,), 8: (6, 5, 4), 9: (5,), 10: (7,), 11: (9,), 12: (6, 4, 1),
    13: (4, 3, 1), 14: (5, 3, 1), 15: (14,), 16: (15, 13, 4), 17: (14,), 18: (11,), 19: (6, 2, 1), 20: (17,),
    21: (19,), 22: (21,), 23: (18,), 24: (23, 22, 17), 25: (22,), 26: (6, 2, 1), 27: (5, 2, 1), 28: (25,),
    29: (27,), 30: (6, 4, 1), 31: (28,), 32: (22, 2, 1), 33: (20,), 34: (27, 2, 1), 35: (33,), 36: (25,),
    37: (5, 4, 3, 2, 1), 38: (6, 5, 1), 39: (35,), 40: (38, 21, 19), 41: (38,), 42: (41, 20, 19), 43: (42, 38, 37),
    44: (43, 18, 17), 45: (44, 42, 41), 46: (45, 26, 25), 47: (42,), 48: (47, 21, 20), 49: (40,), 50: (49, 24, 23),
    51: (50, 36, 35), 52: (49,), 53: (52, 38, 37), 54: (53, 18, 17), 55: (31,), 56: (55, 35, 34), 57: (50,),
    58: (39,), 59: (58, 38, 37), 60: (59,), 61: (60, 46, 45), 62: (61, 6, 5), 63: (62,), 64: (63, 61, 60),
}  # fmt: skip


def pseudo_random_binary(
    order: int,
    *,
    amplitude: float = 1.0,
    hold: int = 1,
    samples: int | None = None,
    taps: ArrayLike | None = None,
    start: int = 1,
) -> Array:
    """A signal that switches between -amplitude and amplitude with the period (2^order - 1) * hold samples.

    Over a whole period the mean is amplitude / (2^order - 1) and the autocorrelation is amplitude^2 at 0 and
    -amplitude^2 / (2^order - 1) at all other multiples of hold: (13) of docs/theory/identification.md.

    Parameters
    ----------
    order
        Stages of the register.
    amplitude
        Size of the signal.
    hold
        Samples per register step: the power lies below the frequency 1 / (2 hold Ts), and a plant slower than
        hold Ts sees more of it.
    samples
        Length; one period unless given.
    taps
        Stages that feed back besides the last, for an order beyond 64 or another sequence of the same order.
        They are not checked for a sequence of maximal length.
    start
        Start content of the register as a whole number, not a multiple of 2^order; it only shifts the
        sequence.

    Returns
    -------
    Array
        The signal (samples,).

    Raises
    ------
    InputError
        For numbers that do not fit.

    Examples
    --------
    >>> pseudo_random_binary(3, amplitude=2.0).tolist()
    [2.0, -2.0, -2.0, 2.0, 2.0, 2.0, -2.0]
    """
    where = "pseudo_random_binary"
    check_numbers(where, amplitude=amplitude)
    check_count(where, hold=hold, start=start, order=order)
    stages = TAPS.get(order, ()) if taps is None else tuple(np.atleast_1d(np.asarray(taps, int)).tolist())
    good = len(stages) > 0 and all(0 < tap < order for tap in stages)
    must = "must be an order from 2 to 64, or one with stages 0 < tap < order of its own"
    received = f"order {order}, taps {list(stages) or None}"
    remedy = "take an order from the table, or look up a primitive polynomial"
    check(good, f"{where}(order, taps)", must, received, remedy)
    period = (2**order - 1) * hold
    length = period if samples is None else samples
    check_count(where, samples=length)
    remedy = "ask for fewer samples"
    check(length <= LONGEST, f"{where}(samples)", f"must be at most {LONGEST}", length, remedy)
    bits = np.array([(start >> i) & 1 for i in range(order)], dtype=np.int8)
    check(bool(bits.any()), f"{where}(start)", f"must not be a multiple of 2^{order}", start, "take 1")
    # Imported on use, as in `filter_response`: scipy.signal takes long to load.
    from scipy.signal import max_len_seq

    sequence, _ = max_len_seq(order, state=bits, length=-(-length // hold), taps=list(stages))
    return amplitude * np.repeat(2.0 * sequence - 1.0, hold)[:length]
