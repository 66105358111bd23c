"""A function called by other compiled functions must not contain sums that the compiler may reorder.

numba links such a function into each caller and optimises it there again, which may change the order of its sums.
A process that compiles uses the separate function, one that reads compiled kernels from files the caller's version:
results would differ in the last digit between the first run and later ones.
"""

import importlib
import inspect
import pkgutil
import types

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import fieldmap.kernels
from fieldmap.kernels.compilation import Inlined, inlined, njit

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
REORDERED = {"fast", "reassoc"}


def kernels_of(package):
    """Names and compiled functions in all modules of a package, except those made inside functions."""
    found = {}
    for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        for value in compiled(vars(importlib.import_module(info.name)).values()):
            found[f"{value.py_func.__module__}.{value.py_func.__qualname__}"] = value
    return found


def compiled(values):
    """Compiled functions among values."""
    values = [value.dispatcher if isinstance(value, Inlined) else value for value in values]
    return [value for value in values if isinstance(value, Dispatcher)]


def called_by(kernel):
    """Compiled functions named in the source of another."""
    function = kernel.py_func
    names = inspect.getclosurevars(function)
    values = [*names.globals.values(), *names.nonlocals.values()]
    modules = [value for value in values if isinstance(value, types.ModuleType)]
    values += [getattr(module, name) for module in modules for name in names.unbound if hasattr(module, name)]
    return compiled(values)


def is_inlined(kernel):
    return kernel.targetoptions.get("forceinline", False) or kernel.targetoptions.get("inline") == "always"


def may_reorder(kernel):
    """Whether the compiled code of a function may reorder sums, its own or those of functions inlined into it."""
    flags = kernel.targetoptions.get("fastmath", False)
    own = flags is True or bool(flags and REORDERED & set(flags))
    return own or any(may_reorder(one) for one in called_by(kernel) if is_inlined(one))


def wrongly_called(kernels):
    return {
        f"{name} calls {one.py_func.__name__}"
        for name, kernel in kernels.items()
        for one in called_by(kernel)
        if not is_inlined(one) and may_reorder(one)
    }


def test_functions_that_kernels_call_keep_the_order_of_their_sums():
    kernels = kernels_of(fieldmap.kernels)
    assert len(kernels) > 150
    assert not wrongly_called(kernels)


def test_one_that_does_not_is_found():
    @numba.njit(fastmath={"reassoc"}, forceinline=True)
    def inner(values):
        return values.sum()

    @numba.njit
    def middle(values):
        return inner(values)

    @numba.njit
    def outer(values):
        return middle(values)

    assert wrongly_called({"outer": outer, "middle": middle}) == {"outer calls middle"}


def test_an_inlined_function_is_a_part_of_kernels_alone():
    """Python cannot call it, and gets an error: without numba's wrapper the call would be to address 0."""

    @inlined(cache=False)
    def reciprocal(value):
        """One over a value."""
        return 1.0 / value

    @numba.njit
    def twice(value):
        return 2.0 * reciprocal(value)

    assert twice(4.0) == 0.5
    assert reciprocal.__doc__ == "One over a value."
    (made,) = reciprocal.dispatcher.overloads.values()
    code = made.library.get_llvm_str()
    assert made.fndesc.llvm_func_name in code
    assert made.fndesc.llvm_cpython_wrapper_name not in code
    with pytest.raises(TypeError, match="reciprocal"):
        reciprocal(4.0)


def test_kernels_divide_as_numpy_does_whoever_calls_them_first():
    """Otherwise numba's own rule, an error, would be inherited from a caller."""

    @njit(cache=False)
    def kernel(value):
        return 1.0 / value

    @inlined(cache=False)
    def part(value):
        return -1.0 / value

    @numba.njit
    def caller(value):
        return kernel(value), part(value)

    assert caller(0.0) == (np.inf, -np.inf)


@pytest.mark.parametrize("compiled_by", [njit, inlined])
def test_kernels_keep_the_order_of_sums_whoever_calls_them_first(compiled_by):
    """A caller that may reorder would pass this on, and the last digits would depend on which one compiled first."""

    @compiled_by(cache=False)
    def part(a, b, c):
        return a + b + c - a

    @njit(cache=False, fastmath=True)
    def caller(a, b, c):
        return part(a, b, c)

    # A reordered sum would be b + c.
    assert caller(1e16, 1.0, 1.0) == 0.0


def test_all_kernels_say_what_they_would_take_from_a_caller():
    kernels = kernels_of(fieldmap.kernels)
    assert not {
        name
        for name, kernel in kernels.items()
        if not {"fastmath", "forceinline", "error_model"} <= kernel.targetoptions.keys()
    }
