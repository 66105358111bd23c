"""Files of other programs are read by another process first: libraries in C++ may end the process that they run in."""

import functools
import subprocess
import sys
from pathlib import Path

MEMORY_BYTES, MEMORY_TIMES = 1 << 30, 400
"""What a reader may ask for: a part, and that many times the size of the file."""
LONGEST_S, SIZE_OF_A_SECOND = 30, 20_000
"""What it may take: so many seconds, and one more for each of so many bytes."""

_BEFORE = f"""
import os, sys
path = sys.argv[1]

def limit():
    try:
        import resource
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        most = used + {MEMORY_BYTES} + {MEMORY_TIMES} * os.path.getsize(path)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    except (ImportError, OSError, ValueError):
        pass
"""


def try_to_read(path: Path, program: str) -> None:
    """Run a program that reads the file at `path`, once for each state of a file.

    program: Python that calls limit() when it has imported what it needs. Raises ValueError where its process crashes,
    does not end, or asks for more memory than `MEMORY_BYTES` and `MEMORY_TIMES` the size of the file; on other systems
    than Linux the memory is not limited. Other errors are left for the caller, who reads the file again.
    """
    about = path.stat()
    told = _trial(path.resolve(), program, about.st_mtime_ns, about.st_size)
    if told:
        raise ValueError(f"{path}: {told}")


@functools.lru_cache(maxsize=32)
def _trial(path: Path, program: str, changed: int, size: int) -> str:
    # -P: modules of the working folder are not taken for those of the reader.
    command = [sys.executable, "-P", "-c", _BEFORE + program, str(path)]
    longest = LONGEST_S + size / SIZE_OF_A_SECOND
    try:
        done = subprocess.run(
            command, capture_output=True, stdin=subprocess.DEVNULL, timeout=longest, check=False
        )
    except subprocess.TimeoutExpired:
        return f"reading it does not end within {longest:.0f} s"
    except OSError:
        return ""  # no process can be started here
    if b"MemoryError" in done.stderr or b"bad_alloc" in done.stderr:
        return f"it asks for more memory than {MEMORY_BYTES >> 30} GB and {MEMORY_TIMES} times its size"
    # A process that crashed ended by a signal; on Windows with a number beyond those of exits.
    return "" if 0 <= done.returncode <= 255 else "damaged: its reader crashes on it"
