"""Numbers with their units as text."""

import numpy as np

from fieldmap.typing import Array

_UNITS = {"N m-1": "N/m", "mm2": "mm²", "1": ""}


def fitting_prefix(largest: float) -> tuple[str, float]:
    """SI prefix for numbers up to `largest`, and the factor from the plain unit.

    >>> fitting_prefix(0.11), fitting_prefix(3e-6), fitting_prefix(12.0), fitting_prefix(0.0)
    (('m', 1000.0), ('u', 1000000.0), ('', 1.0), ('', 1.0))
    """
    size = abs(largest)
    known = (("", 1.0), ("m", 1e3), ("u", 1e6), ("n", 1e9))
    if not np.isfinite(size) or size < 1e-12:
        return known[0]
    return next((one for one in known if size * one[1] >= 0.5), known[-1])


def fixed(value: float, decimals: int) -> str:
    """A number with a number of decimals, never -0."""
    return f"{round(float(value), decimals) + 0.0:.{decimals}f}"


def millimetres(point: Array) -> str:
    """A point given in m.

    >>> millimetres(np.array([0.001, 0.0, -0.1025]))
    '(1, 0, -102.5)'
    """
    return "(" + ", ".join(f"{1e3 * x:.6g}" for x in point) + ")"


def amperes_in_words(currents: Array, names: tuple[str, ...]) -> str:
    """One number if all currents are the same.

    >>> amperes_in_words(np.array([2.0, 2.0]), ("left", "right"))
    '2 A in each of 2 coils'
    """
    if len(set(currents)) == 1:
        return f"{currents[0]:g} A in {'the coil' if len(names) == 1 else f'each of {len(names)} coils'}"
    return ", ".join(f"{name}: {value:g} A" for name, value in zip(names, currents, strict=True))


def force_in_words(force: Array) -> str:
    """Components of a force (3,), N, to four digits of the largest, in the unit that fits it.

    >>> force_in_words(np.array([0.0, -2e-7, 0.11])), force_in_words(np.array([1.2e-5, 0.0, 0.0]))
    ('(0.0, 0.0, 110.0) mN', '(12.00, 0.00, 0.00) uN')
    """
    prefix, factor = fitting_prefix(float(np.abs(force).max()))
    scaled = factor * np.asarray(force)
    largest = float(np.abs(scaled).max())
    decimals = int(np.clip(3 - np.floor(np.log10(largest)), 0, 3)) if largest else 1
    return f"({', '.join(fixed(x, decimals) for x in scaled)}) {prefix}N"


def unit_in_words(unit: str) -> str:
    """A unit of studies as written in figures; "" for a plain number.

    >>> unit_in_words("mm2"), unit_in_words("A"), unit_in_words("1")
    ('mm²', 'A', '')
    """
    return _UNITS.get(unit, unit)


def with_unit(name: str, unit: str) -> str:
    """A label of an axis, without a unit for plain numbers.

    >>> with_unit("radius", "mm"), with_unit("share", "1")
    ('radius (mm)', 'share')
    """
    words = unit_in_words(unit)
    return f"{name} ({words})" if words else name


def label_step(span: float) -> float:
    """Distance of labels: 1, 2 or 5 times a power of ten, with about six labels in a span at most.

    >>> label_step(511.0)
    100.0
    """
    wanted = span / 6.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= wanted))


def round_numbers(low: float, high: float, step: float) -> Array:
    """Multiples of step from low to high."""
    return step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)


def decimals_of(step: float) -> int:
    """Number of decimals of the multiples of a step.

    >>> decimals_of(0.05), decimals_of(20.0)
    (2, 0)
    """
    return max(0, int(np.ceil(-np.log10(step) - 1e-9)))
