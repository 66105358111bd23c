"""The former archive of states gives back what it was given, by another run too."""

import numpy as np
import pytest

from fieldmap.store import KeptState, StateArchive


def opened(path, fingerprint):
    with pytest.warns(DeprecationWarning, match="Checkpoint") as caught:
        archive = StateArchive(path, fingerprint)
    assert caught[0].filename == __file__
    return archive


def test_states_and_results_are_found_again(tmp_path):
    solved = KeptState(np.array([1.0, 2.0]), np.arange(4.0), 3.0, 5.0)
    with opened(tmp_path / "a", "f") as archive:
        archive.put(0, solved)
        archive.put(1, KeptState(np.array([9.0, 9.0]), "not solved"))
        archive.keep({"x": np.eye(2)}, {"n": 1})
    with opened(tmp_path / "a", "f") as archive:
        found = archive.get(0, np.array([1.0, 2.0]))
        np.testing.assert_array_equal(found.values, solved.values)
        assert (found.seconds, found.processor_seconds, np.isnan(found.estimate)) == (3.0, 5.0, True)
        assert archive.get(0, np.array([1.0, 3.0])) is archive.get(2) is None
        assert archive.get(1).values == "not solved"
        arrays, about = archive.kept()
        np.testing.assert_array_equal(arrays["x"], np.eye(2))
        assert about == {"n": 1}
    with opened(tmp_path / "a", "other") as archive:
        assert archive.get(0) is archive.kept() is None
