"""A map that is read has the numbers that were written."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fieldmap.errors import MapFileError
from fieldmap.store import FieldError, checkpoint_path, open_writer, read_info, read_map, write_map
from fieldmap.store.map_format import record_names
from tests.refusals import refused
from tests.store.conftest import make_saturating


def test_everything_comes_back(data, tmp_path):
    path = write_map(tmp_path / "map.h5", data)
    again = read_map(path)
    np.testing.assert_array_equal(again.flux_density, data.flux_density)
    np.testing.assert_array_equal(again.gradient, data.gradient)
    np.testing.assert_array_equal(again.grid.lower, data.grid.lower)
    np.testing.assert_array_equal(again.grid.spacing, data.grid.spacing)
    assert again.grid.shape == data.grid.shape
    assert again.coil_names == ("1", "upper left")
    assert again.provenance == data.provenance
    assert again.interpolation_error == FieldError(1e-9, 2e-7)
    assert again.error_bounds == {"harmonic": FieldError(2e-9, 3e-7), "global": FieldError(1e-9, 2e-7)}
    assert not checkpoint_path(path).exists()
    assert read_info(path).provenance == data.provenance


def test_fields_of_iron_and_a_background_come_back(tmp_path):
    """Equal bits to `as_read`, because the reference current of 0.3 A rounds."""
    data = make_saturating()
    path = write_map(tmp_path / "map.h5", data)
    again, expected = read_map(path), data.as_read()
    for name in ("flux_density", "gradient"):
        np.testing.assert_array_equal(getattr(again, name), getattr(expected, name))
        np.testing.assert_allclose(getattr(expected, name), getattr(data, name), rtol=4e-16)
    assert (again.fixed_sources, again.constant_field) == (("magnet", "background"), True)
    assert again.current_error == read_info(path).current_error == FieldError(4e-6, 5e-3)
    assert (again.interpolation_error, again.error_bounds) == (None, {})
    assert again.field_names == data.field_names


@pytest.mark.parametrize(
    ("value", "written"),
    [(1e15, True), (-1e15, True), (1.001e15, False), (-1.001e15, False), (np.nan, False)],
)
@pytest.mark.parametrize("name", ["flux_density", "gradient"])
def test_numbers_of_edges_and_wires_are_no_field(large, tmp_path, name, value, written):
    """The limit is 1e15 T; the message names the fifth of nine planes."""
    values = getattr(large, name).copy()
    values[1, 4, 2, 3, -1] = value
    data = replace(large, **{name: values})
    if written:
        write_map(tmp_path / "map.h5", data)
        return
    with refused(MapFileError, where="map.h5, x-planes 4 to 4"):
        write_map(tmp_path / "map.h5", data)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def large(make_map):
    return make_map(shape=(9, 20, 30))


def test_another_reference_current_gives_the_same_unit_fields(make_map, tmp_path):
    data = make_map(reference_current=2.5)
    again = read_map(write_map(tmp_path / "map.h5", data))
    np.testing.assert_allclose(again.flux_density, data.flux_density, rtol=4e-16)
    np.testing.assert_allclose(again.gradient, data.gradient, rtol=4e-16)
    np.testing.assert_array_equal(again.reference_current, [2.5, 2.5])


def test_empty_texts_come_back_empty(make_map, tmp_path):
    data = make_map(recipe_text="", device_text="", title="")
    assert read_map(write_map(tmp_path / "map.h5", data)).provenance == data.provenance


def test_several_chunks(make_map, tmp_path):
    data = make_map(shape=(17, 12, 20))
    with open_writer(tmp_path / "other.h5", data) as writer:
        ends = [(chunk.first, chunk.last) for chunk in writer.chunks]
    assert len(ends) > 1
    assert ends[0][0] == 0
    assert ends[-1][1] == 17
    assert all(before[1] == after[0] for before, after in pairwise(ends))
    again = read_map(write_map(tmp_path / "map.h5", data))
    np.testing.assert_array_equal(again.gradient, data.gradient)


def test_an_existing_map_is_replaced(data, make_map, tmp_path):
    path = write_map(tmp_path / "map.h5", data)
    write_map(path, make_map(title="another"))
    assert read_info(path).provenance.title == "another"


@pytest.mark.parametrize(
    ("names", "records"),
    [
        (["1", "2"], ("1", "2")),
        (["a b", "a-b", "a_b", "a_b_2"], ("a_b", "a_b_2", "a_b_3", "a_b_2_2")),
        (["µ", "ß", ""], ("_", "__2", "__3")),
        (["../x", "a/b"], ("___x", "a_b")),
    ],
)
def test_record_names_are_plain_and_distinct(names, records):
    assert record_names(names) == records


def test_any_coil_name_survives(make_map, tmp_path):
    names = ("a b", "a-b", "Spule ø", "x/y", "..")
    data = make_map(coil_names=names)
    again = read_map(write_map(tmp_path / "map.h5", data))
    assert again.coil_names == names
    np.testing.assert_array_equal(again.flux_density, data.flux_density)
