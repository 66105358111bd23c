"""The older name of `fieldmap.iron.symmetry`."""

from fieldmap.deprecated import renamed

__getattr__ = renamed(
    __name__,
    {name: f"fieldmap.iron.symmetry:{name}" for name in ("Operation", "SymmetryGroup", "find_symmetry")},
)
