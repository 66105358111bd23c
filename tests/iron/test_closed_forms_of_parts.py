"""Parts of solvers and of geometry that have closed forms, without a solve."""

from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Background
from fieldmap.iron.geometry.contacts import Contact, NamedSolid, Overlap
from fieldmap.iron.geometry.thin_gaps import _moves
from fieldmap.iron.solvers.surface import _applied, _enclosed_area
from fieldmap.sources import CoilSet


def box_faces(size):
    """Outward triangles (12, 3, 3) of a box about the origin."""
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            corners = np.zeros((4, 3))
            corners[:, axis] = side
            corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = [-1, 1, 1, -1], [-1, -1, 1, 1]
            quad = corners if side > 0 else corners[::-1]
            faces += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    return 0.5 * np.array(faces) * size


@pytest.mark.parametrize(
    ("normal", "at", "area"),
    [
        ([0.0, 0.0, 1.0], 0.01, 2.0 * 3.0),
        ([0.0, 0.0, -1.0], 0.01, 2.0 * 3.0),
        ([0.0, 1.0, 0.0], -0.7, 2.0 * 4.0),
        # At 45 degrees to x the section is sqrt(2) times 3 by the shorter side, and near an edge a narrow strip.
        ([np.sqrt(0.5), 0.0, np.sqrt(0.5)], 0.3, 2.0 * np.sqrt(2.0) * 3.0),
        ([np.sqrt(0.5), 0.0, np.sqrt(0.5)], 3.0 * np.sqrt(0.5) - 0.5, 2.0 * 0.5 * 3.0),
        ([1.0, 0.0, 0.0], 1.1, 0.0),
    ],
)
def test_the_area_of_a_plane_in_a_closed_surface(normal, at, area):
    corners, normal = box_faces([2.0, 3.0, 4.0]), np.array(normal)
    moved = corners + [5.0, -6.0, 7.0]
    assert _enclosed_area(moved, corners @ normal - at, normal) == pytest.approx(area, rel=1e-9)


def test_a_hole_counts_less():
    """A box with a box taken out of it, whose faces look inward."""
    corners = np.concatenate([box_faces([2.0, 3.0, 4.0]), box_faces([1.0, 0.5, 2.0])[:, ::-1]])
    normal = np.array([0.0, 0.0, 1.0])
    assert _enclosed_area(corners, corners @ normal - 0.1, normal) == pytest.approx(6.0 - 0.5)


def test_fields_that_are_applied_to_iron():
    coils = [fm.CircularCoil(name, 0.01, 0.012, 0.01, 100) for name in ("a", "b")]
    coils[1] = coils[1].moved([0.02, 0.0, 0.01])
    x, background = np.array([[0.0, 0.0, 0.03], [0.01, 0.02, 0.04]]), Background(np.array([1.0, 2.0, 3.0]))
    found = _applied(coils, background, 3, x)
    unit = CoilSet(tuple(coils))
    np.testing.assert_allclose(found[0], unit.field(x, [1.0, 0.0]), rtol=1e-6)
    np.testing.assert_allclose(found[1], unit.field(x, [0.0, 1.0]), rtol=1e-6)
    np.testing.assert_array_equal(found[2], [[1.0, 2.0, 3.0]] * 2)
    np.testing.assert_array_equal(_applied(coils, None, 3, x)[2], np.zeros((2, 3)))


def test_bodies_move_towards_the_largest_piece():
    """Piece 0 has two bodies of volumes 1 and 2, pieces 1, 2 and 3 have one each. Piece 2 is the largest and stays;
    piece 0 closes its gap to piece 2, and piece 1 its gap to piece 0. Piece 3 has no gap."""
    volume, piece = np.array([1.0, 2.0, 0.5, 9.0, 4.0]), np.array([0, 0, 1, 2, 3])
    x, y, z = np.eye(3)
    steps = {(0, 3): 0.1 * x, (1, 2): 0.2 * y}
    moves, closed = _moves(volume, piece, steps)
    # A step is the displacement of the second body relative to the first that closes their gap.
    np.testing.assert_allclose(moves, [-0.1 * x, -0.1 * x, -0.1 * x + 0.2 * y, 0 * x, 0 * x])
    assert closed == [(0, 3), (1, 2)]
    # Of three gaps in a ring of bodies one stays open.
    moves, closed = _moves(volume, piece, steps | {(2, 3): 0.3 * z})
    assert set(closed) < {*steps, (2, 3)}
    assert len(closed) == 2
    np.testing.assert_array_equal(moves[4], 0 * x)


def test_overlaps_and_contacts_in_words():
    one, other = (NamedSolid("body", name, None) for name in ("a", "b"))
    overlap = Overlap(one, other, 12.3456789, np.array([-1.0, -2e-8, 3.0000004]), np.array([1.5, 2.25, 4.0]))
    assert str(overlap) == "12.35 mm^3 in common, within x -1 to 1.5, y 0 to 2.25, z 3 to 4 mm"
    assert (str(one), str(NamedSolid("workspace", "", None))) == ("body 'a'", "workspace")
    assert str(Contact(one, other, 0.012345)) == "a gap of 0.0123 mm"
    assert "no gap" in str(Contact(one, other, 0.0))
    solid = SimpleNamespace(solids=[1], mass=2.5)
    assert (NamedSolid("body", "a", solid).has_volume, NamedSolid("body", "a", solid).volume) == (True, 2.5)
    assert not NamedSolid("body", "a", SimpleNamespace(solids=[])).has_volume
