"""Records of the thesis's rows are frozen; those with arrays or figures compare by identity, the others by value."""

import importlib
import pkgutil
from dataclasses import is_dataclass

import pytest

from fieldmap import thesis
from fieldmap.records import Record

MODULES = [
    importlib.import_module(one.name) for one in pkgutil.walk_packages(thesis.__path__, "fieldmap.thesis.")
]
RECORDS = {
    name: one
    for module in MODULES
    for name, one in vars(module).items()
    if isinstance(one, type) and is_dataclass(one) and one.__module__ == module.__name__
}
# These hold arrays or figures.
BY_IDENTITY = {"Answers", "LiftLaw", "PartResult", "Readings", "Run", "Shift", "Walk"}
# These have few numbers, and their repr shows all of them.
IN_FULL = {"Control", "Exponential", "HorizontalForce"}


@pytest.mark.parametrize("name", RECORDS)
def test_manners_of_a_record(name):
    made = RECORDS[name]
    assert issubclass(made, Record)
    assert made.__dataclass_params__.frozen
    assert (made.__eq__ is object.__eq__) == (name in BY_IDENTITY)
    assert (made.__repr__ is not Record.__repr__) == (name in IN_FULL)
