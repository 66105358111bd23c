"""The numpy door in front of the kernels: shapes, `out=`, threads, and what happens outside the box."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numba
import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.kernels.map import lookup as kernels
from fieldmap.lookup.checks import outside_error
from fieldmap.typing import Array

# Points below which a second thread costs more than it saves: a chunk of this size takes about a millisecond.
CHUNK = 16384
_PIECES_PER_THREAD = 4


@dataclass(frozen=True, eq=False)
class Box:
    """Where a map holds, what a point outside does, and how many threads a large batch may use."""

    lower: Array
    upper: Array
    outside: str
    threads: int

    def check(self, points: Array, n_outside: int) -> None:
        """Raise OutsideMapError if that is the rule and points lie outside."""
        if n_outside and self.outside == "raise":
            raise outside_error(points, n_outside, self.lower, self.upper)


def default_threads() -> int:
    """One per processor that this process may use, or NUMBA_NUM_THREADS."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def result_array(out: Array | None, shape: tuple[int, ...]) -> Array:
    """A new array, or `out` if it fits. Raises InputError if it does not."""
    if out is None:
        return np.empty(shape)
    good = isinstance(out, np.ndarray) and out.shape == shape and out.dtype == np.float64
    if not (good and out.flags.c_contiguous and out.flags.writeable):
        received = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        problem = Problem(
            "lookup, out", f"a contiguous, writeable float64 array of shape {shape}", received, "match it"
        )
        raise InputError(problem)
    return out


def in_chunks(kernel: Callable[..., int], points: Array, others: Sequence[Array], box: Box) -> None:
    """kernel(points[a:b], *(other[a:b])) over all points, on several threads if there are many.

    Arrays of another length than the points are passed whole. The kernels release the interpreter's lock and
    write to disjoint rows, so plain threads do. They are kept between calls and the caller sleeps meanwhile: a thread
    that is new, or woken by one that goes on running, begins on the same processor and waits there for milliseconds.
    """
    n = len(points)
    workers = max(1, min(box.threads, n // CHUNK))

    def part(a: int, b: int) -> int:
        return kernel(points[a:b], *(other[a:b] if len(other) == n else other for other in others))

    if workers == 1:
        box.check(points, part(0, n))
        return
    # More pieces than threads, which each takes when it has done one: who is held up leaves the rest to the others.
    count = min(_PIECES_PER_THREAD * workers, n // CHUNK)
    pieces = iter(list(pairwise(n * w // count for w in range(count + 1))))
    waiting = [_pool().submit(lambda: sum(part(a, b) for a, b in pieces)) for _ in range(workers)]
    box.check(points, sum(future.result() for future in waiting))


@cache
def _pool() -> ThreadPoolExecutor:
    """The threads of all lookups of this process; made when first needed."""
    return ThreadPoolExecutor(os.cpu_count(), "fieldmap lookup")


# Threads do not survive a fork: the child makes its own.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def field_and_gradient(
    block: Array, currents: Array | None, points: Array, flux: Array, slope: Array, box: Box
) -> None:
    """Fill flux (n, 3) and slope (n, 3, 3), or (n, 0, 0) for the field alone.

    currents (n, n_coils) or (1, n_coils) for a block of coils, None for a block at given currents.
    """
    if currents is None:
        in_chunks(lambda p, f, s: kernels.evaluate(block, p, f, s), points, [flux, slope], box)
    elif len(currents) == len(points) > 1:
        in_chunks(
            lambda p, i, f, s: kernels.evaluate_with(block, i, p, f, s), points, [currents, flux, slope], box
        )
    else:
        in_chunks(lambda p, f, s: kernels.evaluate_with(block, currents, p, f, s), points, [flux, slope], box)


def with_currents(
    kernel: Callable[..., int], block: Array, currents: Array, points: Array, out: Array, box: Box
) -> None:
    """Fill out (n, ...) by kernel(block, currents, points, out)."""
    if len(currents) == len(points) > 1:
        in_chunks(lambda p, i, o: kernel(block, i, p, o), points, [currents, out], box)
    else:
        in_chunks(lambda p, o: kernel(block, currents, p, o), points, [out], box)
