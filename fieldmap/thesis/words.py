"""Numbers of a comparison as a reader wants them."""

import re
from collections.abc import Iterable

from fieldmap.thesis.computation import Comparison


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


def minutes(seconds: float) -> str:
    """A time for people.

    >>> minutes(0.04), minutes(75.0)
    ('under 0.1 s', '1 min 15 s')
    """
    if seconds < 0.1:
        return "under 0.1 s"
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    return f"{whole // 60} min {whole % 60} s"


def resting_on(numbers: Iterable[Comparison]) -> list[tuple[str, str]]:
    """Each assumption once, and the names of what rests on it: "" where that is everything."""
    users: dict[str, dict[str, None]] = {}
    every: dict[str, None] = {}
    for number in numbers:
        name = number.name.partition("[")[0]
        every[name] = None
        for text in number.assumptions:
            users.setdefault(text, {})[name] = None
    return [(text, "" if len(names) == len(every) else ", ".join(names)) for text, names in users.items()]


def powers(unit: str) -> str:
    """A unit with its exponents raised.

    >>> powers("A m2"), powers("1/s2"), powers("m3")
    ('A m²', '1/s²', 'm³')
    """
    return re.sub(r"(?<=[A-Za-z])[23]\b", lambda found: "²³"[int(found[0]) - 2], unit)
