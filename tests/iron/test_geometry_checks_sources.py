"""Currents and magnets in air are refused by their place relative to bodies and workspace."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.constants import MU0
from fieldmap.device.air_sources import NEEDS, OTHER, AirSource
from fieldmap.errors import GeometryError
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes

J = np.array([0.0, 0.0, 1.0])
CORNERS = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]]) * 1e-3
STRIP = np.array([[0.0, 0, 0], [0, 3, 0], [3, 0, 0], [3, 3, 1]]) * 1e-3
FACES = np.array([[0, 1, 2], [1, 2, 3]])
HULL = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
# One of each kind, all within 5 mm of the origin.
SOURCES = {
    "Circle": {"current": 1.0, "diameter": 6e-3},
    "Polyline": {"current": 1.0, "vertices": STRIP[[0, 1, 1, 3]]},
    "TriangleStrip": {"current": 1.0, "vertices": STRIP},
    "TriangleSheet": {"current_densities": np.ones((2, 3)), "vertices": STRIP, "faces": FACES},
    "Cuboid": {"dimension": np.array([3e-3, 4e-3, 5e-3]), "polarization": J},
    "Cylinder": {"dimension": np.array([4e-3, 5e-3]), "polarization": J},
    "CylinderSegment": {
        "dimension": np.array([2e-3, 4e-3, 5e-3]),
        "angles": np.array([10.0, 130.0]),
        "polarization": J,
    },
    "Sphere": {"diameter": 5e-3, "polarization": J},
    "Tetrahedron": {"vertices": CORNERS, "polarization": J},
    "TriangularMesh": {"vertices": CORNERS, "faces": HULL, "polarization": J},
    "Triangle": {"vertices": CORNERS[:3], "polarization": J},
    "Dipole": {"moment": J},
}
CURRENTS = ("Circle", "Polyline", "TriangleStrip", "TriangleSheet")


def source(kind: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> AirSource:
    return AirSource(kind, fm.Placement(1e-3 * np.array([x, y, z])), **SOURCES[kind])


def body(shape, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> fm.Body:
    return fm.Body("iron", "iron", (fm.Part(shape, fm.Placement(1e-3 * np.array([x, y, z]))),), 0.01)


def device(*sources: AirSource, bodies=(), workspace=None, frame=None) -> fm.Device:
    """Sources with currents become coils in a frame of their own; the others become the background."""
    driven = [one for one in sources if one.kind in CURRENTS]
    fixed = tuple(one for one in sources if one.kind not in CURRENTS)
    return fm.Device.unchecked(
        name="d",
        coils=tuple(
            fm.MagpylibCoil(f"c{k}", (one,), placement=frame or fm.Placement())
            for k, one in enumerate(driven)
        ),
        bodies=bodies,
        materials={"iron": fm.LinearMaterial("iron", 100.0)},
        workspace=workspace,
        background=fm.Background(sources=fixed) if fixed else None,
    )


def refused(machine: fm.Device) -> list[str]:
    """The places that the problems name."""
    try:
        check_geometry(machine)
    except GeometryError as error:
        return [one.where for one in error.problems]
    return []


BALL = body(fm.Sphere(0.02))
# A slit of 12 mm: all sources fit into it.
SLIT = fm.Body(
    "iron",
    "iron",
    (fm.Part(fm.Sphere(0.02)), fm.Part(fm.Box((0.05, 0.012, 0.05)), fm.Placement([0, 0, -0.025]), "cut")),
    0.01,
)


def test_every_kind_is_tried():
    assert set(SOURCES) == set(NEEDS)


@pytest.mark.parametrize("kind", SOURCES)
def test_a_source_in_a_body_is_refused(kind):
    """The source is wholly inside the body, or half way through its surface."""
    owner = "coil 'c0'" if kind in CURRENTS else "the background"
    said = [f"device 'd': source 1 ({kind}) of {owner} and body 'iron'"]
    assert refused(device(source(kind), bodies=(BALL,))) == said
    if kind != "Dipole":
        assert refused(device(source(kind, 18.5), bodies=(BALL,))) == said


@pytest.mark.parametrize("kind", SOURCES)
def test_a_source_beside_a_body_or_in_its_slit_is_sound(kind):
    assert refused(device(source(kind, 26), bodies=(BALL,))) == []
    assert refused(device(source(kind), bodies=(SLIT,))) == []


@pytest.mark.parametrize("kind", SOURCES)
def test_a_source_in_the_workspace_is_refused(kind):
    """Field and gradient of a map are taken to be smooth in the workspace, with or without iron."""
    box = fm.WorkspaceBox([-0.02, -0.02, -0.02], [0.02, 0.02, 0.02])
    owner = "coil 'c0'" if kind in CURRENTS else "the background"
    assert refused(device(source(kind), workspace=box)) == [
        f"device 'd': workspace and source 1 ({kind}) of {owner}"
    ]
    assert refused(device(source(kind, 26), workspace=box)) == []


def test_the_frame_of_a_coil_moves_its_sources():
    """A quarter turn about y takes +z to +x, and the coil's place adds to it."""
    turned = fm.Placement(np.array([0.0, 0.03, 0.0]), np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))
    here = body(fm.Sphere(0.002), 26, 30, 0)
    assert len(refused(device(source("Polyline", 0, 0, 25), bodies=(here,), frame=turned))) == 1
    assert refused(device(source("Polyline", 0, 0, -25), bodies=(here,), frame=turned)) == []


def test_magnets_may_touch_and_wires_need_a_gap():
    """The field on a filament or sheet is infinite or has two values; the field on the outside of a magnet has one."""
    block = body(fm.Box((0.02, 0.02, 0.01)))
    assert refused(device(source("Cuboid", z=12.5), bodies=(block,))) == []
    assert len(refused(device(source("Cuboid", z=12.499), bodies=(block,)))) == 1
    for kind in ("Circle", "Triangle"):
        assert len(refused(device(source(kind, z=10.0), bodies=(block,)))) == 1
        assert len(refused(device(source(kind, z=10.0005), bodies=(block,)))) == 1
        assert refused(device(source(kind, z=10.002), bodies=(block,))) == []


def test_all_faults_at_once():
    machine = device(
        source("Circle"), source("Dipole"), source("Sphere"), source("Cuboid", 50), bodies=(BALL,)
    )
    assert [where.split(": ")[1].split(" and ")[0] for where in refused(machine)] == [
        "source 1 (Circle) of coil 'c0'",
        "source 1 (Dipole) of the background",
        "source 2 (Sphere) of the background",
    ]


def test_an_object_of_another_class_is_named_in_the_notes():
    """The checks cannot know where its currents flow."""
    machine = device(AirSource(OTHER, live=object()), bodies=(BALL,))
    assert refused(machine) == []
    (note,) = geometry_notes(machine)
    assert note.startswith("source 1 (other) of the background")
    assert geometry_notes(device(bodies=(BALL,))) == ()


def test_a_shape_that_is_no_shape_is_a_problem():
    open_mesh = replace(source("TriangularMesh", 26), faces=HULL[:3])
    assert refused(device(open_mesh, bodies=(BALL,))) == [
        "device 'd': source 1 (TriangularMesh) of the background"
    ]


def test_a_wire_through_the_hole_of_a_ring():
    """Ampere's law: H = I / (2 pi r) round the wire, and the mean of 1 / r is nearly 1 / r in the middle."""
    ring, far = body(fm.Ring(0.018, 0.022, 0.004)), 0.3
    loop = np.array([[0, 0, -far], [0, 0, far], [far, 0, far], [far, 0, -far], [0, 0, -far]])
    wire = AirSource("Polyline", current=1.0, vertices=loop)
    unit = fm.solve_linear(device(wire, bodies=(replace(ring, mesh_size=0.004),)))
    inside = unit.flux_density_samples([2.0])
    mean = inside.size @ inside.weight / inside.weight.sum()
    assert mean == pytest.approx(100 * MU0 * 2.0 / (2 * np.pi * 0.02), rel=0.01)
