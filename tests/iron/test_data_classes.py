"""Data classes of the package are frozen, and classes with arrays are not compared by value."""

import importlib
import pkgutil
from dataclasses import fields

import pytest

import fieldmap
from fieldmap.iron.solvers.to_tolerance import _Run
from fieldmap.levitation.balance import MagnetBalance
from fieldmap.levitation.continuation import _Walk
from fieldmap.records import Record

# A run and a walk keep their progress, a balance counts its evaluations.
CHANGES = (_Run, _Walk, MagnetBalance)


def data_classes(package):
    folder = [f"{fieldmap.__path__[0]}/{package}"]
    for found in pkgutil.walk_packages(folder, f"fieldmap.{package}."):
        module = importlib.import_module(found.name)
        for one in vars(module).values():
            if (
                isinstance(one, type)
                and one.__module__ == module.__name__
                and "__dataclass_params__" in vars(one)
            ):
                yield one


@pytest.mark.parametrize(("package", "count"), [("iron", 100), ("levitation", 20), ("dynamics", 40)])
def test_data_classes_do_not_change(package, count):
    """An array has no truth value, so objects with arrays cannot be equal or a key. A `Record` prints one line."""
    every = [*data_classes(package)]
    assert len(every) > count
    for one in every:
        types = [str(field.type) for field in fields(one)]
        made = one.__dataclass_params__
        assert made.frozen is not issubclass(one, CHANGES), one
        if any(word in kind for kind in types for word in ("Array", "Index", "Mask", "ndarray")):
            assert not made.eq, one
        assert not (made.repr and issubclass(one, Record)), one
