"""Sparse factors, and the air's operator that rests on them, against dense algebra."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix, identity, random_array

from fieldmap.device.model import Body, Device, LinearMaterial, Part, Sphere
from fieldmap.iron import generate_mesh
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.operators.linear_systems import SparseFactor, elimination_order


def test_factor_solves():
    rng = np.random.default_rng(0)
    half = random_array((80, 80), density=0.03, rng=rng)
    matrix = csr_matrix(half @ half.T + identity(80))
    order = elimination_order(matrix)
    assert (np.sort(order) == np.arange(80)).all()
    right = rng.random((80, 3))
    x = SparseFactor(matrix, order).solve(right)
    assert matrix @ x == pytest.approx(right, rel=1e-10)
    assert SparseFactor(matrix, order).solve(right[:, 0]) == pytest.approx(x[:, 0])


def test_a_diagonal_matrix_has_no_graph():
    matrix = csr_matrix(2.0 * identity(4))
    assert SparseFactor(matrix, elimination_order(matrix)).solve(np.ones(4)) == pytest.approx([0.5] * 4)


@pytest.fixture(scope="module")
def form():
    ball = Body("ball", "iron", (Part(Sphere(0.05)),), 0.03)
    device = Device("ball", "", (), (ball,), {"iron": LinearMaterial("iron", 1.0)})
    return PotentialForm(assemble(generate_mesh(device)))


def test_inward_flux_against_the_saddle_point(form):
    """N^-1 m, N = M K^-1 M^T: the stiffness and the face means as one dense system, which is not definite."""
    exterior, elements = form._exterior, form.elements
    mean = elements.face_mean.toarray()
    stiffness = vacuum_stiffness(form)
    faces = len(mean)
    saddle = np.block([[stiffness, mean.T], [mean, np.zeros((faces, faces))]])
    given = np.random.default_rng(1).standard_normal((faces, 2))
    right = np.vstack([np.zeros((elements.count, 2)), given])
    exact = -np.linalg.lstsq(saddle, right, rcond=1e-13)[0][elements.count :]
    assert exterior._inward(given) == pytest.approx(exact, abs=1e-5 * np.abs(exact).max())


def vacuum_stiffness(form):
    """int grad N_i . grad N_j dV, written out: the gradients are linear, so that a rule of four points is exact."""
    elements = form.elements
    a, b = (5 - np.sqrt(5)) / 20, (5 + 3 * np.sqrt(5)) / 20
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    matrix = np.zeros((elements.count,) * 2)
    for nodes, g, volume in zip(elements.nodes, elements.gradients, elements.volume, strict=True):
        for q in range(4):
            l = np.full(4, a)
            l[q] = b
            shape = [(4 * l[i] - 1) * g[i] for i in range(4)]
            shape += [4 * (l[i] * g[j] + l[j] * g[i]) for i, j in pairs]
            matrix[np.ix_(nodes, nodes)] += volume / 4 * np.array(shape) @ np.array(shape).T
    return matrix


def test_air_takes_energy_from_smooth_potentials(form):
    """S is symmetric, and for a potential z in a ball the field outside is a dipole's: phi S phi = twice the outer
    energy = int |grad phi|^2 dV = 2 (4 pi / 3) R^3."""
    elements = form.elements
    nodes = np.concatenate([elements.points, elements.points[elements.edges].mean(axis=1)])
    z = nodes[:, 2:]
    radius = np.cbrt(3 * elements.volume.sum() / (4 * np.pi))
    energy = float((z.T @ form._exterior.apply(z)).item())
    assert energy == pytest.approx(8 * np.pi / 3 * radius**3, rel=0.02)
    one, other = np.random.default_rng(2).standard_normal((2, elements.count, 1))
    left, right = other.T @ form._exterior.apply(one), one.T @ form._exterior.apply(other)
    assert left.item() == pytest.approx(
        right.item(), abs=1e-6 * np.abs(one.T @ form._exterior.apply(one)).item()
    )
