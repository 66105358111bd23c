"""Fixtures of the iron tests."""

import pytest

from fieldmap.device import mesh_files
from fieldmap.iron.geometry import shapes


@pytest.fixture
def read_at_once(monkeypatch, tmp_path):
    """The process of the test itself reads files that a library has just written."""

    def here(path, program):
        out = tmp_path / "handed_over"
        exec(program, {"path": str(path), "out": str(out), "limit": lambda: None})
        return out.read_bytes()

    monkeypatch.setattr(shapes, "read_by_another", here)
    monkeypatch.setattr(mesh_files, "read_by_another", lambda *_: None)
