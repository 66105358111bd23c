"""User-defined controllers as compiled loops call them, and messages about their failures.

Messages state exceptions with their lines, wrong return values, writes outside of arrays, and errors of numba.
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
"""Guard numbers before and after an array, in which writes are detected."""
# A NaN with bits that no arithmetic produces: reads outside of an array give NaN, and writes are detected.
_MARK = np.uint64(0x7FF8_5A5A_C3C3_1E1E)


class BoundFunction:
    """A function as compiled loops call it, for one run: a C function at an address. It reports a failure only by its
    return value; derived classes know more."""

    def __init__(self, address: int, alive: object = None) -> None:
        self.address, self._alive = address, alive

    def cause(self, time: float, measured: Array, reference: Array, state: Array) -> BaseException | None:
        """The exception that the function raised when it was called with these arguments, if any."""
        return None

    def shape(self, time: float, measured: Array, reference: Array, state: Array) -> str:
        """The return value of a wrong shape, in words; "" if it is not known."""
        return ""


def reason(error: Exception) -> str:
    """The first line of numba's error that concerns the function, and the line of code that it names."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    lines = [line.strip() for line in plain.splitlines() if line.strip()]
    said = [line for line in lines if not line.startswith(("Failed in", "File ", "During:", "- Resolution"))]
    named = re.search(r'File "([^"]+)", line (\d+)', plain)
    first = said[0] if said else type(error).__name__
    return first if named is None else f"{first} ({_shorter(named[1])}, line {named[2]})"


def wrong_outputs(where: str, names: Sequence[str], received: str) -> Problem:
    """The problem of a function with a wrong number of outputs. names: of the outputs."""
    wanted = f"must return {len(names)} number{'s' * (len(names) > 1)}: {', '.join(names)}"
    return Problem(where, wanted, received, "return them as a tuple or an array, or choose what it gives")


def failure(
    bound: BoundFunction,
    names: Sequence[str],
    answer: int,
    outputs: Array,
    given: tuple[float, Array, Array, Array],
) -> tuple[Problem, BaseException | None]:
    """The problem at a sample at which a function failed, and its exception if it is known. given: time, measured,
    reference and state; answer: the return value; outputs (m,): as the function left them."""
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
    """File and line of the function at which it raised an exception; "" if they are not known."""
    every = traceback.extract_tb(error.__traceback__)
    frames = [frame for frame in every if os.path.dirname(frame.filename) != _HERE]
    # The first frame is the function's own; frames in other files below belong to libraries that it calls.
    own = [frame for frame in frames if frame.filename == frames[0].filename]
    return f"{_shorter(own[-1].filename)}, line {own[-1].lineno}" if own else ""


def _shorter(file: str) -> str:
    """The path of a file, relative to the current folder if the file lies below it."""
    here = os.getcwd() + os.sep
    return file[len(here) :] if file.startswith(here) else file


def guarded(values: ArrayLike) -> Array:
    """A contiguous copy (n,) of values with guard numbers before and after it."""
    given = np.asarray(values, float).ravel()
    whole = np.empty(len(given) + 2 * ROOM)
    whole.view(np.uint64)[:] = _MARK
    inside = whole[ROOM : ROOM + len(given)]
    inside[:] = given
    return inside


def _overrun(inside: Array) -> int | None:
    """The index outside of an array of `guarded`, nearest to it, that was written to; None if there is none."""
    whole: NDArray[np.float64] = inside.base  # type: ignore[assignment]
    changed = np.flatnonzero(whole.view(np.uint64) != _MARK) - ROOM
    beside = changed[(changed < 0) | (changed >= len(inside))]
    return int(beside[np.argmin(np.abs(beside - 0.5 * len(inside)))]) if len(beside) else None


def written_beside(
    time: float, state: Array, given: Array, outputs: Array, measured: slice = slice(3, 6)
) -> Problem | None:
    """The problem of a compiled function that wrote outside of its arrays before a time, s; None if it did not. All
    arrays are of `guarded`. given (7,) or longer: signals of the loop; the function gets the slice `measured` of them,
    and the first three as reference."""
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
