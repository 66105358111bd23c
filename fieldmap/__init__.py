"""Magnetic fields, gradients and forces of coils with soft iron. Only the iron is meshed, never the air.

The public functions and the packages, such as fieldmap.iron, are imported on first use. A simulation that only opens a
map therefore never loads the mesher or magpylib.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fieldmap import control as control
    from fieldmap import currents as currents
    from fieldmap import device as device
    from fieldmap import dynamics as dynamics
    from fieldmap import errors as errors
    from fieldmap import field as field
    from fieldmap import instruments as instruments
    from fieldmap import interop as interop
    from fieldmap import io as io
    from fieldmap import iron as iron
    from fieldmap import levitation as levitation
    from fieldmap import lookup as lookup
    from fieldmap import maps as maps
    from fieldmap import planar as planar
    from fieldmap import plot as plot
    from fieldmap import sources as sources
    from fieldmap import store as store
    from fieldmap import studies as studies
    from fieldmap import thesis as thesis
    from fieldmap.device import material as material
    from fieldmap.device import read_device as read_device
    from fieldmap.device.model import Arctangent as Arctangent
    from fieldmap.device.model import Background as Background
    from fieldmap.device.model import BHTable as BHTable
    from fieldmap.device.model import Body as Body
    from fieldmap.device.model import Box as Box
    from fieldmap.device.model import CircularCoil as CircularCoil
    from fieldmap.device.model import Coil as Coil
    from fieldmap.device.model import Cylinder as Cylinder
    from fieldmap.device.model import Device as Device
    from fieldmap.device.model import Driver as Driver
    from fieldmap.device.model import ExtrudedPolygon as ExtrudedPolygon
    from fieldmap.device.model import FieldSensor as FieldSensor
    from fieldmap.device.model import FluxBarrier as FluxBarrier
    from fieldmap.device.model import Froehlich as Froehlich
    from fieldmap.device.model import Joint as Joint
    from fieldmap.device.model import LinearMaterial as LinearMaterial
    from fieldmap.device.model import MagnetBlock as MagnetBlock
    from fieldmap.device.model import MagnetCylinder as MagnetCylinder
    from fieldmap.device.model import MagnetSphere as MagnetSphere
    from fieldmap.device.model import MagpylibCoil as MagpylibCoil
    from fieldmap.device.model import Marrocco as Marrocco
    from fieldmap.device.model import MeshFile as MeshFile
    from fieldmap.device.model import Part as Part
    from fieldmap.device.model import PathCoil as PathCoil
    from fieldmap.device.model import Payload as Payload
    from fieldmap.device.model import PayloadPiece as PayloadPiece
    from fieldmap.device.model import PermanentMagnet as PermanentMagnet
    from fieldmap.device.model import Placement as Placement
    from fieldmap.device.model import Reference as Reference
    from fieldmap.device.model import RevolvedProfile as RevolvedProfile
    from fieldmap.device.model import Ring as Ring
    from fieldmap.device.model import RoundedRectangleCoil as RoundedRectangleCoil
    from fieldmap.device.model import Section as Section
    from fieldmap.device.model import SoftEllipsoid as SoftEllipsoid
    from fieldmap.device.model import SoftSphere as SoftSphere
    from fieldmap.device.model import Sphere as Sphere
    from fieldmap.device.model import StepFile as StepFile
    from fieldmap.device.model import TriangleSurface as TriangleSurface
    from fieldmap.device.model import VolumeMesh as VolumeMesh
    from fieldmap.device.model import WorkspaceBox as WorkspaceBox
    from fieldmap.device.model import WorkspaceCylinder as WorkspaceCylinder
    from fieldmap.device.model import placed as placed
    from fieldmap.dynamics import open_machine as open_machine
    from fieldmap.dynamics import simulate as simulate
    from fieldmap.io import open_field as open_field
    from fieldmap.iron import design_figures as design_figures
    from fieldmap.iron import solve as solve
    from fieldmap.iron import solve_linear as solve_linear
    from fieldmap.iron import solve_to_tolerance as solve_to_tolerance
    from fieldmap.levitation import find_equilibrium as find_equilibrium
    from fieldmap.lookup import open_map as open_map
    from fieldmap.maps import generate as generate
    from fieldmap.provenance import __version__ as __version__
    from fieldmap.studies import generate_many as generate_many
    from fieldmap.studies import optimise as optimise

# Classes and functions that build a machine in Python.
_PARTS = (
    "Arctangent",
    "Background",
    "BHTable",
    "Body",
    "Box",
    "CircularCoil",
    "Coil",
    "Cylinder",
    "Device",
    "Driver",
    "ExtrudedPolygon",
    "FieldSensor",
    "FluxBarrier",
    "Froehlich",
    "Joint",
    "LinearMaterial",
    "MagnetBlock",
    "MagnetCylinder",
    "MagnetSphere",
    "MagpylibCoil",
    "Marrocco",
    "MeshFile",
    "Part",
    "PathCoil",
    "Payload",
    "PayloadPiece",
    "PermanentMagnet",
    "Placement",
    "Reference",
    "RevolvedProfile",
    "Ring",
    "RoundedRectangleCoil",
    "Section",
    "SoftEllipsoid",
    "SoftSphere",
    "Sphere",
    "StepFile",
    "TriangleSurface",
    "VolumeMesh",
    "WorkspaceBox",
    "WorkspaceCylinder",
    "placed",
)
_PUBLIC = {
    **dict.fromkeys(_PARTS, "fieldmap.device.model"),
    "material": "fieldmap.device",
    "read_device": "fieldmap.device",
    "solve_linear": "fieldmap.iron",
    "solve_to_tolerance": "fieldmap.iron",
    "solve": "fieldmap.iron",
    "design_figures": "fieldmap.iron",
    "generate": "fieldmap.maps",
    "open_map": "fieldmap.lookup",
    "open_field": "fieldmap.io",
    "find_equilibrium": "fieldmap.levitation",
    "simulate": "fieldmap.dynamics",
    "open_machine": "fieldmap.dynamics",
    "generate_many": "fieldmap.studies",
    "optimise": "fieldmap.studies",
    "__version__": "fieldmap.provenance",
}
_PACKAGES = (
    "control",
    "core",
    "currents",
    "device",
    "dynamics",
    "errors",
    "field",
    "instruments",
    "interop",
    "io",
    "iron",
    "levitation",
    "lookup",
    "maps",
    "planar",
    "plot",
    "sources",
    "store",
    "studies",
    "thesis",
)
# Not all packages, because `from fieldmap import *` would load them.
__all__ = [*_PUBLIC, "control", "dynamics", "instruments", "interop"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    if name in _PACKAGES:
        return import_module(f"fieldmap.{name}")
    raise AttributeError(f"module 'fieldmap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *_PACKAGES})
