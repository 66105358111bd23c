"""Modules that add choices: those of a folder of the package, and entry points of packages installed beside it."""

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType


def import_modules(package: str, folder: Path) -> None:
    """Import every module of a package of this program."""
    for module in iter_modules([str(folder)]):
        import_module(f"{package}.{module.name}")


def installed_modules(group: str) -> list[ModuleType]:
    """The modules, imported, that installed packages name as entry points of a group."""
    from importlib.metadata import entry_points

    return [entry.load() for entry in entry_points(group=group)]
