"""Kept meshes have the bits of fresh meshes, and only equal solids share a mesh."""

import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import InputError
from fieldmap.iron.geometry.solids import glue_bodies
from fieldmap.iron.mesh import mesher
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.mesh.mesher import FOLDER, KeptMeshes, LocalSizes, mesh_solids
from fieldmap.iron.mesh.surface_mesh import generate_surface
from tests.conftest import DEVICES

COARSE = 0.4


@pytest.fixture
def made(monkeypatch):
    """The requests to the mesher, which starts with no kept mesh and no folder."""
    asked, generated = [], mesher._generated

    def counted(*arguments):
        asked.append(arguments[3:])
        return generated(*arguments)

    monkeypatch.setattr(mesher, "_generated", counted)
    monkeypatch.setattr(mesher, "KEPT", KeptMeshes())
    monkeypatch.delenv(FOLDER, raising=False)
    return asked


@pytest.fixture
def device():
    return read_device("loop_and_sphere")


def with_radius(device, factor):
    (body,) = device.bodies
    (part,) = body.parts
    larger = replace(part, shape=replace(part.shape, radius=factor * part.shape.radius))
    return device.replace(bodies=[replace(body, parts=(larger,))])


def same_bits(one, other):
    return all(
        np.array_equal(a, b) if isinstance(a := getattr(one, field.name), np.ndarray) else True
        for field in fields(one)
        if (b := getattr(other, field.name)) is not None
    )


def test_all_processes_of_a_test_run_share_one_folder():
    """`tests/conftest.py` has the name of the variable as a literal."""
    assert Path(os.environ[FOLDER]).is_dir()


@pytest.mark.parametrize("generate", [generate_mesh, generate_surface])
def test_the_same_bits_from_memory_and_from_the_folder(made, device, generate, tmp_path, monkeypatch):
    fresh = generate(device, COARSE)
    assert same_bits(fresh, generate(device, COARSE))
    assert len(made) == 1
    monkeypatch.setenv(FOLDER, str(tmp_path / "meshes"))
    for _ in range(2):
        mesher.KEPT.forget()
        assert same_bits(fresh, generate(device, COARSE))
    assert len(made) == 2
    assert len(list((tmp_path / "meshes").iterdir())) == 1


def test_other_coils_and_materials_need_no_other_mesh(made, device):
    generate_mesh(device, COARSE)
    (coil,), (material,) = device.coils, device.materials.values()
    generate_mesh(device.replace(coils=[replace(coil, turns=7)], materials={material.name: material}), COARSE)
    assert len(made) == 1


def test_whatever_the_mesher_is_given_asks_for_another_mesh(made, device):
    """The smallest change of a radius, other sizes, other places of small elements, and the surface alone."""
    (body,) = device.bodies
    local = LocalSizes(np.array([[0.0, 0.0, 0.01]]), np.array([0.002]), np.zeros((0, 3)), np.zeros(0))
    moved = replace(local, points=local.points + 1e-4)
    finer = device.replace(bodies=[replace(body, mesh_size=0.99 * body.mesh_size)])
    generate_mesh(device, COARSE)
    generate_mesh(device, 1.01 * COARSE)
    generate_mesh(finer, COARSE)
    generate_mesh(with_radius(device, 1 + 1e-14), COARSE)
    generate_mesh(device, COARSE, local=local)
    generate_mesh(device, COARSE, local=moved)
    generate_surface(device, COARSE)
    assert len(made) == 7


def test_files_that_cannot_be_read_are_made_anew(made, device, tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    fresh = generate_mesh(device, COARSE)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for content in (b"", whole[: len(whole) // 2], b"PK\x03\x04 no archive"):
        file.write_bytes(content)
        mesher.KEPT.forget()
        assert same_bits(fresh, generate_mesh(device, COARSE))
    assert len(made) == 4


def test_a_folder_that_is_none_is_refused_before_a_mesh_is_made(made, device, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(FOLDER, str(tmp_path / "file"))
    with pytest.raises(InputError) as caught:
        generate_mesh(device, COARSE)
    (problem,) = caught.value.problems
    assert FOLDER in problem.where
    assert str(tmp_path / "file") in problem.received
    assert made == []


def test_memory_is_bounded_and_the_last_mesh_used_stays(made, device):
    mesh = mesh_solids(glue_bodies(device), device, COARSE)
    size = sum(array.nbytes for array in mesh.arrays.values())
    kept = KeptMeshes(int(2.5 * size))
    for key in "abac":
        kept.get(key, lambda: mesh)
    assert len(kept) == 2
    called = []
    for key in "acb":
        kept.get(key, lambda key=key: called.append(key) or mesh)
    assert called == ["b"]


def test_nobody_writes_into_a_mesh_that_others_use(made, device):
    for array in mesh_solids(glue_bodies(device), device, COARSE).arrays.values():
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


def test_solids_of_the_mesh_are_those_of_the_bodies(made):
    """In the same order: volumes of the tetrahedra of each solid against the drawing."""
    drawn = read_device(DEVICES / "core_and_magnet.toml")
    shape = glue_bodies(drawn)
    mesh = mesh_solids(shape, drawn, 0.5)
    corners = mesh.points[mesh.elements]
    volume = np.einsum(
        "kd,kd->k",
        corners[:, 1] - corners[:, 0],
        np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0]),
    )
    meshed = np.bincount(mesh.solids, np.abs(volume) / 6, len(shape.solids))
    np.testing.assert_allclose(meshed, [1e-9 * solid.mass for solid in shape.solids], rtol=0.15)
