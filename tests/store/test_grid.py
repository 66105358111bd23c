"""Nodes of a grid, and what is refused."""

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.store import Grid, MapData, MapInfo


def test_nodes_come_in_c_order():
    grid = Grid([1, 2, 3], [0.5, 0.25, 2.0], (3, 2, 2))
    points = grid.points()
    assert grid.size == len(points) == 12
    cube = points.reshape(3, 2, 2, 3)
    for i, j, k in np.ndindex(3, 2, 2):
        np.testing.assert_allclose(cube[i, j, k], [1 + 0.5 * i, 2 + 0.25 * j, 3 + 2.0 * k])
    np.testing.assert_allclose(grid.upper, [2.0, 2.25, 5.0])
    np.testing.assert_array_equal(points[-1], grid.upper)


def test_planes_are_parts_of_the_whole():
    grid = Grid([0, 0, 0], [0.1, 0.1, 0.1], (5, 3, 2))
    parts = [grid.points(0, 2), grid.points(2, 3), grid.points(3, 5)]
    np.testing.assert_array_equal(np.concatenate(parts), grid.points())


@pytest.mark.parametrize(
    ("lower", "spacing", "shape", "words"),
    [
        ([0, 0], [1, 1, 1], (2, 2, 2), "Grid, lower"),
        ([0, 0, np.nan], [1, 1, 1], (2, 2, 2), "Grid, lower"),
        ([0, 0, 0], [1, 0, 1], (2, 2, 2), "Grid, spacing: three positive"),
        ([0, 0, 0], [1, np.inf, 1], (2, 2, 2), "Grid, spacing"),
        ([0, 0, 0], [1, 1, 1], (2, 1, 2), "Grid, shape"),
        ([0, 0, 0], [1, 1, 1], (2, 2), "Grid, shape"),
    ],
)
def test_ill_formed_grids(lower, spacing, shape, words):
    with pytest.raises(InputError, match=words):
        Grid(lower, spacing, shape)


def test_a_grid_cannot_be_changed_behind_its_back():
    lower = np.zeros(3)
    grid = Grid(lower, [1, 1, 1], (2, 2, 2))
    lower[0] = 5
    assert grid.lower[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        grid.lower[0] = 1


def test_map_data_must_fit_grid_and_coils():
    grid = Grid([0, 0, 0], [1, 1, 1], (2, 2, 2))
    good = {"flux_density": np.zeros((1, 2, 2, 2, 3)), "gradient": np.zeros((1, 2, 2, 2, 3, 3))}
    MapData(grid, ("a",), [1.0], **good)
    for make, where, received in (
        (
            lambda: MapData(grid, ("a",), [1.0], **(good | {"gradient": np.zeros((1, 2, 2, 2, 9))})),
            "gradient",
            "(1, 2",
        ),
        (lambda: MapInfo(grid, ("a", "a"), [1.0, 1.0]), "coil_names", "('a', 'a')"),
        (lambda: MapInfo(grid, ("a",), [0.0]), "reference_current", "[0.]"),
    ):
        with pytest.raises(InputError) as error:
            make()
        (problem,) = error.value.problems
        assert problem.where.endswith(f", {where}")
        assert received in problem.received
