"""Manners of the data classes of the package: they do not change, and none with arrays in it is compared by them."""

import importlib
import pkgutil
from dataclasses import fields

import fieldmap.iron
from fieldmap.iron.solvers.to_tolerance import _Run
from fieldmap.records import Record


def data_classes():
    for found in pkgutil.walk_packages(fieldmap.iron.__path__, "fieldmap.iron."):
        module = importlib.import_module(found.name)
        for one in vars(module).values():
            if (
                isinstance(one, type)
                and one.__module__ == module.__name__
                and "__dataclass_params__" in vars(one)
            ):
                yield one


def test_data_classes_of_iron():
    """An array has no truth value: two objects with arrays cannot be equal or a key. A run alone remembers how far it
    is; what people see writes itself on one line, as `Record` does."""
    every = [*data_classes()]
    assert len(every) > 100
    for one in every:
        types = [str(field.type) for field in fields(one)]
        made = one.__dataclass_params__
        assert made.frozen or one is _Run, one
        if any(word in kind for kind in types for word in ("Array", "Index", "Mask", "ndarray")):
            assert not made.eq, one
        assert not (made.repr and issubclass(one, Record)), one
