"""Bodies glued together: shared faces, kept volumes and names, and groups of bodies that touch."""

import numpy as np
import pytest
from netgen.occ import OCCGeometry

from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Placement, Sphere
from fieldmap.errors import GeometryError
from fieldmap.iron.geometry.solids import glue_bodies


def at(x: float, y: float, z: float) -> Placement:
    return Placement(np.array([x, y, z]) * 1e-3)


def body(name: str, shape, x: float = 0, y: float = 0, z: float = 0, mesh_size: float = 0.005) -> Body:
    return Body(name, "iron", (Part(shape, at(x, y, z)),), mesh_size)


def device(*bodies: Body) -> Device:
    return Device.unchecked(name="d", coils=(), bodies=bodies)


DISK = body("disk", Cylinder(0.066, 0.006), mesh_size=0.012)
CORE = body("core", Cylinder(0.010, 0.040), 44, 0, 6, mesh_size=0.006)
BALL = body("ball", Sphere(0.010), 0, 0, -50)
CUBE = Box((0.010, 0.010, 0.010))


def faces_of(glued, name):
    return {face for solid in glued.solids if solid.name == name for face in solid.faces}


def test_a_core_on_a_disk_shares_its_end_face_with_it():
    glued = glue_bodies(device(DISK, CORE))
    shared = faces_of(glued, "disk") & faces_of(glued, "core")
    assert [face.mass for face in shared] == pytest.approx([np.pi * 100])
    volumes = {solid.name: solid.mass for solid in glued.solids}
    assert volumes == pytest.approx({"disk": np.pi * 66**2 * 6, "core": np.pi * 100 * 40}, rel=1e-9)
    assert {solid.name: solid.maxh for solid in glued.solids} == {"disk": 12.0, "core": 6.0}


def test_coplanar_faces_of_two_bodies_are_not_merged():
    glued = glue_bodies(device(body("a", CUBE), body("b", CUBE, 10)))
    # Two cubes: six faces each, one of them shared; merged across bodies there would be fewer.
    assert len(faces_of(glued, "a") | faces_of(glued, "b")) == 11


def test_the_mesher_gives_each_body_its_own_region_and_shares_points_at_the_contact():
    mesh = OCCGeometry(glue_bodies(device(DISK, CORE))).GenerateMesh(maxh=12.0)
    elements = mesh.Elements3D().NumPy()
    names = np.array([mesh.GetMaterial(i + 1) for i in range(2)])[elements["index"] - 1]
    points = np.array([point.p for point in mesh.Points()])
    corners = points[elements["nodes"][:, :4].astype(int) - 1]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    # Straight-sided tetrahedra lie inside the circles: less volume, by the sagitta of the chords.
    for name, volume in (("disk", np.pi * 66**2 * 6), ("core", np.pi * 100 * 40)):
        assert 0.9 * volume < volumes[names == name].sum() <= volume * (1 + 1e-9)
    used = {name: set(elements["nodes"][names == name][:, :4].ravel()) for name in ("disk", "core")}
    common = points[np.array(sorted(used["disk"] & used["core"])) - 1]
    assert len(common) >= 6
    assert np.abs(common[:, 2] - 6).max() < 1e-9
    assert np.hypot(common[:, 0] - 44, common[:, 1]).max() < 10 + 1e-6


def touching_bodies(of):
    """Sets of bodies that share faces, directly or through others."""
    glued, groups = glue_bodies(of), []
    for name in (body.name for body in of.bodies):
        mine = {name: faces_of(glued, name)}
        for group in [group for group in groups if any(faces & mine[name] for faces in group.values())]:
            groups.remove(group)
            mine |= group
        groups.append(mine)
    return {frozenset(group) for group in groups}


def test_bodies_that_touch_through_others_are_one_magnetic_body():
    chain = device(body("left", CUBE, 0), BALL, body("right", CUBE, 20), body("middle", CUBE, 10))
    assert touching_bodies(chain) == {frozenset(("left", "right", "middle")), frozenset(("ball",))}


def test_bodies_apart_or_in_edge_contact_stay_separate():
    apart = {frozenset("a"), frozenset("b")}
    assert touching_bodies(device(body("a", CUBE), body("b", CUBE, 10, 10))) == apart
    assert touching_bodies(device(body("a", CUBE), body("b", CUBE, 11))) == apart


def test_a_device_of_coils_alone_has_nothing_to_glue():
    with pytest.raises(GeometryError, match="body"):
        glue_bodies(device())
