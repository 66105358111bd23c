"""Shapes of coils: each is in a file of its own; the winding is a closed curve of arcs and bars."""

import inspect
from pathlib import Path

import numpy as np
import pytest

import fieldmap
from fieldmap.device import coils
from fieldmap.device.coils import COIL_KEYS, Coil
from fieldmap.device.coils.winding import arc, bar, rounded_path, winding_path
from fieldmap.device.model import CircularCoil, PathCoil, RoundedRectangleCoil
from fieldmap.errors import InputError
from fieldmap.kernels.coils.path import path_flux_density

PACKAGE = Path(fieldmap.__file__).parent
FOLDER = Path(coils.__file__).parent
L_SHAPE = np.array([[0, 0], [0.06, 0], [0.06, 0.03], [0.03, 0.03], [0.03, 0.07], [0, 0.07]])
COILS = [
    (CircularCoil("c", 0.01, 0.02, 0.03, 100), 2 * np.pi * 0.015),
    (RoundedRectangleCoil("r", 0.03, 0.02, 0.006, 0.008, 0.02, 100), 0.2 - 8 * 0.006 + 2 * np.pi * 0.006),
    (PathCoil("p", L_SHAPE, 0.006, 0.008, 0.01, 50), 0.26 - 12 * 0.006 + 3 * np.pi * 0.006),
    (PathCoil("back", L_SHAPE[::-1], 0.006, 0.008, 0.01, 50), 0.26 - 12 * 0.006 + 3 * np.pi * 0.006),
]


def test_kinds_of_file_and_of_python_are_the_same():
    shapes = [shape for shape in Coil.__subclasses__() if FOLDER in Path(inspect.getfile(shape)).parents]
    assert {kind: keys.makes for kind, keys in COIL_KEYS.items()} == {shape.kind: shape for shape in shapes}
    assert len(shapes) == 4


@pytest.mark.parametrize(("coil", "length"), COILS, ids=lambda given: getattr(given, "name", ""))
def test_the_outline_is_a_closed_curve_beside_the_middle_line(coil, length):
    path = coil.winding()
    turning = -1.0 if coil.name == "back" else 1.0
    assert path.turning == turning
    for offset in (0.0, 0.003, -0.002):
        pieces = path.outline(offset, 400)
        points, normals = (np.concatenate([piece[k] for piece in pieces]) for k in range(2))
        steps = np.roll(points, -1, axis=0) - points
        # A parallel curve of a plane closed curve that turns once is longer by 2 pi times its distance outside.
        expected = length + 2 * np.pi * offset * turning
        assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(expected, rel=2e-5)
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
        # The normal points to the right of the direction of travel.
        along = np.linalg.norm(steps, axis=1) > 1e-9
        right = np.column_stack([steps[:, 1], -steps[:, 0]])[along]
        cosine = (right * normals[along]).sum(axis=1) / np.linalg.norm(right, axis=1)
        assert cosine.min() > 0.99


def test_pieces_in_any_order_are_the_same_curve():
    path = rounded_path("p", L_SHAPE, 0.006, 0.008, 0.01)
    mixed = winding_path(path.arcs[::-1].tolist(), np.roll(path.bars, 2, axis=0).tolist(), 0.008, 0.01)
    lengths = [
        np.linalg.norm(np.diff(np.concatenate([p for p, _ in one.outline(0.0, 30)]), axis=0), axis=1)
        for one in (path, mixed)
    ]
    assert np.sort(lengths[0])[-6:] == pytest.approx(np.sort(lengths[1])[-6:], abs=1e-12)
    assert mixed.turning == 1.0


def test_pieces_that_leave_a_gap_are_refused():
    half = [arc((0.0, 0.0), 0.0, np.pi / 2, 0.02, 0.004)]
    chord = [bar(np.array([0.0, 0.02]), np.array([0.0, -0.019]))]
    with pytest.raises(InputError) as caught:
        winding_path(half, chord, 0.004, 0.01).outline(0.0, 3)
    assert "0.001 m" in caught.value.problems[0].received


def test_corners_that_are_no_numbers_are_refused():
    with pytest.raises(InputError) as caught:
        rounded_path("p", np.where(L_SHAPE == 0.06, np.nan, L_SHAPE), 0.006, 0.008, 0.01)
    assert caught.value.problems[0].where == "coil 'p', corners"


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_wide_arcs_are_divided_at_right_angles(sense):
    """The rules of the kernel hold for arcs up to a right angle."""
    half = arc((0.01, 0.0), 0.3, np.pi / 2, 0.02, 0.004, sense)
    path = winding_path([half], [], 0.004, 0.01)
    assert path.arcs[:, 4] == pytest.approx([np.pi / 4, np.pi / 4])
    assert np.arctan2(path.arcs[:, 3], path.arcs[:, 2]) == pytest.approx(
        [0.3 - sense * np.pi / 4, 0.3 + sense * np.pi / 4]
    )
    assert len(winding_path([arc((0.0, 0.0), 0.0, np.pi / 4, 0.02, 0.004)], [], 0.004, 0.01).arcs) == 1


def test_a_stadium_has_the_field_of_a_rectangle_with_the_largest_corners():
    ends = [arc((x, 0.0), angle, np.pi / 2, 0.01, 0.006) for x, angle in ((0.01, 0.0), (-0.01, np.pi))]
    corners = np.array([[0.01, 0.01], [-0.01, 0.01], [-0.01, -0.01], [0.01, -0.01]])
    sides = [bar(corners[0], corners[1]), bar(corners[2], corners[3])]
    path = winding_path(ends, sides, 0.006, 0.012)
    twin = RoundedRectangleCoil("r", 0.02, 0.01, 0.01, 0.006, 0.012, 200)
    points = np.random.default_rng(2).normal(size=(40, 3)) * 0.02
    field = path_flux_density(points, path.arcs, path.bars, path.thickness, path.height, 10.0)
    assert field == pytest.approx(twin.unit_flux_density(points, 10.0), rel=1e-8, abs=1e-12)
