"""Opened maps: field, gradient and wrench at any point, for any currents."""

from fieldmap.lookup.actuation import (
    Actuation,
    capability,
    field_actuation,
    gradient_actuation,
    wrench_actuation,
)
from fieldmap.lookup.at_currents import FieldAtCurrents
from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.jumps import Jump
from fieldmap.lookup.opening import interpolate, open_map

__all__ = [
    "Actuation",
    "FieldAtCurrents",
    "FieldMap",
    "Jump",
    "capability",
    "field_actuation",
    "gradient_actuation",
    "interpolate",
    "open_map",
    "wrench_actuation",
]
