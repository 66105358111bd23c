"""All tests of the C core run on every library that this machine can run."""

import sys

import pytest

from fieldmap.core import (
    body,
    caller,
    closed_loop,
    controller,
    current_table,
    harmonics,
    iron,
    least_power,
    machine,
    map,
    mujoco,
)
from fieldmap.core.compile import libraries
from fieldmap.core.compile import machine as architecture
from fieldmap.core.library import loaded

OLDEST, *NEWER = libraries(architecture(), sys.platform).values()


@pytest.fixture(params=[OLDEST, *NEWER], ids=lambda path: path.name.split(".")[1], autouse=True)
def library(request, monkeypatch):
    """Each library that this machine can run."""
    found = loaded(request.param)
    if request.param != OLDEST and not found.is_for_newer():
        pytest.skip("not for this processor")
    modules = (
        body,
        caller,
        closed_loop,
        controller,
        current_table,
        harmonics,
        iron,
        least_power,
        machine,
        map,
        mujoco,
    )
    for module in modules:
        monkeypatch.setattr(module, "LIBRARY", found)
    return found
