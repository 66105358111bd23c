"""The keys of a device file, section by section: names with units, limits, and the turn into SI data."""

from fieldmap.device.schema.file import DeviceFile, MaterialFile

__all__ = ["DeviceFile", "MaterialFile"]
