"""All tests of the C core run with every library that this machine can run."""

import sys

import pytest

from fieldmap.core.compile import libraries, machine
from fieldmap.core.library import loaded, runs

OLDEST, *NEWER = libraries(machine(), sys.platform).values()


@pytest.fixture(params=[OLDEST, *NEWER], ids=lambda path: path.name.split(".")[1], autouse=True)
def library(request, monkeypatch):
    """Each library that this machine can run."""
    if not runs(request.param, loaded(OLDEST).level()):
        pytest.skip("not for this processor")
    found = loaded(request.param)
    for name, module in tuple(sys.modules.items()):
        if name.startswith("fieldmap.core.") and hasattr(module, "LIBRARY"):
            monkeypatch.setattr(module, "LIBRARY", found)
    return found
