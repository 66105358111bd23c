"""The examples in the docstrings of the packages store and maps run and print what they say."""

import doctest
from importlib import import_module

import pytest

MODULES = {
    "fieldmap.store.map_data": 1,
    "fieldmap.store.map_format": 1,
    "fieldmap.maps.recipe": 1,
    "fieldmap.maps.generation": 1,
    "fieldmap.lookup.field_map": 1,
}


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    done = doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS)
    assert done.failed == 0
    assert done.attempted >= MODULES[name]
