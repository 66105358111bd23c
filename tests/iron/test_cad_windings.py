"""Windings as solids: their volume against Pappus's rule, their extent, and windings that are refused."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.iron.geometry.shapes import winding_solid, workspace_solid

# The rounded-square coil of thesis Appendix A-3 (RACE elements): half-width 16 mm, corner radius 15 mm.
A3 = fm.RoundedRectangleCoil("5", 0.016, 0.016, 0.015, 0.010, 0.039, 840)


def square_path(corners, radius=0.004, thickness=0.004, height=0.01) -> fm.PathCoil:
    return fm.PathCoil("path", np.array(corners) * 1e-3, radius, thickness, height, 100)


def extent(solid) -> np.ndarray:
    lower, upper = solid.bounding_box
    return np.array([[lower.x, lower.y, lower.z], [upper.x, upper.y, upper.z]])


def test_circular_winding_is_a_ring_centred_on_its_place():
    coil = fm.CircularCoil(
        "c", 0.011, 0.021, 0.039, 840, placement=fm.Placement(np.array([0.044, 0.0, 0.026]))
    )
    solid = winding_solid(coil)
    assert solid.mass == pytest.approx(np.pi * (21**2 - 11**2) * 39, rel=1e-9)
    assert extent(solid) == pytest.approx(np.array([[23, -21, 6.5], [65, 21, 45.5]]), abs=1e-5)


def test_rounded_square_winding_has_section_times_middle_line():
    # Middle line: four straight pieces of 2 (16 - 15) mm and a full circle of radius 15 mm.
    length = 4 * 2.0 + 2 * np.pi * 15
    solid = winding_solid(A3)
    assert solid.mass == pytest.approx(length * 10 * 39, rel=1e-9)
    assert extent(solid) == pytest.approx(np.array([[-21, -21, -19.5], [21, 21, 19.5]]), abs=1e-5)


@pytest.mark.parametrize("scale", [1.0, 1e-2])
@pytest.mark.parametrize("order", [1, -1])
def test_a_path_with_an_inward_corner_has_section_times_middle_line(order, scale):
    """An L of sides 40, 20, 20, 20, 20, 40 mm: five left turns and one right turn of 90 degrees. At a hundredth of the
    size it keeps all its edges too."""
    corners = scale * np.array([[0, 0], [40, 0], [40, 20], [20, 20], [20, 40], [0, 40]])[::order]
    length = 160 - 6 * 2 * 4 + 6 * np.pi / 2 * 4
    coil = square_path(corners, scale * 0.004, scale * 0.004, scale * 0.01)
    assert winding_solid(coil).mass == pytest.approx(length * 4 * 10 * scale**3, rel=1e-9)


def test_corners_as_tight_as_the_winding_is_wide_close_to_a_point_inside():
    # corner_radius = thickness / 2: the inner outline is a plain rectangle.
    coil = fm.RoundedRectangleCoil("c", 0.02, 0.01, 0.002, 0.004, 0.005, 10)
    length = 2 * (40 + 20) - 4 * 2 * 2 + 2 * np.pi * 2
    assert winding_solid(coil).mass == pytest.approx(length * 4 * 5, rel=1e-9)


@pytest.mark.parametrize(
    ("half", "straight"), [((0.02, 0.02), 0.0), ((0.03, 0.02), 40.0), ((0.02, 0.03), 40.0)]
)
def test_windings_of_arcs_alone_and_of_arcs_that_follow_each_other(half, straight):
    """Corners as wide as the winding: a ring, and a stadium with two straight sides of 20 mm."""
    solid = winding_solid(fm.RoundedRectangleCoil("c", *half, 0.02, 0.004, 0.005, 10))
    assert solid.mass == pytest.approx((2 * np.pi * 20 + straight) * 4 * 5, rel=1e-9)
    reach = 1e3 * np.array(half) + 2
    assert extent(solid)[:, :2] == pytest.approx(np.array([-reach, reach]), abs=1e-4)


def test_a_turned_winding_stands_where_its_placement_says():
    on_its_side = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    coil = fm.RoundedRectangleCoil(
        "c", 0.02, 0.01, 0.004, 0.004, 0.006, 10, placement=fm.Placement(np.array([0.1, 0, 0]), on_its_side)
    )
    expected = np.array([[100 - 22, -3, -12], [100 + 22, 3, 12]])
    assert extent(winding_solid(coil)) == pytest.approx(expected, abs=1e-5)
    assert {piece.name for piece in winding_solid(coil).solids} == {"c"}


def keyhole(slot: float) -> fm.PathCoil:
    """A path around a keyhole whose slot is `slot` mm wide; the winding is 4 mm thick."""
    left, right = 23 - slot / 2, 23 + slot / 2
    outside = [[0, 60], [0, 0], [46, 0], [46, 60]]
    inside = [[right, 60], [right, 40], [35, 40], [35, 20], [11, 20], [11, 40], [left, 40], [left, 60]]
    return square_path(outside + inside, radius=2.0e-3)


def test_turns_must_not_run_into_each_other():
    assert len(winding_solid(keyhole(4.5)).solids) == 1
    with pytest.raises(ValueError, match="turns"):
        winding_solid(keyhole(3.0))


@pytest.mark.parametrize(
    ("coil", "word"),
    [
        (fm.RoundedRectangleCoil("c", 0.02, 0.02, 0.004, 0.010, 0.01, 1), "corner_radius"),
        (fm.RoundedRectangleCoil("c", 0.02, 0.01, 0.015, 0.010, 0.01, 1), "edge"),
        (fm.CircularCoil("c", 0.02, 0.01, 0.01, 1), "radius"),
        (square_path([[0, 0], [40, 40], [40, 0], [0, 40]]), "line"),
        (square_path([[0, 0], [40, 0], [40, 40], [0, 40]], thickness=0.0), "thickness"),
        (square_path([[0, 0], [np.nan, 0], [40, 40], [0, 40]]), "finite"),
    ],
)
def test_windings_that_cannot_be_wound_are_refused(coil, word):
    with pytest.raises(ValueError, match=word):
        winding_solid(coil)


def test_workspaces():
    box = fm.WorkspaceBox(np.array([-0.02, -0.03, -0.11]), np.array([0.02, 0.03, -0.07]))
    assert workspace_solid(box).mass == pytest.approx(40 * 60 * 40)
    assert extent(workspace_solid(box)) == pytest.approx(
        np.array([[-20, -30, -110], [20, 30, -70]]), abs=1e-5
    )
    cylinder = fm.WorkspaceCylinder(np.array([0.01, 0.0, -0.11]), 0.02, 0.04)
    assert workspace_solid(cylinder).mass == pytest.approx(np.pi * 400 * 40)
    assert workspace_solid(cylinder).center.z == pytest.approx(-90)
    with pytest.raises(ValueError, match="zero"):
        workspace_solid(fm.WorkspaceBox(box.upper, box.lower))
