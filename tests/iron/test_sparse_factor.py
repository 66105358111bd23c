"""Sparse factors, and the air's operator that rests on them, against dense algebra."""

import importlib.util
import sys

import numpy as np
import pytest
from scipy.sparse import csr_matrix, diags_array, eye_array, kron, random_array
from scipy.sparse.linalg import splu

from fieldmap.device.model import Body, Device, LinearMaterial, Part, Sphere
from fieldmap.errors import NotConverged
from fieldmap.iron import generate_mesh
from fieldmap.iron.elements.flux_form import FluxElements
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.operators.linear_systems import ElementSums, Elimination, nested_dissection


def laplacian(n):
    """Seven-point Laplacian on n^3 nodes, shifted: sparse, positive definite, with supernodes of all widths."""
    one = diags_array([-np.ones(n - 1), 2.1 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    unit = eye_array(n)
    grid = kron(kron(one, unit), unit) + kron(kron(unit, one), unit) + kron(kron(unit, unit), one)
    return canonical(grid)


def canonical(matrix):
    matrix = csr_matrix(matrix)
    matrix.sum_duplicates()
    return matrix


def random_matrix(size=80):
    rng = np.random.default_rng(0)
    half = random_array((size, size), density=0.03, rng=rng)
    return canonical(half @ half.T + eye_array(size))


@pytest.mark.parametrize(
    "matrix", [random_matrix(), laplacian(9), laplacian(1), canonical(2.0 * eye_array(4))]
)
def test_factor_solves(matrix):
    elimination = Elimination.of(matrix)
    count = matrix.shape[0]
    assert (np.sort(elimination.order) == np.arange(count)).all()
    right = np.random.default_rng(1).random((count, 3))
    x = elimination.factor(matrix.data).solve(right)
    assert x == pytest.approx(np.linalg.solve(matrix.toarray(), right), rel=1e-10)
    assert elimination.factor(matrix.data).solve(right[:, 0]) == pytest.approx(x[:, 0], rel=1e-12)


@pytest.mark.parametrize(
    "matrix", [random_matrix(), laplacian(9), laplacian(1), canonical(2.0 * eye_array(4))]
)
def test_without_metis_on_windows_the_order_is_of_minimum_degree(matrix, monkeypatch):
    fill = Elimination.of(matrix).panel_start[-1]
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "pymetis", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    order = nested_dissection(matrix)
    assert (np.sort(order) == np.arange(matrix.shape[0])).all()
    elimination = Elimination.of(matrix)
    # A reversed order, or none, takes several times as many numbers.
    assert elimination.panel_start[-1] <= 1.5 * fill
    right = np.random.default_rng(1).random(matrix.shape[0])
    assert matrix @ elimination.factor(matrix.data).solve(right) == pytest.approx(right, rel=1e-10)


@pytest.mark.parametrize("scale", [1e20, 1e-20])
def test_the_units_of_a_matrix_do_not_matter(scale):
    matrix = laplacian(6)
    right = np.random.default_rng(4).random(matrix.shape[0])
    found = Elimination.of(matrix).factor(scale * matrix.data).solve(right)
    assert scale * found == pytest.approx(np.linalg.solve(matrix.toarray(), right), rel=1e-10)


def test_the_factor_is_sparse():
    """A grid of n^3 nodes takes about n^4 numbers (A. George, SIAM J. Numer. Anal. 10 (1973) 345, in three dimensions),
    and not many more than SuperLU in minimum-degree order: zeros that join supernodes are stored too."""
    numbers = [Elimination.of(laplacian(n)).factor(laplacian(n).data).bytes / 8 for n in (8, 16)]
    assert np.log2(numbers[1] / numbers[0]) == pytest.approx(4.0, abs=0.6)
    other = splu(laplacian(16).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    assert numbers[1] < 1.5 * other.L.nnz


def test_a_matrix_that_is_not_positive_is_refused():
    matrix = laplacian(4)
    matrix.data[matrix.data > 0] *= 0.3
    with pytest.raises(NotConverged):
        Elimination.of(matrix).factor(matrix.data)


@pytest.mark.parametrize("apart", [1.0, 1e-10])
def test_a_rough_factor_is_in_single_precision_where_that_can_tell_the_matrix_from_a_singular_one(apart):
    """Each element couples two unknowns with determinant `apart`: at 1e-10 only doubles see that it is positive."""
    unknowns = np.arange(12).reshape(6, 2)
    sums = ElementSums(unknowns, 12)
    entries = sums.entries(np.tile([[1.0 + apart, 1.0], [1.0, 1.0]], (6, 1, 1)))
    right = np.random.default_rng(4).random(12)
    single = apart == 1.0
    found = sums.rough_factor(entries)
    assert found.bytes == sums.factor(entries).bytes / (2 if single else 1)
    expected = np.linalg.solve(sums.matrix(entries).toarray(), right)
    assert found.solve(right) == pytest.approx(expected, rel=1e-5 if single else 1e-4)


def test_sums_over_elements_are_those_of_dense_matrices():
    rng = np.random.default_rng(3)
    unknowns = np.array([rng.permutation(12)[:4] for _ in range(20)])
    unknowns[:3] = np.arange(12).reshape(3, 4)
    sums = ElementSums(unknowns, 12)
    matrices, vectors = rng.random((20, 4, 4)), rng.random((20, 4))
    dense, vector = np.zeros((12, 12)), np.zeros(12)
    for numbers, matrix, part in zip(unknowns, matrices, vectors, strict=True):
        dense[np.ix_(numbers, numbers)] += matrix
        vector[numbers] += part
    entries = sums.entries(matrices)
    assert sums.matrix(entries).toarray() == pytest.approx(dense, rel=1e-14)
    assert (np.diff(sums.matrix(entries).tocoo().coords[0] * 12 + sums.matrix(entries).indices) > 0).all()
    assert sums.vector(vectors) == pytest.approx(vector, rel=1e-14)
    assert entries[sums.diagonal] == pytest.approx(np.diag(dense), rel=1e-14)
    assert sums.entries_of(sums.matrix(entries)) == pytest.approx(entries, rel=0)


@pytest.fixture(scope="module")
def form():
    ball = Body("ball", "iron", (Part(Sphere(0.05)),), 0.03)
    device = Device("ball", "", (), (ball,), {"iron": LinearMaterial("iron", 1.0)})
    return PotentialForm(assemble(generate_mesh(device)))


def test_inward_flux_against_the_saddle_point(form):
    """N^-1 m, N = M K^-1 M^T, against one dense indefinite system of the stiffness and the face means."""
    exterior, elements = form.exterior, form.elements
    mean = elements.face_mean.toarray()
    stiffness = vacuum_stiffness(form)
    faces = len(mean)
    saddle = np.block([[stiffness, mean.T], [mean, np.zeros((faces, faces))]])
    given = np.random.default_rng(1).standard_normal((faces, 2))
    right = np.vstack([np.zeros((elements.count, 2)), given])
    exact = -np.linalg.lstsq(saddle, right, rcond=1e-13)[0][elements.count :]
    assert exterior._inward(given) == pytest.approx(exact, abs=1e-5 * np.abs(exact).max())


def vacuum_stiffness(form):
    """int grad N_i . grad N_j dV, written out: the gradients are linear, so a rule of four points is exact."""
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
    energy = float((z.T @ form.exterior.apply(z)).item())
    assert energy == pytest.approx(8 * np.pi / 3 * radius**3, rel=0.02)
    one, other = np.random.default_rng(2).standard_normal((2, elements.count, 1))
    left, right = other.T @ form.exterior.apply(one), one.T @ form.exterior.apply(other)
    assert left.item() == pytest.approx(
        right.item(), abs=1e-6 * np.abs(one.T @ form.exterior.apply(one)).item()
    )


def test_the_rough_air_is_the_air_to_three_digits(form):
    """The rough operator is a preconditioner in single precision, and symmetric."""
    exterior = form.exterior
    one, other = np.random.default_rng(5).standard_normal((2, form.elements.count, 1))
    exact, rough = exterior.apply(one), exterior.apply_roughly(one)
    assert 0.0 < np.linalg.norm(rough - exact) < 1e-3 * np.linalg.norm(exact)
    left, right = other.T @ rough, one.T @ exterior.apply_roughly(other)
    assert left.item() == pytest.approx(right.item(), abs=1e-3 * np.abs(one.T @ exact).item())


@pytest.mark.parametrize("kind", ["potential", "flux"])
def test_the_order_of_the_points_or_faces_fills_as_little_as_that_of_all_unknowns(form, kind):
    elements = form.elements
    if kind == "flux":
        elements = FluxElements.from_mesh(elements, form.iron.topology)
    sums = ElementSums(elements.unknowns, elements.count)
    order = elements.elimination_order()
    assert (np.sort(order) == np.arange(elements.count)).all()
    by_parts, whole = Elimination.of(sums.pattern, order), Elimination.of(sums.pattern)
    assert by_parts.panel_start[-1] < 1.15 * whole.panel_start[-1]
    # The reversed order fills far more, so the bound above is a real one.
    assert Elimination.of(sums.pattern, order[::-1]).panel_start[-1] > 1.5 * whole.panel_start[-1]
