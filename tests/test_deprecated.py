"""Old names work and warn."""

import math
import sys
import types
import warnings

import pytest

import fieldmap.errors
from fieldmap.deprecated import renamed, renamed_argument, warn_renamed


@pytest.fixture
def module():
    made = types.ModuleType("made_for_this_test")
    made.new = object()
    made.__getattr__ = renamed(
        made.__name__, {"old": "new", "elsewhere": "math:pi", "package": "fieldmap.errors:"}
    )
    sys.modules[made.__name__] = made
    yield made
    del sys.modules[made.__name__]


def test_old_names_are_the_new_objects(module):
    for name, object_ in (("old", module.new), ("elsewhere", math.pi), ("package", fieldmap.errors)):
        with pytest.warns(DeprecationWarning, match="is now") as caught:
            assert getattr(module, name) is object_
        assert caught[0].filename == __file__


def test_other_names_are_missing(module):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert module.new is not None
        assert not hasattr(module, "unknown")


def test_a_warning_points_to_the_caller():
    def function():
        warn_renamed("function(old)", "function(new)")

    with pytest.warns(DeprecationWarning, match="is now") as caught:
        function()
    assert caught[0].filename == __file__
    assert caught[0].lineno == function.__code__.co_firstlineno + 4


def test_an_argument_by_its_old_name_works_and_warns():
    @renamed_argument("radius", "r")
    def area(r, factor=3.0):
        return factor * r**2

    assert area(2.0) == area(r=2.0) == 12.0
    with pytest.warns(DeprecationWarning, match=r"area\(r\)"):
        assert area(radius=2.0, factor=1.0) == 4.0
