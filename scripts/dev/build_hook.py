"""Build hook of hatchling, which compiles the C core for an installation from a checkout or for a wheel.

scripts/dev/wheels.py compiles for other systems: FIELDMAP_TARGET names machine and system, such as aarch64-darwin, and
FIELDMAP_TARGET_FILES the folder with the headers of that system (`compile_libraries`).
"""

import os
import runpy
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CoreHook(BuildHookInterface):  # type: ignore[type-arg]
    """Hook that calls `fieldmap.core.compile`."""

    def dependencies(self) -> list[str]:
        """A compiler, unless the user names one."""
        return [] if os.environ.get("CC") else [self._core()["COMPILER"]]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the libraries into the wheel, which becomes a wheel for this kind of machine."""
        core = self._core()
        target = os.environ.get("FIELDMAP_TARGET", f"{core['machine']()}-{sys.platform}")
        machine, system = target.split("-")
        files = os.environ.get("FIELDMAP_TARGET_FILES")
        written = core["compile_libraries"](machine, system, os.environ.get("CC"), files and Path(files))
        build_data["artifacts"] += [path.relative_to(self.root).as_posix() for path in written]
        build_data["pure_python"] = False
        if version != "editable":
            build_data["tag"] = core["wheel_tag"](machine, system)

    def _core(self) -> dict[str, Any]:
        return runpy.run_path(str(Path(self.root, "fieldmap", "core", "compile.py")))
