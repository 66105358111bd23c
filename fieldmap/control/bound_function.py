"""A controller of one's own as a compiled loop calls it, and what went wrong in it.

Messages say where a function raised what, what it returned, what it wrote beside its arrays, and what numba says of it.
"""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.core.controller import DONE, WRONG_LENGTH
from fieldmap.errors import Problem
from fieldmap.records import count_of
from fieldmap.typing import Array

WHERE = "FunctionController(function)"
CALL = "function(time, measured, reference, state) -> outputs"
_HERE = os.path.dirname(__file__)
ROOM = 256
"""Numbers before and behind an array that are watched."""
# A NaN with bits that no arithmetic makes: what is read beside an array is no number, and what is written shows.
_MARK = np.uint64(0x7FF8_5A5A_C3C3_1E1E)


class BoundFunction:
    """A function as compiled loops call it, for one run: a C function at an address. One that fails says so by its
    number alone."""

    def __init__(self, address: int, alive: object = None) -> None:
        self.address, self._alive = address, alive

    def cause(self, time: float, measured: Array, reference: Array, state: Array) -> BaseException | None:
        """The exception that the function raised when it was called with these, if any."""
        return None

    def shape(self, time: float, measured: Array, reference: Array, state: Array) -> str:
        """What it gave in the place of the outputs, as a text; "" where that is not known."""
        return ""


def reason(error: Exception) -> str:
    """What numba says first that is about the function, and the line that it names."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    lines = [line.strip() for line in plain.splitlines() if line.strip()]
    said = [line for line in lines if not line.startswith(("Failed in", "File ", "During:", "- Resolution"))]
    named = re.search(r'File "([^"]+)", line (\d+)', plain)
    first = said[0] if said else type(error).__name__
    return first if named is None else f"{first} ({_shorter(named[1])}, line {named[2]})"


def wrong_outputs(where: str, names: Sequence[str], received: str) -> Problem:
    """Of a function whose outputs are not as many as these names."""
    wanted = f"must return {len(names)} number{'s' * (len(names) > 1)}: {', '.join(names)}"
    return Problem(where, wanted, received, "return them as a tuple or an array, or choose what it gives")


def failure(
    bound: BoundFunction,
    names: Sequence[str],
    answer: int,
    outputs: Array,
    given: tuple[float, Array, Array, Array],
) -> tuple[Problem, BaseException | None]:
    """What went wrong at a sample at which a function was given time, measured, reference and state, and returned
    `answer`; outputs (m,): what it filled in."""
    time, measured, reference, state = given
    where = f"controller at {time:.6g} s"
    about = f"measured {measured.tolist()}, reference {reference.tolist()} m, state {state.tolist()}"
    if answer == DONE:
        values = ", ".join(f"{name} {value:g}" for name, value in zip(names, outputs, strict=True))
        remedy = (
            f"look for a division by zero, a state that grows or an index out of range; it was given {about}"
        )
        return Problem(where, "must return finite numbers", values, remedy), None
    shape = bound.shape(*given) if answer == WRONG_LENGTH else ""
    if shape:
        return wrong_outputs(where, names, shape), None
    cause = bound.cause(*given)
    if cause is None:
        remedy = f"see what it means by that; it was given {about}"
        return Problem(where, "must return 0", f"{answer}", remedy), None
    at = _raised_at(cause)
    received = f"{type(cause).__name__}: {cause}{at and f' ({at})'}"
    remedy = "mend it" if not isinstance(cause, IndexError) else _more_state(len(state))
    return Problem(
        where, f"must be {CALL} and raise nothing", received, f"{remedy}; it was given {about}"
    ), cause


def _more_state(states: int) -> str:
    numbers = count_of(states, "number", "numbers")
    return f"`state` has {numbers}: give as many as it uses, FunctionController(function, state=N)"


def _raised_at(error: BaseException) -> str:
    """File and line of the function at which it raised an exception, "" where they are not known."""
    every = traceback.extract_tb(error.__traceback__)
    frames = [frame for frame in every if os.path.dirname(frame.filename) != _HERE]
    # The first is the function's own; below its last line in that file lie the libraries that it calls.
    own = [frame for frame in frames if frame.filename == frames[0].filename]
    return f"{_shorter(own[-1].filename)}, line {own[-1].lineno}" if own else ""


def _shorter(file: str) -> str:
    """A file as seen from the current folder where it lies below it."""
    here = os.getcwd() + os.sep
    return file[len(here) :] if file.startswith(here) else file


def guarded(values: ArrayLike) -> Array:
    """A copy (n,) of values with watched room before and behind it, contiguous."""
    given = np.asarray(values, float).ravel()
    whole = np.empty(len(given) + 2 * ROOM)
    whole.view(np.uint64)[:] = _MARK
    inside = whole[ROOM : ROOM + len(given)]
    inside[:] = given
    return inside


def _overrun(inside: Array) -> int | None:
    """The index, nearest to it, beside an array of `guarded` at which something was written; None where nothing was."""
    whole: NDArray[np.float64] = inside.base  # type: ignore[assignment]
    changed = np.flatnonzero(whole.view(np.uint64) != _MARK) - ROOM
    beside = changed[(changed < 0) | (changed >= len(inside))]
    return int(beside[np.argmin(np.abs(beside - 0.5 * len(inside)))]) if len(beside) else None


def written_beside(
    time: float, state: Array, given: Array, outputs: Array, measured: slice = slice(3, 6)
) -> Problem | None:
    """What a compiled function wrote beside its arrays by a time, s; None where it kept to them. All of `guarded`;
    given (7,) or longer: what a loop sees, of which the function gets `measured`, and the first three as reference."""
    arrays = (("state", state, 0), ("outputs", outputs, 0), ("measured", given, measured.start))
    for name, array, first in arrays:
        index = _overrun(array)
        if index is not None:
            size = measured.stop - first if name == "measured" else len(array)
            must = f"must write within {name}, which has {count_of(size, 'number', 'numbers')}"
            remedy = _more_state(size) if name == "state" else "look for the index that goes too far"
            received = f"a write to {name}[{index - first}]"
            where = f"controller, noticed at {time:.6g} s"
            return Problem(where, must, received, f"{remedy}; the run does not hold")
    return None
