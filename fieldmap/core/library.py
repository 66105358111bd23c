"""The compiled run time: a module in C (python.c), in the newest variant that this processor supports."""

import sys
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

from fieldmap.core.compile import FOLDER, libraries, machine


def loaded(path: Path) -> Any:
    """Load the module in a file."""
    loader = ExtensionFileLoader(f"{__name__.rpartition('.')[0]}.library", str(path))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


def runs(path: Path, level: int) -> bool:
    """Return whether a processor of this level (`level` in python.c) can run a library."""
    _, dash, needed = path.name.split(".")[1].partition("-v")
    return not dash or int(needed) <= level


def _for_this_machine() -> Any:
    oldest, *newer = libraries(machine(), sys.platform).values()
    if not oldest.exists():
        must = f"install the package, or compile it with `python {FOLDER / 'compile.py'}`"
        raise ImportError(f"{oldest.name} is not there: {must}")
    module = loaded(oldest)
    suitable = [path for path in newer if runs(path, module.level())]
    return loaded(suitable[-1]) if suitable else module


LIBRARY = _for_this_machine()
