"""Limits of a process that reads hostile input, and detection of forbidden actions."""

import ctypes
import os
import resource
import struct
import sys
import tracemalloc
from pathlib import Path
from typing import Any

ADDRESS_SPACE = 4 << 30
"""Bytes that the process may allocate beyond its size at the first case. A larger allocation gives a MemoryError."""

_READ = 0x1 | 0x20  # IN_ACCESS, IN_OPEN
_RUNS = (
    "os.system", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "subprocess.Popen", "socket.connect",
)  # fmt: skip


class Watch:
    """Detects access to forbidden files (by inotify, which includes libraries in C), forbidden actions (by Python's
    audit events), and the memory that was allocated."""

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
        """Begin a case."""
        self._opened()
        self._told[0] = ""
        tracemalloc.reset_peak()
        self._before = tracemalloc.get_traced_memory()[0]
        Path("/proc/self/clear_refs").write_text("5") if sys.platform == "linux" else None
        self._resident = _status("VmHWM")
        self._active = True

    def end(self) -> tuple[str, float]:
        """End the case. Returns its forbidden action, or "", and the allocated megabytes."""
        self._active = False
        asked = tracemalloc.get_traced_memory()[1] - self._before
        # An allocation beyond the limit failed and is not counted. The reader handled it, or ends in a MemoryError.
        asked = asked if asked <= ADDRESS_SPACE else 0
        # Allocations of libraries in C appear in the peak memory of the process only.
        asked = max(asked, _status("VmHWM") - self._resident)
        return self._told[0] or self._opened(), asked / 1e6

    def _opened(self) -> str:
        """Description of an access to a decoy since the last call, or ""."""
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
