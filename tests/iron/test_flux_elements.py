"""Second-order flux elements: patch tests, the derivative of the fluxes, balance of every element."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Body, Box, Device, LinearMaterial, Part
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.flux_form import FluxElements
from fieldmap.iron.elements.nodal_elements import NodalElements
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.topology import build_faces


@pytest.fixture(scope="module")
def block():
    body = Body("block", "iron", (Part(Box((0.03, 0.02, 0.02))),), 0.01, 0.002)
    mesh = generate_mesh(Device("d", "", (), (body,), {"iron": LinearMaterial("iron", 1.0)}))
    topology = build_faces(mesh.points, mesh.tets)
    return topology, FluxElements.from_mesh(NodalElements.from_mesh(mesh, topology), topology)


def material(elements, law, remanence=0.0):
    count = len(elements.volume)
    return Magnetisation(np.zeros(count, np.int64), law_tables([law]), np.full((1, count, 3), remanence))


def nodal_values(elements, function):
    nodal = elements.nodal
    return function(np.vstack([nodal.points, nodal.points[nodal.edges].mean(axis=1)]))


def points_of(elements):
    b = (5 - np.sqrt(5)) / 20
    corners = elements.nodal.points[elements.nodal.nodes[:, :4]]
    return np.einsum("qk,ekd->eqd", np.full((4, 4), b) + (1 - 4 * b) * np.eye(4), corners)


def quadratic(x):
    """A harmonic function of second degree: its gradient is linear and free of divergence."""
    return (
        3 * x[:, 0]
        - x[:, 1]
        + 40 * (x[:, 0] ** 2 - x[:, 2] ** 2)
        + 25 * x[:, 0] * x[:, 1]
        - 60 * x[:, 1] * x[:, 2]
    )


def gradient(x):
    u, v, w = np.moveaxis(x, -1, 0)
    return np.stack([3 + 80 * u + 25 * v, -1 + 25 * u - 60 * w, -80 * w - 60 * v], axis=-1)


@pytest.mark.parametrize("mu_r", [1.0, 1e3, 1e-3])
def test_patch(block, mu_r):
    """A linear field is reproduced at every point whatever the elements' shapes, and inner faces are in balance."""
    topology, elements = block
    potential = elements.from_nodal(nodal_values(elements, quadratic)[:, None])
    law, none = material(elements, LinearMaterial("iron", mu_r)), elements.no_field()
    exact = -gradient(points_of(elements))
    assert elements.strength_at_points(potential, none, law)[0] == pytest.approx(exact, abs=1e-9)
    flux = elements.residual(potential[:, 0], none, 0, law)
    sums = np.bincount(elements.unknowns.ravel(), flux.ravel(), elements.count).reshape(-1, 3)
    inner = np.setdiff1d(np.arange(len(sums)), topology.surface)
    assert np.abs(sums[inner]).max() < 1e-10 * np.abs(sums[topology.surface]).max()


def test_means_over_triangles(block):
    """Means of a quadratic function over faces with corners in any order: nodal and flux elements are exact."""
    topology, elements = block
    faces = topology.nodes[np.random.default_rng(3).permutation(len(topology.nodes))[:40]]
    faces = np.array([np.roll(face, k) for k, face in enumerate(faces)])
    a, b, c = np.moveaxis(elements.nodal.points[faces], 1, 0)
    exact = sum(quadratic((one + other) / 2) for one, other in ((a, b), (b, c), (c, a))) / 3
    nodal = nodal_values(elements, quadratic)
    assert elements.nodal.mean_over(faces, topology) @ nodal == pytest.approx(exact, rel=1e-12, abs=1e-12)
    flux = elements.from_nodal(nodal[:, None])[:, 0]
    assert elements.mean_over(faces, topology) @ flux == pytest.approx(exact, rel=1e-12, abs=1e-12)
    surface = topology.nodes[topology.surface]
    assert (elements.mean_over(surface, topology) != elements.face_mean).nnz == 0


def test_coil_field_is_that_of_the_nodal_elements(block):
    """A linear coil field without curl is represented exactly, and in air it leaves no residual."""
    _, elements = block
    field = elements.coil_field(lambda x: gradient(x)[None])
    assert field[0] == pytest.approx(gradient(points_of(elements)), abs=1e-10)
    law = material(elements, LinearMaterial("air", 1.0))
    flux = elements.residual(np.zeros(elements.count), field, 0, law)
    assert np.abs(flux).max() < 1e-12 * np.abs(elements.area).max() * np.abs(field).max()


@pytest.mark.parametrize("strength", [1e-4, 1e-3, 0.1, 2.0])
def test_tangent_is_the_derivative_and_elements_keep_their_flux(block, strength):
    """Steel from weak to saturated, at random potentials: Taylor remainder of second order, no net flux."""
    _, elements = block
    steel = material(elements, fm.read_device("drive_unit").materials["steel"], remanence=0.3)
    random = np.random.default_rng(5)
    scale = strength * np.cbrt(elements.volume.mean())
    start, step = scale * random.normal(size=(2, elements.count))
    field = strength * random.normal(size=elements.no_field().shape)
    here = elements.residual(start, field, 0, steel)
    assert np.abs(here.sum(axis=1)).max() < 1e-9 * np.abs(here).max()
    slope = np.einsum("eij,ej->ei", elements.tangent(start, field, 0, steel), step[elements.unknowns])
    remainder = [
        np.linalg.norm(elements.residual(start + h * step, field, 0, steel) - here + h * slope)
        for h in (1e-4, 1e-5)
    ]
    # The law's slope has kinks; a few elements may sit on one.
    assert remainder[1] < 0.05 * remainder[0]
    assert remainder[1] < 1e-6 * np.linalg.norm(slope)


def test_tangent_is_symmetric_and_positive(block):
    _, elements = block
    steel = material(elements, fm.read_device("drive_unit").materials["steel"])
    start = 1e-4 * np.random.default_rng(7).normal(size=elements.count)
    matrices = elements.tangent(start, elements.no_field(), 0, steel)
    assert matrices == pytest.approx(
        np.swapaxes(matrices, 1, 2), rel=1e-9, abs=1e-12 * np.abs(matrices).max()
    )
    values = np.linalg.eigvalsh(matrices)
    # Equal potentials on all faces drive nothing; everything else does.
    assert (np.abs(values[:, 0]) < 1e-9 * values[:, -1]).all()
    assert (values[:, 1] > 1e-9 * values[:, -1]).all()
