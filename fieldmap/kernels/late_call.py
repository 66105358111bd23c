"""Compiled functions that others call by an address, found when it is first needed.

numba links a function that a compiled one calls into it and optimises both again, at every level of callers. Of a large
function that many call this is most of the time of compiling. A late function is compiled by itself, once, as a C
function. Its callers hold the name of a cell of memory, read the address there, and, where they find none, call what
compiles the function or takes it from numba's files. No address is part of compiled code, so that numba can keep it in
files.
"""

import ctypes
from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic, overload
from numba.np.arrayobj import populate_array

from fieldmap.kernels.compilation import cfunc, njit

_NAMED: list[Any] = []
"""What symbols stand for: all lives as long as the process, as they do."""


class LateFunctions:
    """C functions of equal arguments, of which a caller names one by its number: often one alone.

    name: of the symbols, for the whole process. functions: their bodies as `numba.cfunc` takes them, with the arguments
    of the C function. returns, arguments: types of numba; an array stands for the address of its first number, and
    must be contiguous, and one that may be written to unless the type is of those that may not; a tuple travels as it
    is, with the arrays in it, which the function is lent, and whose types must be the same. options: those of
    `numba.cfunc`; unless they say otherwise, what is compiled is kept in files, and divides as kernels do.

    `call(number, (...))`: for compiled code, with the arguments in a tuple. Raises IndexError for a number that no
    function has, RuntimeError if the function could not be compiled.
    """

    def __init__(
        self,
        name: str,
        returns: types.Type,
        arguments: tuple[types.Type, ...],
        functions: Sequence[Callable[..., Any]],
        **options: Any,
    ) -> None:
        self.name, self.functions, self._options = name, tuple(functions), options
        self._arguments = arguments
        places = [types.CPointer(t.dtype) if isinstance(t, types.Array) else t for t in arguments]
        self._signature = returns(*places)
        self._compile = cfunc(self._signature, **options)
        self._compiled: dict[int, Any] = {}
        self._lock = RLock()
        self._cells = (ctypes.c_void_p * len(self.functions))()
        self._finder = ctypes.CFUNCTYPE(None, ctypes.c_ssize_t)(self.find)
        _NAMED.append(self)
        llvm.add_symbol(name, ctypes.addressof(self._cells))
        address = ctypes.cast(self._finder, ctypes.c_void_p).value
        llvm.add_symbol(f"{name}_find", 0 if address is None else address)
        self.call: Any = _call(name, len(self.functions), self._signature, arguments)
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            self.call = lambda number, given: self.functions[number](*given)

    def __repr__(self) -> str:
        return f"LateFunctions({self.name}, {len(self.functions)})"

    def called_or_linked(self) -> Any:
        """The only function, for compiled code: called late, and for arguments of other types compiled into the caller
        as any other."""
        (function,) = self.functions
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        call = self.call
        # Without a cache of its own, in which it would lie beside the late one.
        linked = njit(**{**self._options, "cache": False})(function)

        def chosen(*arguments: Any) -> Any:
            return function(*arguments)

        @overload(chosen, strict=False)
        def choose(*arguments: Any) -> Any:
            if len(arguments) == len(self._arguments) and all(map(_fits, arguments, self._arguments)):
                return lambda *arguments: call(0, arguments)
            return lambda *arguments: linked(*arguments)

        return chosen

    @property
    def found(self) -> bool:
        """Whether every function has been compiled or read from its file."""
        return len(self._compiled) == len(self.functions)

    def find(self, number: int = 0) -> None:
        """Compile a function unless it has been. `call` does so by itself, but cannot pass an interrupt on, and must
        not be the first to do so in a thread for which one waits that holds the interpreter's lock."""
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return
        with self._lock:
            if number not in self._compiled:
                self._compiled[number] = self._compile(self.functions[number])
                self._cells[number] = self._compiled[number].address


def _call(name: str, functions: int, c_signature: Any, arguments: tuple[types.Type, ...]) -> Any:
    def late_call(_: Any, number: Any, given: Any) -> Any:
        if len(given.types) != len(arguments) or not all(map(_fits, given.types, arguments)):
            return None

        def generate(target: Any, builder: Any, signature: Any, values: Any) -> Any:
            kinds = [target.get_value_type(t) for t in c_signature.args]
            kind = ir.FunctionType(target.get_value_type(c_signature.return_type), kinds)
            word = ir.IntType(target.address_size)
            cells = _external(builder.module, ir.ArrayType(word, functions), name)
            chosen = target.cast(builder, values[0], number, types.intp)
            # As one without a sign, a number below zero is large.
            with builder.if_then(builder.icmp_unsigned(">=", chosen, word(functions)), likely=False):
                text = f"{name} has {functions} functions, numbered from 0"
                target.call_conv.return_user_exc(builder, IndexError, (text,))
            cell = builder.gep(cells, [ir.IntType(32)(0), chosen])
            with builder.if_then(cgutils.is_null(builder, builder.load(cell)), likely=False):
                finder = ir.FunctionType(ir.VoidType(), [word])
                found = cgutils.get_or_insert_function(builder.module, finder, f"{name}_find")
                builder.call(found, [chosen])
            address = builder.load(cell)
            with builder.if_then(cgutils.is_null(builder, address), likely=False):
                text = f"{name} could not be compiled"
                target.call_conv.return_user_exc(builder, RuntimeError, (text,))
            parts = zip(given.types, arguments, cgutils.unpack_tuple(builder, values[1]), strict=True)
            places = [
                target.make_array(t)(target, builder, value=value).data
                if isinstance(t, types.Array)
                else value
                if isinstance(t, types.BaseTuple)
                else target.cast(builder, value, t, wanted)
                for t, wanted, value in parts
            ]
            return builder.call(builder.inttoptr(address, kind.as_pointer()), places)

        return c_signature.return_type(number, given), generate

    return intrinsic(late_call)


def _fits(given: Any, wanted: Any) -> bool:
    if isinstance(wanted, types.BaseTuple):
        return bool(given == wanted)
    if not isinstance(wanted, types.Array):
        return isinstance(given, types.Number)
    if not isinstance(given, types.Array) or (wanted.mutable and not given.mutable):
        return False
    return (given.dtype, given.ndim, given.layout, given.aligned) == (wanted.dtype, wanted.ndim, "C", True)


def _external(module: Any, kind: Any, name: str) -> Any:
    try:
        return module.get_global(name)
    except KeyError:
        return ir.GlobalVariable(module, kind, name)


@intrinsic
def _array_at(context, address, shape):
    """A contiguous array of a shape, a tuple, whose first number is at a pointer; for functions without counts of
    references, in which `numba.carray` is not allowed."""
    if isinstance(address, types.Array):
        return address(address, shape), lambda target, builder, signature, values: impl_ret_borrowed(
            target, builder, address, values[0]
        )
    kind = types.Array(address.dtype, len(shape.types), "C")

    def generate(target, builder, signature, values):
        array = target.make_array(kind)(target, builder)
        sizes = cgutils.unpack_tuple(builder, values[1])
        width = target.get_abi_sizeof(target.get_data_type(kind.dtype))
        strides: list[Any] = []
        step = target.get_constant(types.intp, width)
        for size in reversed(sizes):
            strides.insert(0, step)
            step = builder.mul(step, size)
        populate_array(array, values[0], sizes, strides, target.get_constant(types.intp, width), meminfo=None)
        return array._getvalue()

    return kind(address, shape), generate


array_at: Any = (lambda array, _: array) if config.DISABLE_JIT else _array_at  # type: ignore[attr-defined]
"""`array_at(pointer, shape)`, in the body of a late function. An array is given as it is: nothing is compiled with
NUMBA_DISABLE_JIT, and a linked function gets arrays."""
