"""The data of a machine, and the file that describes it.

A module is imported on first use of its names, so that a program that only opens a map does not load the file schemas.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fieldmap.device.model import Device as Device
    from fieldmap.device.model import Payload as Payload
    from fieldmap.device.reader import material as material
    from fieldmap.device.reader import read_device as read_device
    from fieldmap.device.reader import recorded_device as recorded_device

_PUBLIC = {
    "Device": "fieldmap.device.model",
    "Payload": "fieldmap.device.model",
    "material": "fieldmap.device.reader",
    "read_device": "fieldmap.device.reader",
    "recorded_device": "fieldmap.device.reader",
}
__all__ = ["Device", "Payload", "material", "read_device", "recorded_device"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'fieldmap.device' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
