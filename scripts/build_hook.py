"""Compiles the C core when the package is installed from a checkout or a wheel is built. hatchling runs this."""

import os
import runpy
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CoreHook(BuildHookInterface):  # type: ignore[type-arg]
    """See `fieldmap.core.compile`, of which everything here comes."""

    def dependencies(self) -> list[str]:
        """A compiler, unless the user names one."""
        return [] if os.environ.get("CC") else [self._core()["COMPILER"]]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the libraries into the wheel, which is then one for this kind of machine."""
        core = self._core()
        written = core["compile_libraries"](core["machine"](), sys.platform, os.environ.get("CC"))
        build_data["artifacts"] += [path.relative_to(self.root).as_posix() for path in written]
        build_data["pure_python"] = False
        if version != "editable":
            build_data["tag"] = f"py3-none-{_platform(core['machine']())}"

    def _core(self) -> dict[str, Any]:
        return runpy.run_path(str(Path(self.root, "fieldmap", "core", "compile.py")))


def _platform(machine: str) -> str:
    """The tag of wheels for this system: the oldest for which zig compiles."""
    if sys.platform == "linux":
        return f"manylinux_2_17_{machine}"
    if sys.platform == "darwin":
        return f"macosx_13_0_{'arm64' if machine == 'aarch64' else machine}"
    return "win_amd64" if machine == "x86_64" else "win_arm64"
