"""Opened maps: field, gradient and wrench at any point, for any currents."""

from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.opening import interpolate, open_map

__all__ = ["FieldMap", "interpolate", "open_map"]
