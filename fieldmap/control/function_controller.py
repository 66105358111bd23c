"""User-defined controllers: a Python function, a function compiled by numba, or a C function.

    outputs = function(time, measured, reference, state)                                Python, numba
    int function(double time, const double *measured, const double *reference,          C
                 double *state, double *outputs)

time, s, of the sample; measured, reference (3,): of the sensed point, m, frame of the map, as read by the sensors; for
field sensors without an estimator measured (s + n,): their readings, T, and the currents of the coils, A; state (n,):
kept by the function from sample to sample; outputs (m,).
"""

from __future__ import annotations

import ctypes
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_choice, check_numbers, check_ordered, check_positive
from fieldmap.control.blocks import state_block
from fieldmap.control.bound_function import CALL, WHERE, BoundFunction
from fieldmap.core.controller import DONE, FAILED, SIGNALS, WRONG_LENGTH, Block
from fieldmap.errors import InputError
from fieldmap.records import Record, count_of
from fieldmap.typing import Array

GIVES = ("signals", "currents", "voltages")
C_CALL = "int function(double time, const double *measured, const double *reference, double *state, double *outputs)"
_CPointer: Any = ctypes._CFuncPtr  # type: ignore[attr-defined]
_real = ctypes.POINTER(ctypes.c_double)
ControlFunction = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, _real, _real, _real, _real)
"""The C signature for ctypes: `ControlFunction(("control", library))`, or set restype and argtypes."""
# Signature of the callback of a Python function: it takes addresses, from which arrays are made once.
_Entry = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, *[ctypes.c_void_p] * 4)


@dataclass(frozen=True, eq=False, repr=False)
class FunctionController(Record):
    """A function as controller; the docstring of its module states the arguments.

    function: any Python callable; a function jitted by numba; a C function: `numba.cfunc` of `C_SIGNATURE`, a function
    of ctypes, or an address. state: start values (n,), or a number of zeros; none unless given. gives: "signals": of
    the machine's control allocation, such as lift, V, and x and y signals; "currents": of each coil, A; "voltages": of
    each coil's amplifier input, V. Currents and voltages go through converters, amplifiers and windings as signals do.
    lower, upper: limits of the outputs, one for all or (m,). period: sampling time, s, in place of the scenario's.
    Raises InputError for an object that cannot be called like this.

    A callable with a method `reset` is reset at the start of every run. Other data that a callable stores itself is
    carried over into the next run; with all data in `state`, equal seeds give equal runs.

    Indices out of range are errors of the run. A function jitted by numba is compiled anew with checked indices, unless
    it sets `boundscheck` itself. In functions that it calls, and in C functions, a run detects at its end writes up to
    256 numbers before or after state and outputs.

    >>> def hold(time, measured, reference, state):
    ...     state[0] += reference[2] - measured[2]
    ...     return 2.0 + 300.0 * state[0], 0.0, 0.0
    >>> FunctionController(hold, state=1).form
    'python'
    """

    function: Any
    state: ArrayLike = ()
    gives: str = "signals"
    lower: ArrayLike = -np.inf
    upper: ArrayLike = np.inf
    period: float | None = None
    form: str = field(init=False)

    def __post_init__(self) -> None:
        check_choice("FunctionController(gives)", self.gives, GIVES)
        if self.period is not None:
            check_positive("FunctionController", period=self.period)
        state = np.zeros(self.state) if isinstance(self.state, int) else np.array(self.state, float).ravel()
        check_numbers("FunctionController", **{f"state[{k}]": value for k, value in enumerate(state)})
        object.__setattr__(self, "state", state)
        for low, high in np.broadcast(self.lower, self.upper):
            check_ordered("FunctionController", float(low), float(high))
        object.__setattr__(self, "form", _form(self.function))
        object.__setattr__(self, "_compiled", {})

    @property
    def memory(self) -> Array:
        """State (n,) at the start of a run."""
        return np.array(self.state)

    @property
    def name(self) -> str:
        """Name of the function, with its file if it is known."""
        function = self.function
        if self.form == "c":
            named = getattr(function, "__name__", None)
            return f"a C function {named}" if named else "a C function"
        python = function.py_func if self.form == "numba" else function
        named = getattr(python, "__name__", None) or type(python).__name__
        code = getattr(python, "__code__", None) or getattr(type(python).__call__, "__code__", None)
        return named if code is None else f"{named} of {os.path.basename(code.co_filename)}"

    @property
    def assumption(self) -> str:
        """The assumption of a run in one line: function and file, state, outputs and their limits."""
        form = {"python": " (Python)", "numba": " (numba)", "c": ""}[self.form]
        low, high = (", ".join(f"{v:g}" for v in np.ravel(limit)) for limit in (self.lower, self.upper))
        bounded = np.isfinite(np.ravel(self.lower)).any() or np.isfinite(np.ravel(self.upper)).any()
        limits = f"limits {low} to {high}" if bounded else "no limits"
        state = count_of(len(self.memory), "number", "numbers")
        return f"controller: {self.name}{form}, which gives {self.gives}, {limits}; a state of {state}"

    def limits(self, outputs: int) -> Block:
        """The arrays for compiled loops of a block that has only limits of the outputs.

        Parameters
        ----------
        outputs
            Number of outputs.

        Returns
        -------
        Block
            The block.
        """
        for name in ("lower", "upper"):
            size, must = np.size(getattr(self, name)), f"must be one limit for all outputs or ({outputs},)"
            where, remedy = f"FunctionController({name})", "give one for each output"
            check(size in (1, outputs), where, must, f"{size} numbers", remedy)
        nothing = np.zeros((outputs, SIGNALS))
        return state_block((), (), (), nothing, lower=self.lower, upper=self.upper).arrays

    def bound(self, names: Sequence[str], measured: int = 3) -> BoundFunction:
        """The function for one run.

        Parameters
        ----------
        names
            Names of the outputs.
        measured
            Length of its argument `measured`.

        Returns
        -------
        BoundFunction
            The function with these outputs.

        Raises
        ------
        InputError
            If it cannot return these outputs.
        """
        function, states = self.function, len(self.memory)
        if self.form == "python":
            return _PythonFunction(function, measured, len(names), states)
        if self.form == "numba":
            kept = self._compiled  # type: ignore[attr-defined]
            sizes = measured, len(names)
            if sizes not in kept:
                kept[sizes] = _about_numba().JittedFunction(function, measured, names, states)
            return kept[sizes]
        if isinstance(function, _CPointer):
            return BoundFunction(ctypes.cast(function, ctypes.c_void_p).value or 0, function)
        # A C function compiled by numba has an attribute with its address.
        return BoundFunction(int(getattr(function, "address", function)), function)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.function, self.state, self.gives, self.lower, self.upper, self.period)


def as_controller(given: Any) -> Any:
    """A function as `FunctionController`; a controller as it is."""
    known = hasattr(given, "arrays") or isinstance(given, FunctionController)
    return given if known else FunctionController(given)


def _about_numba() -> Any:
    """The module for functions of numba; None if numba is not imported, as there are no such functions then."""
    if "numba" not in sys.modules:
        return None
    from fieldmap.control import jitted_function

    return jitted_function


def _form(function: Any) -> str:
    """python, numba or c. Raises InputError for another signature, and for an object that cannot be called."""
    jitted = _about_numba()
    if jitted and isinstance(function, jitted.CFunc):
        wanted, signature = jitted.C_SIGNATURE, function._sig
        same = (signature.return_type, signature.args) == (wanted.return_type, wanted.args)
        remedy = "compile it with @numba.cfunc(fieldmap.control.C_SIGNATURE)"
        check(same, WHERE, f"must be {C_CALL}", signature, remedy)
        return "c"
    if isinstance(function, _CPointer):
        _check_ctypes(function)
        return "c"
    if isinstance(function, (int, np.integer)) and not isinstance(function, bool):
        check(bool(function > 0), WHERE, f"must be the address of {C_CALL}", function, "give it")
        return "c"
    check(callable(function), WHERE, f"must be {CALL}", type(function).__name__, "give a function")
    is_jitted = bool(jitted) and jitted.is_jitted(function)
    python: Any = getattr(function, "py_func") if is_jitted else function  # noqa: B009
    try:
        inspect.signature(python).bind(0.0, None, None, None)
    except TypeError as error:
        received = f"{getattr(python, '__name__', type(python).__name__)}{inspect.signature(python)}: {error}"
        raise InputError.of(WHERE, f"must be {CALL}", received, "take these four arguments") from None
    except ValueError:
        pass  # a builtin without a signature
    return "numba" if is_jitted else "python"


def _check_ctypes(function: Any) -> None:
    """Raise InputError unless the return type, and the argument types if declared, are those of `C_CALL`."""
    real, pointers = ctypes.c_double, (_real, ctypes.c_void_p)
    declared = function.argtypes
    fits = function.restype is ctypes.c_int
    if declared is not None:
        fits &= len(declared) == 5 and declared[0] is real and all(each in pointers for each in declared[1:])
    names = [getattr(each, "__name__", str(each)) for each in (function.restype, *(declared or ()))]
    remedy = "set restype to ctypes.c_int and argtypes as fieldmap.control.ControlFunction has them"
    check(fits, WHERE, f"must be {C_CALL}", ", ".join(names), remedy)


class _PythonFunction(BoundFunction):
    """A Python callable, called back from the loop, with the interpreter's lock held only during the call."""

    def __init__(self, function: Callable[..., Any], measured: int, outputs: int, states: int) -> None:
        self._function, self._sizes = function, (measured, 3, states, outputs)
        self._views: list[Array] = []
        self._error: BaseException | None = None
        self._shape = ""
        entry = _Entry(self._called_back)
        super().__init__(ctypes.cast(entry, ctypes.c_void_p).value or 0, entry)
        reset = getattr(function, "reset", None)
        if callable(reset):
            reset()

    def cause(self, time: float, measured: Array, reference: Array, state: Array) -> BaseException | None:
        return self._error

    def shape(self, time: float, measured: Array, reference: Array, state: Array) -> str:
        return self._shape

    def _called_back(self, time: float, *places: int) -> int:
        try:
            if not self._views:
                # The addresses are the same at every sample of a run.
                self._views = [_array_at(*each) for each in zip(places, self._sizes, strict=True)]
            measured, reference, state, out = self._views
            # Copies, which the function may keep.
            found = self._function(time, measured.copy(), reference.copy(), state)
            if type(found) is tuple:
                if len(found) != len(out):
                    self._shape = f"{len(found)} of them"
                    return WRONG_LENGTH
                for k, value in enumerate(found):
                    out[k] = value
                return DONE
            values = np.asarray(found, float)
            if values.shape != out.shape and not (len(out) == 1 and values.ndim == 0):
                self._shape = "None" if found is None else f"an array {values.shape}"
                return WRONG_LENGTH
            out[:] = values
        except BaseException as error:  # must not pass through compiled code; raised after the loop
            self._error = error
            return FAILED
        return DONE


def _array_at(address: int | None, size: int) -> Array:
    if not size or not address:
        return np.zeros(0)
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))
