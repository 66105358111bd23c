"""Results as JSON return their values in any program; values that JSON does not have become null."""

import json
import math
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fieldmap.plain import plain
from fieldmap.store import FieldError

numbers = st.one_of(st.floats(), st.integers(-(2**70), 2**70), st.booleans(), st.none(), st.text())
nested = st.recursive(
    numbers,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(), inner, max_size=4)),
    max_leaves=12,
)


def strict(value):
    """Through a text that every JSON parser reads, without NaN and infinity."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(json.dumps(plain(value), allow_nan=False), parse_constant=refuse)


def same(found, value):
    if isinstance(value, float) and not math.isfinite(value):
        return found is None
    if isinstance(value, list):
        return isinstance(found, list) and len(found) == len(value) and all(map(same, found, value))
    if isinstance(value, dict):
        return found.keys() == value.keys() and all(same(found[key], one) for key, one in value.items())
    return found == value and type(found) is type(value)


@given(nested)
def test_there_and_back(value):
    assert same(strict(value), value)


@given(
    st.lists(st.floats(width=64), min_size=1, max_size=24),
    st.sampled_from([np.float64, np.float32, np.int64, bool]),
)
def test_arrays(values, kind):
    if kind is np.int64:
        values = [0 if not math.isfinite(one) else int(one % 1000) for one in values]
    with np.errstate(over="ignore"):
        array = np.array(values).astype(kind)
    found = strict({"a": array, "b": array.reshape(-1, 1), "c": tuple(array)})
    exact = [None if not math.isfinite(one) else one for one in array.tolist()]
    assert found == {"a": exact, "b": [[one] for one in exact], "c": exact}
    assert [type(one) for one in found["a"]] == [type(one) for one in exact]


@given(st.floats(0.0, 1e3), st.floats(0.0, 1e3))
def test_data_classes_and_paths(flux, slope):
    found = strict({"error": FieldError(flux, slope), "file": Path("a") / "b.h5", "set": {1.5}})
    assert found == {
        "error": {"flux_density": flux, "gradient": slope},
        "file": str(Path("a/b.h5")),
        "set": [1.5],
    }
