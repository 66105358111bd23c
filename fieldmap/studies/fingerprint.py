"""What decides the numbers of a study: its file, the device as it is varied, libraries, and the code itself."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import fieldmap
from fieldmap.device.reader import device_of
from fieldmap.maps.fingerprint import library_versions
from fieldmap.studies.study import Study

# Rooms whose code takes part in a study.
ROOMS = ("kernels", "device", "sources", "iron", "levitation", "studies")


def versions() -> dict[str, str]:
    """Versions of fieldmap and of the libraries that take part in a study."""
    found = library_versions()
    for name in ("xarray", "h5netcdf"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def fingerprint(study: Study) -> str:
    """Hash of everything that decides the numbers; equal hashes mean equal data on one machine."""
    device = device_of(study.device_document)
    parts = [study.text, device.text, repr(study.iron)]
    parts += [text for pair in sorted(device.included.items()) for text in pair]
    parts += [text for pair in sorted(library_versions().items()) for text in pair]
    total = hashlib.sha256()
    for part in (*parts, _code()):
        raw = part.encode()
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()


@cache
def _code() -> str:
    package = Path(fieldmap.__file__).parent
    total = hashlib.sha256()
    for room in ROOMS:
        for path in sorted((package / room).rglob("*.py")):
            total.update(path.read_bytes())
    return total.hexdigest()
