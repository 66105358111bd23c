"""A mesher that gives up: the user learns what to change."""

import pytest

from fieldmap.device import read_device
from fieldmap.errors import GeometryError
from fieldmap.iron.mesh import mesh, mesher


class GivesUp:
    """A geometry of the mesher's that it cannot mesh."""

    def __init__(self, shape):
        pass

    def GenerateMesh(self, mp):  # noqa: N802 - the mesher's name
        raise RuntimeError("Meshing failed!")


def test_a_mesh_that_cannot_be_made_is_a_geometry_error(monkeypatch):
    import netgen.occ

    monkeypatch.setattr(netgen.occ, "OCCGeometry", GivesUp)
    monkeypatch.setattr(mesher, "KEPT", mesher.KeptMeshes())
    monkeypatch.delenv(mesher.FOLDER, raising=False)
    with pytest.raises(GeometryError) as caught:
        mesh.generate_mesh(read_device("loop_and_sphere"), 0.3)
    (problem,) = caught.value.problems
    assert "loop_and_sphere" in problem.where
    for said in ("Meshing failed!", "refinement 0.3"):
        assert said in problem.received
    # A fifth larger; that of neighbouring sizes often fails as well.
    assert "0.36" in problem.remedy
