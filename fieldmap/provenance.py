"""A fingerprint of everything that decides computed numbers: settings, the package's own code, and its libraries.

Cached results (solved states, rows of a study, parts of a report) are reused only if their fingerprint is unchanged. A
version number is not enough, because it does not change with every correction.
"""

import hashlib
import platform
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from fieldmap.shipped import PACKAGE

__version__ = "0.2.0"
LIBRARIES = ("numpy", "scipy", "numba", "h5py", "netgen-mesher", "pydantic", "pymetis")


def library_versions(*more: str) -> dict[str, str]:
    """Versions of fieldmap, of Python, of every library that decides numbers, and of `more` distributions."""
    versions = {"fieldmap": __version__, "python": platform.python_version()}
    return versions | {name: _installed(name) for name in (*LIBRARIES, *more)}


@cache
def _installed(name: str) -> str:
    """Version of a distribution, cached because its metadata must be read and parsed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def fingerprint(settings: Iterable[str], packages: Iterable[str]) -> str:
    """64 hexadecimal digits for texts in order, the code of packages and modules, and the libraries."""
    total = hashlib.sha256()
    for text in (*settings, _code(tuple(packages)), *map(repr, library_versions().items())):
        raw = text.encode()
        total.update(len(raw).to_bytes(8, "little") + raw)
    return total.hexdigest()


@cache
def _code(packages: tuple[str, ...]) -> str:
    total = hashlib.sha256()
    for name in packages:
        module = PACKAGE / f"{name}.py"
        for path in [module] if module.is_file() else sorted((PACKAGE / name).rglob("*.py")):
            total.update(path.relative_to(PACKAGE).as_posix().encode() + path.read_bytes())
    return total.hexdigest()
