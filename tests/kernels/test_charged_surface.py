"""Near/far evaluation of many charged triangles against the closed form of each."""

import numpy as np
import pytest

from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.kernels.iron.charged_triangle import triangles_field_and_gradient

RNG = np.random.default_rng(3)
N = 6
POINTS = RNG.uniform(-1, 1, size=(3 * N, 3)) * 0.3 + np.repeat(RNG.uniform(-2, 2, size=(N, 3)), 3, axis=0)
FACES = ChargedFaces.from_nodes(POINTS, np.arange(3 * N).reshape(N, 3))
DENSITY = RNG.normal(size=(2, N))


def test_field_and_gradient_at_all_distances():
    # Some points are close to single triangles, some far from all: both branches are used.
    x = np.concatenate([FACES.centres + 0.05 * FACES.normals, RNG.normal(size=(4, 3)) * 10])
    field, gradient = FACES.field_and_gradient(x, DENSITY)
    for k in range(2):
        exact_field, exact_gradient = triangles_field_and_gradient(
            x, FACES.corners, FACES.normals, DENSITY[k]
        )
        scale = np.linalg.norm(exact_field, axis=1, keepdims=True) / (4 * np.pi)
        assert (np.abs(field[k] - exact_field / (4 * np.pi)) < 2e-4 * scale).all()
        size = np.abs(exact_gradient).max(axis=(1, 2)) / (4 * np.pi)
        assert (np.abs(gradient[k] - exact_gradient / (4 * np.pi)).max(axis=(1, 2)) < 5e-4 * size).all()


def test_field_alone_is_the_same():
    x = RNG.normal(size=(5, 3)) * 4
    assert FACES.field(x, DENSITY) == pytest.approx(FACES.field_and_gradient(x, DENSITY)[0], rel=1e-12)


def test_gradient_is_symmetric_and_trace_free():
    _, gradient = FACES.field_and_gradient(RNG.normal(size=(9, 3)) * 3, DENSITY)
    size = np.abs(gradient).max()
    assert (gradient == np.swapaxes(gradient, -1, -2)).all()
    assert np.abs(np.trace(gradient, axis1=-2, axis2=-1)).max() < 1e-12 * size
