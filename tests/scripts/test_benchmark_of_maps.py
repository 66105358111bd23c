"""The benchmark of saturating maps: its solves are near exact ones, and what is missing is said."""

import numpy as np
import pytest

from fieldmap.currents import IndependentCurrents
from fieldmap.store import Grid, MapData, ReducedModel, write_map


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
    """Two coils along z and two fields of one kind of iron, made up."""
    rng, (n, modes) = np.random.default_rng(4), (12, 3)
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    x, y, z = grid.points().T
    flux, slope = [], []
    for b0, b1 in rng.uniform([0.001, -0.05], [0.01, 0.05], (4, 2)):
        flux.append(np.stack([-0.5 * b1 * x, -0.5 * b1 * y, b0 + b1 * z], axis=1).reshape(5, 5, 5, 3))
        slope.append(np.broadcast_to(np.diag([-0.5 * b1, -0.5 * b1, b1]), (5, 5, 5, 3, 3)))
    knots = np.array([0.0, 1e-3, 3e-3])
    model = ReducedModel(
        gradients=3e-3 * rng.standard_normal((3 * n, modes)),
        source=1e-3 * rng.standard_normal((3 * n, 2)),
        weights=rng.random(n) + 0.1,
        law=np.zeros(n, np.int64),
        law_offset=np.array([0, 3]),
        law_knots=knots,
        law_coefficients=np.array([[0, 0, 2e3, 0], [0, -1999 / 4e-3, 2e3, 2], [0, 0, 1, 4.001]]),
        air=1e-4 * np.eye(modes),
        constant=np.zeros(modes),
        output=rng.standard_normal((2, modes)),
        known_currents=np.zeros((1, 2)),
        known_amplitudes=np.zeros((1, modes)),
        lower=np.array([-2.0, -2.0]),
        upper=np.array([2.0, 2.0]),
        parametrisation=IndependentCurrents(2),
        reference_weights=np.ones(2),
    )
    data = MapData(
        grid,
        ("a", "b"),
        np.ones(2),
        flux_density=np.array(flux),
        gradient=np.array(slope),
        reduced_model=model,
    )
    write_map(tmp_path / "eight_coils.h5", data)
    result = section.measure(quick=True)
    assert len(result["missing"]) == 1
    assert len(result["rows"]) in (6, 8)
    for row in result["rows"]:
        assert row["us"] > 0.0
    off = [row["off"] for row in result["rows"] if row["off"] is not None]
    assert len(off) == 4
    assert max(off) < 1e-4
