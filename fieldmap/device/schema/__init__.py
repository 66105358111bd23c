"""The keys of a device file, section by section: names with units, limits, and the turn into SI data."""

from fieldmap.device.schema.file import DEVICE, MATERIAL, DeviceFile, MaterialFile

__all__ = ["DEVICE", "MATERIAL", "DeviceFile", "MaterialFile"]
