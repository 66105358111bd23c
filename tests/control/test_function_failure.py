"""Where a compiled controller wrote outside its arrays, and the remedy."""

import pytest

from fieldmap.control.bound_function import guarded, written_beside


@pytest.mark.parametrize(
    ("name", "index", "received", "size", "more_state"),
    [
        ("state", 2, "state[2]", 2, True),
        ("state", -1, "state[-1]", 2, True),
        ("outputs", 6, "outputs[6]", 6, False),
        ("given", 7, "measured[4]", 3, False),
    ],
)
def test_the_array_its_size_and_the_index_are_told(name, index, received, size, more_state):
    arrays = {"state": guarded([0.0] * 2), "given": guarded([0.0] * 7), "outputs": guarded([0.0] * 6)}
    assert written_beside(0.02, **arrays) is None
    whole = arrays[name].base
    whole[(len(whole) - len(arrays[name])) // 2 + index] = 1.0
    problem = written_beside(0.02, **arrays)
    assert problem.where.endswith("0.02 s")
    assert problem.received.endswith(received)
    assert f" {size} numbers" in problem.must_hold
    assert ("state=" in problem.remedy) is more_state
