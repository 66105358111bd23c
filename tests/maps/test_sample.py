"""The map that comes with the package is that of its recipe, and agrees with a solution of its device."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import MapFileError
from fieldmap.maps import read_recipe
from fieldmap.maps.recipe import choose_grid, read_recipe_device
from fieldmap.shipped import shipped_file
from fieldmap.store import check_map, map_path, read_map


def test_it_is_whole_small_and_of_its_recipe():
    path = map_path("sample")
    assert path.stat().st_size < 600_000
    check_map(path)
    recipe = read_recipe("sample")
    device, data = read_recipe_device(recipe), read_map("sample")
    grid = choose_grid(recipe.box(device), recipe.spacing)
    assert data.grid.shape == grid.shape
    np.testing.assert_allclose(data.grid.points(), grid.points(), atol=1e-15)
    assert data.provenance.device_name == "disk_six_cores"


def test_its_numbers_are_those_of_its_device():
    m = fm.open_map("sample")
    solved = fm.solve_linear(fm.read_device("disk_six_cores"), refinement=0.4)
    points, currents = [[0.003, -0.005, -0.09], [-0.011, 0.007, -0.117]], [3.0, -1.0, 2.0, 0.5, 4.0, 1.0]
    for ours, judge in zip(
        m.field_and_gradient(points, currents), solved.field_and_gradient(points, currents), strict=True
    ):
        # The difference is due to the coarser mesh of the reference.
        assert np.abs(ours - judge).max() < 0.01 * np.abs(judge).max()


def test_a_name_is_a_shipped_map_only_where_there_is_no_such_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert map_path("sample") == shipped_file("maps", "sample.h5")
    assert [str(map_path(name)) for name in ("sample.h5", "none", "./sample")] == [
        "sample.h5",
        "none",
        "sample",
    ]
    (tmp_path / "sample").write_text("a file of the user's own")
    assert str(map_path("sample")) == "sample"
    with pytest.raises(MapFileError):
        fm.open_map("sample")
