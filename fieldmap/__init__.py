"""Magnetic fields, gradients and forces of coils with soft iron, without finite elements.

The public functions are imported on first use. A simulation that only opens a map therefore
never loads the mesher or magpylib.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fieldmap import control as control
    from fieldmap import dynamics as dynamics
    from fieldmap import instruments as instruments
    from fieldmap import interop as interop
    from fieldmap.device import read_device as read_device
    from fieldmap.dynamics import simulate as simulate
    from fieldmap.io import open_field as open_field
    from fieldmap.iron import solve as solve
    from fieldmap.iron import solve_linear as solve_linear
    from fieldmap.iron import solve_to_tolerance as solve_to_tolerance
    from fieldmap.levitation import find_equilibrium as find_equilibrium
    from fieldmap.lookup import open_map as open_map
    from fieldmap.maps import generate as generate
    from fieldmap.provenance import __version__ as __version__

_PUBLIC = {
    "read_device": "fieldmap.device",
    "solve_linear": "fieldmap.iron",
    "solve_to_tolerance": "fieldmap.iron",
    "solve": "fieldmap.iron",
    "generate": "fieldmap.maps",
    "open_map": "fieldmap.lookup",
    "open_field": "fieldmap.io",
    "find_equilibrium": "fieldmap.levitation",
    "simulate": "fieldmap.dynamics",
    "__version__": "fieldmap.provenance",
}
_PACKAGES = ("control", "dynamics", "instruments", "interop")
__all__ = [*_PUBLIC, *_PACKAGES]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    if name in _PACKAGES:
        return import_module(f"fieldmap.{name}")
    raise AttributeError(f"module 'fieldmap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
