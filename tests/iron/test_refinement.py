"""Where the mesh must be finer: dipoles in the workspace, shares of faces and elements, and sizes of the next mesh."""

import tracemalloc
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

from fieldmap.device.model import Body, Box, Device, LinearMaterial, Part
from fieldmap.iron.materials import body_properties
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import LAYER_RATIO, generate_mesh
from fieldmap.iron.mesh.mesher import LocalSizes, MesherCells
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.operators.mutual import DenseMutualPotential
from fieldmap.iron.report import Stages
from fieldmap.iron.solvers.linear import form_on, solved_in_form
from fieldmap.iron.solvers.refinement import (
    FaceShares,
    WorkspaceDipoles,
    element_indicators,
    expected_growth,
    face_indicators,
    heights,
    near_kernels,
    next_sizes,
    smooth_neighbours,
)
from fieldmap.iron.topology import build_faces
from tests.iron.shared import electromagnet

IRON = LinearMaterial("iron", 1000.0)
PLACES = np.array([[0.005, 0.002, -0.02], [-0.01, 0.006, -0.015]])


def iron_of(mesh):
    """Mesh, faces and surface, without mutual potentials."""
    topology = build_faces(mesh.points, mesh.tets)
    surface = ChargedFaces.from_nodes(mesh.points, topology.nodes[topology.surface])
    return SimpleNamespace(mesh=mesh, topology=topology, surface=surface)


@pytest.fixture(scope="module")
def solved():
    """Solutions of both forms, and both forms in the field of the dipoles."""
    machine = electromagnet(IRON)
    properties, iron = body_properties(machine, None), assemble(generate_mesh(machine))
    forms = [form_on(iron, name) for name in ("potential", "flux")]
    states = [solved_in_form(machine, form, properties, 1e-4, Stages(None)).state for form in forms]
    dipoles = WorkspaceDipoles(PLACES)
    return iron, properties, states, dipoles, [dipoles.magnetise(form, properties) for form in forms]


def test_field_of_a_dipole():
    """On its axis and across it; mu0 m = 1 T m^3."""
    dipole = WorkspaceDipoles(np.array([[0.0, 0.0, 0.1]]))
    b = dipole.flux_densities(np.array([[0.0, 0.0, 0.3], [0.2, 0.0, 0.1]]))
    strength = 1 / (4 * np.pi * 0.2**3)
    assert b[2] == pytest.approx(np.array([[0, 0, 2 * strength], [0, 0, -strength]]), abs=1e-12)
    assert b[0] == pytest.approx(np.array([[-strength, 0, 0], [2 * strength, 0, 0]]), abs=1e-12)


def test_dipoles_stand_at_three_places_near_the_iron_and_far_from_each_other():
    """Twelve places on a line, and iron below the fifth: the dipoles stand at three of the nearest four."""
    places = np.column_stack([np.arange(12.0), np.zeros((12, 2))])
    iron = SimpleNamespace(centres=np.array([[4.1, 0.0, -1.0], [4.1, 0.0, -3.0]]))
    found = WorkspaceDipoles.near_iron(places, iron)
    # 4, 5, 3 and 6 are nearest: first 4, then 6, the farthest from it; 3 and 5 are as far from both, and 5 comes first.
    np.testing.assert_array_equal(found.points[:, 0], [4.0, 6.0, 5.0])
    few = WorkspaceDipoles.near_iron(places[:4], iron)
    np.testing.assert_array_equal(few.points[:, 0], [3.0, 1.0, 2.0])


def test_dipoles_and_iron_are_reciprocal(solved):
    """The iron in the field of one dipole acts on the other as the iron in the field of the other acts on the first."""
    *_, dual = solved
    for state in dual:
        b = state.faces.field(PLACES, state.density)
        response = np.moveaxis(b, 2, 1).reshape(6, 6).reshape(6, 3, 2).swapaxes(1, 2).reshape(6, 6)
        assert response == pytest.approx(response.T, abs=2e-3 * np.abs(response).max())
        assert np.linalg.eigvalsh(0.5 * (response + response.T)).min() > 0


def test_shares_of_the_elements_hold_the_gap_between_the_forms(solved):
    """The gap of the field at the dipoles' places is a signed sum of the products whose sizes are the shares."""
    iron, properties, states, _, dual = solved
    fields = [state.faces.field(PLACES, state.density)[0] for state in states]
    size = np.array([np.abs(fields[0]).max()])
    gap = np.abs(fields[0] - fields[1]).max() / size[0]
    mu_r = properties.mu_r[iron.mesh.body]
    volume = np.abs(np.linalg.det(np.diff(iron.mesh.points[iron.mesh.tets], axis=1))) / 6
    total = element_indicators(volume, mu_r, tuple(states), tuple(dual), size).sum()
    assert 0.7 * gap < total < 10 * gap


def plate(slope):
    """A flat grid of triangles, 6 x 6 squares of 10 mm with charges that rise by `slope` (2,) along x and y."""
    x, y = np.meshgrid(*[0.01 * np.arange(7)] * 2, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(49)])
    corner = (7 * np.arange(6)[:, None] + np.arange(6)).ravel()
    one, other = corner[:, None] + [0, 7, 8], corner[:, None] + [0, 8, 1]
    return points, np.vstack([one, other]), lambda place: place[:, :2] @ np.asarray(slope)


@pytest.mark.parametrize("slope", [(3.0, 0.0), (1.0, -2.0)])
def test_shares_of_faces_are_the_energy_that_constant_charges_leave_out(slope):
    """Against the mutual potentials of triangles cut in 16, away from the plate's edges."""
    points, triangles, charge = plate(slope)
    surface = ChargedFaces.from_nodes(points, triangles)
    values = charge(surface.centres)[None]
    shares = face_indicators(surface, triangles, values, values, np.ones(1), np.zeros((1, *values.shape)))
    every = shares.across + shares.rest
    assert shares.total == pytest.approx(every.sum())
    nodes, cells, parent = points, triangles, np.arange(len(triangles))
    for _ in range(2):
        nodes, cells, parent = quartered(nodes, cells, parent)
    fine = ChargedFaces.from_nodes(nodes, cells)
    left = (charge(fine.centres) - values[0, parent]) * fine.areas
    left[shares.at_edge[parent]] = 0.0
    exact = left @ fine.mutual_potential() @ left
    assert 0.5 < every[~shares.at_edge].sum() / exact < 2.0


def quartered(points, cells, parent):
    a, b, c = (points[cells[:, k]] for k in range(3))
    count = len(cells)
    nodes = np.vstack([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2])
    pieces = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
    fine = np.vstack([np.arange(count)[:, None] + count * np.array(piece) for piece in pieces])
    return nodes, fine, np.tile(parent, 4)


def test_neighbours_are_not_looked_for_round_edges():
    """Every side of a box is a surface of its own."""
    box = Body("b", "iron", Box((0.02, 0.03, 0.01)), 0.008)
    iron = iron_of(generate_mesh(Device("d", "", (), (box,), {"iron": IRON})))
    normals = iron.surface.normals
    neighbours = smooth_neighbours(iron.topology.nodes[iron.topology.surface], normals)
    one, side = np.nonzero(neighbours >= 0)
    assert np.allclose(normals[one], normals[neighbours[one, side]])
    # Each side of a triangle is an edge of the box or has a neighbour.
    assert (neighbours >= 0).sum() > 2 * len(neighbours)


def test_sizes_fall_where_the_shares_are_and_the_mesh_follows():
    machine = electromagnet(IRON, 0.006, 0.006)
    mesh = generate_mesh(machine)
    iron = iron_of(mesh)
    # All of the error is on one side of the disk.
    share = np.where(iron.surface.centres[:, 0] > 0.02, iron.surface.areas, 0.0)
    none = np.zeros(len(share))
    shares = FaceShares(none, share / share.sum(), none > 0, np.ones(1))
    sizes = next_sizes(iron, shares, np.zeros(len(mesh.tets)), 4.0)
    ratio, x = sizes.sizes / mesh.cells.sizes, sizes.points[:, 0]
    assert ratio[x > 0.024].max() < 0.9
    assert np.median(ratio[x < 0.01]) > 1.2
    finer = generate_mesh(machine, local=sizes)
    here = [m.points[m.tets].mean(axis=1)[:, 0] for m in (mesh, finer)]
    assert (here[1] > 0.022).sum() > 1.3 * (here[0] > 0.022).sum()
    assert (here[1] < 0.0).sum() < (here[0] < 0.0).sum()


@pytest.mark.parametrize("kind", ["faces", "elements", "layers"])
def test_sizes_of_copies_of_a_chamber_are_those_of_the_largest_share(kind):
    """The error on one of eight copies makes elements small on all of them."""
    box = Body("b", "iron", (Part(Box((0.03, 0.02, 0.01))),), 0.008)
    mesh = generate_mesh(Device.unchecked(name="d", bodies=(box,), materials={"iron": IRON}), symmetry="auto")
    iron = iron_of(mesh)
    centres = mesh.points[mesh.tets].mean(axis=1)
    faces, tets = ((x > [0, 0, 0.005]).all(axis=1) for x in (iron.surface.centres, centres))
    none = np.zeros(len(faces))
    share = faces / faces.sum() if kind != "elements" else none
    at_edge = np.full(len(faces), kind == "layers")
    shares = FaceShares(share, none, at_edge, np.ones(1))
    elements = tets / tets.sum() if kind == "elements" else np.zeros(len(tets))
    sizes = next_sizes(iron, shares, elements, 4.0)
    copies = sizes.sizes.reshape(8, -1)
    thinnest = [sizes.layers[(np.sign(sizes.edge_points - [0, 0, 0.005]) == side).all(axis=1)].min(initial=1.0)
                for side in product((-1.0, 1.0), repeat=3)]  # fmt: skip
    assert copies.min(axis=1) == pytest.approx(np.full(8, copies.min()), rel=0.05)
    assert thinnest == pytest.approx([min(thinnest)] * 8, rel=0.05)
    if kind == "layers":
        assert min(thinnest) < 0.7 * heights(iron.surface.corners).min()
    else:
        assert copies.min() < 0.9 * mesh.cells.sizes.min()


def clusters(at_edge=False):
    """Three clusters of six cells far from each other, of sizes 1, 2 and 3 mm, each with one face of height 1 mm."""
    centres = np.repeat(np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]]), 6, axis=0)
    centres = centres + 1e-3 * np.random.default_rng(5).uniform(size=(18, 3))
    corners = centres[:, None] + 1e-3 * np.array([[0.0, 0, 0], [2.0, 0, 0], [0.5, 1.0, 0]])
    surface = ChargedFaces.from_nodes(corners.reshape(-1, 3), np.arange(54).reshape(18, 3))
    number = np.arange(18)[::-1].copy()
    cells = MesherCells(number, centres[::-1].copy(), 1e-3 * np.repeat([3.0, 2.0, 1.0], 6))
    mesh = SimpleNamespace(cells=cells, tets=np.zeros((18, 4), int), symmetry=None)
    topology = SimpleNamespace(owner=np.column_stack([np.arange(18), np.full(18, -1)]), surface=np.arange(18))
    iron = SimpleNamespace(mesh=mesh, topology=topology, surface=surface)
    return iron, np.full(18, at_edge)


# Power p of the size in a share, power d of 1 / size in the number of pieces, cost of a piece, and the least and
# largest factor of the size in one step.
KINDS = {
    "faces": (2.5, 2.0, 1.0, 0.45, 1.3),
    "elements": (3.0, 3.0, 1.0, 0.45, 1.3),
    "layers": (4 / 3, 0.0, 4.0, 0.16, 1.0),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reduction", [1.5, 2.5, 9.0])
@pytest.mark.parametrize("spread", [1.3, 30.0])
def test_sizes_are_those_of_equal_shares(kind, reduction, spread):
    """h changes by the (p + d)th root of the common share over its own share, so that the total falls by the wanted
    factor, four at most."""
    order, dimension, cost, least, most = KINDS[kind]
    iron, at_edge = clusters(kind == "layers")
    cells, share = iron.mesh.cells, np.repeat([1.0, spread, spread**2], 6)
    none = np.zeros(18)
    own = {name: share if name == kind else none for name in KINDS}
    shares = FaceShares(own["layers"], own["faces"], at_edge, np.ones(1))
    sizes = next_sizes(iron, shares, own["elements"], reduction, 0.0)

    def factors(common):
        return np.clip((cost * common / share) ** (1 / (order + dimension)), least, most)

    aim = share.sum() / min(reduction, 4.0)
    common = (
        brentq(lambda c: share @ factors(c) ** order - aim, 1e-9, 1e9)
        if share.sum() * least**order < aim
        else 1e-9
    )
    expected = factors(common)
    if kind == "layers":
        assert sizes.layers == pytest.approx(np.maximum(1e-3 * expected, 0.02 * sizes.sizes[::-1]), rel=1e-6)
        assert np.array_equal(sizes.edge_points, iron.surface.centres)
        assert sizes.sizes == pytest.approx(1.3 * cells.sizes)
    else:
        assert sizes.sizes[::-1] == pytest.approx(expected * cells.sizes[::-1], rel=1e-6)
        assert sizes.layers.size == 0
    assert np.array_equal(sizes.points, cells.centres)


def test_layers_are_no_flatter_than_a_fiftieth_of_the_elements():
    iron, at_edge = clusters(True)
    iron.mesh.cells = replace(iron.mesh.cells, sizes=0.1 * np.arange(1.0, 19.0))
    shares = FaceShares(np.ones(18), np.zeros(18), at_edge, np.ones(1))
    sizes = next_sizes(iron, shares, np.zeros(18), 4.0, 0.0)
    assert sizes.layers == pytest.approx(0.02 * sizes.sizes[::-1])


def test_a_mesh_that_is_to_grow_does():
    """Where the shares ask for no finer mesh, the common share is lowered until there are enough faces."""
    iron, at_edge = clusters()
    shares = FaceShares(np.zeros(18), np.repeat([1.0, 1.3, 1.69], 6), at_edge, np.ones(1))
    found = [next_sizes(iron, shares, np.zeros(18), 1.0, growth) for growth in (0.5, 1.5, 2.0)]
    grown = [float(np.mean((one.sizes / iron.mesh.cells.sizes) ** -2)) for one in found]
    assert grown[0] == pytest.approx(1.0, abs=0.2)
    assert 1.5 <= grown[1] < 1.6
    assert 2.0 <= grown[2] < 2.1


def test_growth_by_its_powers():
    """The number of faces goes with size^-2, of tetrahedra with size^-2.5. A layer adds 2.8 faces and 7 tetrahedra to
    each face along an edge, and the number of these faces goes with size^-1."""
    iron, _ = clusters()
    surface, cells = iron.surface, iron.mesh.cells
    at_edge = np.arange(18) < 6
    factor = np.repeat([0.5, 0.8, 1.25], 6)
    thin = np.full(6, 0.25 * LAYER_RATIO * heights(surface.corners)[0])
    sizes = LocalSizes(cells.centres, factor[::-1] * cells.sizes, surface.centres[:6], thin)
    layers = np.log(4 / LAYER_RATIO) / np.log(1 / LAYER_RATIO)
    faces, tets = expected_growth(iron, at_edge, sizes)
    assert faces == pytest.approx((2.0 * (1 + 2.8 * layers) + 0.8**-2 + 1.25**-2) / 3)
    assert tets == pytest.approx((2.0**2.5 + 0.8**-2.5 + 1.25**-2.5 + 2.0 * 7 * layers) / 3)
    # Layers that exist already cost nothing.
    thick = replace(sizes, layers=np.full(6, 1.0))
    assert expected_growth(iron, at_edge, thick)[0] == pytest.approx((2.0 + 0.8**-2 + 1.25**-2) / 3)


@pytest.mark.parametrize(
    ("size", "thickness", "within"), [(0.6, 1.0, 0.5), (1.0, 0.5, 0.2), (1.0, 0.15, 0.3)]
)
def test_a_mesh_grows_about_as_expected(size, thickness, within):
    """Smaller elements on one side, or thinner layers at all edges."""
    machine = electromagnet(IRON, 0.006, 0.006)
    mesh = generate_mesh(machine)
    iron = iron_of(mesh)
    triangles, surface = iron.topology.nodes[iron.topology.surface], iron.surface
    none = np.zeros((1, len(surface.areas)))
    shares = face_indicators(surface, triangles, none, none, np.ones(1), np.zeros((1, *none.shape)))
    tips = surface.centres[shares.at_edge]
    factor = np.where(mesh.cells.centres[:, 0] > 0, size, 1.0)
    layers = thickness * heights(surface.corners[shares.at_edge])
    sizes = LocalSizes(mesh.cells.centres, factor * mesh.cells.sizes, tips, layers)
    expected = expected_growth(iron, shares.at_edge, sizes)
    finer = generate_mesh(machine, local=sizes)
    grown = (
        build_faces(finer.points, finer.tets).surface.size / len(surface.areas),
        len(finer.tets) / len(mesh.tets),
    )
    assert grown[0] > 1.2
    assert expected == pytest.approx(grown, rel=within)


def test_faces_near_a_place_err_by_their_own_charge():
    """A dipole on a coarse face leaves no charge with a slope there: the product of slopes alone is zero."""
    points, triangles, charge = plate((30.0, 0.0))
    surface = ChargedFaces.from_nodes(points, triangles)
    values = charge(surface.centres)[None]
    none, inside = np.zeros_like(values), int(np.abs(surface.centres - [0.03, 0.03, 0]).sum(axis=1).argmin())
    place = surface.centres[inside] + [0.0, 0.0, 1e-3]
    shares = face_indicators(
        surface, triangles, values, none, np.ones(1), np.zeros((1, *values.shape)), place[None]
    )
    # A slope of 30 T/m over a face of 10 mm deviates by 0.07 T, and half of it is seen from close by. Deviations along
    # two axes add up to at most sqrt(2) times that.
    seen = 0.5 * 30.0 * 0.01 / np.sqrt(18)
    assert 0.99 * seen < shares.rest[inside] < 1.42 * seen
    assert shares.rest[inside] == pytest.approx(shares.rest.max(), rel=0.01)
    far = face_indicators(
        surface, triangles, values, none, np.ones(1), np.zeros((1, *values.shape)), place[None] + 0.1
    )
    assert far.rest.max() == 0.0


def test_a_face_at_an_edge_errs_near_by_as_a_singular_charge_does():
    """Charges without a slope on a plate with sharp edges: r^(-1/3) over a strip deviates from its mean by (1/3)^0.5 of
    the mean, and half of that is seen above its middle. Inner faces have no error."""
    points, triangles, _ = plate((0.0, 0.0))
    surface = ChargedFaces.from_nodes(points, triangles)
    values, size = np.full((2, len(triangles)), [[0.5], [-2.0]]), np.array([1.0, 8.0])
    edge = int(np.abs(surface.centres - [0.03, 0.003, 0]).sum(axis=1).argmin())
    inside = int(np.abs(surface.centres - [0.03, 0.03, 0]).sum(axis=1).argmin())
    places = surface.centres[[edge, inside]] + [0.0, 0.0, 1e-4]
    none = np.zeros((2, 1, len(triangles)))
    shares = face_indicators(surface, triangles, values, 0 * values[:1], size, none, places)
    assert shares.rest[edge] == pytest.approx(0.5 * 3**-0.5 * 0.5, rel=0.01)
    assert shares.rest[inside] == pytest.approx(0.0, abs=1e-12)
    # For each source the place with the largest sum counts.
    near = near_kernels(surface, places)
    expected = 0.58 * np.array([0.5, 0.25]) * (near * shares.at_edge).sum(axis=1).max()
    assert shares.totals == pytest.approx(expected, rel=1e-9)


def test_layers_at_edges_are_as_asked():
    """Layers are thin at one place of a disk's rim, and unlimited elsewhere."""
    machine = electromagnet(IRON, 0.008, 0.008)
    places = np.array([[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]])
    sizes = LocalSizes(places, np.full(2, 0.008), places, np.array([0.0003, 1.0]))
    mesh = generate_mesh(machine, local=sizes)
    z, x = mesh.points[:, 2], mesh.points[:, 0]
    lowest = [z[(z > 1e-9) & here].min() for here in (x > 0.02, x < -0.02)]
    assert 1e-4 < lowest[0] < 5e-4
    assert lowest[1] > 2e-3


def test_memory_of_the_dense_factor_is_what_is_predicted():
    """Making the factor takes 13 bytes a pair; 16 are predicted."""
    count = 1500
    x = np.linspace(0, 1, count)
    matrix = 1 / (1e-2 + np.abs(x[:, None] - x))
    matrix += np.diag(matrix.sum(axis=1))
    tracemalloc.start()
    mutual = DenseMutualPotential(matrix)
    peak = tracemalloc.get_traced_memory()[1] + matrix.nbytes
    tracemalloc.stop()
    assert mutual.bytes < peak < 16 * count**2 + 1.2e7
