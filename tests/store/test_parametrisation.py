"""How a map of saturating iron states its domain of currents, also in older files."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from fieldmap.currents import CoilGroups, IndependentCurrents, LiftAndDirections
from fieldmap.errors import MapFileError
from fieldmap.store import read_map, seal_map, write_map
from fieldmap.store.map_format import REDUCED_MODEL
from tests.dynamics.conftest import saturating_data

ATTRIBUTE = "parametrisation"
ALL = [
    IndependentCurrents(6),
    LiftAndDirections(1.25),
    LiftAndDirections(1.25, 4.0),
    CoilGroups(((0, 1, 2), (3, 4, 5))),
]


def saturating_map(parametrisation):
    signals, data = parametrisation.signal_count, saturating_data()
    domain = {"lower": np.linspace(0.5, 1.0, signals), "upper": np.linspace(2.0, 3.0, signals)}
    model = replace(data.reduced_model, parametrisation=parametrisation, **domain)
    return replace(data, reduced_model=model)


def changed(path, change):
    with h5py.File(path, "r+") as file:
        change(file[REDUCED_MODEL])
    seal_map(path)
    return path


@pytest.mark.parametrize("parametrisation", ALL)
def test_a_map_says_which_signals_its_domain_is_of(parametrisation, tmp_path):
    data = saturating_map(parametrisation)
    again = read_map(write_map(tmp_path / "map.h5", data)).reduced_model
    assert again.parametrisation == parametrisation
    for name, values in data.reduced_model.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], values)
    shares = np.random.default_rng(2).random((5, parametrisation.signal_count))
    np.testing.assert_array_equal(again.domain.at(shares), data.reduced_model.domain.at(shares))


@pytest.mark.parametrize("parametrisation", ALL[:2])
def test_a_file_without_the_name_of_its_parametrisation_is_read_as_before(parametrisation, tmp_path):
    path = write_map(tmp_path / "map.h5", saturating_map(parametrisation))
    changed(path, lambda group: group.attrs.__delitem__(ATTRIBUTE))
    assert read_map(path).reduced_model.parametrisation == parametrisation


@pytest.mark.parametrize(
    ("stored", "stated"),
    [
        (LiftAndDirections(1.25), LiftAndDirections(1.5).to_json()),
        (LiftAndDirections(1.25), IndependentCurrents(6).to_json()),
        (IndependentCurrents(6), IndependentCurrents(5).to_json()),
        (IndependentCurrents(6), '{"name": "unknown", "parameters": {}}'),
        (IndependentCurrents(6), '{"name": "groups", "parameters": {}}'),
        (IndependentCurrents(6), '{"name": "groups"}'),
        (IndependentCurrents(6), "[]"),
        (IndependentCurrents(6), "{"),
    ],
)
def test_a_parametrisation_that_does_not_fit_is_refused(stored, stated, tmp_path):
    path = write_map(tmp_path / "map.h5", saturating_map(stored))
    changed(path, lambda group: group.attrs.__setitem__(ATTRIBUTE, np.bytes_(stated)))
    with pytest.raises(MapFileError):
        read_map(path)
