"""Damaged files on which C++ libraries crash, hang or take all memory are refused, all alike."""

import json
import sys

import numpy as np
import pytest
import pyvista
from netgen import occ

import fieldmap as fm
from fieldmap.device import another_process, mesh_files
from fieldmap.device.mesh_files import read_mesh
from fieldmap.device.surfaces import read_stl
from fieldmap.errors import GeometryError, InputError, Problem
from fieldmap.iron.geometry import shapes
from fieldmap.iron.geometry.solids import body_solid, glue_bodies
from fieldmap.iron.mesh import mesher


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "a.file"
    file.write_text("text")
    return file


def test_a_reader_that_crashes(path):
    with pytest.raises(ValueError, match="crashes"):
        another_process.read_by_another(path, "import os; os.abort()")


def test_a_reader_that_does_not_end(path, monkeypatch):
    monkeypatch.setattr(another_process, "LONGEST_S", 1)
    with pytest.raises(ValueError, match="does not end"):
        another_process.read_by_another(path, "import time; time.sleep(20)")


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")
def test_a_reader_that_asks_for_memory(path):
    # Half of the memory limit, requested but not written to.
    asked = f"mmap.mmap(-1, {another_process.MEMORY_BYTES // 2})"
    another_process.read_by_another(
        path, f"import mmap\nlimit()\ntry:\n    {asked}\nexcept OSError:\n    raise MemoryError"
    )
    with pytest.raises(ValueError, match="memory"):
        another_process.read_by_another(path, f"limit(); a = bytearray({2 * another_process.MEMORY_BYTES})")


def test_the_trial_of_a_mesh_comes_to_its_end(tmp_path):
    """A trial that stopped at an import would find no file damaged."""
    file = tmp_path / "cube.vtu"
    pyvista.examples.cells.Hexahedron().save(file)
    with pytest.raises(ValueError, match="crashes"):
        another_process.read_by_another(file, mesh_files._TRIAL + "os.abort()")


@pytest.fixture
def cube(monkeypatch):
    """A device with a body of a surface from another program."""
    monkeypatch.delenv(mesher.FOLDER, raising=False)
    points = 0.01 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    body = fm.Body("cube", "iron", fm.TriangleSurface(points, np.array(faces)), 0.005)
    return fm.Device("unit", "", (), (body,), {"iron": fm.LinearMaterial("iron", 100.0)})


def test_a_mesher_that_crashes_is_bad_input(cube, monkeypatch):
    monkeypatch.setattr(mesher, "_APART", "import os; os.abort()")
    monkeypatch.setattr(mesher, "KEPT", mesher.KeptMeshes())
    with pytest.raises(GeometryError) as caught:
        mesher.mesh_solids(glue_bodies(cube), cube, 1.0)
    (problem,) = caught.value.problems
    assert problem.where == "the iron of unit"
    assert "crashes" in problem.received


def test_another_process_makes_the_mesh_or_says_why_not(cube, monkeypatch):
    """If the other process fails, this process makes the mesh; a refusal of the other process is passed on."""
    solids, here = glue_bodies(cube), []
    whole = mesher._generated

    def counted(*asked):
        here.append(asked[1])
        return whole(*asked)

    monkeypatch.setattr(mesher, "_generated", counted)
    meshes = []
    for program, made_here in ((mesher._APART, 0), ("raise RuntimeError", 1)):
        monkeypatch.setattr(mesher, "_APART", program)
        monkeypatch.setattr(mesher, "KEPT", mesher.KeptMeshes())
        meshes.append(mesher.mesh_solids(solids, cube, 1.0))
        assert len(here) == made_here
    for mesh in meshes:
        corners = mesh.points[mesh.elements]
        volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
        assert np.abs(volumes).sum() == pytest.approx(1e-6)
    told = ["the iron of unit", "must have a mesh", "none", "smaller"]
    program = f"import sys; open(sys.argv[1] + '/refused.json', 'w').write({json.dumps(told)!r})"
    monkeypatch.setattr(mesher, "_APART", program)
    monkeypatch.setattr(mesher, "KEPT", mesher.KeptMeshes())
    with pytest.raises(GeometryError) as caught:
        mesher.mesh_solids(solids, cube, 1.0)
    assert caught.value.problems == (Problem(*told),)


def test_what_a_reader_writes_is_handed_over_and_one_that_refuses_hands_over_nothing(path):
    read = another_process.read_by_another
    assert read(path, "open(out, 'w').write(open(path).read())") == b"text"
    assert read(path, "pass") is None
    assert read(path, "open(out, 'w').write('half of it'); raise RuntimeError") is None


def test_the_kernel_reads_no_step_file_here(tmp_path, monkeypatch):
    """The CAD kernel hangs on some damaged files by chance, even if another process has read them without harm."""
    file = tmp_path / "a.step"
    occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(4, 5, 6)).WriteStep(str(file))
    kernel, read_here = occ.OCCGeometry, []

    def seen(name):
        read_here.append(name)
        return kernel(name)

    monkeypatch.setattr(shapes.occ, "OCCGeometry", seen)
    solid = body_solid(fm.Body("b", "steel", fm.StepFile(file, 1e-3), mesh_size=1e-3))
    assert solid.mass == pytest.approx(120.0, rel=1e-12)
    assert [name for name in read_here if not name.endswith(".brep")] == []
    assert read_here


def test_a_solid_that_cannot_be_taken_over_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(shapes, "read_by_another", lambda *_: b"no solid of the kernel")
    path = tmp_path / "a.step"
    path.write_text("ISO-10303-21;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n")
    with pytest.raises(GeometryError) as caught:
        body_solid(fm.Body("b", "steel", fm.StepFile(path, 1e-3), mesh_size=1e-3))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("module", ["iron.geometry.shapes", "device.mesh_files"])
def test_a_damaged_file_is_told_at_its_place(tmp_path, monkeypatch, module):
    """The readers are made to crash here, because real crashes differ by version."""

    def crash(path, program):
        return another_process.read_by_another(path, "import os; os.abort()")

    monkeypatch.setattr(f"fieldmap.{module}.read_by_another", crash)
    path = tmp_path / ("a.step" if module.endswith("shapes") else "a.vtk")
    path.write_text("ISO-10303-21;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n")
    if module.endswith("shapes"):
        body = fm.Body("b", "steel", fm.StepFile(path, 1e-3), mesh_size=1e-3)
        with pytest.raises(GeometryError) as caught:
            body_solid(body)
    else:
        with pytest.raises(InputError) as caught:
            read_mesh(path)
    assert "crashes" in caught.value.problems[0].received


def test_numbers_that_overflow(tmp_path):
    path = tmp_path / "a.stl"
    path.write_text("solid\n" + "vertex 0 0 0\nvertex 1e200 0 0\nvertex 0 1 0\n" + "endsolid\n")
    with pytest.raises(InputError):
        read_stl(path)
    meshio = pytest.importorskip("meshio")
    points = np.array([[0, 0, 0], [1e200, 0, 0], [0, 1, 0], [0, 0, 1]])
    meshio.write(tmp_path / "a.vtk", meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))]))
    with pytest.raises(InputError):
        read_mesh(tmp_path / "a.vtk")
