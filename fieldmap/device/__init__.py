"""What a machine is, and the file that describes it."""

from fieldmap.device.model import Device, Payload
from fieldmap.device.reader import material, read_device, recorded_device

__all__ = ["Device", "Payload", "material", "read_device", "recorded_device"]
