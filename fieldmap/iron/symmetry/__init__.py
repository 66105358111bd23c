"""Which mirrors and rotations map a device onto itself: found from its parts, never declared."""

from fieldmap.iron.symmetry.finder import find_symmetry
from fieldmap.iron.symmetry.group import Operation, SymmetryGroup

__all__ = ["Operation", "SymmetryGroup", "find_symmetry"]
