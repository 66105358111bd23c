"""Imports modules that add choices: modules in a folder of fieldmap, and entry points of other installed packages."""

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType


def import_modules(package: str, folder: Path) -> None:
    """Import every module in the folder of a package of fieldmap."""
    for module in iter_modules([str(folder)]):
        import_module(f"{package}.{module.name}")


def installed_modules(group: str) -> list[ModuleType]:
    """Import the modules that installed packages name as entry points of a group, and return them."""
    from importlib.metadata import entry_points

    return [entry.load() for entry in entry_points(group=group)]
