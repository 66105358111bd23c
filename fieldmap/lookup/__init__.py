"""Opened maps: field, gradient and wrench at any point, for any currents."""

from fieldmap.interpolants import Jump
from fieldmap.lookup.actuation import (
    Actuation,
    capability,
    field_actuation,
    gradient_actuation,
    wrench_actuation,
)
from fieldmap.lookup.at_currents import FieldAtCurrents
from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.finite_magnet import FiniteMagnet, finite_magnet, volume_rule
from fieldmap.lookup.opening import interpolate, open_map
from fieldmap.lookup.soft_sphere import soft_sphere_force

__all__ = [
    "Actuation",
    "FieldAtCurrents",
    "FieldMap",
    "FiniteMagnet",
    "Jump",
    "capability",
    "field_actuation",
    "finite_magnet",
    "gradient_actuation",
    "interpolate",
    "open_map",
    "soft_sphere_force",
    "volume_rule",
    "wrench_actuation",
]
