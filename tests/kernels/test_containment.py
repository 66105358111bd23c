"""Point location in tetrahedra."""

import numpy as np

from fieldmap.kernels.iron.containment import find_tetrahedron

CORNERS = np.array(
    [[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[2.0, 0, 0], [3, 0, 0], [2, 1, 0], [2, 0, 1]]]
)


def find(points):
    found = np.full(len(points), -1)
    find_tetrahedron(
        0, len(points), np.array(points), CORNERS, CORNERS.min(axis=1), CORNERS.max(axis=1), found
    )
    return found


def test_points_in_each_and_outside():
    found = find([[0.1, 0.1, 0.1], [2.2, 0.2, 0.2], [0.5, 0.5, 0.5], [1.5, 0.1, 0.1], [0.4, 0.4, 0.4]])
    assert found.tolist() == [0, 1, -1, -1, -1]


def test_barycentric_combinations_are_inside():
    weights = np.random.default_rng(0).dirichlet(np.ones(4), size=50)
    assert (find(weights @ CORNERS[1]) == 1).all()
