"""Limits of a process that reads hostile input, and what it did beside reading."""

import ctypes
import os
import resource
import struct
import sys
import tracemalloc
from pathlib import Path
from typing import Any

ADDRESS_SPACE = 4 << 30
"""Beyond what the process has when the cases begin: who asks for more is refused, which shows as a MemoryError."""

_READ = 0x1 | 0x20  # IN_ACCESS, IN_OPEN
_RUNS = (
    "os.system", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "subprocess.Popen", "socket.connect",
)  # fmt: skip


class Watch:
    """Files that nothing may open (by inotify, so that libraries in C are seen as well), code that nothing may run (by
    Python's audit events), and the memory that was asked for."""

    def __init__(self, folder: Path, decoys: Path) -> None:
        self._folder, self._active, self._told = str(folder), False, [""]
        self._handle = -1
        if sys.platform == "linux":
            library = ctypes.CDLL(None, use_errno=True)
            self._handle = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            for place in (decoys, *decoys.iterdir(), *folder.glob("*.good")):
                library.inotify_add_watch(self._handle, os.fsencode(place), _READ)
        sys.addaudithook(self._audit)
        tracemalloc.start(1)
        limit = _size() + ADDRESS_SPACE
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._active:
            return
        if event in _RUNS:
            self._told[0] = f"{event} {arguments!s:.80}"
        elif event == "exec" and str(getattr(arguments[0], "co_filename", "")).startswith(self._folder):
            self._told[0] = f"ran {arguments[0].co_filename}"
        elif (
            event == "open"
            and isinstance(arguments[0], str | bytes)
            and arguments[1] not in (None, "r", "rb")
        ):
            path = os.fsdecode(arguments[0])
            if (
                not os.path.abspath(path).startswith((self._folder, "/dev/null"))
                and "__pycache__" not in path
            ):
                self._told[0] = f"wrote {path[-80:]}"

    def begin(self) -> None:
        """A case begins."""
        self._opened()
        self._told[0] = ""
        tracemalloc.reset_peak()
        self._before = tracemalloc.get_traced_memory()[0]
        Path("/proc/self/clear_refs").write_text("5") if sys.platform == "linux" else None
        self._resident = _status("VmHWM")
        self._active = True

    def end(self) -> tuple[str, float]:
        """The case has ended: what it did that it must not, and megabytes that it asked for."""
        self._active = False
        asked = tracemalloc.get_traced_memory()[1] - self._before
        # More than the process may have was asked for and not given; who did not bear that ends in a MemoryError.
        asked = asked if asked <= ADDRESS_SPACE else 0
        # What libraries in C ask for shows in the memory that the process used at most.
        asked = max(asked, _status("VmHWM") - self._resident)
        return self._told[0] or self._opened(), asked / 1e6

    def _opened(self) -> str:
        """Whether a decoy was opened since the last question."""
        if self._handle < 0:
            return ""
        try:
            events = os.read(self._handle, 65536)
        except BlockingIOError:
            return ""
        mask = struct.unpack_from("iI", events)[1]
        return f"read another file (inotify event {mask:#x})"


def _size() -> int:
    return _status("VmSize") or 8 << 30


def _status(name: str) -> int:
    try:
        text = Path("/proc/self/status").read_text()
    except OSError:
        return 0
    return int(text.partition(f"{name}:")[2].split()[0]) * 1024
