"""Files and geometry of other programs are read and meshed by another process first: libraries in C++ may end the
process that they run in, or never answer it.

That it goes well there does not say that it goes well here: on some damaged STEP files the CAD kernel loops for ever in
one of some hundred runs, by what stood in memory before. So the other process may hand over what the file holds.
"""

import functools
import subprocess
import sys
import tempfile
from pathlib import Path

MEMORY_BYTES, MEMORY_TIMES = 1 << 30, 400
"""What a reader may ask for: a part, and that many times the size of the file."""
LONGEST_S, SIZE_OF_A_SECOND = 30, 20_000
"""What it may take: so many seconds, and one more for each of so many bytes."""

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
    """The end of another process that runs a program of Python; None where no process can be started here.

    longest: seconds after which it is ended, which raises subprocess.TimeoutExpired.
    """
    # -P: modules of the working folder are not taken for those of the program.
    command = [sys.executable, "-P", "-c", program, *arguments]
    try:
        return subprocess.run(
            command, capture_output=True, stdin=subprocess.DEVNULL, timeout=longest, check=False
        )
    except OSError:
        return None


def crashed(done: subprocess.CompletedProcess[bytes]) -> bool:
    """Whether a process ended by a signal; on Windows by a number beyond those of exits."""
    return not 0 <= done.returncode <= 255


def read_by_another(path: Path, program: str) -> bytes | None:
    """What a program writes of the file at `path`, run once for each state of the file; None where it writes nothing.

    program: Python that reads `path`, calls limit() when it has imported what it needs, and writes to the file `out`.
    What it raises ends it. Raises ValueError where its process crashes, does not end, or asks for more memory than
    `MEMORY_BYTES` and `MEMORY_TIMES` the size of the file; on other systems than Linux the memory is not limited.
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
