"""Windings, bodies and pieces of payloads against volumes and extents known in closed form."""

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
from fieldmap.plot.device_drawing import add_payload
from fieldmap.plot.forces import magnetic_force
from fieldmap.plot.solids import body_surface, current_arrow, middle_line, payload_surface, winding_surface
from tests.plot.conftest import Harmonic

TRIANGLE = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.02]])
L_SHAPE = np.array([[0.0, 0.0], [0.03, 0.0], [0.03, 0.01], [0.01, 0.01], [0.01, 0.03], [0.0, 0.03]])
CONE = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.03]])
TURN = Placement(np.array([0.01, 0.02, -0.03]), np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))


def one_body(*parts):
    body = fm.Body("piece", "iron", parts, mesh_size=0.004)
    return fm.Device("d", "", (), (body,), {"iron": fm.LinearMaterial("iron", 1000.0)}), body


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Cylinder(0.01, 0.02), np.pi * 10**2 * 20),
        (Ring(0.005, 0.01, 0.02), np.pi * 75 * 20),
        (Box((0.01, 0.02, 0.03)), 6000.0),
        (Sphere(0.01), 4 / 3 * np.pi * 10**3),
        (ExtrudedPolygon(TRIANGLE, 0.01), 2000.0),
        (ExtrudedPolygon(L_SHAPE, 0.01), 5000.0),
        (RevolvedProfile(CONE), np.pi * 10**2 * 30 / 3),
    ],
)
def test_volume_and_place_of_shapes(shape, volume):
    device, body = one_body(Part(shape, TURN))
    surface = body_surface(device, body)
    # Circles are polygons of 96 sides: 0.07 % less area, the sphere's coarser meridian 0.4 %.
    assert abs(surface.volume) == pytest.approx(volume, rel=5e-3)
    upright = body_surface(*one_body(Part(shape)))
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


def test_a_path_with_an_inward_corner():
    """Pappus: the volume is the section times the length of the middle line."""
    coil = fm.PathCoil("c", 2 * L_SHAPE, 0.004, 0.004, 0.01, 10)
    # Six corners of a right angle, each replacing 2 r by pi r / 2.
    length = 2 * (60 + 60) - 6 * (2 - np.pi / 2) * 4
    assert abs(winding_surface(coil).volume) == pytest.approx(length * 4 * 10, rel=1e-3)


def test_the_arrow_follows_the_current():
    """Positive current runs counter-clockwise about the coil's axis; a negative polarity turns the arrow around."""
    for polarity in (1, -1):
        place = Placement(np.array([0.044, 0, 0]))
        coil = fm.RoundedRectangleCoil("c", 0.016, 0.016, 0.015, 0.01, 0.039, 840, polarity, place)
        arrow = current_arrow(coil)
        x_min, _, y_min, y_max, *_ = arrow.bounds
        assert x_min > 44  # on the side that faces away from the axis
        # The cone is wider than the shaft and stands at the end where the current goes to: +y there.
        heights = arrow.points[np.abs(arrow.points[:, 2]) > 2.5]
        assert len(heights)
        assert np.sign(heights[:, 1].mean() - 0.5 * (y_min + y_max)) == polarity


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
    # The ellipsoid lies along y, 3 to 5 mm above the centre; the cylinder stands below it.
    np.testing.assert_allclose(surface.bounds, [-1, 1, -3, 3, -4, 5], atol=0.03)
    assert payload_surface(fm.Payload(1e-3, moment=0.1)) is None
    scene = pv.Plotter(off_screen=True)
    add_payload(scene, PAYLOAD, np.array([0.0, 0.0, -20.0]))
    np.testing.assert_allclose(scene.bounds, [-1, 1, -3, 3, -24, -15], atol=0.03)


def test_arrows_are_the_force_on_the_pieces():
    """In B = B0 + G x of 0.1 T and 1 T/m."""
    sphere, field = fm.Payload(1e-3, pieces=[fm.SoftSphere(4e-3, mu_r=1e8)]), Harmonic(0.1, 1.0, 0.0)
    force = magnetic_force(field, [1.0], sphere, np.zeros((1, 3)))
    exact = np.pi * 4e-3**3 / 2 / (4e-7 * np.pi) * 0.1
    np.testing.assert_allclose(force, [[0.0, 0.0, exact]], rtol=1e-6, atol=1e-15)
    assert magnetic_force(field, [1.0], sphere, np.zeros((2, 3))).shape == (2, 3)
