"""Flux through sections: areas and uniform fields exactly; conservation, a sphere, a bar, rings and inner corners."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.integrate import quad

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron.elements.bh_law import law_tables
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.elements.state import IronState, LinearField
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import generate_mesh, volumes
from fieldmap.iron.sections import areas_above, clip_triangles, relative_energy_error, section_flux
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from tests.iron.shared import FOOT, RING, at, in_uniform_field, iron_of, toroid

ONE = np.ones(1)
UNIFORM = np.array([0.3, -0.8, 1.1])


def through(solved, section):
    mesh, state, air = solved
    return section_flux(mesh, state, section, ONE, air)


def plane(origin, normal, bodies=(), half_widths=None):
    widths = None if half_widths is None else np.array(half_widths, float)
    return fm.Section("plane", np.array(origin, float), np.array(normal, float), bodies, widths)


@pytest.fixture(scope="module")
def blocks():
    """Two blocks that touch in the plane z = 20 mm, two bars that overlap in the plane z = 15 mm, and a ball; the same
    field in all bodies and in the air."""
    bodies = (
        fm.Body("low", "iron", (fm.Part(fm.Box((0.03, 0.02, 0.02))),), 0.006),
        fm.Body("high", "iron", (fm.Part(fm.Box((0.03, 0.02, 0.01)), at(0, 0, 0.02)),), 0.004),
        fm.Body("ball", "iron", (fm.Part(fm.Sphere(0.01), at(0.05, 0, 0)),), 0.002),
        fm.Body("under", "iron", (fm.Part(fm.Box((0.03, 0.02, 0.01)), at(-0.1, 0, 0.005)),), 0.006),
        fm.Body("over", "iron", (fm.Part(fm.Box((0.03, 0.02, 0.01)), at(-0.08, 0, 0.015)),), 0.006),
    )
    mesh = generate_mesh(fm.Device("d", "", (), bodies, {"iron": fm.LinearMaterial("iron", 1.0)}))
    field = np.broadcast_to(UNIFORM, (1, len(mesh.tets), 3))
    none = ChargedFaces.from_nodes(mesh.points, np.zeros((0, 3), int))
    inside = np.repeat(field[:, :, None], 4, axis=2)
    state = IronState(none, np.zeros((1, 0)), field, 0, (), LinearField(inside, inside))
    return partial(through, (mesh, state, lambda x: np.broadcast_to(UNIFORM, x.shape)))


TILTED = np.array([1.0, 2.0, 2.0]) / 3


@pytest.mark.parametrize(
    ("section", "area"),
    [
        (plane([0, 0, 0.01], [0, 0, 1], ("low",)), 6e-4),
        (plane([0.0, 0, 0.013], [0, 0, -2], ("low",)), 6e-4),
        (plane([0.005, 0, 0], [1, 0, 0], ("low", "high")), 6e-4),
        (plane([0, 0, 0.01], [0, 0, 1], ("low",), [0.004, 0.003, 1]), 4.8e-5),
        # Half of the window lies beside the block.
        (plane([0.015, 0, 0.01], [0, 0, 1], ("low",), [0.004, 0.003, 1]), 2.4e-5),
        # The window is |x| < 4 mm, |y| < 3 mm; the plane's area is its projection over n_z = 2/3.
        (plane([0, 0, 0.01], TILTED, ("low",), [0.004, 0.003, 1]), 4.8e-5 * 1.5),
        # The common face of the blocks, the top and the bottom belong to the section from either side.
        (plane([0, 0, 0.02], [0, 0, 1], ("low",)), 6e-4),
        (plane([0, 0, 0.02], [0, 0, 1], ("high",)), 6e-4),
        (plane([0, 0, 0.02], [0, 0, 1], ("low", "high")), 6e-4),
        (plane([0, 0, 0.03], [0, 0, 1]), 6e-4),
        (plane([0, 0, 0.0], [0, 0, 1], ("low",)), 6e-4),
        # Two bars overlap over a third of their length: the section of both is the area of contact.
        (plane([-0.09, 0, 0.015], [0, 0, 1], ("under", "over")), 2e-4),
        (plane([-0.09, 0, 0.015], [0, 0, -3], ("under", "over")), 2e-4),
        (plane([-0.09, 0, 0.015], [0, 0, 1], ("under",)), 6e-4),
        # The plane cuts the lower bar; the side of the upper bar that lies in the plane does not count.
        (plane([-0.095, 0, 0], [1, 0, 0], ("under", "over")), 2e-4),
    ],
)
def test_area_and_uniform_field(blocks, section, area):
    """To rounding: the plane's area in the blocks, and the area times the normal field."""
    found = blocks(section)
    assert found.area == pytest.approx(area, rel=1e-9)
    normal = section.normal / np.linalg.norm(section.normal)
    assert found.flux_density == pytest.approx(UNIFORM @ normal, rel=1e-9)
    assert found.flux == pytest.approx(area * (UNIFORM @ normal), rel=1e-9)


@pytest.mark.parametrize("height", [0.0, 0.004, -0.006])
def test_discs_of_a_ball(blocks, height):
    found = blocks(plane([0.05, 0, height], [0, 0, 1], ("ball",)))
    assert found.area == pytest.approx(np.pi * (1e-4 - height**2), rel=0.01)


def test_areas_of_triangles_above_a_plane():
    """Corner heights of every sign: the tip that is cut off has the product of the shares of its two sides."""
    triangle = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]])
    cases = {
        (1.0, 2.0, 3.0): 6.0,
        (0.0, 0.0, 1.0): 6.0,
        (-1.0, -2.0, -3.0): 0.0,
        (0.0, -1.0, -1.0): 0.0,
        # The tip takes 1 / (1 + 3) and 1 / (1 + 1) of two sides; the rest counts where the tip lies below.
        (1.0, -3.0, -1.0): 6.0 / 4 / 2,
        (-1.0, 3.0, 1.0): 6.0 * (1 - 1 / 4 / 2),
        (-3.0, 1.0, -1.0): 6.0 / 4 / 2,
        (0.0, 2.0, -6.0): 6.0 * 2 / 8,
        (-2.0, 0.0, 6.0): 6.0 * 6 / 8,
    }
    found = areas_above(np.array([triangle] * len(cases)), np.array(list(cases)))
    np.testing.assert_allclose(found, list(cases.values()), rtol=1e-12)


def test_parts_of_triangles_within_a_plane_have_these_areas():
    """In barycentric coordinates of one element: the areas, and nothing outside the plane."""
    rng = np.random.default_rng(3)
    corners, margin = np.eye(4)[None, :3] * np.ones((200, 1, 1)), rng.normal(size=(200, 3))
    places = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 1]])
    element, parts = clip_triangles(np.arange(200), corners, margin)
    x = parts @ places
    own = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    areas = np.bincount(element, own, 200)
    np.testing.assert_allclose(areas, areas_above(np.array([places[:3]] * 200), margin), atol=1e-12)
    heights = np.einsum("pkb,pb->pk", parts[:, :, :3], margin[element])
    assert heights.min() > -1e-12


def test_the_error_of_elements_is_their_distance_from_the_means_about_nodes():
    """Two tetrahedra of volumes V and W share a face, with B 1 and 3 along x: the mean at its nodes is (V 1 + W 3) / (V
    + W). A separate tetrahedron has no error."""
    points = np.array(
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -2], [5, 5, 5], [6, 5, 5], [5, 6, 5], [5, 5, 6]]
    )
    tets = np.array([[0, 1, 2, 3], [0, 2, 1, 4], [5, 6, 7, 8]])
    mesh = SimpleNamespace(points=points, tets=tets, body=np.array([0, 0, 1]), body_names=("a", "b"))
    flux = np.array([[1.0, 0.5, 0.0], [3.0, 0.5, 0.0], [0.0, 0.0, 7.0]])
    volume = np.array([1.0, 2.0, 1.0]) / 6
    mean = (1.0 * 1 + 2.0 * 3) / 3
    error = volume[0] * (0.75 * (mean - 1)) ** 2 + volume[1] * (0.75 * (mean - 3)) ** 2
    whole = volume @ (flux**2).sum(axis=1)
    assert relative_energy_error(mesh, flux) == pytest.approx(error / whole)
    mesh.body = np.array([0, 1, 1])
    assert relative_energy_error(mesh, flux) == pytest.approx(0.0, abs=1e-15)
    assert relative_energy_error(mesh, 0 * flux) == 0.0


def test_nothing_cut_and_bad_planes(blocks):
    for section, what, received in (
        (plane([0, 0, 0.05], [0, 0, 1]), "", "(0, 0, 50) mm"),
        (plane([0, 0, 0.01], [0, 0, 1], ("high",)), "", "(0, 0, 10) mm"),
        (plane([0, 0, 0.01], [0, 0, 1], ("low",), [1e-3, 1e-3, -1]), ", half widths", "-1"),
        (plane([0, 0, 0.01], [0, 0, 0]), ", normal", "0"),
        (plane([0, 0, 0.01], [0, 0, 1], ("lid",)), ", bodies", "'lid'"),
        (plane([0, np.nan, 0.01], [0, 0, 1]), ", origin", "nan"),
    ):
        with pytest.raises(InputError) as caught:
            blocks(section)
        (problem,) = caught.value.problems
        assert problem.where == f"section '{section.name}'{what}"
        assert received in problem.received
        assert ("not all zero" in problem.remedy) == ("normal" in what)
    with pytest.raises(InputError) as caught:
        through((None, None, np.copy), plane([0, 0, 0], [0, 0, 1]))
    assert "(0, 0, 0) mm" in caught.value.problems[0].received


def solved_in(field, body, mu_r):
    """Mesh and state of one body in a uniform field (3,), and the field in the air."""
    form = PotentialForm(iron_of(body))
    state = in_uniform_field(form, [fm.LinearMaterial("iron", mu_r)], field, 1e-7)
    return form.iron.mesh, state, lambda x: field + state.faces.field(x, state.density)[0]


def test_sphere():
    """Uniform inside: 3 mu_r / (mu_r + 2) times the field, through every plane."""
    field = np.array([0.0, 0.6, 0.8])
    solved = solved_in(field, fm.Body("b", "iron", fm.Sphere(0.05), 0.012), 50.0)
    for origin, normal in (([0, 0, 0], [0, 0.6, 0.8]), ([0, 0, 0.02], [0, 0, 1]), ([0.01, 0, 0], [1, 2, 2])):
        section = plane(origin, normal)
        exact = 150 / 52 * field @ section.normal / np.linalg.norm(section.normal)
        assert through(solved, section).flux_density == pytest.approx(exact, rel=1e-3)


def test_long_bar():
    """B = mu_r B0 / (1 + N (mu_r - 1)) in the middle. For weakly magnetic bars N is the solid angle of one charged
    square end over 2 pi."""
    half, distance = 0.005, 0.1
    box = fm.Box((2 * half, 2 * half, 2 * distance))
    solved = solved_in([0, 0, 0.5], fm.Body("b", "iron", box, 0.006).moved([0, 0, -distance]), 3.0)
    exact = 0.5 * 3 / (1 + 2 * 4 * np.arcsin(half**2 / (half**2 + distance**2)) / (2 * np.pi))
    found = through(solved, plane([0, 0, 0], [0, 0, 1]))
    assert found.flux_density == pytest.approx(exact, rel=1e-3)


def test_the_field_inside_elements_has_their_mean():
    """The second-order field at the points of the solver's own rule averages to the mean that it reports."""
    mesh, state, _ = solved_in([0.1, 0, 0.4], fm.Body("b", "iron", fm.Cylinder(0.01, 0.02), 0.006), 200.0)
    points, weights = tetrahedron_rule(2)
    element = np.arange(len(mesh.tets))
    mean = sum(
        w * state.flux_density_at(element, np.tile(p, (len(element), 1)))
        for p, w in zip(points, weights, strict=True)
    )
    assert mean == pytest.approx(state.flux_density, rel=1e-9, abs=1e-12)
    # The volume integral of B has no component across the applied field, which lies in the xz plane.
    assert volumes(mesh.points, mesh.tets) @ state.flux_density[0] @ [0, 1, 0] == pytest.approx(0, abs=1e-9)


(INNER, OUTER, HEIGHT), TURNS = RING, 10.0


CUTS = tuple(
    fm.Section(
        f"at {degrees}",
        np.array([0.02 * np.cos(angle), 0.02 * np.sin(angle), 0]),
        np.array([-np.sin(angle), np.cos(angle), 0]),
        (),
        np.full(3, 0.01),
    )
    for degrees in (0, 17, 30, 90, 200)
    for angle in [np.deg2rad(degrees)]
)


def toroid_mean(law, current):
    """Mean of b(mu0 6 N I / (2 pi r)) over the ring's section: Ampere's law."""
    total, _ = quad(lambda r: law(mu_0 * 6 * TURNS * current / (2 * np.pi * r)), INNER, OUTER)
    return total / (OUTER - INNER)


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_linear_ring(form):
    """The section of the meshed ring varies a little, as the ring is a polygon. The potential form conserves the field
    along the ring, hence B; the flux form conserves the flux."""
    device = toroid(fm.LinearMaterial("iron", 2000.0), 0.0035, CUTS)
    unit = fm.solve_linear(device, form=form)
    exact = toroid_mean(lambda h: 2000.0 * h, 0.3)
    found = [unit.section_flux(section.name, np.full(6, 0.3)) for section in device.sections]
    area = (OUTER - INNER) * HEIGHT
    assert [f.area for f in found] == pytest.approx([area] * 5, rel=0.02)
    if form == "flux":
        assert [f.flux / area for f in found] == pytest.approx([exact] * 5, rel=0.01)
        assert np.ptp([f.flux for f in found]) < 5e-3 * found[0].flux
    else:
        assert [f.flux_density for f in found] == pytest.approx([exact] * 5, rel=0.01)
        assert np.ptp([f.flux_density for f in found]) < 0.01 * exact
    twice = unit.section_flux_density("at 17", np.full(6, 0.6))
    assert twice == pytest.approx(2 * found[1].flux_density)


@pytest.mark.parametrize("current", [0.45, 0.7, 3.0])
def test_saturating_ring(current):
    """At rising permeability, at its maximum, and in saturation."""
    device = toroid(FOOT, 0.0035, CUTS)
    state = fm.solve(device, np.full(6, current))
    tables = law_tables([FOOT])
    exact = toroid_mean(lambda h: tables.flux_density(np.array([h]), np.zeros(1, int))[0][0], current)
    found = [state.section_flux_density(section) for section in device.sections]
    assert found == pytest.approx([exact] * 5, rel=0.015)
    assert np.ptp(found) < 0.015 * exact
    with pytest.raises(InputError) as caught:
        state.section_flux_density("at 45")
    (problem,) = caught.value.problems
    assert problem.received == "'at 45'"
    for section in device.sections:
        assert section.name in problem.must_hold


def test_flux_splits_at_a_joint():
    """A three-legged core: the middle leg carries the sum of both outer legs, up to leakage through air."""
    leg = 0.01
    bars = [fm.Part(fm.Box((0.05, leg, leg)), at(0, 0, z)) for z in (0.0, 0.03)]
    legs = [fm.Part(fm.Box((leg, leg, 0.02)), at(x, 0, leg)) for x in (-0.02, 0.0, 0.02)]
    core = fm.Body("core", "iron", (*bars, *legs), 0.005)
    coil = fm.CircularCoil("coil", 0.0075, 0.009, 0.012, 50.0, placement=at(0, 0, 0.02))
    table = np.array([200.0, 1e3, 1e4]), np.array([1.2, 1.6, 1.9])
    steel = fm.BHTable("steel", *table, "straight line to the origin", "slope mu0", 4775.0)
    state = fm.solve(fm.Device("d", "", (coil,), (core,), {"iron": steel}), [6.0])
    middle, left, right = (
        state.section_flux(plane([x, 0, 0.02], [0, 0, 1], (), [leg, leg, leg])) for x in (0.0, -0.02, 0.02)
    )
    assert middle.area == pytest.approx(leg**2, rel=1e-9)
    assert middle.flux == pytest.approx(-left.flux - right.flux, rel=0.02)
    assert left.flux == pytest.approx(right.flux, rel=5e-3)
    assert 0.9 < middle.flux_density < 2.0


@pytest.fixture(scope="module")
def thin_frame():
    """A frame of 3 mm, one element thick, and a coil around its lower bar; inner corners at x = +-17, z = 3, 37 mm."""
    outer, hole = fm.Box((0.04, 0.03, 0.04)), fm.Box((0.034, 0.04, 0.034))
    frame = fm.Body("frame", "iron", (fm.Part(outer), fm.Part(hole, at(0, 0, 0.003), "cut")), 0.006)
    about_x = fm.placed((0, 0, 0.0015), (0, 90, 0))
    coil = fm.CircularCoil("coil", 0.022, 0.026, 0.02, 100.0, placement=about_x)
    device = fm.Device("d", "", (coil,), (frame,), {"iron": fm.LinearMaterial("iron", 1000.0)})
    return {form: fm.solve_linear(device, form=form).at([1.0]) for form in ("potential", "flux")}


WALL = [0.0016, 0.02, 0.0016]


@pytest.mark.parametrize(
    ("corner", "beside"),
    [
        # The left wall from the lower inner corner on, and the lower bar from the same corner on.
        (plane([-0.0185, 0, 0.003], [0, 0, -1], (), WALL), plane([-0.0185, 0, 0.013], [0, 0, -1], (), WALL)),
        (plane([-0.017, 0, 0.0015], [1, 0, 0], (), WALL), plane([-0.007, 0, 0.0015], [1, 0, 0], (), WALL)),
        (plane([0.0185, 0, 0.037], [0, 0, 1], (), WALL), plane([0.0185, 0, 0.027], [0, 0, 1], (), WALL)),
    ],
)
def test_flux_at_an_inner_corner(thin_frame, corner, beside):
    """A cut at an inner corner passes the flux of a cut 10 mm further on, less one or two per cent that leave the wall
    between. The flux form, whose B has no divergence, gives the same ratio; B of the potential form, integrated over
    this cut, would give a fifth less."""
    found = {
        form: [state.section_flux(one) for one in (corner, beside)] for form, state in thin_frame.items()
    }
    ratio = {form: here.flux / there.flux for form, (here, there) in found.items()}
    assert ratio["potential"] == pytest.approx(1, abs=0.02)
    assert ratio["potential"] == pytest.approx(ratio["flux"], abs=2e-3)
    # The forms err to opposite sides; both state an error that covers their difference, and 3 % at most.
    for one, other in zip(*found.values(), strict=True):
        assert one.area == pytest.approx(9e-5)
        assert abs(one.flux - other.flux) < min(one.error, other.error) < 0.03 * one.flux


def test_a_section_that_ends_within_the_iron(thin_frame):
    """By symmetry half of a wall carries half. Its border is in the iron, so that the stated error is larger."""
    whole = plane([-0.0185, 0, 0.02], [0, 0, 1], (), WALL)
    half = plane([-0.0185, 0.0075, 0.02], [0, 0, 1], (), [0.002, 0.0075, 0.001])
    all_of, part = (thin_frame["potential"].section_flux(one) for one in (whole, half))
    assert part.area == pytest.approx(0.5 * all_of.area)
    assert part.flux == pytest.approx(0.5 * all_of.flux, rel=0.05)
    assert 3 * all_of.error < part.error < 0.3 * abs(part.flux)
