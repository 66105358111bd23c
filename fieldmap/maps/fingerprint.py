"""What decides the numbers of a map: settings, device, libraries, and the code itself."""

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import fieldmap
from fieldmap.device.model import Device
from fieldmap.maps.recipe import Recipe
from fieldmap.parallel import Workers

LIBRARIES = ("numpy", "scipy", "numba", "h5py", "netgen-mesher", "pydantic", "pymetis")
# Rooms whose code takes part in making a map.
ROOMS = ("kernels", "parallel", "device", "store", "interpolants", "sources", "iron", "maps")


def library_versions() -> dict[str, str]:
    """Versions of fieldmap, of Python, and of every library that takes part in making a map."""
    versions = {"fieldmap": fieldmap.__version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions


def finished_by(workers: Workers) -> dict[str, str]:
    """Who finished a map: nothing that decides its numbers, as long as the processors are of one kind."""
    return {"workers": str(workers), "machine": f"{platform.system()}, {platform.machine()}"}


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
