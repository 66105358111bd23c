"""Nodes of a grid, and refusals."""

import pkgutil
from dataclasses import fields, is_dataclass
from importlib import import_module

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.records import Record
from fieldmap.store import Grid, MapData, MapInfo
from fieldmap.store.map_format import chunks_of, planes_per_chunk
from tests.refusals import refused
from tests.store.conftest import make_model, make_saturating


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
        ([0, 0, 0, 0], [1, 1, 1], (2, 2, 2), "Grid, lower"),
        ([[0, 0, 0]], [1, 1, 1], (2, 2, 2), "Grid, lower"),
        ([0, 0, np.nan], [1, 1, 1], (2, 2, 2), "Grid, lower"),
        ([0, np.inf, 0], [1, 1, 1], (2, 2, 2), "Grid, lower"),
        ([0, 0, 0], [1, 1], (2, 2, 2), "Grid, spacing"),
        ([0, 0, 0], [1, 1, 1, 1], (2, 2, 2), "Grid, spacing"),
        ([0, 0, 0], [1, -1, 1], (2, 2, 2), "Grid, spacing"),
        ([0, 0, 0], [1, np.nan, 1], (2, 2, 2), "Grid, spacing"),
        ([0, 0, 0], [1, 0, 1], (2, 2, 2), "Grid, spacing: three positive"),
        ([0, 0, 0], [1, np.inf, 1], (2, 2, 2), "Grid, spacing"),
        ([0, 0, 0], [1, 1, 1], (2, 1, 2), "Grid, shape"),
        ([0, 0, 0], [1, 1, 1], (2, 0, 2), "Grid, shape"),
        ([0, 0, 0], [1, 1, 1], (2, 2), "Grid, shape"),
        ([0, 0, 0], [1, 1, 1], (2, 2, 2, 2), "Grid, shape"),
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


GRID = Grid([0, 0, 0], [1, 1, 1], (2, 2, 2))
FIELDS = {"flux_density": np.zeros((1, 2, 2, 2, 3)), "gradient": np.zeros((1, 2, 2, 2, 3, 3))}


@pytest.mark.parametrize("name", FIELDS)
def test_fields_must_fit_grid_and_coils(name):
    MapData(GRID, ("a",), [1.0], **FIELDS)
    shape = FIELDS[name].shape
    wrong = [
        tuple(n + step * (k == axis) for k, n in enumerate(shape))
        for axis in range(len(shape))
        for step in (-1, 1)
    ]
    for one in [*wrong, shape[:-1], (*shape, 1)]:
        with refused(InputError, where=f"map data, {name}", received=f"shape {one}"):
            MapData(GRID, ("a",), [1.0], **(FIELDS | {name: np.zeros(one)}))


def test_a_description_must_fit_its_coils():
    """A constant field alone is allowed."""
    for coils, current, where, received in (
        (("a", "a"), [1.0, 1.0], "coil_names", "('a', 'a')"),
        ((), [], "coil_names", "()"),
        (("a",), [0.0], "reference_current", "[0.]"),
        (("a",), [-1.0], "reference_current", "[-1.]"),
        (("a",), [np.nan], "reference_current", "[nan]"),
        (("a",), [np.inf], "reference_current", "[inf]"),
        (("a",), [1.0, 1.0], "reference_current", "[1. 1.]"),
        (("a", "b"), [1.0], "reference_current", "[1.]"),
        (("a",), 1.0, "reference_current", "1.0"),
        (("a",), [[1.0]], "reference_current", "[[1.]]"),
    ):
        with refused(InputError, where=f"map data, {where}", received=received):
            MapInfo(GRID, coils, current)
    with refused(InputError, where="map data, fixed_sources", received="none"):
        MapInfo(GRID, ("a",), [1.0], constant_field=True)
    alone = MapInfo(GRID, (), [], constant_field=True, fixed_sources=("magnet",))
    assert (alone.field_names, alone.field_scale.tolist(), alone.reference_weights.tolist()) == (
        ("no current",),
        [1.0],
        [1.0],
    )
    info = MapInfo(GRID, ("a", "b"), np.array([0.25, 1.0]))
    with pytest.raises(ValueError, match="read-only"):
        info.reference_current[0] = 1.0


def test_fields_of_iron_and_a_background():
    """For two coils, five fields of iron and a background: names, scales and weights in this order."""
    data = make_saturating()
    modes = [f"iron mode {k}" for k in (1, 2, 3, 4, 5)]
    assert data.field_names == ("upper left", "1", *modes, "no current")
    assert data.field_scale.tolist() == [0.3, 7.0, 1, 1, 1, 1, 1, 1]
    assert data.reference_weights.tolist() == [1, 1, 0.5, -1.5, 2.5, 3.5, -4.5, 1]
    about = {"reduced_model": make_model(), "fixed_sources": ("magnet",), "constant_field": True}
    for coils in (("a",), ("a", "b", "c")):
        with refused(InputError, where="map data, reduced_model", received="a model of 2 coils"):
            MapInfo(GRID, coils, np.ones(len(coils)), **about)
    with refused(InputError, where="map data, reduced_model", received="a constant field is missing"):
        MapInfo(GRID, ("a", "b"), np.ones(2), **(about | {"constant_field": False}))
    without = about | {"reduced_model": make_model(fixed=np.zeros(0))}
    with refused(InputError, where="map data, reduced_model", received="a constant field is there"):
        MapInfo(GRID, ("a", "b"), np.ones(2), **without)
    free = MapInfo(GRID, ("a", "b"), np.ones(2), **(without | {"constant_field": False}))
    assert free.field_names == ("a", "b", *modes)


@pytest.mark.parametrize(
    ("shape", "planes", "ends"),
    [
        ((4, 3, 5), 4, [4]),
        ((10, 10, 10), 10, [10]),
        ((11, 10, 10), 6, [6, 11]),
        ((13, 7, 11), 7, [7, 13]),
        ((3, 40, 50), 1, [1, 2, 3]),
        ((5, 20, 25), 2, [2, 4, 5]),
        ((25, 9, 11), 9, [9, 18, 25]),
        ((30, 2, 2), 30, [30]),
    ],
)
def test_parts_of_a_thousand_nodes_at_most(shape, planes, ends):
    """The fewest parts of whole x-planes, with sizes as equal as possible."""
    grid = Grid([0, 0, 0], [1, 1, 1], shape)
    assert planes_per_chunk(grid) == planes
    chunks = chunks_of(grid)
    assert [chunk.last for chunk in chunks] == ends
    assert [chunk.first for chunk in chunks] == [0, *ends[:-1]]
    assert [chunk.number for chunk in chunks] == list(range(len(ends)))


BY_VALUE = {
    "Chunk", "ErrorShares", "FieldError", "Format", "IronOptions", "MapAccuracy", "MissedAccuracy", "Provenance",
    "TriedStates",
}  # fmt: skip


def test_records_do_not_change_and_those_with_arrays_are_not_compared():
    """Records with fields of other libraries are not compared either. Their text is one line, from `Record`."""
    seen = {}
    for package in ("io", "store"):
        for found in pkgutil.iter_modules(
            import_module(f"fieldmap.{package}").__path__, f"fieldmap.{package}."
        ):
            for name, one in vars(import_module(found.name)).items():
                if isinstance(one, type) and one.__module__ == found.name and is_dataclass(one):
                    seen[name] = one
    public = {name: one for name, one in seen.items() if not name.startswith("_")}
    assert {name for name, one in public.items() if one.__eq__ is not object.__eq__} == BY_VALUE
    assert len(public) > 20
    for one in public.values():
        assert one.__dataclass_params__.frozen
        plain = {getattr(kind.type, "__name__", kind.type) for kind in fields(one)} <= {"int", "float", "str"}
        assert plain or one.__repr__ is Record.__repr__, one
