"""The study of the joints: the tables that it fits, and their readings."""

import numpy as np
import pytest

from fieldmap.thesis.hysteresis import Run


@pytest.fixture
def study(program):
    return program("joint_study", "studies")


def test_tables_are_printed_ones_from_where_each_run_began(study):
    """Corners of the thesis's Tables 6-3 to 6-7, relative to the start of each run, written here by hand."""
    found = study.tables()
    assert found["Table 6-4"].measured[[0, 7, 8, 15]] == pytest.approx([0.932, 9.417, 6.662, -0.688])
    assert found["Table 6-5"].measured[[0, -1]] == pytest.approx([-0.842, 0.88])
    assert found["Table 6-6"].measured[[0, 5, 6, -1]] == pytest.approx([0.636, 3.566, 1.963, -0.879])
    assert found["Table 6-7"].measured[[5, -1]] == pytest.approx([-3.787, 0.876])
    assert found["Table 6-7"].way[[6, 7, -1]] == pytest.approx([-0.3, -0.25, 0.0])
    single = found["Table 6-3, 11.5 mm"]
    assert (single.back, single.z_s) == (None, 11.5)
    assert single.measured[[0, -1]] == pytest.approx([0.981, 8.666])
    assert found["Table 6-2, n = 1.5"].measured[-1] == pytest.approx(10.758)
    for one in found.values():
        assert len(one.measured) == len(one.way) - 1


def test_readings_are_those_of_the_table(study):
    about, asked = study.tables()["Table 6-4"], []

    class Straight:
        def run(self, axis, signals, n, z_s):
            asked.append((axis, n, z_s))
            return Run(20.0 * signals, signals, signals, signals)

    readings = study.BranchReadings(about, 0.1)
    assert readings.computed(None, Straight()) == pytest.approx(20.0 * about.way[1:])
    assert asked == [("x", 1.25, 10.0)]
    assert np.array_equal(readings.measured, about.measured)
