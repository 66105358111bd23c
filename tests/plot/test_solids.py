"""Windings, bodies and pieces of payloads against volumes and extents in closed form."""

import numpy as np
import pytest
import pyvista as pv

import fieldmap as fm
from fieldmap.device.model import (
    Box,
    Cylinder,
    ExtrudedPolygon,
    Part,
    Placement,
    RevolvedProfile,
    Ring,
    Sphere,
)
from fieldmap.levitation.balance import upright_force
from fieldmap.plot.device_drawing import add_payload
from fieldmap.plot.solids import (
    body_surface,
    current_arrow,
    middle_line,
    payload_surface,
    sensor_arrow,
    sharp_edges,
    winding_surface,
    workspace_outline,
)
from tests.plot.conftest import Harmonic

TRIANGLE = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.02]])
L_SHAPE = np.array([[0.0, 0.0], [0.03, 0.0], [0.03, 0.01], [0.01, 0.01], [0.01, 0.03], [0.0, 0.03]])
CONE = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.03]])
TURN = Placement(np.array([0.01, 0.02, -0.03]), np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))


def one_body(*parts):
    body = fm.Body("piece", "iron", parts, mesh_size=0.004)
    return fm.Device("d", "", (), (body,), {"iron": fm.LinearMaterial("iron", 1000.0)}), body


@pytest.mark.parametrize(
    ("shape", "volume", "ends"),
    [
        (Cylinder(0.01, 0.02), np.pi * 10**2 * 20, [-10, 10, -10, 10, 0, 20]),
        (Ring(0.005, 0.01, 0.02), np.pi * 75 * 20, [-10, 10, -10, 10, 0, 20]),
        (Box((0.01, 0.02, 0.03)), 6000.0, [-5, 5, -10, 10, 0, 30]),
        (Sphere(0.01), 4 / 3 * np.pi * 10**3, [-10, 10, -10, 10, -10, 10]),
        (ExtrudedPolygon(TRIANGLE, 0.01), 2000.0, [0, 20, 0, 20, 0, 10]),
        (ExtrudedPolygon(L_SHAPE, 0.01), 5000.0, [0, 30, 0, 30, 0, 10]),
        (RevolvedProfile(CONE), np.pi * 10**2 * 30 / 3, [-10, 10, -10, 10, 0, 30]),
    ],
)
def test_volume_and_place_of_shapes(shape, volume, ends):
    device, body = one_body(Part(shape, TURN))
    surface = body_surface(device, body)
    # Circles are polygons of 96 sides: 0.07 % less area; the sphere's meridian is coarser: 0.4 %.
    assert abs(surface.volume) == pytest.approx(volume, rel=5e-3)
    upright = body_surface(*one_body(Part(shape)))
    np.testing.assert_allclose(upright.bounds, ends, atol=0.02)
    assert surface.clean().n_open_edges == 0
    moved = upright.points @ TURN.rotation.T + 1e3 * TURN.position
    np.testing.assert_allclose(surface.bounds, pv.PolyData(moved).bounds, atol=1e-3)


def test_a_body_with_a_hole_is_meshed():
    hole = Part(Cylinder(0.004, 0.02), Placement(np.array([0.0, 0, -0.001])), "cut")
    device, body = one_body(Part(Box((0.02, 0.02, 0.01))), hole)
    surface = body_surface(device, body)
    assert surface.volume == pytest.approx(20 * 20 * 10 - np.pi * 16 * 10, rel=0.01)


def rounded_area(half_x, half_y, radius):
    return 4 * half_x * half_y - (4 - np.pi) * radius**2


@pytest.mark.parametrize(
    ("coil", "area", "height"),
    [
        (
            fm.RoundedRectangleCoil("c", 0.016, 0.012, 0.008, 0.01, 0.039, 840, placement=TURN),
            rounded_area(21, 17, 13) - rounded_area(11, 7, 3),
            39,
        ),
        (fm.CircularCoil("c", 0.01, 0.02, 0.03, 100), np.pi * (400 - 100), 30),
    ],
)
def test_volume_of_windings(coil, area, height):
    assert abs(winding_surface(coil).volume) == pytest.approx(area * height, rel=2e-3)


def test_windings_stand_about_their_place():
    ring = fm.CircularCoil("c", 0.006, 0.010, 0.008, 100).moved([0.03, 0.01, 0.02])
    np.testing.assert_allclose(winding_surface(ring).bounds, [20, 40, 0, 20, 16, 24], atol=0.01)
    frame = fm.RoundedRectangleCoil("c", 0.009, 0.006, 0.004, 0.002, 0.012, 50, placement=TURN)
    # The frame's axis is along x, and its x axis along z.
    np.testing.assert_allclose(winding_surface(frame).bounds, [4, 16, 13, 27, -40, -20], atol=0.01)


def test_a_path_with_an_inward_corner():
    """Pappus: the volume is the section times the length of the middle line."""
    coil = fm.PathCoil("c", 2 * L_SHAPE, 0.004, 0.004, 0.01, 10)
    # Six right-angled corners, each replacing 2 r by pi r / 2.
    length = 2 * (60 + 60) - 6 * (2 - np.pi / 2) * 4
    assert abs(winding_surface(coil).volume) == pytest.approx(length * 4 * 10, rel=1e-3)


def test_the_arrow_of_a_sensor_ends_in_its_place_and_points_along_its_axis():
    sensor = fm.FieldSensor("hall", [0.01, -0.02, 0.03], [2.0, -1.0, 2.0])
    points = np.asarray(sensor_arrow(sensor, 6.0).points, float) - [10.0, -20.0, 30.0]
    along = points @ np.array([2.0, -1.0, 2.0]) / 3.0
    assert (along.min(), along.max()) == pytest.approx((-6.0, 0.0), abs=1e-5)
    # The tip is a point; the cone is wider than the shaft.
    across = np.linalg.norm(points - along[:, None] * np.array([2.0, -1.0, 2.0]) / 3.0, axis=1)
    assert across[along > -1e-5] == pytest.approx(0.0, abs=1e-5)
    assert across[along > -3.0].max() > 2.0 * across[along < -5.0].max()


def test_the_arrow_follows_the_current():
    """Positive current runs counter-clockwise about the coil's axis; a negative polarity turns the arrow around."""
    for polarity in (1, -1):
        place = Placement(np.array([0.044, 0, 0]))
        coil = fm.RoundedRectangleCoil("c", 0.016, 0.016, 0.015, 0.01, 0.039, 840, polarity, place)
        arrow = current_arrow(coil)
        x_min, _, y_min, y_max, *_ = arrow.bounds
        assert x_min > 44  # on the side far from the axis
        # The cone is wider than the shaft, and is at the end in the current's direction: +y there.
        heights = arrow.points[np.abs(arrow.points[:, 2]) > 2.5]
        assert len(heights)
        assert np.sign(heights[:, 1].mean() - 0.5 * (y_min + y_max)) == polarity


@pytest.mark.parametrize("sense", [1, -1])
def test_the_arrow_of_a_current_covers_three_tenths_of_the_turn_about_its_outermost_place(sense):
    """0.6 mm off a ring of 10 mm radius at (30, 40) mm, at half its height of 20 mm; the cone, 0.216 of the height
    long, extends by half its length beyond the end of the path."""
    ring = fm.CircularCoil("c", 0.006, 0.010, 0.020, 100).moved([0.03, 0.04, 0.05])
    points = np.asarray(current_arrow(ring, sense).points, float) - [30.0, 40.0, 50.0]
    angle = np.rad2deg(np.arctan2(points[:, 1], points[:, 0])) - np.rad2deg(np.arctan2(40.0, 30.0))
    tail, tip = sense * np.min(sense * angle), sense * np.max(sense * angle)
    assert tail == pytest.approx(-sense * 54.0, abs=2.5)
    assert tip == pytest.approx(sense * (54.0 + np.rad2deg(0.5 * 0.216 * 20 / 10.6)), abs=2.5)
    away = np.hypot(points[:, 0], points[:, 1])[np.abs(angle) < 30.0]
    shaft = 0.25 * 0.09 * 20
    assert (away.min(), away.max()) == pytest.approx((10.6 - shaft, 10.6 + shaft), abs=0.05)
    assert np.abs(points[:, 2]).max() == pytest.approx(0.8 * 0.09 * 20, abs=0.05)


def test_an_arrow_along_straight_sides_covers_as_much_of_their_length():
    """A frame of 9 mm by 3 mm with corners of 1 mm: 0.3 of the turn 0.6 mm off its winding, 53.2 mm long."""
    frame = fm.RoundedRectangleCoil("c", 0.009, 0.003, 0.001, 0.001, 0.004, 50).moved([0.0, 0.05, 0.0])
    turn = 4 * (8 + 2) + 2 * np.pi * (1 + 0.5 + 0.6)
    points = np.asarray(current_arrow(frame).points, float) - [0.0, 50.0, 0.0]
    # About the middle of the corner at (9, 3), the first of the equally distant corners.
    assert np.ptp(points[:, 0]) + np.ptp(points[:, 1]) == pytest.approx(0.3 * turn, rel=0.2)
    assert points[:, 1].max() == pytest.approx(3 + 0.5 + 0.6, abs=0.4)


@pytest.mark.parametrize(
    ("payload", "ends"),
    [
        (fm.MagnetCylinder(0.004, 0.01, 1.2), [-2, 2, -2, 2, -5, 5]),
        (fm.MagnetSphere(0.006, 1.2), [-3, 3, -3, 3, -3, 3]),
        (fm.MagnetBlock((0.002, 0.004, 0.01), 1.2), [-1, 1, -2, 2, -5, 5]),
    ],
)
def test_magnets_stand_about_their_centre(payload, ends):
    np.testing.assert_allclose(payload_surface(fm.Payload(1e-3, magnet=payload)).bounds, ends, atol=0.03)


def test_outlines_of_workspaces():
    box = workspace_outline(fm.WorkspaceBox(np.array([-0.01, 0.02, -0.07]), np.array([0.03, 0.08, -0.03])))
    assert box.n_lines == 12
    np.testing.assert_allclose(box.bounds, [-10, 30, 20, 80, -70, -30])
    drum = workspace_outline(fm.WorkspaceCylinder(np.array([0.01, -0.02, -0.05]), 0.008, 0.03))
    np.testing.assert_allclose(drum.bounds, [2, 18, -28, -12, -50, -20], atol=0.02)
    # All points are on the two rims.
    assert set(np.asarray(drum.points)[:, 2].round(6)) == {-50.0, -20.0}
    np.testing.assert_allclose(np.hypot(drum.points[:, 0] - 10, drum.points[:, 1] + 20), 8.0, rtol=1e-5)
    assert drum.compute_cell_sizes()["Length"].sum() == pytest.approx(4 * np.pi * 8, rel=5e-3)


@pytest.mark.parametrize(
    ("options", "bend", "edges"), [((), 34, 0), ((), 36, 1), ((50.0,), 49, 0), ((50.0,), 51, 1)]
)
def test_edges_are_sharp_beyond_an_angle(options, bend, edges):
    turned = np.deg2rad(bend)
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1 + np.cos(turned), 0, np.sin(turned)]]
    points += [[1 + np.cos(turned), 1, np.sin(turned)]]
    folded = pv.PolyData(np.array(points, float), faces=[4, 0, 1, 2, 3, 4, 1, 4, 5, 2])
    assert sharp_edges(folded, *options).n_cells == edges


def test_the_middle_line_turns_counter_clockwise():
    line, normal = middle_line(fm.CircularCoil("c", 0.01, 0.02, 0.03, 100))
    x, y = line.T
    assert 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)


PAYLOAD = fm.Payload(
    1e-3,
    pieces=[
        fm.PayloadPiece(
            fm.SoftEllipsoid((2e-3, 2e-3, 6e-3), mu_r=100.0), fm.placed([0, 0, 4e-3], [90.0, 0, 0])
        ),
        fm.PayloadPiece(fm.MagnetCylinder(2e-3, 4e-3, 1.2), fm.placed([0.0, 0.0, -2e-3])),
    ],
)


def test_surfaces_of_pieces():
    surface = payload_surface(PAYLOAD)
    # The ellipsoid is along y, 3 to 5 mm above the centre; the cylinder is below it.
    np.testing.assert_allclose(surface.bounds, [-1, 1, -3, 3, -4, 5], atol=0.03)
    assert payload_surface(fm.Payload(1e-3, moment=0.1)) is None
    scene = pv.Plotter(off_screen=True)
    add_payload(scene, PAYLOAD, np.array([0.0, 0.0, -20.0]))
    np.testing.assert_allclose(scene.bounds, [-1, 1, -3, 3, -24, -15], atol=0.03)


def test_arrows_are_the_force_on_the_pieces():
    """In B = B0 + G x with 0.1 T and 1 T/m."""
    sphere, field = fm.Payload(1e-3, pieces=[fm.SoftSphere(4e-3, mu_r=1e8)]), Harmonic(0.1, 1.0, 0.0)
    force = upright_force(field, [1.0], sphere, np.zeros((1, 3)))
    exact = np.pi * 4e-3**3 / 2 / (4e-7 * np.pi) * 0.1
    np.testing.assert_allclose(force, [[0.0, 0.0, exact]], rtol=1e-6, atol=1e-15)
    assert upright_force(field, [1.0], sphere, np.zeros((2, 3))).shape == (2, 3)
