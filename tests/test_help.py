"""`help` and editors show readable names of arguments and types for the public functions."""

import inspect
import pkgutil
from dataclasses import fields, is_dataclass
from importlib import import_module

import pytest

import fieldmap as fm
from fieldmap.iron import LinearSolution, NonlinearSolver
from fieldmap.lookup import FieldMap
from fieldmap.sources import CoilSet

LONGEST = 700


def signatures():
    for name in fm.__all__:
        one = getattr(fm, name)
        if callable(one) and not inspect.isabstract(one):
            yield name, one
    for one in (FieldMap, LinearSolution, NonlinearSolver, CoilSet, fm.Device, fm.Body):
        for name, method in inspect.getmembers(one, inspect.isfunction):
            if not name.startswith("_"):
                yield f"{one.__name__}.{name}", method


@pytest.mark.parametrize(
    ("name", "one"), [*signatures()], ids=lambda value: value if isinstance(value, str) else ""
)
def test_a_signature_is_read_in_one_glance(name, one):
    text = str(inspect.signature(one))
    assert len(text) <= LONGEST
    assert "_typing" not in text
    assert "*arguments" not in text
    assert inspect.getdoc(one)


@pytest.mark.parametrize("name", [name for name in fm.__all__ if is_dataclass(getattr(fm, name))])
def test_a_part_of_a_machine_shows_its_dimensions(name):
    one = getattr(fm, name)
    if not inspect.isabstract(one):
        shown, own = inspect.signature(one).parameters, [field for field in fields(one) if field.init]
        # Positional fields first, then keyword-only ones.
        assert list(shown) == [field.name for field in sorted(own, key=lambda field: field.kw_only)]
        assert not any("FieldInfo" in str(each.annotation) for each in shown.values())


OWN = {"cli", "inputs", "interpolants", "kernels", "parallel"}
"""Packages that a user has no need to name."""


@pytest.mark.parametrize(
    "name", sorted({info.name for info in pkgutil.iter_modules(fm.__path__) if info.ispkg} - OWN | {"errors"})
)
def test_packages_are_attributes_before_anybody_has_imported_them(name):
    assert fm.__getattr__(name) is import_module(f"fieldmap.{name}")
    assert name in dir(fm)


def test_other_names_are_no_attributes():
    assert not hasattr(fm, "kernel")
    with pytest.raises(AttributeError):
        fm.__getattr__("utils")
