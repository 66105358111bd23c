"""The benchmark of saturating maps: its solves are close to exact ones, and missing maps are named."""

import pytest

from fieldmap.store import write_map
from tests.dynamics.conftest import saturating_data


@pytest.fixture
def section(program, monkeypatch, tmp_path):
    found = program("benchmarks.saturating_maps")
    monkeypatch.setattr(found, "FOLDER", tmp_path)
    return found


def test_without_maps_it_says_what_makes_them(section):
    result = section.measure(quick=True)
    assert result["rows"] == []
    assert [line.split(": ")[1] for line in result["missing"]] == [
        "fieldmap map eight_coils",
        "fieldmap map workspace",
    ]


def test_the_solves_that_are_timed_are_near_exact_ones(section, tmp_path):
    write_map(tmp_path / "eight_coils.h5", saturating_data(free=True))
    result = section.measure(quick=True)
    assert len(result["missing"]) == 1
    assert len(result["rows"]) in (6, 8)
    for row in result["rows"]:
        assert row["us"] > 0.0
    off = [row["off"] for row in result["rows"] if row["off"] is not None]
    assert len(off) == 4
    assert max(off) < 1e-4
