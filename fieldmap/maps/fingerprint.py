"""What decides the numbers of a map: settings, device, libraries, and the code itself."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import fieldmap
from fieldmap.device.model import Device
from fieldmap.maps.recipe import Recipe

LIBRARIES = ("numpy", "scipy", "numba", "h5py", "netgen-mesher", "pydantic")
# Rooms whose code takes part in making a map.
ROOMS = ("kernels", "device", "store", "sources", "iron", "maps")


def library_versions() -> dict[str, str]:
    """Versions of fieldmap and of every library that takes part in making a map."""
    versions = {"fieldmap": fieldmap.__version__}
    for name in LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions


def fingerprint(recipe: Recipe, device: Device) -> str:
    """Hash of everything that decides the numbers of a map; equal hashes mean equal maps on one machine."""
    total = hashlib.sha256()
    parts = [recipe.text, device.text]
    parts += [text for pair in sorted(device.included.items()) for text in pair]
    parts += [text for pair in library_versions().items() for text in pair]
    for part in (*parts, _code()):
        raw = part.encode()
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()


@cache
def _code() -> str:
    """Hash of the package's own source: a version number does not change with every correction."""
    package = Path(fieldmap.__file__).parent
    total = hashlib.sha256()
    for room in ROOMS:
        for path in sorted((package / room).rglob("*.py")):
            total.update(path.read_bytes())
    return total.hexdigest()
