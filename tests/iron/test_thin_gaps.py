"""Gaps of the drawing that are thin against the elements."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Sphere, placed
from fieldmap.iron import generate_mesh
from fieldmap.iron.elements.potential_form import vacuum
from fieldmap.iron.geometry.thin_gaps import closed_gaps
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import volumes
from fieldmap.iron.report import thin_gap_warnings
from fieldmap.iron.topology import build_faces

SIDE, HEIGHT = 0.02, 0.01
MATERIALS = {
    "iron": fm.LinearMaterial("iron", 1e4),
    "magnet": fm.PermanentMagnet("magnet", np.array([0, 0, 1.0]), 1.0),
}


def block(name, size, position, material="iron", mesh=0.004, edge=None, turned=(0.0, 0.0, 0.0)):
    return Body(name, material, (Part(Box(size), placed(position, turned)),), mesh, edge)


def magnet_above_plate(gap, mesh=0.004, edge=5e-4, shift=0.0, turned=(0.0, 0.0, 0.0)):
    magnet = block("magnet", (SIDE, SIDE, HEIGHT), (shift, 0, gap), "magnet", mesh, edge, turned)
    plate = block("plate", (0.06, 0.06, 0.02), (0, 0, -0.02), mesh=0.008)
    return Device("magnet above a plate", "", [], [magnet, plate], MATERIALS)


def force_of_two_magnets(distance):
    """Cuboids of 1 T along z, one above the other: G. Akoun, J.-P. Yonnet, IEEE Trans. Magn. 20 (1984) 1962."""
    a, c, total = SIDE / 2, HEIGHT / 2, 0.0
    for i, j, k, m, p, q in product((0, 1), repeat=6):
        u, v = a * ((-1) ** j - (-1) ** i), a * ((-1) ** m - (-1) ** k)
        w = HEIGHT + distance + c * ((-1) ** q - (-1) ** p)
        r = np.sqrt(u * u + v * v + w * w)
        term = -u * w * np.log(r - u) - v * w * np.log(r - v) + u * v * np.arctan2(u * v, r * w) - r * w
        total += (-1) ** (i + j + k + m + p + q) * term
    return abs(total) / (4 * np.pi * mu_0)


def test_the_closed_form_is_that_of_dipoles_far_away():
    moment = SIDE**2 * HEIGHT / mu_0
    dipoles = 3 * mu_0 * moment**2 / (2 * np.pi * 0.51**4)
    assert force_of_two_magnets(0.5) == pytest.approx(dipoles, rel=5e-3)


@pytest.mark.parametrize("gap", [3e-4, 1e-5, 1e-6])
def test_holding_force_is_that_of_the_magnet_and_its_image(gap):
    state = fm.solve_linear(magnet_above_plate(gap, 0.005, 1e-3)).at([])
    on_magnet, on_plate = (state.force_on(name) for name in ("magnet", "plate"))
    expected = force_of_two_magnets(2 * gap)
    assert -on_magnet[2] == pytest.approx(expected, rel=1e-2)
    assert np.abs(on_magnet[:2]).max() < 1e-3 * expected
    assert np.abs(on_magnet + on_plate).max() < 1e-3 * expected
    assert state.pieces_of_iron == (("magnet",), ("plate",))
    assert any("sheet" in words for words in state.assumptions)


@pytest.mark.parametrize("symmetry", ["auto", "none"])
def test_bodies_stay_where_they_are_drawn(symmetry):
    gap = 1e-5
    mesh = generate_mesh(magnet_above_plate(gap), symmetry=symmetry)
    volume = volumes(mesh.points, mesh.tets)
    assert volume.min() > 0
    expected = {"magnet": SIDE**2 * HEIGHT, "plate": 0.06**2 * 0.02, "magnet | plate": SIDE**2 * gap}
    of_body = {name: volume[mesh.body == k].sum() for k, name in enumerate(mesh.body_names)}
    assert of_body == pytest.approx(expected, rel=1e-9)
    magnet = mesh.points[mesh.tets[mesh.body == 0]].reshape(-1, 3)
    assert [magnet[:, 2].min(), magnet[:, 2].max()] == pytest.approx([gap, gap + HEIGHT], abs=1e-12)
    assert (mesh.symmetry is not None) == (symmetry == "auto")
    apart = build_faces(mesh.points, mesh.without_drawn_sheets().tets)
    assert apart.group_of_tet.max() == 1


def test_symmetry_changes_nothing():
    device = magnet_above_plate(1e-5)
    forces = [fm.solve_linear(device, symmetry=use).at([]).force_on("magnet")[2] for use in ("auto", "none")]
    assert forces[0] == pytest.approx(forces[1], rel=1e-2)


@pytest.mark.parametrize("form", ["potential", "flux"])
@pytest.mark.parametrize("gap", [1e-5, 1e-6])
def test_pads_below_a_magnet_converge(form, gap):
    """A thin pad is pulled less than a thick plate. These solves once stopped at a residual of 1e-6."""
    magnet = block("magnet", (SIDE, SIDE, HEIGHT), (0, 0, gap), "magnet", 0.004, 1e-3)
    pad = block("pad", (SIDE, SIDE, 0.002), (0, 0, -0.002), mesh=0.004, edge=1e-3)
    state = fm.solve_linear(Device("pad", "", [], [magnet, pad], MATERIALS), form=form).at([])
    assert state.report.residual < 1e-6
    pull = state.force_on("pad")[2]
    assert 0 < pull < force_of_two_magnets(2 * gap)
    assert state.force_on("magnet")[2] == pytest.approx(-pull, rel=1e-2)


def test_a_drawn_gap_is_the_joint_that_it_looks_like():
    """A bar on a block with coil, the gap drawn, against a joint of the same width at the place of contact."""

    def device(drawn, joints=()):
        lower = block("lower", (0.01, 0.01, 0.02), (0, 0, -0.02))
        upper = block("upper", (0.01, 0.01, 0.02 - (0.0 if joints else drawn)), (0, 0, drawn))
        coil = fm.CircularCoil("coil", 0.009, 0.011, 0.01, 100)
        return Device("bars", "", [coil], [lower, upper], MATERIALS, joints=joints)

    # On meshes of the device's own sizes both are off by 1e-3.
    gap, finer = 2e-4, 1.3
    drawn = fm.solve_linear(device(gap), refinement=finer).at([1.0])
    joint = fm.solve_linear(device(0.0, (fm.Joint(gap),)), refinement=finer).at([1.0])
    assert drawn.flux_linkage() == pytest.approx(joint.flux_linkage(), rel=1e-3)


def test_a_gap_with_a_joint_elsewhere():
    gap, joint = 1e-5, 1e-4
    foot = block("foot", (0.06, 0.06, 0.01), (0, 0, -0.03), mesh=0.01)
    device = magnet_above_plate(gap)
    device = device.replace(bodies=(*device.bodies, foot), joints=(fm.Joint(joint),))
    mesh = generate_mesh(device)
    assert [(sheet.name, sheet.drawn) for sheet in mesh.sheets] == [
        ("magnet | plate", True),
        ("plate | foot", False),
    ]
    volume = volumes(mesh.points, mesh.tets)
    found = [volume[mesh.body == 3 + k].sum() for k in range(2)]
    assert found == pytest.approx([SIDE**2 * gap, 0.06**2 * joint], rel=1e-9)
    assert volume.min() > 0


def test_elements_at_the_rim_of_a_sheet_are_softer_by_their_width():
    """Its permeability is g / h; h is the altitude of the element's triangle on the longest side, g the thickness."""
    gap = 1e-5
    mesh = generate_mesh(magnet_above_plate(gap), symmetry="none")
    air = vacuum(SimpleNamespace(mesh=mesh, topology=build_faces(mesh.points, mesh.tets)))
    softer = np.flatnonzero(air.law)
    assert len(softer) > 10
    assert (mesh.body[softer] == 2).all()
    for element in softer:
        flat = np.unique(np.round(mesh.points[mesh.tets[element], :2], 9), axis=0)
        a, b, c = flat
        longest = max(np.linalg.norm(b - a), np.linalg.norm(c - a), np.linalg.norm(c - b))
        width = abs(np.linalg.det([b - a, c - a])) / longest
        (found,), _ = air.tables.flux_density(np.array([1.0]), air.law[[element]])
        assert found == pytest.approx(min(1.0, gap / width), rel=1e-3)


# ---- which gaps ----


def closed(*bodies):
    field = fm.Background(np.array([0, 0, 1.0]))
    return closed_gaps(Device("gaps", "", [], bodies, MATERIALS, background=field))


def made(name, *parts):
    return Body(name, "iron", parts, 0.004)


def test_gaps_that_are_closed():
    def pairs(*bodies):
        found = closed(*bodies)
        return None if found is None else set(found.gaps)

    def cube(name, z, x=0.0, **more):
        return block(name, (0.01, 0.01, 0.01), (x, 0, z), **more)

    low = cube("low", 0)
    assert pairs(low, cube("high", 0.0101)) == {(0, 1)}
    assert pairs(low, cube("high", 0.0101, x=0.005)) == {(0, 1)}
    # The bodies touch, are far apart, face each other with an edge only, or slant.
    assert pairs(low, cube("high", 0.01)) is None
    assert pairs(low, cube("high", 0.0115)) is None
    assert pairs(low, cube("high", 0.0101, x=0.0101)) is None
    assert pairs(low, cube("high", 0.0102, turned=(0.5, 0, 0))) is None
    # A stack closes towards the largest body; a slug that would have to move both ways closes one end only.
    assert pairs(low, cube("middle", 0.0101), cube("high", 0.0203)) == {(0, 1), (1, 2)}
    hole, bore = Box((0.03, 0.01, 0.03)), Box((0.0104, 0.0104, 0.01))
    frame = made("frame", Part(Box((0.05, 0.01, 0.05))), Part(hole, placed((0, 0, 0.01)), "cut"))
    collar = made("collar", Part(Box((0.03, 0.03, 0.01))), Part(bore, placed((0, 0, 0)), "cut"))
    assert pairs(low, collar) is None
    slug = block("slug", (0.01, 0.01, 0.0298), (0, 0, 0.0101))
    assert len(pairs(frame, slug) or ()) <= 1
    # Both feet of a yoke stand on one gap; a slug in a slot has a gap on either side, and neither is closed.
    slot = Part(Box((0.0102, 0.01, 0.01)), placed((0, 0, 0)), "cut")
    yoke = made("yoke", Part(Box((0.03, 0.01, 0.02))), slot)
    assert pairs(yoke, block("keeper", (0.03, 0.01, 0.01), (0, 0, -0.0101))) == {(0, 1)}
    assert pairs(yoke, block("slug", (0.01, 0.01, 0.008), (0, 0, 0))) is None
    # A ring round both that touches neither is no hindrance. A ball that the moved body would meet is one, at any place
    # of its way; a ball that it just misses is not.
    ring = made("ring", Part(fm.Ring(0.012, 0.016, 0.03), placed((0, 0, -0.005))))
    assert pairs(low, cube("high", 0.0101), ring) == {(0, 1)}
    base = block("base", (0.03, 0.01, 0.03), (0.015, 0, -0.03))
    feet = tuple(Part(Box((0.01, 0.01, 0.01)), placed((x, 0, 1e-4))) for x in (0.02, 0.05))

    def with_ball(radius, x, z):
        return pairs(base, made("bar", *feet), made("ball", Part(Sphere(radius), placed((x, 0, z)))))

    assert with_ball(0.005, 0.05, -0.005) is None
    assert with_ball(0.005, 0.05, -0.005 + 5e-5) is None
    assert with_ball(0.005, 0.05, -0.005 - 5e-5) == {(0, 1)}
    assert with_ball(1e-5, 0.02, 5e-5) is None


def test_moves_are_those_of_whole_pieces():
    """Two blocks that touch move together."""
    low = block("low", (0.03, 0.03, 0.02), (0, 0, 0))
    left = block("left", (0.01, 0.01, 0.01), (-0.005, 0, 0.0201))
    right = block("right", (0.01, 0.01, 0.01), (0.005, 0, 0.0201))
    moves = closed(low, left, right).moves
    np.testing.assert_allclose(moves, [[0, 0, 0], [0, 0, -1e-4], [0, 0, -1e-4]], atol=1e-12)


def test_gaps_that_are_not_meshed_as_sheets_are_told():
    """A plunger in a bore, with a gap of a thirtieth of the element size, and with a wide gap."""

    def warnings(gap):
        ring = made("ring", Part(fm.Ring(0.006 + gap, 0.012, 0.01)))
        plunger = made("plunger", Part(Cylinder(0.006, 0.01)))
        coil = fm.CircularCoil("coil", 0.02, 0.022, 0.01, 100)
        report = fm.solve_linear(Device("bore", "", [coil], [ring, plunger], MATERIALS)).report
        return [words for words in report.assumptions if words.startswith("warning")]

    (told,) = warnings(1e-4)
    assert "ring" in told
    assert "plunger" in told
    assert warnings(3e-3) == []


def facing(gap, shift=0.0, angle=0.0, names=("one", "other"), body=(0, 1), sign=1.0):
    """Warnings of two triangles with legs of 10 mm, one above the other, that face each other where sign is 1."""
    low = 0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    middle = low.mean(axis=0)
    high = (low[[0, 2, 1]] - middle) @ turn.T + middle + [shift, 0, gap]
    nodes = np.array([[0, 1, 2], [3, 4, 5]])
    faces = ChargedFaces.from_nodes(np.vstack([low, high]), nodes if sign > 0 else nodes[:, [0, 2, 1]])
    topology = SimpleNamespace(owner=np.array([[0, -1], [1, -1]]), surface=np.arange(2))
    mesh = SimpleNamespace(body=np.array(body), body_names=names)
    return thin_gap_warnings(SimpleNamespace(surface=faces, topology=topology, mesh=mesh))


def test_thin_gaps_are_told_by_the_faces_that_look_at_each_other():
    """A gap is thin below a fifth of the side of a square of twice the face's area, here 10 mm, between faces that are
    opposite within half of their radius and at less than 25 degrees."""
    radius = 0.01 * np.hypot(2, 1) / 3
    (told,) = facing(1.9e-3)
    assert "faces of 'one' and 'other' lie 1.9 mm apart, a thin gap for elements of 10 mm" in told
    (slot,) = facing(1e-3, names=("one",), body=(0, 0))
    assert "faces of 'one' lie 1 mm apart" in slot
    for thin, *about in (
        (False, 2.1e-3),
        # Seen from inside the iron the space between the faces is a sheet of iron.
        (False, 1e-3, 0.0, 0.0, ("one", "other"), (0, 1), -1.0),
        (True, 1e-3, 0.49 * radius),
        (False, 1e-3, 0.51 * radius),
        (True, 1e-3, 0.0, np.radians(25.0)),
        (False, 1e-3, 0.0, np.radians(26.5)),
    ):
        assert len(facing(*about)) == thin
