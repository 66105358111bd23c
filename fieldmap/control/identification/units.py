"""Units in the headings of CSV columns."""

import re

from fieldmap.errors import InputError, Problem

# unit -> SI unit, factor
UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "min": ("s", 60.0),
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "um": ("m", 1e-6), "µm": ("m", 1e-6),
    "A": ("A", 1.0), "mA": ("A", 1e-3), "V": ("V", 1.0), "mV": ("V", 1e-3),
    "T": ("T", 1.0), "mT": ("T", 1e-3), "N": ("N", 1.0), "mN": ("N", 1e-3), "kg": ("kg", 1.0), "g": ("kg", 1e-3),
    "rad": ("rad", 1.0), "deg": ("rad", 0.017453292519943295), "1": ("1", 1.0),
}  # fmt: skip
_QUANTITIES = {"s": "time", "m": "length", "A": "current", "V": "voltage", "T": "flux density", "N": "force"}
_QUANTITIES |= {"kg": "mass", "rad": "angle", "1": "numbers without unit"}
_HEADING = re.compile(r"^\s*(?P<name>[^()]*\S)\s*\((?P<unit>[^()]*)\)\s*$")


def in_si(where: str, unit: str) -> tuple[str, float]:
    """SI unit and factor of a unit. Raises InputError for one that is not in the table."""
    if unit not in UNITS:
        raise InputError(_unknown(where, unit))
    return UNITS[unit]


def named_unit(unit: str) -> str:
    """The quantity that an SI unit measures, in words."""
    return _QUANTITIES[unit]


def split_heading(where: str, heading: str) -> tuple[str, str, float] | Problem:
    """Name, SI unit and factor of `name (unit)`, or what is wrong with it."""
    match = _HEADING.match(heading)
    if not match:
        return Problem(
            f"{where}:1",
            "must give every column as `name (unit)`, (1) for numbers without unit",
            heading.strip() or "an empty heading",
            "write, for one: time (s),position (mm),current (A)",
        )
    unit = match["unit"].strip()
    if unit not in UNITS:
        return _unknown(f"{where}:1 column {match['name']}", unit)
    return match["name"], *UNITS[unit]


def _unknown(where: str, unit: str) -> Problem:
    return Problem(where, f"must be a unit of {', '.join(UNITS)}", unit or "no unit", "convert the column")
