"""Arrays in another order and read-only arrays take the kernels that are compiled already: compiling takes seconds."""

import numpy as np
import pytest
from numba import config

from fieldmap.device.model import Body, Box, Device, LinearMaterial, Part
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.flux_form import FluxElements
from fieldmap.iron.elements.nodal_elements import CoilField, NodalElements
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.topology import build_faces
from fieldmap.kernels.iron import charged_surface, linear_flux, quadratic_potential

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")
RNG = np.random.default_rng(4)


@pytest.fixture(scope="module")
def elements():
    body = Body("block", "iron", (Part(Box((0.03, 0.02, 0.02))),), 0.01)
    mesh = generate_mesh(Device("d", "", (), (body,), {"iron": LinearMaterial("iron", 1.0)}))
    topology = build_faces(mesh.points, mesh.tets)
    nodal = NodalElements.from_mesh(mesh, topology)
    law = law_tables([LinearMaterial("iron", 30.0)])
    count = len(nodal.volume)
    material = Magnetisation(np.zeros(count, np.int64), law, np.zeros((1, count, 3)))
    return nodal, FluxElements.from_mesh(nodal, topology), material


def signatures(*kernels):
    return [len(kernel.nopython_signatures) for kernel in kernels]


def same(ask, one, other, *kernels):
    wanted, count = ask(one), signatures(*kernels)
    assert min(count) == 1
    for found, expected in zip(ask(other), wanted, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert signatures(*kernels) == count


def test_nodal_elements(elements):
    nodal, _, material = elements
    constant, potential = RNG.normal(size=(1, len(nodal.volume), 3)), RNG.normal(size=nodal.count)
    bubble = RNG.normal(size=(1, nodal.count))

    def ask(field):
        return (
            nodal.residual(potential, field, 0, material),
            nodal.tangent(potential, field, 0, material),
            nodal.strength_at_points(potential[:, None], field, material),
        )

    names = ("sample_gradients", "tested_vectors", "tested_matrices")
    one, other = CoilField(constant, bubble), CoilField(np.asfortranarray(constant), bubble)
    same(ask, one, other, *(getattr(quadratic_potential, name) for name in names))


def test_flux_elements(elements):
    _, flux, material = elements
    field, potential = RNG.normal(size=(1, len(flux.volume), 4, 3)), RNG.normal(size=flux.count)

    def ask(field):
        return (
            flux.residual(potential, field, 0, material),
            flux.tangent(potential, field, 0, material),
            flux.strength_at_points(potential[:, None], field, material),
        )

    names = ("strength", "moment_matrices")
    same(ask, field, np.asfortranarray(field), *(getattr(linear_flux, name) for name in names))


def test_points_of_charged_faces():
    faces = ChargedFaces.from_nodes(np.eye(4)[:, :3], np.array([[0, 1, 2], [0, 2, 3]]))
    points, density = RNG.normal(size=(5, 3)), RNG.normal(size=(2, 2))
    fixed = points.copy()
    fixed.flags.writeable = False

    def ask(points):
        return faces.field(points, density), *faces.field_and_gradient(points, density)

    for other in (fixed, np.asfortranarray(points)):
        same(ask, points, other, charged_surface.surface_field)
