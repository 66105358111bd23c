"""Data files that come with the package: devices and materials (geometry), recipes (maps).

Devices and recipes lie in fieldmap/shipped/ in an installed wheel; in a checkout, in the folders of the same name
beside the package.
"""

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
KINDS = ("geometry", "maps")


def shipped_folder(kind: str) -> Path:
    """Folder of the shipped files of one kind: "geometry" or "maps"."""
    if kind not in KINDS:
        raise ValueError(f"shipped_folder: kind must be one of {', '.join(KINDS)}; received {kind!r}")
    installed = PACKAGE / "shipped" / kind
    return installed if installed.is_dir() else PACKAGE.parent / kind


def is_file(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a file; False also for a path that is invalid, too long or not accessible.

    >>> is_file(__file__), is_file("x" * 5000), is_file("no\\x00name")
    (True, False, False)
    """
    # Path.is_file raises for names that are too long and folders that may not be entered.
    return os.path.isfile(path)


def shipped_file(kind: str, name: str) -> Path | None:
    """Path of a shipped file, or None. `name` is relative to the folder; ".toml" may be left out.

    >>> shipped_file("geometry", "drive_unit").name
    'drive_unit.toml'
    """
    folder = shipped_folder(kind)
    for candidate in (folder / name, folder / f"{name}.toml"):
        if is_file(candidate) and candidate.resolve().is_relative_to(folder):
            return candidate
    return None


def shipped_alone(
    kind: str, name: str | os.PathLike[str], subfolder: str = "", ending: str = ".toml"
) -> Path | None:
    """The shipped file of a name alone, which has neither a folder nor an ending; None for every other name.

    >>> shipped_alone("geometry", "drive_unit").name, shipped_alone("geometry", "./drive_unit")
    ('drive_unit.toml', None)
    """
    text = os.fspath(name)
    alone = Path(text).name == text
    return shipped_file(kind, str(Path(subfolder) / f"{text}{ending}")) if alone else None


def shipped_names(kind: str, subfolder: str = "") -> list[str]:
    """Names of the shipped TOML files of one kind, without ".toml", in alphabetical order."""
    prefix = f"{subfolder}/" if subfolder else ""
    return [prefix + path.stem for path in sorted((shipped_folder(kind) / subfolder).glob("*.toml"))]
