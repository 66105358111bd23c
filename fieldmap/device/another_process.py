"""Trial reads of other programs' files in a separate process, since C++ libraries may crash or hang the process.

A file that was read there may still fail here: on some damaged STEP files the CAD kernel hangs in about one of a
hundred runs, depending on the state of the memory. The separate process can therefore return the contents of the file.
"""

import functools
import subprocess
import sys
import tempfile
from pathlib import Path

MEMORY_BYTES, MEMORY_TIMES = 1 << 30, 400
"""Memory that a reader may allocate after its imports: `MEMORY_BYTES` plus `MEMORY_TIMES` times the file's size."""
LONGEST_S, SIZE_OF_A_SECOND = 30, 20_000
"""Time limit of a reader: `LONGEST_S` seconds, plus one second for each `SIZE_OF_A_SECOND` bytes of the file."""

_BEFORE = f"""
import os, sys
path, out = sys.argv[1:]

def limit():
    try:
        import resource
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        most = used + {MEMORY_BYTES} + {MEMORY_TIMES} * os.path.getsize(path)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    except (ImportError, OSError, ValueError):
        pass
"""


def run_by_another(
    program: str, *arguments: str, longest: float | None = None
) -> subprocess.CompletedProcess[bytes] | None:
    """Result of a Python program that is run in another process; None where no process can be started.

    longest: seconds after which the process is killed and subprocess.TimeoutExpired raised.
    """
    # -P: the program does not import modules from the working folder.
    command = [sys.executable, "-P", "-c", program, *arguments]
    try:
        return subprocess.run(
            command, capture_output=True, stdin=subprocess.DEVNULL, timeout=longest, check=False
        )
    except OSError:
        return None


def crashed(done: subprocess.CompletedProcess[bytes]) -> bool:
    """Whether a process was ended by a signal, or on Windows with an exit code outside of 0 to 255."""
    return not 0 <= done.returncode <= 255


def read_by_another(path: Path, program: str) -> bytes | None:
    """Output of a program that reads the file at `path`, cached until the file changes; None without output.

    program: Python that reads `path`, calls limit() after its imports, and writes to the file `out`; if it raises, the
    result is None. Raises ValueError where its process crashes, exceeds the time limit, or exceeds the memory limit,
    which holds on Linux only.
    """
    about = path.stat()
    told, written = _read(path.resolve(), program, about.st_mtime_ns, about.st_size)
    if told:
        raise ValueError(f"{path}: {told}")
    return written


@functools.lru_cache(maxsize=32)
def _read(path: Path, program: str, changed: int, size: int) -> tuple[str, bytes | None]:
    longest = LONGEST_S + size / SIZE_OF_A_SECOND
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        try:
            done = run_by_another(_BEFORE + program, str(path), str(out), longest=longest)
        except subprocess.TimeoutExpired:
            return f"reading it does not end within {longest:.0f} s", None
        if done is None:
            return "", None
        if b"MemoryError" in done.stderr or b"bad_alloc" in done.stderr:
            most = f"{MEMORY_BYTES >> 30} GB and {MEMORY_TIMES} times its size"
            return f"it asks for more memory than {most}", None
        if crashed(done):
            return "damaged: its reader crashes on it", None
        return "", out.read_bytes() if done.returncode == 0 and out.is_file() else None
