"""The kernels that a map needs late, compiled by another process while the map is still being meshed and assembled.

numba keeps compiled kernels in files. On the first run after an installation there are none, and compiling takes as
long as solving. The process started here goes through `KERNELS` and leaves the files for the run that started it; what
the run itself needs first is not in the list, and what it needs before its turn it compiles by itself.

    python -m fieldmap.kernels.compile_ahead        compiles all of the list
"""

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numba
from numba import types
from numba.core.caching import FunctionCache

# Module, kernel, and the types of its arguments: d, f, i for float64, float32 and int64; with a number, an array of
# that many dimensions in C order. In the order in which they are compiled.
KERNELS = """
coils.path _path_flux_density_rows i i d2 d2 d2 d d d d2
coils.path _path_flux_density_and_gradient_rows i i d2 d2 d2 d d d d2 d3
map.reduced_iron newton d1 d2 f2 d1 i1 i1 d1 d2 d2 d1 d1 d2 d i
iron.charged_surface surface_field_and_gradient i i d2 d3 d2 d2 d2 d3 d4
iron.sample_gradients root_of_susceptibility d1 d1 i1 i1 d1 d2 d3
iron.sample_gradients magnetise_states d2 d1 i1 i1 d1 d2
growing_cholesky append d2 i d1 d
growing_cholesky solve_lower d2 i d1
growing_cholesky solve_upper d2 i d1
growing_cholesky remove d2 i i
iron.sample_gradients point_moments i i d1 d2 d1 i1 i1 d1 d2 d1 d2
"""

_NUMBERS = {"d": types.float64, "f": types.float32, "i": types.int64}
_PATIENCE = 10  # added to the niceness of the process: the run itself comes first


class Entry(NamedTuple):
    """A kernel and the types of arguments it is compiled for."""

    kernel: Any
    arguments: tuple[Any, ...]

    @property
    def is_cached(self) -> bool:
        """Whether a file says that it has been compiled, by this version of the source or an earlier one."""
        function = self.kernel.py_func
        stem = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}-"
        return any(Path(FunctionCache(function).cache_path).glob(f"{stem}*.nbi"))

    def compile(self) -> None:
        """Compile it, and leave its file."""
        self.kernel.compile(self.arguments)


def listed() -> Iterator[Entry]:
    """The kernels of the list, imported."""
    for line in KERNELS.split("\n")[1:-1]:
        module, name, *arguments = line.split()
        kernel = getattr(importlib.import_module(f"fieldmap.kernels.{module}"), name)
        yield Entry(kernel, tuple(_type_of(text) for text in arguments))


def _type_of(text: str) -> Any:
    number = _NUMBERS[text[0]]
    return number if len(text) == 1 else types.Array(number, int(text[1]), "C")


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """While the block runs, another process compiles the listed kernels, if any of them lacks its file.

    Not where this process may use one processor only, nor where numba does not compile at all.
    """
    if numba.config.DISABLE_JIT or numba.config.NUMBA_NUM_THREADS < 2:  # type: ignore[attr-defined]
        yield
        return
    if all(entry.is_cached for entry in listed()):
        yield
        return
    silent = subprocess.DEVNULL
    process = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=silent, stdout=silent, stderr=silent, start_new_session=True
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def _compile_all() -> None:
    started_by = os.getppid()
    if hasattr(os, "nice"):
        os.nice(_PATIENCE)
    for entry in listed():
        # Nobody waits for the rest of a run that was killed.
        if os.getppid() != started_by:
            return
        entry.compile()


if __name__ == "__main__":
    _compile_all()
