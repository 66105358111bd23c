"""The surface form: bodies in uniform fields with closed forms, open and closed circuits, and its solution."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import eval_legendre

import fieldmap as fm
from fieldmap.device.surfaces import enclosed_volume
from fieldmap.errors import InputError
from fieldmap.iron.geometry.solids import glue_bodies
from fieldmap.iron.mesh import mesh as mesh_module
from fieldmap.iron.mesh import surface_mesh
from fieldmap.iron.mesh.mesh import generate_mesh, volumes
from fieldmap.iron.mesh.mesher import mesh_solids
from fieldmap.iron.mesh.surface_mesh import AIR, generate_surface
from fieldmap.iron.operators import assembled
from fieldmap.iron.sections import areas_above
from fieldmap.iron.solvers.surface import _enclosed_area
from fieldmap.sources import unit_flux_density
from tests.iron.shared import moments_of_two_spheres

RADIUS = 0.05
UP = np.array([0.0, 0.0, 1.0])
OUTSIDE = np.array([[0.06, 0, 0], [0, 0, 0.06], [0.04, 0.03, 0.04], [0.1, 0.02, 0.03], [0, 0.07, -0.02]])


def in_field(mu_r, *bodies, field=UP, **materials):
    """Solution of bodies, each of the permeability of its own name, in a uniform field of 1 T."""
    values = {
        body.name: value for body, value in zip(bodies, np.broadcast_to(mu_r, len(bodies)), strict=True)
    }
    kinds = {name: fm.LinearMaterial(name, float(value)) for name, value in values.items()} | materials
    used = {body.material: kinds[body.material] for body in bodies}
    return fm.solve_linear(
        fm.Device("d", "", (), bodies, used, background=fm.Background(field)), form="surface"
    )


def sphere(name, radius=RADIUS, height=0.0, size=0.009, cut=None):
    at = fm.Placement(np.array([0.0, 0.0, height]), np.eye(3))
    parts = (fm.Part(fm.Sphere(radius), at),) + ((fm.Part(fm.Sphere(cut), at, "cut"),) if cut else ())
    return fm.Body(name, name, parts, size)


def dipole(points, moment):
    r = np.linalg.norm(points, axis=1)[:, None]
    return (3 * points * (points @ moment)[:, None] / r**2 - moment) / r**3


def largest(difference, whole):
    return float((np.linalg.norm(difference, axis=1) / np.linalg.norm(whole, axis=1)).max())


@pytest.mark.parametrize("mu_r", [1e-4, 0.5, 2.0, 1e3, 1e6])
def test_sphere_outside_and_inside(mu_r):
    solution = in_field(mu_r, sphere("ball"))
    exact = UP + dipole(OUTSIDE, (mu_r - 1) / (mu_r + 2) * RADIUS**3 * UP)
    assert largest(solution.field(OUTSIDE, []) - exact, exact) < 1e-3
    inside = 3 * mu_r / (mu_r + 2) * UP
    assert solution.field([[0.0, 0.0, 0.0], [0.01, 0.02, -0.02]], []) == pytest.approx(
        np.tile(inside, (2, 1)), abs=2e-3 * inside[2]
    )
    assert solution.flux_density("ball", []) == pytest.approx(inside, abs=1e-3 * inside[2])
    net = solution.state.density[0] @ solution.state.faces.areas
    assert abs(net) < 1e-5 * np.abs(solution.state.density[0]) @ solution.state.faces.areas


def test_sphere_converges():
    """Third order in the element size, so 3/2 in the number of faces; the bound leaves room for irregular meshes."""
    exact = dipole(OUTSIDE, RADIUS**3 * 999 / 1002 * UP)
    error, faces = [], []
    for size in (0.024, 0.008):
        solution = in_field(1e3, sphere("ball", size=size))
        error.append(np.linalg.norm(solution.field(OUTSIDE, []) - UP - exact))
        faces.append(solution.report.surface_faces)
    assert np.log(error[0] / error[1]) / np.log(faces[1] / faces[0]) > 1.0


def test_shell_shields():
    """The hollow is 1/40 of the applied field; a/b = 0.8, mu_r 1000 (Jackson 5.121)."""
    mu, ratio = 1000.0, 0.8
    exact = 9 * mu / ((2 * mu + 1) * (mu + 2) - 2 * ratio**3 * (mu - 1) ** 2)
    solution = in_field(mu, sphere("shell", cut=ratio * RADIUS, size=0.008))
    hollow = np.array([[0, 0, 0.0], [0.02, 0, 0], [0, 0.01, 0.02]])
    assert solution.field(hollow, []) == pytest.approx(np.tile(exact * UP, (3, 1)), abs=1e-3 * exact)


def test_coated_sphere_of_two_materials():
    """An inner sphere of mu_r 5 in a coat of mu_r 50, with flux through their common face."""
    inner, mu_i, mu_o = 0.03, 5.0, 50.0
    bodies = sphere("inner", inner, size=0.012), sphere("coat", cut=inner, size=0.012)
    solution = in_field([mu_i, mu_o], *bodies)
    fill = (inner / RADIUS) ** 3
    factor = ((mu_o - 1) * (mu_i + 2 * mu_o) + fill * (mu_i - mu_o) * (1 + 2 * mu_o)) / (
        (mu_o + 2) * (mu_i + 2 * mu_o) + 2 * fill * (mu_i - mu_o) * (mu_o - 1)
    )
    exact = UP + dipole(OUTSIDE, factor * RADIUS**3 * UP)
    assert largest(solution.field(OUTSIDE, []) - exact, exact) < 2e-3
    core = 9 * mu_i * mu_o / ((mu_o + 2) * (mu_i + 2 * mu_o) + 2 * fill * (mu_i - mu_o) * (mu_o - 1))
    assert solution.flux_density("inner", [])[2] == pytest.approx(core, rel=5e-3)
    assert solution.report.magnetic_bodies == 1


def field_of_two_spheres(points, multipoles, distance):
    """B (n, 3) by differences of the potential over 2e-6 of the radius, right to some 1e-9."""

    def potential(x):
        value = -x[:, 2]
        for centre, sign in ((0.0, 1.0), (distance, -1.0)):
            from_centre = x - [0.0, 0.0, centre]
            r = np.linalg.norm(from_centre, axis=1)
            for n, a in enumerate(multipoles, start=1):
                value = value + sign ** (n + 1) * a * eval_legendre(n, from_centre[:, 2] / r) / r ** (n + 1)
        return value

    steps = 1e-6 * np.eye(3)
    return np.stack([(potential(points - e) - potential(points + e)) / 2e-6 for e in steps], axis=1)


@pytest.mark.parametrize("mu_r", [1e8, 1e3, 1e-9])
def test_two_spheres_beside_each_other(mu_r):
    """Half a radius apart, in a field along their axis: moment of each, and the field around and between them."""
    apart = 2.5
    exact = moments_of_two_spheres(mu_r, apart)
    solution = in_field(mu_r, sphere("lower", size=0.011), sphere("upper", height=apart * RADIUS, size=0.011))
    faces = solution.state.faces
    charge = solution.state.density[0] * faces.areas
    lower = faces.centres[:, 2] < apart * RADIUS / 2
    moment = charge[lower] @ faces.centres[lower]
    assert moment == pytest.approx(
        4 * np.pi * RADIUS**3 * exact[0] * UP, abs=1e-3 * abs(4 * np.pi * RADIUS**3)
    )
    points = np.array(
        [[1.2, 0, 0], [0, 0, 1.25], [0.4, 0, 1.25], [0, 1.4, 2.5], [0, 0, 3.7], [0.8, 0.6, 1.25]]
    )
    wanted = field_of_two_spheres(points, exact, apart)
    error = np.abs(solution.field(RADIUS * points, []) - wanted).max()
    assert error < 1e-3 * np.linalg.norm(wanted, axis=1).max()


def test_a_ball_cut_in_two_of_one_material_is_the_ball():
    """Faces between bodies of one material carry nothing, and B crosses them."""
    half = (
        fm.Part(fm.Sphere(RADIUS)),
        fm.Part(fm.Box((0.2, 0.2, 0.1)), fm.Placement(-0.1 * UP, np.eye(3)), "cut"),
    )
    low = (fm.Part(fm.Sphere(RADIUS)), fm.Part(fm.Box((0.2, 0.2, 0.1)), operation="cut"))
    solution = in_field(100.0, fm.Body("upper", "upper", half, 0.009), fm.Body("lower", "lower", low, 0.009))
    exact = UP + dipole(OUTSIDE, 99 / 102 * RADIUS**3 * UP)
    assert largest(solution.field(OUTSIDE, []) - exact, exact) < 2e-3
    assert solution.flux_density("upper", []) == pytest.approx(300 / 102 * UP, abs=2e-2)
    with pytest.raises(InputError) as raised:
        solution.force_on("upper", [])
    assert "'lower'" in raised.value.problems[0].remedy
    assert solution.force_on(["upper", "lower"], []) == pytest.approx(np.zeros(3), abs=1e-3)


@pytest.mark.parametrize("mu_r", [1.0, 1.05, 3.0])
def test_magnetised_sphere(mu_r):
    """Remanence and recoil permeability: polarisation 3 Br / (mu_r + 2); a dipole outside, uniform inside."""
    magnet = fm.PermanentMagnet("ball", np.array([0.0, 0.0, 1.2]), mu_r)
    device = fm.Device("d", "", (), (sphere("ball"),), {"ball": magnet})
    solution = fm.solve_linear(device, form="surface")
    polarisation = 3 * 1.2 / (mu_r + 2)
    exact = dipole(OUTSIDE, polarisation * RADIUS**3 / 3 * UP)
    assert largest(solution.field(OUTSIDE, []) - exact, exact) < 2e-3
    assert solution.at([]).polarisation([0.0, 0.01, 0.0]) == pytest.approx(polarisation * UP, abs=3e-3)


@pytest.mark.parametrize(("mu_r", "exact"), [(1e8, 3.644305190268), (1e-9, -1.638415711)])
def test_polarisability_of_a_cube(mu_r, exact):
    """Published: Helsing and Perfekt, Appl. Comput. Harmon. Anal. 34 (2013) 445."""
    cube = fm.Body("cube", "cube", (fm.Part(fm.Box((1.0, 1.0, 1.0))),), 0.25, 0.01)
    solution = in_field(mu_r, cube)
    state = solution.state
    moment = (state.density[0] * state.faces.areas) @ state.faces.centres
    assert moment[2] == pytest.approx(exact, rel=1e-3)
    assert moment[:2] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_the_volume_is_not_meshed(monkeypatch):
    """Neither for a box nor for a surface of triangles; both are the same body."""
    monkeypatch.setattr(mesh_module, "generate_mesh", None)
    size = 0.02
    box = fm.Body("cube", "cube", (fm.Part(fm.Box((size, size, size))),), 0.006)
    corners = size * np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])
    stl = fm.Body("cube", "cube", (fm.Part(fm.TriangleSurface(corners, triangles)),), 0.006)
    fields = []
    for body in (box, stl):
        device = fm.Device(
            "d", "", (), (body,), {"cube": fm.LinearMaterial("cube", 100.0)}, background=fm.Background(UP)
        )
        mesh = mesh_solids(glue_bodies(device), device, 1.0, surface_only=True)
        assert mesh.elements.shape[1] == 3
        assert len(mesh.elements) > 50
        solution = fm.solve_linear(device, form="surface")
        assert solution.report.tetrahedra == 0
        fields.append(solution.field([[0.0, 0.0, 0.03], [0.02, 0.01, 0.01]], []))
    assert fields[1] == pytest.approx(fields[0], rel=1e-3, abs=1e-3)


def test_surface_mesh_bounds_the_bodies_of_the_volume_mesh():
    """The same volumes after rounding, closed, layers at the edges; a triangle between bodies has both on its sides."""
    parts = (fm.Part(fm.Sphere(0.02)), fm.Part(fm.Box((0.1, 0.1, 0.1)), operation="cut"))
    bodies = (
        fm.Body("cap", "iron", parts, 0.006, 0.0005),
        fm.Body("block", "iron", (fm.Part(fm.Box((0.05, 0.05, 0.01))),), 0.009),
    )
    device = fm.Device("d", "", (), bodies, {"iron": fm.LinearMaterial("iron", 10.0)})
    surface, mesh = generate_surface(device), generate_mesh(device)
    tets = volumes(mesh.points, mesh.tets)
    for name in surface.body_names:
        triangles = surface.around(surface.solids_of(name))
        whole = tets[mesh.body == mesh.body_names.index(name)].sum()
        assert enclosed_volume(surface.points, triangles) == pytest.approx(whole, rel=1e-4)
        edges = np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        assert {(a, b) for a, b in edges.tolist()} == {(b, a) for a, b in edges.tolist()}
    assert surface.pieces.tolist() == [0, 0]
    assert set(map(tuple, surface.sides.tolist())) == {(0, AIR), (1, AIR), (0, 1)} or (1, 0) in map(
        tuple, surface.sides.tolist()
    )


def test_triangles_that_the_mesher_turns_inwards_are_turned_back(monkeypatch):
    body = fm.Body("block", "iron", (fm.Part(fm.Box((0.03, 0.02, 0.01))),), 0.01)
    device = fm.Device("d", "", (), (body,), {"iron": fm.LinearMaterial("iron", 10.0)})
    own = surface_mesh.mesh_solids

    def inward(*given, **more):
        mesh = own(*given, **more)
        elements, solids = mesh.elements.copy(), mesh.solids.copy()
        elements[::2], solids[::2] = elements[::2, ::-1], solids[::2, ::-1]
        return replace(mesh, elements=elements, solids=solids)

    monkeypatch.setattr(surface_mesh, "mesh_solids", inward)
    surface = generate_surface(device)
    assert (surface.sides == [0, AIR]).all()
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(6e-6, rel=1e-9)
    corners = surface.points[surface.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = np.array([0.0, 0.0, 0.005])
    assert (np.einsum("nd,nd->n", normal, corners.mean(axis=1) - middle) > 0).all()


def test_shadow_of_a_disk_half_a_millimetre_from_a_winding():
    """Behind the disk its field cancels all but a twentieth of the coil's field. The error is a share of the coil's
    field; it is 4 % with the coil's potential at the corners of triangles alone."""
    body = fm.Body("disk", "iron", (fm.Part(fm.Cylinder(0.066, 0.006)),), 0.011, 0.001)
    at = fm.Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
    coil = fm.CircularCoil("coil", 0.011, 0.021, 0.039, 840.0, placement=at)
    device = fm.Device("d", "", (coil,), (body,), {"iron": fm.LinearMaterial("iron", 4000.0)})
    ours, theirs = (fm.solve_linear(device, form=form) for form in ("surface", "potential"))
    behind = np.array([[0.0, 0.0, -0.01], [0.03, 0.0, -0.01], [0.0, 0.05, -0.01], [0.0, 0.0, -0.03]])
    coil_alone = unit_flux_density(coil, behind)
    assert largest(ours.field(behind, [1.0]) - theirs.field(behind, [1.0]), coil_alone) < 4e-3


@pytest.mark.parametrize("level", [-0.7, -0.2, 0.0, 0.5, 0.9])
def test_what_a_plane_cuts_out_of_a_closed_surface(level):
    """A turned regular octahedron of half-diagonal 1: its section normal to a diagonal has the area 2 (1 - h)^2."""
    turn, _ = np.linalg.qr(np.random.default_rng(7).standard_normal((3, 3)))
    axes = np.vstack([np.eye(3), -np.eye(3)])
    faces = np.array([[i, j, k] for i in (0, 3) for j in (1, 4) for k in (2, 5)])
    corners = axes[faces] @ turn.T + 5.0
    a, b, c = np.moveaxis(corners - 5.0, 1, 0)
    inward = np.einsum("nd,nd->n", np.cross(b - a, c - a), a) < 0
    corners[inward] = corners[inward][:, [0, 2, 1]]
    height = (corners - 5.0) @ turn[:, 2] - level
    assert _enclosed_area(corners, height, turn[:, 2]) == pytest.approx(2 * (1 - abs(level)) ** 2, rel=1e-9)
    assert _enclosed_area(corners, -height, -turn[:, 2]) == pytest.approx(2 * (1 - abs(level)) ** 2, rel=1e-9)
    # The flux of a uniform field through the section equals the flux through the surface on either side.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / np.sqrt(3)
    flux = areas_above(corners, height) @ (normal @ turn[:, 2])
    assert flux == pytest.approx(2 * (1 - abs(level)) ** 2, rel=1e-9)


def window(mu_r, size=0.016):
    """A closed iron window about 80 mm long on each side, with a coil around one limb."""
    hole = fm.Placement(np.array([0.0, 0.0, -0.01]), np.eye(3))
    parts = (fm.Part(fm.Box((0.1, 0.1, 0.02))), fm.Part(fm.Box((0.06, 0.06, 0.04)), hole, "cut"))
    along_y = np.column_stack([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).astype(float)
    at = fm.Placement(np.array([0.04, 0.0, 0.01]), along_y)
    coil = fm.CircularCoil("coil", 0.017, 0.022, 0.03, 100.0, placement=at)
    body = fm.Body("window", "iron", (fm.Part(fm.Box((0.1, 0.1, 0.02))), parts[1]), size, 0.006)
    return fm.Device("window", "", (coil,), (body,), {"iron": fm.LinearMaterial("iron", mu_r)})


@pytest.fixture(scope="module")
def closed():
    return {form: fm.solve_linear(window(1000.0), form=form) for form in ("surface", "potential")}


def turns_around(state):
    """Integral of the total H along the middle line of the window, A."""
    n = 200
    share = ((np.arange(n) + 0.5) / n)[:, None]
    around = 0.04 * np.array([[1.0, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]])
    turns = 0.0
    for start, end in zip(around, np.roll(around, -1, axis=0), strict=True):
        x = start + share * (end - start) + [0.0, 0.0, 0.0103]
        strength = state.field(x) - state.polarisation(x)
        turns += float(strength.sum(axis=0) @ (end - start)) / n / (4e-7 * np.pi)
    return turns


def test_closed_circuit_obeys_ampere(closed):
    """Around the window, through the iron, the total H integrates to the coil's ampere-turns."""
    assert turns_around(closed["surface"].at([1.0])) == pytest.approx(100.0, rel=1e-3)


def test_closed_circuit_of_two_materials_obeys_ampere():
    """A window of two halves of different permeability: what holds at faces towards the air does not hold at the faces
    that the halves share."""
    one = window(300.0)
    (whole,) = one.bodies
    away = [
        fm.Part(fm.Box((0.1, 0.2, 0.06)), fm.Placement(np.array([x, 0.0, -0.02]), np.eye(3)), "cut")
        for x in (-0.05, 0.05)
    ]
    halves = [
        replace(whole, name=name, material=name, parts=(*whole.parts, cut))
        for name, cut in zip(("good", "poor"), away, strict=True)
    ]
    materials = {"good": fm.LinearMaterial("good", 300.0), "poor": fm.LinearMaterial("poor", 50.0)}
    device = replace(one, bodies=tuple(halves), materials=materials)
    state, other = (fm.solve_linear(device, form=form).at([1.0]) for form in ("surface", "potential"))
    assert turns_around(state) == pytest.approx(100.0, rel=2e-3)
    for name in materials:
        theirs = other.flux_density(name)
        assert state.flux_density(name) == pytest.approx(theirs, abs=0.04 * np.linalg.norm(theirs))


def test_closed_circuit_beside_the_potential_form(closed):
    surface, potential = closed["surface"], closed["potential"]
    assert surface.inductance() == pytest.approx(potential.inductance(), rel=1e-2)
    outside = np.array([[-0.07, 0.0, 0.01], [0.0, 0.0, 0.01], [0.0, 0.08, 0.01], [0.04, 0.0, 0.05]])
    ours, theirs = surface.field(outside, [1.0]), potential.field(outside, [1.0])
    assert largest(ours - theirs, theirs) < 5e-3
    limb = fm.Section("limb", (-0.04, 0.01, 0.01), (0.0, 1.0, 0.0), half_widths=(0.02, 0.05, 0.05))
    both = fm.Section("both", (0.0, 0.01, 0.01), (0.0, 1.0, 0.0))
    area = surface.section_flux(both, [1.0]).area
    assert area == pytest.approx(8e-4, rel=1e-9)
    # Nearly all flux through one limb returns through the other.
    whole = abs(potential.section_flux(limb, [1.0]).flux)
    ours, theirs = (closed[form].section_flux(both, [1.0]) for form in ("surface", "potential"))
    assert ours.flux == pytest.approx(theirs.flux, abs=5e-3 * whole)
    assert ours.error is None
    assert 1e-3 * whole < theirs.error < 0.05 * whole
    with pytest.raises(InputError):
        surface.section_flux(limb, [1.0])


@pytest.fixture(scope="module")
def open_circuit():
    device = fm.read_device("loop_and_sphere")
    return {form: fm.solve_linear(device, form=form) for form in ("surface", "potential")}


def test_sphere_and_coil_against_the_closed_form_of_its_file(open_circuit):
    device, unit = fm.read_device("loop_and_sphere"), open_circuit["surface"]
    for known in device.references:
        ours = (
            unit.field(known.at, known.currents)[2]
            if known.quantity == "Bz"
            else unit.gradient(known.at, known.currents)[2, 2]
        )
        assert ours == pytest.approx(known.value, rel=5e-4)


@pytest.mark.parametrize("axis", range(3))
def test_taylor_of_the_field(open_circuit, axis):
    unit = open_circuit["surface"]
    points = np.array([[0.0, 0.0, -0.014], [0.003, 0.002, -0.016], [0.02, -0.01, 0.0]])
    step = np.eye(3)[axis]
    slope = unit.gradient(points, [2.0])[:, :, axis]
    remainder = [
        np.abs(unit.field(points + h * step, [2.0]) - unit.field(points, [2.0]) - h * slope).max()
        for h in (1e-3, 5e-4, 2.5e-4)
    ]
    assert np.log2(remainder[0] / remainder[1]) > 1.8
    assert np.log2(remainder[1] / remainder[2]) > 1.8


def test_linkage_of_weak_iron():
    """The inductance that iron of mu_r 3 adds, against the potential form's integral over the volume."""
    device = fm.read_device("loop_and_sphere")
    added = [fm.solve_linear(device, mu_r=3.0, form=form).iron_linkage for form in ("surface", "potential")]
    assert added[0] == pytest.approx(added[1], rel=5e-4)


def test_forces_energies_and_limits_of_the_solution(open_circuit):
    surface, potential = open_circuit["surface"], open_circuit["potential"]
    (name,) = (body.name for body in fm.read_device("loop_and_sphere").bodies)
    force = surface.force_on(name, [1.0])
    assert force == pytest.approx(potential.force_on(name, [1.0]), rel=2e-3, abs=2e-3 * np.abs(force).max())
    assert surface.force_on(surface.coil_names, [1.0]) == pytest.approx(
        -force, rel=1e-3, abs=1e-3 * np.abs(force).max()
    )
    assert surface.inductance() == pytest.approx(potential.inductance(), rel=1e-4)
    assert surface.flux_density(name, [1.0])[2] == pytest.approx(
        potential.flux_density(name, [1.0])[2], rel=1e-3
    )
    centre = surface.surface.points.mean(axis=0)
    with pytest.raises(InputError):
        surface.gradient(centre, [1.0])
    with pytest.raises(InputError):
        surface.flux_density("nothing", [1.0])
    assert len(surface.outlines()) == 2


def test_matrices_that_do_not_fit_are_refused_before_they_are_made(monkeypatch):
    assert assembled.memory_bytes() is None or assembled.memory_bytes() > 1e6
    monkeypatch.setattr(assembled, "memory_bytes", lambda: 1e6)
    with pytest.raises(InputError) as raised:
        in_field(10.0, sphere("ball"))
    assert "GB" in raised.value.problems[0].received
