"""Numbers of a comparison as a reader wants them."""

from fieldmap.thesis.comparison import Comparison


def deviation_in_words(number: Comparison) -> str:
    """ "agrees" for a sharp number that does, otherwise the deviation in per cent; "" where the thesis prints 0."""
    return "agrees" if number.agrees else percent(number.deviation)


def percent(deviation: float | None) -> str:
    """A deviation in per cent, a factor in words where that would be a long number.

    >>> percent(0.0123), percent(-2e-5), percent(11.5), percent(None)
    ('+1.2 %', '-0.002 %', '12.5 times', '')
    """
    if deviation is None:
        return ""
    if abs(deviation) >= 10.0:
        return f"{1.0 + deviation:.3g} times"
    value = 100.0 * deviation
    return f"{value:+.1f} %" if abs(value) >= 0.1 else f"{value:+.1g} %"
