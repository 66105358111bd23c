"""What the tests of the iron may use."""

import pytest

from fieldmap.iron.geometry import mesh_files, step_files


@pytest.fixture
def read_at_once(monkeypatch):
    """Files that a library has just written are not read by another process first."""
    for module in (mesh_files, step_files):
        monkeypatch.setattr(module, "try_to_read", lambda *_: None)
