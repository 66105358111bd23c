"""A program in an environment of its own, made once with pip in the user's cache folder."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from fieldmap.errors import FieldmapError, Problem

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fieldmap"
# Time limit of a command, s. mag_manip reads 46 nodes in each direction in a minute, or in nine on a busy machine.
SECONDS = 1800


class UnavailableError(FieldmapError):
    """The program cannot be installed here, or failed."""

    def __init__(self, program: str, reason: str) -> None:
        remedy = "run this on Linux with Python 3.11 or 3.12 and a package index within reach"
        super().__init__(Problem(program, "must run in an environment of its own", reason, remedy))


@dataclass(frozen=True)
class OwnEnvironment:
    """program: its name. requirements: packages for pip with versions, the program first. newest_python: newest version
    of Python with wheels."""

    program: str
    requirements: tuple[str, ...]
    newest_python: tuple[int, int] | None = None

    @property
    def folder(self) -> Path:
        """Folder of the environment."""
        name = self.requirements[0].replace("==", "-")
        return CACHE / f"{name}-python{sys.version_info.major}.{sys.version_info.minor}"

    def is_installed(self) -> bool:
        """Whether the environment exists with these requirements."""
        ready = _ready(self.folder)
        return ready.exists() and ready.read_text() == "\n".join(self.requirements)

    def python(self) -> Path:
        """The interpreter of the environment, which is made if it is missing. Raises UnavailableError."""
        if not self.is_installed():
            self._install()
        return self.folder / "bin" / "python"

    def run(self, *command: str) -> str:
        """Output of a command. Raises UnavailableError with the last line of its error."""
        clean = {
            name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")
        }
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=SECONDS, env=clean
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise UnavailableError(self.program, str(error)) from None
        if done.returncode:
            said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise UnavailableError(self.program, said[-1])
        return done.stdout

    def _install(self) -> None:
        if sys.platform != "linux":
            raise UnavailableError(self.program, "another system than Linux")
        if self.newest_python is not None and sys.version_info[:2] > self.newest_python:
            raise UnavailableError(self.program, "a newer Python than its wheels are for")
        # Several processes may do this at once: each makes its own folder, and one of them is kept.
        own = self.folder.with_name(f"{self.folder.name}.{os.getpid()}")
        own.parent.mkdir(parents=True, exist_ok=True)
        try:
            self.run(sys.executable, "-m", "venv", str(own))
            pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:")
            self.run(str(own / "bin" / "python"), *pip, *self.requirements)
            _ready(own).write_text("\n".join(self.requirements))
            if not self.is_installed():
                shutil.rmtree(self.folder, ignore_errors=True)
                own.rename(self.folder)
        finally:
            shutil.rmtree(own, ignore_errors=True)


def _ready(folder: Path) -> Path:
    return folder / "installed.txt"
