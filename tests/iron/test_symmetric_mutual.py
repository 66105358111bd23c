"""W by blocks against the dense matrix, and irreducible representations against their orthogonality relations."""

import numpy as np
import pytest

from fieldmap.device.model import Body, Box, Cylinder, Device, LinearMaterial, Part, Placement
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.operators.mutual import DenseMutualPotential
from fieldmap.iron.symmetry import find_symmetry, irreducible_representations, multiplication_table


def ring_of_posts(count):
    bodies = []
    for k in range(count):
        a = 2 * np.pi * k / count
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        place = Placement(turn @ [0.03, 0.0, 0.0], turn)
        bodies.append(Body(f"b{k}", "iron", (Part(Box((0.012, 0.008, 0.02)), place),), 0.009))
    return bodies


def device(count):
    plate = Body("plate", "iron", (Part(Cylinder(0.01, 0.004)),), 0.006)
    return Device("d", "", (), (plate, *ring_of_posts(count)), {"iron": LinearMaterial("iron", 100.0)})


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6])
def test_representations(count):
    """Homomorphisms, orthogonal, inequivalent, and their squared dimensions add up to the order (Schur, Burnside)."""
    group = find_symmetry(device(count))
    table = multiplication_table(group.matrices)
    found = irreducible_representations(table)
    entries = []
    for matrices in found:
        products = np.einsum("aij,bjk->abik", matrices, matrices)
        assert np.abs(products - matrices[table]).max() < 1e-12
        entries.append(np.sqrt(matrices.shape[1] / group.order) * matrices.reshape(group.order, -1))
    overlap = np.concatenate(entries, axis=1)
    assert overlap.shape == (group.order, group.order)
    assert np.abs(overlap.T @ overlap - np.eye(group.order)).max() < 1e-12
    # There is one representation for each class of conjugate elements.
    inverse = np.argmax(table == 0, axis=1)
    classes = {
        frozenset(int(table[table[b, a], inverse[b]]) for b in range(group.order)) for a in range(group.order)
    }
    assert len(found) == len(classes)


def test_rotations_alone_are_refused():
    cycle = np.add.outer(np.arange(3), np.arange(3)) % 3
    with pytest.raises(ValueError, match="real"):
        irreducible_representations(cycle)


@pytest.fixture(scope="module", params=[1, 2, 3])
def pair(request):
    """Blocks of a mesh with 2, 4 or 6 operations, and the dense matrix of the same mesh."""
    iron = assemble(generate_mesh(device(request.param), symmetry="auto"))
    assert iron.mesh.symmetry.group.order == 2 * request.param
    return iron, DenseMutualPotential(iron.surface.mutual_potential())


def test_products_are_those_of_the_dense_matrix(pair):
    """Any charges, symmetric or not. The dense rule for touching triangles is not the same for mirror images: single
    entries differ by 1e-3."""
    iron, dense = pair
    charge = np.random.default_rng(0).standard_normal((len(iron.surface.areas), 3))
    assert iron.mutual @ charge == pytest.approx(dense @ charge, abs=1e-3 * np.abs(dense @ charge).max())
    assert iron.mutual.diagonal == pytest.approx(dense.diagonal, rel=3e-3)
    whole = iron.mutual @ np.eye(len(charge))
    assert whole == pytest.approx(dense.matrix, abs=1e-3 * dense.matrix.max())
    assert np.abs(whole - whole.T).max() < 1e-14 * whole.max()
    assert np.linalg.eigvalsh(whole).min() > 0


def test_solutions_are_inverse_to_products(pair):
    iron, _ = pair
    charge = np.random.default_rng(1).standard_normal((len(iron.surface.areas), 2))
    errors = [np.abs(iron.mutual.solve(iron.mutual @ charge, n) - charge).max() for n in range(3)]
    assert errors[0] < 1e-3
    assert errors[1] < 1e-7
    assert errors[2] < 1e-12
    assert iron.mutual.solve(charge[:, :1]) == pytest.approx(iron.mutual.solve(charge)[:, :1], rel=1e-3)


def test_products_commute_with_the_operations(pair):
    iron, _ = pair
    faces = iron.mutual._faces
    charge = np.random.default_rng(2).standard_normal((faces.size, 1))
    product = iron.mutual @ charge
    symmetry = iron.mesh.symmetry
    triangles = np.sort(iron.topology.nodes[iron.topology.surface], axis=1)
    place = {tuple(t): k for k, t in enumerate(triangles)}
    for images in symmetry.node_images:
        moved = np.array([place[tuple(sorted(images[t]))] for t in triangles])
        turned = np.empty_like(charge)
        turned[moved] = charge
        assert (iron.mutual @ turned)[moved] == pytest.approx(product, abs=1e-13 * np.abs(product).max())


def test_memory_is_divided_by_the_number_of_operations(pair):
    iron, dense = pair
    assert iron.mutual.bytes * iron.mesh.symmetry.group.order == pytest.approx(dense.bytes, rel=1e-12)
