"""All tests of the C core run on every library that this machine can run."""

import sys

import pytest

from fieldmap.core.compile import libraries, machine
from fieldmap.core.library import loaded

OLDEST, *NEWER = libraries(machine(), sys.platform).values()


@pytest.fixture(params=[OLDEST, *NEWER], ids=lambda path: path.name.split(".")[1], autouse=True)
def library(request, monkeypatch):
    """Each library that this machine can run."""
    found = loaded(request.param)
    if request.param != OLDEST and not found.is_for_newer():
        pytest.skip("not for this processor")
    for name, module in tuple(sys.modules.items()):
        if name.startswith("fieldmap.core.") and hasattr(module, "LIBRARY"):
            monkeypatch.setattr(module, "LIBRARY", found)
    return found
