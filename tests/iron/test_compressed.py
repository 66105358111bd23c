"""W by blocks against the dense matrix, and its inverse against W itself and a closed form."""

import numpy as np
import pytest

from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.operators.compressed import CompressedMutualPotential
from fieldmap.iron.operators.compressed import _quarters as quarters


def two_plates(n=16, gap=0.3):
    """Two square plates of 2 n^2 triangles each, graded towards one side, one above the other."""
    t = np.linspace(0, 1, n + 1) ** 1.5
    x, y = np.meshgrid(t, np.linspace(0, 1, n + 1), indexing="ij")
    nodes = []
    for i in range(n):
        for j in range(n):
            a = i * (n + 1) + j
            b = a + n + 1
            nodes += [[a, b, a + 1], [b, b + 1, a + 1]]
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    both = np.vstack([points, points + [0.2, 0.1, gap]])
    return ChargedFaces.from_nodes(both, np.vstack([nodes, np.array(nodes) + len(points)]))


@pytest.fixture(scope="module")
def faces():
    return two_plates()


@pytest.fixture(scope="module")
def dense(faces):
    return faces.mutual_potential()


@pytest.fixture(scope="module")
def compressed(faces):
    return CompressedMutualPotential(faces)


def test_quarters_cover_their_blocks_once():
    seen = np.zeros((9, 12), int)
    for r0, r1, c0, c1 in quarters(np.array([[0, 9, 0, 5], [0, 2, 5, 12], [2, 9, 5, 12]])):
        assert max(r1 - r0, c1 - c0) <= 5
        seen[r0:r1, c0:c1] += 1
    assert (seen == 1).all()


def test_error_follows_the_tolerance_and_rank_grows_with_its_logarithm(faces, dense):
    charge = np.random.default_rng(3).standard_normal((len(dense), 3))
    exact = dense @ charge
    tolerances, errors, ranks = (1e-2, 1e-4, 1e-6), [], []
    for tolerance in tolerances:
        approximate = CompressedMutualPotential(faces, tolerance)
        errors.append(np.linalg.norm(approximate @ charge - exact) / np.linalg.norm(exact))
        ranks.append(approximate.mean_rank)
    assert (np.array(errors) < np.array(tolerances)).all()
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.25)
    # Exponential convergence: each factor of a hundred costs about the same number of terms.
    steps = np.diff(ranks)
    assert (steps > 0).all()
    assert steps.max() < 7.0


def test_symmetric(compressed, dense):
    one, other = np.random.default_rng(4).standard_normal((2, len(dense), 1))
    size = np.abs(one).T @ (dense @ np.abs(other))
    assert abs(one.T @ (compressed @ other) - other.T @ (compressed @ one)) < 1e-13 * size


def test_product_of_ones_and_diagonal(compressed, dense):
    ones = np.ones((len(dense), 1))
    assert (compressed @ ones)[:, 0] == pytest.approx(dense.sum(axis=1), rel=1e-6)
    assert compressed.diagonal == pytest.approx(dense.diagonal(), rel=1e-7)


@pytest.mark.parametrize("columns", [1, 3, 4, 7])
def test_any_number_of_columns(compressed, dense, columns):
    charge = np.random.default_rng(columns).standard_normal((len(dense), columns))
    error = np.linalg.norm(compressed @ charge - dense @ charge) / np.linalg.norm(dense @ charge)
    assert error < 1e-6


def test_products_have_the_same_bits_for_any_number_of_threads(compressed, monkeypatch):
    charge = np.random.default_rng(6).standard_normal((len(compressed.diagonal), 3))
    found = []
    for threads in "1235":
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        found.append(compressed @ charge)
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


@pytest.mark.parametrize(("refinements", "bound"), [(0, 1e-3), (1, 1e-6), (2, 1e-9)])
def test_each_refinement_of_the_inverse_gains_three_digits(compressed, refinements, bound):
    potential = np.random.default_rng(5).standard_normal((len(compressed.diagonal), 2))
    rest = potential - compressed @ compressed.solve(potential, refinements)
    assert np.linalg.norm(rest) < bound * np.linalg.norm(potential)


def test_inverse_without_refinement_is_linear_and_symmetric(compressed):
    """It preconditions GMRES, and the flux form projects with it: it must be one fixed matrix."""
    one, other = np.random.default_rng(6).standard_normal((2, len(compressed.diagonal), 1))
    both = compressed.solve(one + 1e6 * other)
    parts = compressed.solve(one) + 1e6 * compressed.solve(other)
    assert both == pytest.approx(parts, rel=1e-9, abs=1e-12 * np.abs(both).max())
    left, right = other.T @ compressed.solve(one), one.T @ compressed.solve(other)
    assert left == pytest.approx(right, rel=1e-9, abs=1e-11 * np.linalg.norm(both))


def test_sphere_at_unit_potential():
    """A charged conducting sphere has the capacity 4 pi R: an exact answer for the inverse."""
    faces = sphere(4)
    potential = CompressedMutualPotential(faces)
    charge = potential.solve(np.ones((len(faces.areas), 1)), 1)
    # The polyhedron is a little smaller than the sphere, so the reference sphere has the area of the polyhedron.
    radius = np.sqrt(faces.areas.sum() / (4 * np.pi))
    assert charge.sum() == pytest.approx(4 * np.pi * radius, rel=1e-3)


def sphere(level):
    """Unit sphere from an octahedron, 8 * 4^level triangles."""
    top = np.vstack([np.eye(3), -np.eye(3)])
    triangles = [
        [top[0 + 3 * (i > 0)], top[1 + 3 * (j > 0)], top[2 + 3 * (k > 0)]]
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    ]
    corners = np.array(triangles)
    for _ in range(level):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (p / np.linalg.norm(p, axis=1)[:, None] for p in (a + b, b + c, c + a))
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    return ChargedFaces.from_nodes(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
