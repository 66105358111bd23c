"""Compiled functions called by addresses that are found late."""

import gc
import os
import subprocess
import sys
import weakref
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import config, njit, types
from numba.core.errors import NumbaError

from fieldmap.kernels.late_call import LateFunctions, array_at

COMPILED = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")
VECTOR, MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C", readonly=True)


class Pair(NamedTuple):
    """A tuple in a tuple, as models have their domains."""

    values: Any
    switch: Any


class Whole(NamedTuple):
    """Arrays of two kinds, a number, and a tuple of them."""

    table: Any
    pair: Pair
    factor: Any


PAIR = types.NamedTuple((types.Array(types.int64, 1, "C"), types.boolean), Pair)
WHOLE = types.NamedTuple((types.Array(types.float32, 2, "C"), PAIR, types.float64), Whole)


def whole():
    return Whole(np.arange(6, dtype=np.float32).reshape(2, 3), Pair(np.array([2, 3]), True), 0.5)


def late_of_whole(whole, vector, size):
    """A sum over everything; the first integer is counted up."""
    whole.pair.values[0] += 1
    last = array_at(vector, (size,))[size - 1]
    return whole.factor * whole.table[0, 2] + whole.pair.values[0] + last + 100.0 * whole.pair.switch


MODULE = """
from typing import NamedTuple

import numpy as np
from numba import njit, types
from numba.core import event
from fieldmap.kernels.late_call import LateFunctions

def times(factor):
    def late(x):
        return factor * x
    return late

LATE = LateFunctions("late_times", types.float64, (types.float64,), [times(2.0), times(3.0)], cache=True)
_call = LATE.call

@njit(cache=True)
def of(number, x):
    return _call(number, (x,))

class Row(NamedTuple):
    values: np.ndarray
    factor: float

def late_sum(row):
    return row.factor * row.values.sum()

ROW = types.NamedTuple((types.Array(types.float64, 1, "C"), types.float64), Row)
sum_of = LateFunctions("late_sum", types.float64, (ROW,), [late_sum], cache=True).called_or_linked()

@njit(cache=True)
def of_row(row):
    return sum_of(row)

def main():
    rows = Row(np.array([1.0, 2.0]), 3.0), Row(np.arange(4.0)[::2], 5.0)
    with event.install_recorder("numba:compile") as recorder:
        print(of(0, 7.0), of(1, 7.0), of(0, 8.0), *map(of_row, rows), len(recorder.buffer))
"""


def test_a_number_chooses_the_function_and_arrays_arrive_in_their_shapes():
    def row_sums(matrix, out, rows, columns):
        a, b = array_at(matrix, (rows, columns)), array_at(out, (rows,))
        for i in range(rows):
            b[i] = a[i].sum()
        return 1.0

    def column_sums(matrix, out, rows, columns):
        a, b = array_at(matrix, (rows, columns)), array_at(out, (columns,))
        for j in range(columns):
            b[j] = a[:, j].sum()
        return 2.0

    arguments = (MATRIX, VECTOR, types.intp, types.intp)
    late = LateFunctions("late_sums", types.float64, arguments, [row_sums, column_sums])
    call = late.call

    @njit
    def sums(number, matrix, out):
        return call(number, (matrix, out, matrix.shape[0], matrix.shape[1]))

    matrix = np.arange(6.0).reshape(2, 3)
    out = np.zeros(2)
    assert sums(0, matrix, out) == 1.0
    np.testing.assert_array_equal(out, [3.0, 12.0])
    out = np.zeros(3)
    assert sums(1, matrix, out) == 2.0
    np.testing.assert_array_equal(out, [3.0, 5.0, 7.0])
    read_only = matrix.copy()
    read_only.flags.writeable = False
    sums(1, read_only, out)
    np.testing.assert_array_equal(out, [3.0, 5.0, 7.0])


@COMPILED
def test_arrays_that_a_pointer_cannot_stand_for_are_refused_by_the_compiler():
    late = LateFunctions("late_first", types.float64, (VECTOR,), [lambda x: array_at(x, (1,))[0]])
    call = late.call

    @njit
    def first(x):
        return call(0, (x,))

    assert first(np.array([5.0])) == 5.0
    for other in (np.arange(6.0)[::2], np.arange(3), np.zeros((2, 2)), 1.0):
        with pytest.raises(NumbaError):
            first(other)


@COMPILED
def test_what_callers_name_outlives_what_made_it():
    made = LateFunctions("late_half", types.float64, (types.float64,), [lambda x: 0.5 * x])
    call, place = made.call, weakref.ref(made)

    @njit
    def half(x):
        return call(0, (x,))

    del made
    gc.collect()
    assert place() is not None
    assert half(3.0) == 1.5


@COMPILED
def test_arrays_that_are_written_to_must_be_of_those_that_may_be():
    """A caller that lends what may not be written to is told so, as numba tells callers of any function."""

    def put(x):
        array_at(x, (1,))[0] = 3.0
        return 0.0

    call = LateFunctions("late_put", types.float64, (VECTOR,), [put]).call

    @njit
    def of(x):
        return call(0, (x,))

    x = np.zeros(1)
    of(x)
    assert x[0] == 3.0
    x.flags.writeable = False
    with pytest.raises(NumbaError):
        of(x)


def test_tuples_travel_as_they_are_and_their_arrays_are_lent():
    late = LateFunctions("late_whole", types.float64, (WHOLE, VECTOR, types.intp), [late_of_whole])
    function = late.called_or_linked()

    @njit
    def of(given, vector):
        return function(given, vector, vector.size)

    @njit
    def made(vector):
        table = np.zeros((2, 3), np.float32)
        table[0, 2] = 2.0
        given, total = Whole(table, Pair(np.array([2, 3]), True), 0.5), 0.0
        for _ in range(3):
            total += function(given, vector, vector.size)
        return total, given.pair.values[0]

    given, vector = whole(), np.array([10.0, 20.0])
    counts = [sys.getrefcount(a) for a in (given.table, given.pair.values, vector)]
    assert of(given, vector) == 1.0 + 3.0 + 20.0 + 100.0
    assert given.pair.values[0] == 3
    assert of(given._replace(pair=Pair(given.pair.values, False)), vector) == 1.0 + 4.0 + 20.0
    assert [sys.getrefcount(a) for a in (given.table, given.pair.values, vector)] == counts
    # Arrays that compiled code made itself, and a constant in the place of a number.
    assert made(vector) == (3 * (1.0 + 120.0) + 3.0 + 4.0 + 5.0, 5)
    if not config.DISABLE_JIT:
        assert "late_whole" in next(iter(of.inspect_llvm().values()))
        assert "late_whole" in next(iter(made.inspect_llvm().values()))


def test_arguments_of_other_types_are_served_by_a_function_of_theirs():
    late = LateFunctions("late_other", types.float64, (WHOLE, VECTOR, types.intp), [late_of_whole])
    function = late.called_or_linked()

    @njit
    def of(given, vector):
        return function(given, vector, vector.size)

    vector, frozen = np.array([10.0, 20.0]), whole()
    frozen.table.flags.writeable = False
    others = [
        (whole(), np.array([10.0, 0.0, 20.0])[::2]),
        (frozen, vector),
        (whole()._replace(table=np.asfortranarray(whole().table)), vector),
    ]
    for given, row in others:
        assert of(given, row) == 1.0 + 3.0 + 20.0 + 100.0
    if not config.DISABLE_JIT:
        assert not any("late_other" in text for text in of.inspect_llvm().values())


@COMPILED
def test_a_number_that_no_function_has_is_an_error():
    late = LateFunctions("late_same", types.float64, (types.float64,), [lambda x: x])
    call = late.call

    @njit
    def same(number, x):
        return call(number, (x,))

    assert same(0, 5.0) == 5.0
    for number in (-1, 1, 2**62):
        with pytest.raises(IndexError):
            same(number, 5.0)


@COMPILED
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_function_that_cannot_be_compiled_is_an_error_of_the_call():
    late = LateFunctions("late_wrong", types.float64, (types.float64,), [lambda x: x + "a"])
    call = late.call

    @njit
    def wrong(x):
        return call(0, (x,))

    for _ in range(2):
        with pytest.raises(RuntimeError):
            wrong(1.0)


@COMPILED
def test_another_process_takes_caller_and_functions_from_files(tmp_path):
    """No address is kept: the functions lie elsewhere there."""
    (tmp_path / "of_times.py").write_text(MODULE)
    folders = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = dict(
        os.environ, PYTHONPATH=os.pathsep.join(folders), NUMBA_CACHE_DIR=str(tmp_path / "kept")
    )
    command = [sys.executable, "-c", "import of_times; of_times.main()"]
    found = [
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    ]
    assert found[0][:5] == found[1][:5] == ["14.0", "21.0", "16.0", "9.0", "10.0"]
    assert int(found[0][5]) > 0
    assert int(found[1][5]) == 0
