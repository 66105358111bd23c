"""Symmetry groups of devices against point groups whose order is known, and against the fields of the coils."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.iron.mesh.chamber import mirror_chamber
from fieldmap.iron.symmetry import Operation, _Item, exact_matrices, find_symmetry, multiplication_table
from fieldmap.sources import unit_flux_density

MATERIALS = {"iron": fm.LinearMaterial("iron", 100.0), "steel": fm.LinearMaterial("steel", 200.0)}


def turn(axis, degrees):
    """Rotation matrix by Rodrigues's formula."""
    k = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


SKEW = fm.Placement(np.array([0.01, -0.02, 0.03]), turn([1, 2, 3], 47.0))


def body(*parts, material="iron", name="b", size=0.005):
    return fm.Body(name, material, tuple(fm.Part(*part) for part in parts), size)


def device(*bodies, coils=()):
    return fm.Device.unchecked(name="d", coils=tuple(coils), bodies=tuple(bodies), materials=MATERIALS)


def ring_of(count, radius, shape=None, start=0.0):
    angles = np.radians(start) + 2 * np.pi * np.arange(count) / count
    places = [np.array([radius * np.cos(a), radius * np.sin(a), 0.0]) for a in angles]
    shape = shape or fm.Cylinder(0.005, 0.02)
    return [body((shape, fm.Placement(p)), name=f"b{k}") for k, p in enumerate(places)]


HEXAGON = np.array([[np.cos(a), np.sin(a)] for a in np.pi / 3 * np.arange(6)]) * 0.02
L_SHAPE = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2]]) * 0.01


def around(points, *faces):
    """The surface with these plane convex faces, each cut into triangles from its first corner."""
    triangles = [(face[0], b, c) for face in faces for b, c in pairwise(face[1:])]
    return fm.TriangleSurface(np.array(points, dtype=float) * 0.01, np.array(triangles))


def hexahedron(a, b, c):
    """The parallelepiped of three edges."""
    points = [
        i * np.array(a) + j * np.array(b) + k * np.array(c) for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    faces = ([0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3])
    return around(points, *faces)


def pyramid(*tip):
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), tip]
    return around(corners, [3, 2, 1, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4])


X, Y, Z = np.eye(3)
LEANING = hexahedron(X, Y + 0.3 * X, 2 * Z + 0.1 * X + 0.2 * Y)
TETRAHEDRON = around(
    [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], [0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]
)


@pytest.mark.parametrize("place", [fm.Placement(), SKEW])
@pytest.mark.parametrize(
    ("shape", "order"),
    [
        # For surfaces the edges count, not the division of plane faces into triangles.
        (hexahedron(X, Y, Z), 48),  # Oh
        (hexahedron(X, Y, 2 * Z), 16),  # D4h
        (hexahedron(X, 2 * Y, 3 * Z), 8),  # D2h
        (hexahedron(X, Y + 0.3 * X, 2 * Z), 4),  # C2h
        (LEANING, 2),  # Ci
        (TETRAHEDRON, 24),  # Td
        (pyramid(0, 0, 1), 8),  # C4v
        (pyramid(0.5, 0, 1), 2),  # Cs
        (pyramid(0.5, 0.2, 1), 1),
        # So flat that its faces are bent by 0.6 degrees.
        (pyramid(0.5, 0, 0.01), 2),
        (fm.Box((0.01, 0.02, 0.03)), 8),  # D2h
        (fm.Box(np.array([0.02, 0.02, 0.03])), 16),  # D4h
        (fm.Box((0.02, 0.02, 0.02)), 48),  # Oh
        (fm.ExtrudedPolygon(HEXAGON, 0.01), 24),  # D6h
        (fm.ExtrudedPolygon(L_SHAPE, 0.01), 2),  # Cs: the plane half way up
        (fm.Cylinder(0.01, 0.02), 8),  # infinitely many; D2h is used
        (fm.RevolvedProfile(np.array([[0, 0], [2, 0], [1, 1], [0, 1]]) * 0.01), 4),  # frustum: C2v is used
        (fm.Sphere(0.01), 8),
        (fm.Ring(0.01, 0.02, 0.01), 8),
    ],
)
def test_order_of_a_single_shape(shape, order, place):
    group = find_symmetry(device(body((shape, place))))
    assert group.order == order
    table = multiplication_table(group.matrices)
    assert all(len(set(row)) == order for row in table)


@pytest.mark.parametrize(
    ("bodies", "walls", "order"),
    [
        ([body((fm.Box((0.01, 0.02, 0.03)), SKEW))], 3, 8),
        ([body((fm.Box((0.01, 0.02, 0.03)), SKEW))], 2, 4),
        ([body((fm.Box((0.01, 0.02, 0.03)), SKEW))], 1, 2),
        ([body((hexahedron(X, Y, Z), SKEW))], 3, 48),
        ([body((pyramid(0, 0, 1), SKEW))], 3, 8),
        (ring_of(8, 0.03), 3, 32),
        # Wedges of 18 degrees are too sharp: the chamber is a wedge of 36 degrees and half the height.
        (ring_of(10, 0.03), 3, 20),
        (ring_of(11, 0.03), 3, 4),
    ],
)
def test_the_chamber_and_its_copies_fill_space(bodies, walls, order):
    group = find_symmetry(device(*bodies))
    chamber = mirror_chamber(group, walls)
    assert chamber.group.order == order
    points = np.random.default_rng(2).standard_normal((500, 3))
    # A direction lies in a copy if its image under the inverse is in front of all walls.
    back = np.einsum("gji,nj->gni", chamber.group.matrices, points)
    inside = (back @ chamber.walls.T > 0).all(axis=2)
    assert (inside.sum(axis=0) == 1).all()
    assert (inside.sum(axis=1) > 0).all()


@pytest.mark.parametrize(("start", "normal"), [(0.0, Y), (30.0, X), (90.0, X), (15.0, None)])
def test_walls_lie_in_coordinate_planes_where_they_can(start, normal):
    """Three columns at 120 degrees, with six chambers between their mirrors."""
    walls = mirror_chamber(find_symmetry(device(*ring_of(3, 0.03, start=start)))).walls
    assert np.abs(walls @ Z).max() == pytest.approx(1.0, abs=1e-12)
    upright = walls[np.abs(walls @ Z) < 0.5]
    assert len(upright) == 2
    along = np.abs(upright[:, :2]).max(axis=1).max()
    assert (along > 1 - 1e-9) == (normal is not None)
    assert normal is None or np.abs(upright @ normal).max() == pytest.approx(1.0, abs=1e-12)


def test_no_chamber_without_a_mirror():
    assert mirror_chamber(find_symmetry(device(body((pyramid(0.5, 0.2, 1), fm.Placement()))))) is None


def test_items_are_alike_where_each_segment_has_one_like_it():
    rows = np.arange(39.0).reshape(3, 13)

    def like(one, other, kind=("a",)):
        return _Item(("a",), np.array(one)).is_like(_Item(kind, np.array(other)), 1e-3)

    assert like(rows, rows[[2, 0, 1]] + 9e-4)
    assert not like(rows, rows[[2, 0, 1]] + 1.1e-3)
    assert not like(rows, rows, ("b",))
    assert not like(rows, rows[:2])
    # Two rows nearer than the tolerance have only one counterpart.
    double = [rows[0], rows[0] + 1e-4, rows[1]]
    assert not like(double, rows)
    assert not like(rows, double)


def test_items_without_a_symmetry_of_their_own(tmp_path):
    """Meshes and files are like copies of themselves alone; a device without iron has the identity."""
    points, tets = 0.01 * np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]])

    def pair(one, other):
        there = fm.Placement(np.array([-0.05, 0, 0]), np.diag([-1.0, -1.0, 1.0]))
        return find_symmetry(
            device(body((one, fm.placed((0.05, 0, 0))), name="a"), body((other, there), name="b"))
        )

    mesh, file = fm.VolumeMesh(points, tets), fm.MeshFile(tmp_path / "a.msh", 1e-3, "core")
    assert str(pair(mesh, mesh)) == "2-fold axis z"
    assert str(pair(file, file)) == "2-fold axis z"
    assert pair(mesh, file).order == 1
    assert str(pair(mesh, file)) == "none"
    for other in (fm.VolumeMesh(1.1 * points, tets), fm.VolumeMesh(points, tets[:, [1, 0, 3, 2]])):
        assert pair(mesh, other).order == 1
    for change in ({"path": tmp_path / "b.msh"}, {"scale": 1.0}, {"region": None}):
        assert pair(file, replace(file, **change)).order == 1
    assert len(pair(mesh, file).limits) == 2
    assert "is a mesh" in pair(mesh, file).limits[0]
    alone = find_symmetry(device(coils=COILS))
    (identity,) = alone.operations
    assert (identity.coils, identity.coil_signs, identity.bodies) == ((0, 1, 2), (1, 1, 1), ())
    assert np.array_equal(identity(points), points)
    assert alone.limits == ("no iron",)


TILTED = np.array([0.6, 0.8, 0.0])
TILTED_MIRROR = np.eye(3) - 2.0 * np.outer(TILTED, TILTED)


@pytest.mark.parametrize(
    ("matrix", "offset", "name"),
    [
        (turn([0, 0, 1], 90.0), 0 * X, "rotation by 90 deg about axis z"),
        (turn([0, 0, -1], 90.0), 0 * X, "rotation by 270 deg about axis z"),
        (turn([0, 1, 0], -60.0), 0 * X, "rotation by 300 deg about axis y"),
        (turn([1, 1, 1], 120.0), 0 * X, "rotation by 120 deg about axis (0.5774, 0.5774, 0.5774)"),
        (-turn([1, 0, 0], 90.0), 0 * X, "rotation by 90 deg about axis x with inversion"),
        (-np.eye(3), 0 * X, "inversion"),
        (TILTED_MIRROR, 0 * X, "mirror 0.6 x +0.8 y = 0 mm"),
        # The mirror plane lies at 7 mm along the normal.
        (TILTED_MIRROR, 2 * 0.007 * TILTED, "mirror 0.6 x +0.8 y = 7 mm"),
        (np.diag([1.0, -1.0, 1.0]), 0.01 * Y, "mirror y = 5 mm"),
    ],
)
def test_names_of_operations(matrix, offset, name):
    assert str(Operation(matrix, offset, (), (), (), True)) == name


def test_names_of_groups():
    axis = ", ".join(f"{value:.4g}" for value in SKEW.rotation[:, 2])
    for shape, place, name in (
        (LEANING, fm.Placement(), "inversion"),
        (pyramid(0, 0, 1), fm.Placement(), "4-fold axis z with 4 mirror planes"),
        (pyramid(0, 0, 1), SKEW, f"4-fold axis ({axis}) with 4 mirror planes"),
        (pyramid(0.5, 0, 1), fm.Placement(), "mirror y = 0"),
    ):
        assert str(find_symmetry(device(body((shape, place))))) == name


def test_what_is_nearly_a_group_is_made_one():
    """The eight operations of a square, each off by 1e-8; three of them, or one twice, are no group."""
    square = [turn([0, 0, 1], 90.0 * k) @ np.diag([s, 1, 1]) for s in (1, -1) for k in range(4)]
    noise = np.random.default_rng(3).uniform(-1e-8, 1e-8, (8, 3, 3))
    noise[0] = 0.0
    exact = exact_matrices(np.array(square) + noise)
    assert exact == pytest.approx(np.array(square), abs=1e-7)
    products = np.einsum("aij,bjk->abik", exact, exact)
    assert np.abs(products - exact[multiplication_table(exact)]).max() < 2e-15
    assert exact_matrices(np.array(square[:3])) is None
    assert exact_matrices(np.array([square[0], square[2], square[2]])) is None


def test_equal_symmetries_are_equal_to_the_byte():
    """Zeros of either sign are equal numbers, but netgen meshes a wall otherwise if the sign of a zero differs. How an
    operation is computed depends on the rest of the group."""
    devices = [device(body((shape,))) for shape in (fm.Box((0.01, 0.02, 0.03)), fm.Cylinder(0.01, 0.02))]
    groups = [
        find_symmetry(one).operations
        for one in (*devices, device(*ring_of(6, 0.03)), device(*ring_of(4, 0.03)))
    ]
    mirrors = [next(one for one in group if str(one) == "mirror y = 0") for group in groups]
    assert {(one.matrix.tobytes(), one.offset.tobytes()) for one in mirrors} == {
        (np.diag([1.0, -1.0, 1.0]).tobytes(), np.zeros(3).tobytes())
    }
    numbers = np.concatenate([np.append(one.matrix, one.offset) for group in groups for one in group])
    assert np.signbit(numbers).tolist() == (numbers < 0).tolist()


def test_the_matrices_form_a_group_to_rounding():
    group = find_symmetry(fm.read_device("disk_six_cores"))
    table = multiplication_table(group.matrices)
    products = np.einsum("aij,bjk->abik", group.matrices, group.matrices)
    assert np.abs(products - group.matrices[table]).max() < 1e-15
    assert np.abs(group.matrices @ np.swapaxes(group.matrices, 1, 2) - np.eye(3)).max() < 1e-15
    # Cosines and sines of multiples of 60 degrees are the nearest floating-point numbers.
    assert set(np.abs(group.matrices).ravel()) == {0.0, 0.5, 1.0, np.sqrt(0.75)}


@pytest.mark.parametrize(("count", "order"), [(2, 8), (3, 12), (5, 20), (6, 24)])
def test_rings_of_cylinders(count, order):
    group = find_symmetry(device(*ring_of(count, 0.03)))
    assert group.order == order  # D_nh
    assert str(group).startswith(f"{count}-fold axis z") or count == 2


def test_a_pinwheel_has_rotations_and_no_upright_mirror():
    """Boxes turned by 20 degrees out of the radial direction: C4h."""
    blade = fm.Box((0.02, 0.004, 0.01))
    turns = [(turn(Z, angle), turn(Z, angle + 20)) for angle in (0, 90, 180, 270)]
    bodies = [body((blade, fm.Placement(out @ [0.03, 0, 0], along))) for out, along in turns]
    group = find_symmetry(device(*bodies))
    assert group.order == 8
    assert sum(operation.is_mirror for operation in group.operations) == 1


def test_material_size_and_place_of_one_body_break_the_symmetry():
    bodies = ring_of(6, 0.03)
    assert find_symmetry(device(*bodies)).order == 24
    other = replace(bodies[0], material="steel")
    assert find_symmetry(device(other, *bodies[1:])).order == 4  # C2v: y = 0 and the plane half way up
    finer = replace(bodies[0], mesh_size=0.004)
    assert find_symmetry(device(finer, *bodies[1:])).order == 4
    moved = body((fm.Cylinder(0.005, 0.02), fm.Placement(np.array([0.03001, 0, 0]))))
    assert find_symmetry(device(moved, *bodies[1:])).order == 4
    rounded = body((fm.Cylinder(0.005, 0.02), fm.Placement(np.array([0.03 + 2e-9, 0, 0]))))
    assert find_symmetry(device(rounded, *bodies[1:])).order == 24


def test_order_of_parts_counts_only_between_adding_and_cutting():
    hole = fm.Part(fm.Cylinder(0.002, 0.01), fm.Placement(np.array([0.006, 0, 0])), "cut")
    twin = fm.Part(fm.Cylinder(0.002, 0.01), fm.Placement(np.array([-0.006, 0, 0])), "cut")
    plate = fm.Part(fm.Box((0.03, 0.02, 0.01)))
    both = fm.Body("b", "iron", (plate, hole, twin), 0.005)
    assert find_symmetry(device(both)).order == 8
    filled = fm.Body("b", "iron", (plate, hole, twin, fm.Part(hole.shape, hole.placement)), 0.005)
    assert find_symmetry(device(filled)).order == 4


def test_step_bodies_have_no_symmetry_of_their_own(tmp_path):
    solid = fm.StepFile(tmp_path / "solid.step", 1e-3)
    group = find_symmetry(device(body((solid, fm.Placement()))))
    assert group.order == 1
    assert "STEP" in group.limits[0]
    turns = [turn(Z, angle) for angle in (0, 120, 240)]
    three = [body((solid, fm.Placement(out @ [0.03, 0, 0], out))) for out in turns]
    assert str(find_symmetry(device(*three))) == "3-fold axis z"


COILS = (
    fm.CircularCoil("round", 0.01, 0.012, 0.01, 100, placement=SKEW),
    fm.RoundedRectangleCoil(
        "square", 0.01, 0.006, 0.004, 0.002, 0.01, 50, -1, fm.Placement(np.array([0, 0.05, 0]))
    ),
    fm.PathCoil("path", np.array([[0, 0], [2, 0], [0, 1]]) * 0.01, 0.002, 0.001, 0.01, 70),
)


def test_coils_and_the_sense_of_their_currents_against_their_fields():
    """An operation carries a coil's field onto the field of the coil's image: B is an axial vector field."""
    mirror = np.diag([-1.0, 1.0, 1.0])
    coils = []
    for coil in COILS:
        place = coil.placement
        # The mirror image, with the frame made right-handed by reversing the local x axis.
        frame = mirror @ place.rotation @ mirror
        extra = {"corners": coil.corners[::-1] * [-1.0, 1.0]} if isinstance(coil, fm.PathCoil) else {}
        image = replace(coil, placement=fm.Placement(mirror @ place.position + [0.4, 0, 0], frame), **extra)
        coils += [coil, replace(image, name=coil.name + " image")]
    bodies = [body((fm.Sphere(0.003), fm.Placement(np.array([x, 0.03, 0.001])))) for x in (0.1, 0.3)]
    iron = [*bodies, body((fm.Box((0.01, 0.02, 0.03)), fm.Placement(np.array([0.2, 0, 0]))))]
    group = find_symmetry(device(*iron, coils=coils))
    assert str(group) == "mirror x = 200 mm"
    points = np.random.default_rng(1).uniform(-0.05, 0.05, (20, 3)) + [0.1, 0, 0.1]
    operation = group.operations[1]
    assert operation.coils == (1, 0, 3, 2, 5, 4)
    for coil, image, sign in zip(coils, operation.coils, operation.coil_signs, strict=True):
        there = unit_flux_density(coils[image], operation(points))
        moved = operation.handedness * unit_flux_density(coil, points) @ operation.matrix.T
        assert sign * there == pytest.approx(moved, rel=1e-9, abs=1e-12)


def test_shipped_devices():
    unit = find_symmetry(fm.read_device("drive_unit"))
    assert str(unit) == "mirror y = 0"
    names = fm.read_device("drive_unit").coil_names
    assert [names[k] for k in unit.operations[1].coils] == ["3", "2", "1", "6", "5", "4"]
    assert unit.operations[1].coil_signs == (-1,) * 6
    cores = find_symmetry(fm.read_device("disk_six_cores"))
    assert re.findall(r"\d+", str(cores)) == ["6", "6"]
    assert cores.order == 12
    # The square windings are not turned about the axis with the cores: a third of the operations maps them.
    assert sum(operation.coils is not None for operation in cores.operations) == 4


def kept(bodies, **more):
    """The operations of a device that keep the field of its magnets and background."""
    made = replace(device(*bodies), **more)
    return {str(operation) for operation in find_symmetry(made).operations if operation.keeps_magnets}


def test_remanence_and_background_are_axial_vectors():
    up, down = (fm.PermanentMagnet(name, z * Z, 1.05) for name, z in (("up", 1.0), ("down", -1.0)))
    laws = {"up": up, "down": down}
    blocks = [
        body((fm.Box((0.01, 0.02, 0.03)), fm.placed((x, 0, 0))), material=m, name=m)
        for x, m in ((0.02, "up"), (-0.02, "down"))
    ]
    assert find_symmetry(replace(device(*blocks), materials=laws)).order == 8
    # Kept: operations that exchange the blocks and reverse a moment along z, and operations that do neither.
    expected = {"identity", "mirror x = 0", "mirror z = 15 mm", "rotation by 180 deg about axis y"}
    assert kept(blocks, materials=laws) == expected
    alike = [blocks[0], replace(blocks[1], material="up")]
    expected = {"identity", "mirror z = 15 mm", "rotation by 180 deg about axis z", "inversion"}
    assert kept(alike, materials=laws) == expected
    # Bodies without remanence keep the symmetry of the shapes.
    assert len(kept(ring_of(4, 0.03))) == 16
    block = body((fm.Box((0.01, 0.02, 0.03)), fm.placed((0.0, 0.0, -0.015))))
    expected = {"identity", "mirror z = 0", "rotation by 180 deg about axis z", "inversion"}
    assert kept([block], background=fm.Background(0.1 * Z)) == expected
