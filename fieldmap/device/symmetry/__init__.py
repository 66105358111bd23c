"""Which mirrors and rotations map a device onto itself: found from its parts, never declared."""

from fieldmap.device.symmetry.finder import find_symmetry
from fieldmap.device.symmetry.group import Operation, SymmetryGroup

__all__ = ["Operation", "SymmetryGroup", "find_symmetry"]
