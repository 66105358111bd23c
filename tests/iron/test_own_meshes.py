"""Bodies that are meshes of the user's own: fields, files of gmsh and VTK, regions, refused meshes."""

import random
import sys
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

import fieldmap as fm
from fieldmap.device import mesh_files
from fieldmap.device.mesh_files import read_mesh
from fieldmap.device.tetrahedra import boundary, subdivided, tetrahedra_fault, volumes
from fieldmap.errors import FieldmapError, GeometryError, InputError
from fieldmap.iron import check_geometry, generate_mesh
from fieldmap.iron.notes import device_contents

# A block of 10 x 12 x 8 mm, "lower" (7), below one of 10 x 12 x 4 mm, "upper" (8): written by gmsh 4.15, .msh 4.1.
GMSH = Path(__file__).parents[1] / "devices" / "block_of_two_regions.msh"
IRON = {"iron": fm.LinearMaterial("iron", 500.0)}
COIL = fm.CircularCoil("coil", 0.012, 0.016, 0.006, 200.0).moved([0, 0, 0.004])
POINTS = np.array([[0.0, 0.0, -0.003], [0.009, 0.001, 0.004], [0.0, 0.02, 0.01]])
BOX = fm.Body("block", "iron", fm.Box((0.01, 0.012, 0.008)), 0.003, 0.002)
# Two tetrahedra share a face, a third lies on it on the same side, and one touches the first in an edge only.
CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [0.1, 0.1, 0.5], [-1, 0, 0], [0, -1, 0]], float
)


def machine(*bodies):
    return fm.Device("machine", "", (COIL,), bodies, IRON)


def own(shape, name="block"):
    return fm.Body(name, "iron", shape)


def field(device, **options):
    return fm.solve_linear(device, **options).field(POINTS, 1.0)


def problem_of(call):
    with pytest.raises(FieldmapError) as caught:
        call()
    return caught.value.problems[0]


@pytest.fixture(scope="module")
def box():
    """The block as a shape, meshed as a whole: its mesh, and its field."""
    solved = fm.solve_linear(machine(BOX), symmetry="none")
    return solved.mesh, solved.field(POINTS, 1.0)


@pytest.fixture(scope="module")
def coarse():
    """The block of few tetrahedra, for input that is refused before a solve."""
    return generate_mesh(machine(replace(BOX, mesh_size=0.01, edge_size=None)), symmetry="none")


# ---- fields ----


def test_the_mesh_of_the_box_written_and_read_is_the_box(box, tmp_path):
    mesh, wanted = box
    cells = np.column_stack([np.full(len(mesh.tets), 4), mesh.tets]).ravel()
    kinds = np.full(len(mesh.tets), pv.CellType.TETRA)
    for name in ("box.vtu", "box.vtk"):
        pv.UnstructuredGrid(cells, kinds, 1e3 * mesh.points).save(tmp_path / name)
        device = machine(own(fm.MeshFile(tmp_path / name)))
        assert len(generate_mesh(device).tets) == len(mesh.tets)
        assert np.abs(field(device) - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("form", ["gmsh", "gmsh22", "medit", "abaqus"])
def test_the_mesh_of_the_box_by_meshio(box, form, tmp_path):
    meshio = pytest.importorskip("meshio")
    mesh, wanted = box
    path = tmp_path / {"gmsh": "box.msh", "gmsh22": "box.msh", "medit": "box.mesh", "abaqus": "box.inp"}[form]
    tags = [np.ones(len(mesh.tets), int)]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags} if form.startswith("gmsh") else {}
    meshio.Mesh(1e3 * mesh.points, [("tetra", mesh.tets)], cell_data=data).write(path, form)
    found = fm.VolumeMesh.from_file(path)
    assert found.points == pytest.approx(mesh.points, rel=1e-14, abs=1e-17)
    if form.startswith("gmsh"):
        assert np.abs(field(machine(own(found))) - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_a_mesh_of_gmsh_is_the_box_within_the_error_of_its_elements():
    pytest.importorskip("meshio")
    device = machine(own(fm.MeshFile(GMSH, region="lower")))
    wanted = field(machine(replace(BOX, mesh_size=0.002, edge_size=0.0002)))
    coarse, fine = (np.abs(field(device, refinement=k) - wanted).max() / np.abs(wanted).max() for k in (1, 2))
    assert fine < 1e-3
    assert fine < 0.5 * coarse  # charges at sharp edges: uniform elements of half the size leave some 0.4


def test_two_regions_of_a_file_are_one_piece_of_iron(box):
    pytest.importorskip("meshio")
    both = machine(*(own(fm.MeshFile(GMSH, region=name), name) for name in ("lower", "upper")))
    numbered = machine(*(own(fm.MeshFile(GMSH, region=name), name) for name in ("7", "8")))
    whole = machine(own(fm.MeshFile(GMSH)))
    wanted = field(whole)
    assert field(both) == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())
    mesh = generate_mesh(both)
    assert len(mesh.points) == len(generate_mesh(whole).points)
    share = [1e9 * volumes(mesh.points, mesh.tets)[mesh.body == k].sum() for k in (0, 1)]
    assert share == pytest.approx([960.0, 480.0])
    assert [1e9 * one.volume for one in device_contents(numbered).bodies] == pytest.approx([960.0, 480.0])


def test_beside_a_shape_moved_turned_and_mirrored(box):
    """The field in the frame of the moved body, and the field with a second body beside the mesh."""
    mesh, wanted = box
    shape = fm.VolumeMesh(mesh.points, mesh.tets)
    placement = fm.placed([0.001, 0.002, 0.003], [10, 20, 30])
    turned = machine(fm.Body("block", "iron", (fm.Part(shape, placement),)))
    points = generate_mesh(turned).points
    assert points[np.lexsort(points.T)] == pytest.approx(
        (placed := mesh.points @ placement.rotation.T + placement.position)[np.lexsort(placed.T)]
    )
    mirrored = machine(own(shape).mirrored("x"))
    assert volumes(*(lambda m: (m.points, m.tets))(generate_mesh(mirrored))).min() > 0
    reflected = field(mirrored)
    assert np.abs(reflected[[0, 2]] - wanted[[0, 2]]).max() < 2e-3 * np.abs(wanted).max()  # another mesh
    rod = fm.Body("rod", "iron", fm.Cylinder(0.003, 0.004), 0.003).moved([0, 0, 0.01])
    ours, theirs = field(machine(own(shape), rod)), field(machine(BOX, rod), symmetry="none")
    assert np.abs(ours - theirs).max() < 1e-3 * np.abs(theirs).max()


def test_in_a_device_file(box, tmp_path):
    mesh, _ = box
    device = machine(own(fm.VolumeMesh(mesh.points, mesh.tets)))
    read = fm.read_device(device.to_toml()).bodies[0]
    assert read.mesh_size is None
    assert read.parts[0].shape.points == pytest.approx(mesh.points, rel=1e-14)
    assert np.array_equal(read.parts[0].shape.tetrahedra, mesh.tets)
    (tmp_path / "block.msh").write_bytes(GMSH.read_bytes())
    (tmp_path / "machine.toml").write_text(
        'format = 1\nname = "m"\ntitle = "m"\n[material.iron]\nkind = "linear"\nmu_r = 500\n'
        '[[body]]\nname = "block"\nmaterial = "iron"\nshape = "mesh_file"\nfile = "block.msh"\nunit_mm = 25.4\n'
        'region = "upper"\nposition_mm = [0, 0, 5]\n'
    )
    read = fm.read_device(tmp_path / "machine.toml")
    assert read.bodies[0].parts[0].shape == fm.MeshFile(tmp_path / "block.msh", 0.0254, "upper")
    assert list(read.included) == ["block.msh"]
    (tmp_path / "block.msh").unlink()
    assert problem_of(lambda: fm.read_device(tmp_path / "machine.toml")).where.endswith("file")


# ---- files ----


@pytest.mark.usefixtures("read_at_once")
def test_ten_nodes_are_taken_by_their_corners(coarse, tmp_path):
    mesh, points = coarse, 1e3 * coarse.points
    pairs = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])
    middles = points[mesh.tets[:, pairs]].mean(axis=2) + 0.01
    numbers = len(points) + np.arange(6 * len(mesh.tets)).reshape(-1, 6)
    cells = np.column_stack([np.full(len(mesh.tets), 10), mesh.tets, numbers]).ravel()
    kinds = np.full(len(mesh.tets), pv.CellType.QUADRATIC_TETRA)
    pv.UnstructuredGrid(cells, kinds, np.vstack([points, middles.reshape(-1, 3)])).save(tmp_path / "q.vtu")
    found = read_mesh(tmp_path / "q.vtu")
    assert found.higher_order == len(mesh.tets)
    assert np.array_equal(found.points[found.tets], points[mesh.tets])
    notes = fm.solve_linear(machine(own(fm.MeshFile(tmp_path / "q.vtu")))).report.assumptions
    assert any(f"{len(mesh.tets)} tetrahedra" in note for note in notes)


@pytest.mark.usefixtures("read_at_once")
def test_regions_of_a_solved_state(box, tmp_path):
    """A file of write_vtu is read as a body, also by region name; coincident nodes become one."""
    from fieldmap.plot.vtu import write_vtu

    bodies = (BOX, fm.Body("cap", "iron", fm.Box((0.004, 0.004, 0.002)), 0.002).moved([0, 0, 0.008]))
    solved = fm.solve_linear(machine(*bodies))
    write_vtu(solved.at(1.0), tmp_path / "iron.vtu")
    cap = fm.VolumeMesh.from_file(tmp_path / "iron.vtu", 1.0, "cap")
    assert volumes(cap.points, cap.tetrahedra).sum() == pytest.approx(32e-9)
    grid = pv.read(tmp_path / "iron.vtu")
    apart = grid.separate_cells()
    assert apart.n_points == 4 * grid.n_cells
    apart.save(tmp_path / "apart.vtu")
    assert len(read_mesh(tmp_path / "apart.vtu").points) == grid.n_points


def test_damaged_files_are_told(tmp_path):
    """Two hundred files with changed bytes, lines or ends: each is still a mesh, or is refused by its name."""
    pytest.importorskip("meshio")
    whole = GMSH.read_bytes()
    (tmp_path / "22.msh").write_bytes(version_22(read_mesh(GMSH)))
    refused = []
    for seed in range(200):
        rng = random.Random(seed)
        path = tmp_path / f"{seed}.msh"
        path.write_bytes(damaged(rng, whole if seed % 2 else (tmp_path / "22.msh").read_bytes()))
        try:
            mesh = read_mesh(path)
        except InputError as error:
            refused.append(error.problems[0].where == str(path))
        else:
            assert tetrahedra_fault(mesh.points, mesh.tets) is None
    assert all(refused)
    assert len(refused) > 150


def version_22(mesh):
    nodes = "".join(f"{k + 1} {x:.16g} {y:.16g} {z:.16g}\n" for k, (x, y, z) in enumerate(mesh.points))
    cells = "".join(f"{k + 1} 4 2 7 1 {' '.join(map(str, 1 + tet))}\n" for k, tet in enumerate(mesh.tets))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(mesh.points)}\n{nodes}$EndNodes\n"
        f"$Elements\n{len(mesh.tets)}\n{cells}$EndElements\n"
    ).encode()


def damaged(rng, data):
    how, out, lines = rng.randrange(5), bytearray(data), data.split(b"\n")
    if how == 0:
        return data[: rng.randrange(len(data))]
    if how == 1:
        for _ in range(rng.randrange(1, 20)):
            out[rng.randrange(len(out))] = rng.randrange(256)
        return bytes(out)
    if how == 2:
        start = rng.randrange(len(out))
        del out[start : start + rng.randrange(1, 200)]
        return bytes(out)
    place, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    if how == 3:
        lines[place] = rng.choice([b"", b"nan nan nan", b"-1 -1 -1 -1", b"$Foo", b"1 2"])
    else:
        lines[place], lines[other] = lines[other], lines[place]
    return b"\n".join(lines)


@pytest.mark.parametrize("name", ["no.msh", "no.vtu", "no.vtk", "no.unknown"])
def test_no_mesh_file(name, tmp_path, monkeypatch):
    """Another process reads the first file; for the others it is made to find no fault."""
    if not name.endswith(("vtu", "vtk")):
        pytest.importorskip("meshio")
    for data in (b"\0" * 90, b"", b"solid nothing"):
        (tmp_path / name).write_bytes(data)
        assert problem_of(lambda: read_mesh(tmp_path / name)).where == str(tmp_path / name)
        monkeypatch.setattr(mesh_files, "read_by_another", lambda *_: None)
    assert problem_of(lambda: read_mesh(tmp_path / "none.vtu")).where == str(tmp_path / "none.vtu")


@pytest.mark.usefixtures("read_at_once")
def test_what_is_no_tetrahedron(tmp_path):
    pv.examples.cells.Hexahedron().save(tmp_path / "cube.vtu")
    assert problem_of(lambda: read_mesh(tmp_path / "cube.vtu")).received == "1 hexahedron"
    pv.Sphere().cast_to_unstructured_grid().save(tmp_path / "ball.vtu")
    assert problem_of(lambda: read_mesh(tmp_path / "ball.vtu")).received == "none"


def test_regions_that_are_not_there():
    pytest.importorskip("meshio")
    problem = problem_of(lambda: check_geometry(machine(own(fm.MeshFile(GMSH, region="core")))))
    assert problem.received == "'core'"
    assert problem.must_hold.endswith("7, 8, lower, upper")
    assert "body 'block'" in problem.where


def test_without_meshio(monkeypatch, tmp_path):
    (tmp_path / "block.msh").write_bytes(GMSH.read_bytes())
    monkeypatch.setitem(sys.modules, "meshio", None)
    problem = problem_of(lambda: fm.VolumeMesh.from_file(tmp_path / "block.msh"))
    assert problem.where == str(tmp_path / "block.msh")
    assert "fieldmap[mesh]" in problem.remedy


# ---- tetrahedra that fill no solid ----


@pytest.mark.parametrize(
    ("tets", "received"),
    [
        ([[0, 1, 2, 8]], "[0, 1, 2, 8] as tetrahedron 0"),
        ([[0, 1, 2, 3], [0, 1, 2, 6]], "tetrahedron 1 with corners [0, 1, 2, 6] is flat (1 in all)"),
        ([[0, 1, 2, 3], [3, 2, 1, 0]], "tetrahedra 0 and 1 with the corners 0, 1, 2, 3 (1 pair in all)"),
        ([[0, 1, 2, 3], [0, 1, 2, 5]], "tetrahedra 0 and 1 on one side of theirs (1 in all)"),
        ([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]], "3 at the face of points 0, 1 and 2"),
        ([[0, 1, 2, 3], [0, 3, 6, 7]], "pieces that touch only in the edge from point 0 to 3 (1 in all)"),
    ],
    ids=["no such node", "flat", "twice", "folded", "three at a face", "touching in an edge"],
)
def test_what_fills_no_solid_is_told(tets, received):
    tets = np.array(tets)
    assert tetrahedra_fault(CORNERS, tets)[1] == received
    problem = problem_of(lambda: machine(own(fm.VolumeMesh(1e-2 * CORNERS, tets))))
    assert problem.received == received
    assert problem.where.startswith('Device "machine", body "block"')


def test_pieces_that_overlap_are_told(coarse):
    """A second block inside the first, and one that cuts it: no face is shared, only the volumes show it."""
    for shift, scale in (([0.0, 0.0, 0.002], 0.3), ([0.004, 0.003, 0.001], 1.0)):
        points = np.vstack([coarse.points, scale * coarse.points + shift])
        tets = np.vstack([coarse.tets, coarse.tets + len(coarse.points)])
        assert tetrahedra_fault(points, tets) is None
        with pytest.raises(GeometryError) as caught:
            check_geometry(machine(own(fm.VolumeMesh(points, tets))))
        assert "body 'block'" in caught.value.problems[0].where


def test_a_hollow_mesh_and_one_in_its_hole_are_sound():
    """Shells within shells: a block of cubes without the middle one, and half a cube, cut alike, in its place."""
    grid = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    number = lambda c: int(c[0] * 16 + c[1] * 4 + c[2])  # noqa: E731
    paths = permutations(range(3))
    kuhn = [np.cumsum(np.vstack([np.zeros(3, int), np.eye(3, dtype=int)[list(p)]]), axis=0) for p in paths]
    cells = {c: [[number(c + step) for step in path] for path in kuhn] for c in np.ndindex(3, 3, 3)}
    middle = np.array(cells.pop((1, 1, 1)))
    points = np.vstack([grid, 0.5 * (grid - 1.5) + 1.5])
    tets = np.array([tet for cell in cells.values() for tet in cell] + (middle + len(grid)).tolist())
    shape = fm.VolumeMesh(1e-3 * (points - [1.5, 1.5, 0]), tets)
    (block,) = device_contents(machine(own(shape))).bodies
    assert 1e9 * block.volume == pytest.approx(27 - 1 + 1 / 8)
    assert block.mesh_size == pytest.approx(1e-3 * np.sqrt(3))


# ---- bodies against each other, and options ----


def test_contact_without_common_faces_is_told(coarse):
    block = own(fm.VolumeMesh(coarse.points, coarse.tets))
    cap = fm.Body("cap", "iron", fm.Box((0.01, 0.012, 0.004)), 0.003)
    beside = replace(block.moved([0, 0.003, 0.008]), name="cap")
    # Contacts of 10 by 12 mm, and by 9 mm.
    for other, area in ((cap.moved([0, 0, 0.008]), 120), (beside, 90)):
        with pytest.raises(GeometryError) as caught:
            check_geometry(machine(block, other))
        (problem,) = caught.value.problems
        assert "'block' and 'cap'" in problem.where
        assert problem.received == f"a contact of {area} mm^2, common faces of 0 mm^2"
    with pytest.raises(GeometryError) as caught:
        check_geometry(machine(block, cap.moved([0, 0, 0.006])))
    (problem,) = caught.value.problems
    assert problem.received.startswith("240 mm^3")


def test_options_for_shapes_are_refused(coarse):
    shape = fm.VolumeMesh(coarse.points, coarse.tets)
    device = machine(own(shape))
    for wrong in (0.5, 1.5, 3.0):
        assert "block" in problem_of(lambda wrong=wrong: fm.solve_linear(device, refinement=wrong)).where
    workspace = fm.WorkspaceBox(np.array([-0.01, -0.01, -0.01]), np.array([0.01, 0.01, -0.005]))
    two = machine(replace(own(shape).moved([0.05, 0, 0]), name="first"), own(shape))
    for bodies, first in ((device, "'block'"), (two, "'first'")):
        wrong = bodies.replace(workspace=workspace)
        assert problem_of(lambda wrong=wrong: fm.solve_to_tolerance(wrong)).where.endswith(first)
    cube = fm.Box((0.1, 0.1, 0.1))
    for word, *about in (("mesh_size", shape, 0.003), ("shape", (shape, cube), 0.003), ("mesh_size", cube)):
        body = fm.Body("block", "iron", *about)
        assert word in problem_of(lambda body=body: machine(body)).where
    with pytest.raises(InputError):
        own(fm.MeshFile(GMSH)).mirrored("x")


def test_cut_into_eight(box):
    mesh, _ = box
    points, tets = subdivided(mesh.points, mesh.tets)
    whole, part = volumes(mesh.points, mesh.tets), np.abs(volumes(points, tets)).reshape(-1, 8)
    assert part == pytest.approx(np.repeat(whole[:, None] / 8, 8, axis=1), rel=1e-9)
    assert tetrahedra_fault(points, tets) is None
    assert len(boundary(points, tets)) == 4 * len(boundary(mesh.points, mesh.tets))
