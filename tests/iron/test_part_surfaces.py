"""Faces on a part of a body: every kind of shape, turned and shifted, with known answers."""

import numpy as np
import pytest

from fieldmap.device.model import Box, Cylinder, ExtrudedPolygon, Part, Ring, Sphere, placed
from fieldmap.iron.sensitivity.moved_bodies import lies_on

PLACE = placed((0.01, -0.02, 0.03), (20.0, -35.0, 50.0))


def found(shape, *faces):
    """Whether the corners (f, 3) of faces (3, 3), given in the shape's frame, lie on the placed shape."""
    local = np.array(faces, float)
    normal = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    turn = PLACE.rotation
    return lies_on(Part(shape, PLACE), local @ turn.T + PLACE.position, normal @ turn.T).tolist()


ON, OFF = [True] * 3, [False] * 3


def across(*corners, axis=2, at=0.0):
    """A face in the plane where one coordinate is `at`, by its other two coordinates."""
    return np.insert(np.array(corners, float), axis, at, axis=1)


@pytest.mark.parametrize("axis", range(3))
def test_a_box_has_six_planes(axis):
    size = np.array([0.02, 0.03, 0.04])
    low, high = np.array([-0.01, -0.015, 0.0]), np.array([0.01, 0.015, 0.04])
    rest = [k for k in range(3) if k != axis]
    inside = low[rest] + np.array([[0.1, 0.1], [0.9, 0.2], [0.3, 1.0]]) * size[rest]
    beyond = inside.copy()
    beyond[1, 0] = high[rest[0]] + 1e-4
    before = inside.copy()
    before[2, 1] = low[rest[1]] - 1e-4
    for at in (low[axis], high[axis]):
        faces = [across(*corners, axis=axis, at=at) for corners in (inside, beyond, before)]
        # A face in the plane may reach from this part to another.
        assert found(Box(tuple(size)), *faces) == [ON, [True, False, True], [True, True, False]]
        near = [across(*inside, axis=axis, at=at + shift) for shift in (1e-6, -1e-6)]
        assert found(Box(tuple(size)), *near) == [OFF, OFF]
    tilted = across(*inside, axis=axis, at=low[axis])
    tilted[0, axis] += 0.01
    assert found(Box(tuple(size)), tilted) == [OFF]


def around(radius, *places):
    """Corners at angles in degrees and heights."""
    angle, z = np.radians([a for a, _ in places]), [z for _, z in places]
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


@pytest.mark.parametrize("shape", [Cylinder(0.02, 0.03), Ring(0.01, 0.02, 0.03)])
def test_a_turned_shape_has_ends_and_curved_faces(shape):
    bore = isinstance(shape, Ring)
    side = around(0.02, (0, 0.0), (10, 0.0), (5, 0.03))
    assert found(shape, side, side * [1.04, 1.04, 1], side * [0.96, 0.96, 1]) == [ON, ON, ON]
    assert found(shape, side * [1.06, 1.06, 1], side * [0.94, 0.94, 1]) == [OFF, OFF]
    higher, lower = side + [0, 0, 1e-4], side - [0, 0, 1e-4]
    assert found(shape, higher, lower) == [[True, True, False], [False, False, True]]
    hole = around(0.01, (0, 0.0), (10, 0.01), (0, 0.02))
    assert found(shape, hole) == [ON if bore else OFF]
    # The corners are as far out as the side, but the face is not parallel to the axis.
    slanted = around(0.02, (0, 0.0), (10, 0.0), (5, 0.001)) - [[0, 0, 0], [0, 0, 0], [9e-4, 0, 0]]
    assert found(shape, slanted) == [OFF]
    end = around(0.015, (0, 0), (90, 0), (200, 0))
    for at in (0.0, 0.03):
        levels = [end + [0, 0, z] for z in (at, at + 1e-6, at - 1e-6)]
        assert found(shape, *levels) == [ON, OFF, OFF]
        out, middle = end + [0, 0, at], end + [0, 0, at]
        out[0, 0], middle[1, :2] = 0.0211, (0.0, 0.0094)
        assert found(shape, out, middle) == [[False, True, True], [True, not bore, True]]
        # Corners of round edges lie a little off the edge; on the end of a cylinder a corner may lie on the axis.
        out[0, 0], middle[1, :2] = 0.0209, (0.0, 0.0096)
        centre = end + [0, 0, at]
        centre[2, :2] = 0.0
        assert found(shape, out, middle, centre) == [ON, ON, [True, True, not bore]]
    assert found(shape, around(0.015, (0, 0.01), (90, 0.01), (200, 0.01))) == [OFF]


def test_a_sphere_is_known_by_its_radius_and_other_shapes_are_not():
    face = 0.02 * np.array([[0.6, 0.8, 0], [0, 0.6, 0.8], [0.8, 0, 0.6]])
    one = face * [[0.9], [1.0], [1.0]]
    assert found(Sphere(0.02), face, 1.04 * face, 0.96 * face) == [ON, ON, ON]
    assert found(Sphere(0.02), 1.06 * face, 0.94 * face, one) == [OFF, OFF, OFF]
    square = np.array([[0, 0], [0.02, 0], [0.02, 0.02], [0, 0.02]])
    assert found(ExtrudedPolygon(square, 0.01), across([0, 0], [0.02, 0], [0, 0.02])) == [OFF]
