"""Compiled functions called by addresses that are found late."""

import os
import subprocess
import sys

import numpy as np
import pytest
from numba import config, njit, types
from numba.core.errors import NumbaError

from fieldmap.kernels.late_call import LateFunctions, array_at

COMPILED = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")
VECTOR, MATRIX = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")

MODULE = """
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

def main():
    with event.install_recorder("numba:compile") as recorder:
        print(of(0, 7.0), of(1, 7.0), of(0, 8.0), len(recorder.buffer))
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
    assert found[0][:3] == found[1][:3] == ["14.0", "21.0", "16.0"]
    assert int(found[0][3]) > 0
    assert int(found[1][3]) == 0
