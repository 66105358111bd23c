"""Joints: thin gaps between bodies that touch."""

from itertools import permutations, product

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.optimize import brentq

import fieldmap as fm
from fieldmap.device.model import Body, Box, Device, ExtrudedPolygon, Part, RevolvedProfile, placed
from fieldmap.errors import GeometryError, InputError
from fieldmap.iron import HysteresisSolver, Pinning, generate_mesh
from fieldmap.iron.geometry import thin_gaps
from fieldmap.iron.mesh.joints import Sheet, open_sheets, with_rims
from fieldmap.iron.mesh.mesh import volumes
from fieldmap.iron.symmetry import find_symmetry
from fieldmap.iron.topology import build_faces

WIDTH, THICKNESS = 0.04, 0.01


def body(name, shape, position=(0.0, 0.0, 0.0), rotation=None, size=0.004, edge=None):
    parts = (Part(shape, placed(position, rotation or (0.0, 0.0, 0.0))),)
    return Body(name, "iron", parts, mesh_size=size, edge_size=edge)


def blocks(places, joints):
    """Boxes of 10 mm by 10 mm, by their names: place and length along x; a coil around them."""
    bodies = [body(name, Box((length, 0.01, 0.01)), place) for name, (place, length) in places.items()]
    coil = fm.CircularCoil("coil", 0.05, 0.052, 0.01, 100)
    return Device("blocks", "", [coil], bodies, {"iron": fm.LinearMaterial("iron", 100.0)}, joints=joints)


def c_core(joints=(), gap=0.0, size=0.004, edge=0.001, material=None):
    """Two legs on a base, and a bar on both; gap: drawn below the bar and cut out of the legs."""
    a, w, height = THICKNESS, WIDTH / 2, 0.03 - gap
    right = [(w, 0), (w, height), (w - a, height), (w - a, a)]
    outline = right + [(-x, y) for x, y in reversed(right)]
    base = body("base", ExtrudedPolygon(np.array(outline), a), (0, a / 2, 0), (90, 0, 0), size, edge)
    bar = body("bar", Box((WIDTH, a, a)), (0.0, 0.0, 0.03), None, size, edge)
    coil = fm.CircularCoil("coil", 0.0075, 0.0095, 0.012, 100, placement=placed((-w + a / 2, 0, 0.02)))
    section = fm.Section(
        "leg", np.array([w - a / 2, 0, 0.015]), np.array([0, 0, 1.0]), ("base",), [0.006] * 3
    )
    return Device(
        "core", "", [coil], [base, bar], {"iron": material or fm.LinearMaterial("iron", 1000.0)},
        sections=[section], joints=joints,
    )  # fmt: skip


JOINT = (fm.Joint(0.5e-3, ("base", "bar")),)


# ---- the mesh ----


@pytest.mark.parametrize("symmetry", ["none", "auto"])
def test_a_sheet_lies_between_the_bodies(symmetry):
    mesh = generate_mesh(c_core(JOINT), symmetry=symmetry)
    volume = volumes(mesh.points, mesh.tets)
    of_body = {name: volume[mesh.body == k].sum() for k, name in enumerate(mesh.body_names)}
    sheet = 2 * THICKNESS**2 * 0.5e-3
    assert volume.min() > 0
    assert (mesh.symmetry is not None) == (symmetry == "auto")
    # The gap is cut out of the legs, which end at the joint, not out of the bar.
    expected = {"base": 8e-6 - sheet, "bar": 4e-6, "base | bar": sheet}
    assert of_body == pytest.approx(expected, rel=1e-12)
    faces = build_faces(mesh.points, mesh.tets)
    assert faces.group_of_tet.max() == 0
    # The surface is closed: every edge belongs to two faces; and it encloses the whole volume.
    triangles = faces.nodes[faces.surface]
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    a, b, c = np.moveaxis(mesh.points[triangles], 1, 0)
    assert np.einsum("kd,kd->", a, np.cross(b, c)) / 6 == pytest.approx(12e-6, rel=1e-12)


def test_without_a_joint_the_mesh_is_as_before():
    plain, none = generate_mesh(c_core()), generate_mesh(c_core((fm.Joint(0.0),)))
    np.testing.assert_array_equal(plain.points, none.points)
    np.testing.assert_array_equal(plain.tets, none.tets)
    assert none.sheets == ()


def test_the_last_joint_that_names_a_pair_holds_it():
    joints = (fm.Joint(0.3e-3, ("b*", "base")), fm.Joint(0.1e-3), fm.Joint(0.2e-3, ("base", "bar"), mu_r=3.0))
    (sheet,) = generate_mesh(c_core(joints)).sheets
    assert (sheet.name, sheet.gap, sheet.mu_r) == ("base | bar", 0.2e-3, 3.0)
    (sheet,) = generate_mesh(c_core(joints[:2])).sheets
    assert sheet.gap == 0.3e-3


def test_a_joint_in_a_wall_of_symmetry_is_meshed_whole():
    halves = {"left": ((-0.01, 0, 0), 0.02), "right": ((0.01, 0, 0), 0.02)}
    mesh = generate_mesh(blocks(halves, [fm.Joint(1e-4)]), symmetry="auto")
    sheet = volumes(mesh.points, mesh.tets)[mesh.body == 2].sum()
    assert sheet == pytest.approx(1e-8, rel=1e-12)


def test_joints_that_differ_break_the_symmetry():
    legs = {f"leg {k}": ((x, 0, 0.01), 0.01) for k, x in ((1, -0.015), (2, 0.015))}
    bars, one = {"base": ((0, 0, 0), WIDTH), **legs}, fm.Joint(1e-4, ("leg 1", "base"))
    assert find_symmetry(blocks(bars, [fm.Joint(1e-4)])).order == 4
    assert find_symmetry(blocks(bars, [one])).order == 2
    mesh = generate_mesh(blocks(bars, [one]), symmetry="auto")
    assert [sheet.name for sheet in mesh.sheets] == ["base | leg 1"]
    assert volumes(mesh.points, mesh.tets)[mesh.body == 3].sum() == pytest.approx(1e-8, rel=1e-12)


def test_a_third_body_at_the_rim_closes_the_sheet_there():
    """Two blocks side by side on a third: the joint of the blocks ends in the edge that all three share."""
    upper = {"left": ((-0.005, 0, 0.01), 0.01), "right": ((0.005, 0, 0.01), 0.01)}
    three = {"base": ((0, 0, 0), 0.02), **upper}
    mesh = generate_mesh(blocks(three, [fm.Joint(1e-4, ("left", "right"))]))
    volume = volumes(mesh.points, mesh.tets)
    assert volume.min() > 0
    sheet = volume[mesh.body == 3].sum()
    # Half of the gap is missing in the lowest row of elements, 4 mm of 10 mm high.
    assert 0.75e-8 < sheet < 1e-8
    mesh = generate_mesh(blocks(three, [fm.Joint(1e-4)]))
    assert volumes(mesh.points, mesh.tets).min() > 0
    assert [sheet.name for sheet in mesh.sheets] == ["base | left", "base | right", "left | right"]


# ---- the field ----


def column(side, length, heights):
    """Points, tets and bodies of blocks that stand on each other: cubes of 1/2 side, each of six tets."""
    step = side / 2
    grid = np.stack(np.meshgrid(*[np.arange(n + 1) for n in (2, 2, length)], indexing="ij"), axis=-1)
    number = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    tets = []
    for corner in product(range(2), range(2), range(length)):
        for order in permutations(range(3)):
            way = np.array(corner) + np.vstack(
                [np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)]
            )
            tets.append(number[tuple(way.T)])
    tets = np.array(tets)
    points = step * grid.reshape(-1, 3)
    odd = volumes(points, tets) < 0
    tets[odd] = tets[odd][:, [0, 1, 3, 2]]
    body = np.searchsorted(np.array(heights) * step, points[tets].mean(axis=1)[:, 2])
    return points, tets, body


def test_the_layer_at_a_rim_lets_its_share_of_the_flux_pass_the_air():
    """Elements of the size h at a gap g of area A and rim P miss the share P g log(h / (g / 4)) / (pi A) of its flux,
    which passes the air. The layer is the h of a share of 2.5 %, and exp(20) g / 4 at most."""
    side, gaps = 0.01, (1e-4, 2e-5, 1e-6)
    points, tets, body = column(side, 8, (2, 4, 6))
    sheets = [Sheet(f"{k} | {k + 1}", (k, k + 1), gap, 1.0) for k, gap in enumerate(gaps)]
    sharp, layer = with_rims(points, tets, body, sheets, np.array([[0, 1]]), np.full(len(tets), 1e9))
    assert len(sharp) == 1 + 3 * 8
    outside = (np.abs(points[:, :2] - side / 2).max(axis=1) > 0.49 * side)[tets]
    expected = np.full(len(tets), 1e9)
    for k, gap in enumerate(gaps):
        at_rim = (outside & np.isclose(points[tets][:, :, 2], side * (k + 1))).any(axis=1)

        def passes(h, gap=gap):
            return 4 * side * gap * np.log(h / (gap / 4)) / (np.pi * side**2)

        expected[at_rim] = (
            gap / 4 * np.exp(20)
            if passes(gap / 4 * np.exp(20)) < 0.025
            else brentq(lambda h: passes(h) - 0.025, gap / 4, gap * np.exp(20))
        )
    assert layer == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("height", [-1.0, 0.0, 1.0])
def test_sheets_are_cut_out_of_a_body_wherever_the_device_stands(height):
    """A stack of three blocks, the middle twice as high: each sheet has the volume of its gap, one block has lost it,
    and the outside stays."""
    side, gaps = 0.01, (1e-4, 2e-4)
    points, tets, body = column(side, 8, (2, 6))
    points = points + [0.0, 0.0, height]
    sheets = [Sheet(f"{k} | {k + 1}", (k, k + 1), gap, 1.0) for k, gap in enumerate(gaps)]
    opened = open_sheets(points, tets, body, sheets, 3)
    volume = volumes(opened.points, opened.tets)
    assert volume[: len(tets)].min() > 0
    # Tets of sheets are oriented later.
    of_body = np.bincount(opened.body, np.abs(volume))
    assert of_body[3:] == pytest.approx(side**2 * np.array(gaps), rel=1e-9)
    assert of_body.sum() == pytest.approx(4 * side**3, rel=1e-12)
    # At each joint the smaller block makes room.
    assert of_body[:3] == pytest.approx(
        side**2 * np.array([side - gaps[0], 2 * side, side - gaps[1]]), rel=1e-9
    )


@pytest.mark.parametrize(
    ("lower", "upper", "heights", "out_of"),
    [
        # Both walls are alike, upright or slanted: the smaller block makes room.
        (0.0, 0.0, (6,), 1), (0.0, 0.0, (2,), 0), (0.5, 0.5, (6,), 1), (0.5, 0.5, (2,), 0), (0.5, 0.53, (6,), 1),
        # Only the upright block can slide along its walls.
        (0.0, 0.5, (6,), 0), (0.0, 0.5, (2,), 0), (0.5, 0.0, (6,), 1), (0.5, 0.0, (2,), 1),
    ],
)  # fmt: skip
def test_a_gap_is_cut_out_of_what_slides_along_its_walls(lower, upper, heights, out_of):
    """Two blocks; lower, upper: the shift of each along x per height."""
    side, gap = 0.01, 1e-4
    points, tets, body = column(side, 8, heights)
    above = points[:, 2] - 0.5 * side * heights[0]
    points[:, 0] += np.where(above > 0, upper, lower) * above
    opened = open_sheets(points, tets, body, [Sheet("0 | 1", (0, 1), gap, 1.0)], 2)
    now = np.bincount(opened.body, np.abs(volumes(opened.points, opened.tets)))
    lost = np.bincount(body, volumes(points, tets)) - now[:2]
    assert now[2] == pytest.approx(side**2 * gap, rel=1e-9)
    # Slanted walls bulge a little where their ends move.
    assert lost[out_of] == pytest.approx(now[2], rel=0.2)
    assert lost[1 - out_of] == pytest.approx(0.0, abs=1e-9 * side**3)


@pytest.fixture(scope="module")
def joined():
    return fm.solve_linear(c_core(JOINT, size=0.006, edge=0.003)).at([1.0])


@pytest.fixture
def gaps_as_air(monkeypatch):
    """Thin drawn gaps are meshed as air, not as the sheets that they are otherwise."""
    monkeypatch.setattr(thin_gaps, "THIN", 0.0)


def test_a_joint_is_the_gap_that_it_stands_for(gaps_as_air):
    """The same core with the gap drawn, both meshed alike: 0.2 % of flux and inductance."""
    drawn, joint = c_core(gap=1e-3), c_core((fm.Joint(1e-3, ("base", "bar")),))
    states = [fm.solve_linear(device).at([1.0]) for device in (drawn, joint)]
    flux, other = (state.section_flux("leg").flux for state in states)
    assert other == pytest.approx(flux, rel=2e-3)
    assert states[1].flux_linkage() == pytest.approx(states[0].flux_linkage(), rel=2e-3)


def test_a_saturated_joint_is_the_gap_that_it_stands_for(gaps_as_air):
    steel = fm.Froehlich("steel", 2000.0, 2.0)
    states = [
        fm.solve(c_core(joints, gap, 0.003, 0.0005, steel), [25.0])
        for joints, gap in ((JOINT, 0.0), ((), 0.5e-3))
    ]
    flux, other = (state.section_flux("leg").flux for state in states)
    assert np.abs(states[0].element_flux_density).max() > 1.5
    assert other == pytest.approx(flux, rel=2e-3)


def ring(gap, mu_r):
    """A ring of square section in two halves, eight coils around it."""
    inner, outer, height, coils = 0.03, 0.04, 0.01, 8
    whole = RevolvedProfile(np.array([[inner, 0], [outer, 0], [outer, height], [inner, height]]))
    cut = [Part(Box((0.1, 0.05, 0.02)), placed((0, y, -0.005)), "cut") for y in (-0.025, 0.025)]
    halves = [Body(f"half {k}", "iron", (Part(whole), cut[k]), mesh_size=0.003) for k in range(2)]
    around = []
    for k, angle in enumerate(2 * np.pi * (np.arange(coils) + 0.5) / coils):
        at = placed(
            (0.035 * np.cos(angle), 0.035 * np.sin(angle), height / 2), (-90.0, 0.0, np.degrees(angle))
        )
        around.append(fm.CircularCoil(f"coil_{k}", 0.0078, 0.0088, 0.014, 50, placement=at))
    joints = [fm.Joint(gap)] if gap else []
    return Device("ring", "", around, halves, {"iron": fm.LinearMaterial("iron", mu_r)}, joints=joints)


def flux_density_inside(state, points):
    """B (n, 3) at points in iron and sheets, not the mean of the element."""
    element = state.mesh.containing(points)
    corners = state.mesh.points[state.mesh.tets[element]]
    edges = np.swapaxes(corners[:, :3] - corners[:, 3:], 1, 2)
    three = np.linalg.solve(edges, (points - corners[:, 3])[:, :, None])[:, :, 0]
    barycentric = np.column_stack([three, 1 - three.sum(axis=1)])
    return np.einsum("c,cnd->nd", state.weights, state.iron.flux_density_at(element, barycentric))


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_a_ring_with_joints_obeys_amperes_law(form):
    """Two gaps of 1 um in a ring of mu_r 10 000 take a twelfth of the 400 A that its coils carry around."""
    gap, mu_r, count = 1e-6, 1e4, 4000
    state = fm.solve_linear(ring(gap, mu_r), form=form).at(np.ones(8))
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    circle = np.column_stack([0.035 * np.cos(angle), 0.035 * np.sin(angle), np.full(count, 0.005)])
    along = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(count)])
    step = 2 * np.pi * 0.035 / count
    iron = np.einsum("nd,nd->", flux_density_inside(state, circle), along) * step / (mu_r * mu_0)
    across = flux_density_inside(state, np.array([[0.035, gap / 2, 0.005], [-0.035, gap / 2, 0.005]]))[:, 1]
    air = (across[0] - across[1]) * gap / mu_0
    assert iron + air == pytest.approx(400.0, rel=1e-3)
    share = 2 * gap / (2 * gap + 2 * np.pi * 0.035 / mu_r)
    assert air == pytest.approx(400.0 * share, rel=1e-2)


def test_a_sheet_of_the_iron_itself_is_no_joint():
    joined = c_core((fm.Joint(0.5e-3, ("base", "bar"), mu_r=1000.0),))
    flux = [fm.solve_linear(device).at([1.0]).section_flux("leg").flux for device in (c_core(), joined)]
    assert flux[1] == pytest.approx(flux[0], rel=2e-3)


def test_symmetry_changes_nothing(joined):
    unused = fm.solve_linear(c_core(JOINT, size=0.006, edge=0.003), symmetry="none").at([1.0])
    assert joined.flux_linkage() == pytest.approx(unused.flux_linkage(), rel=2e-3)
    at = np.array([[0.0, 0.0, 0.02], [0.0, 0.01, 0.05]])
    np.testing.assert_allclose(joined.field(at), unused.field(at), atol=3e-3 * np.abs(unused.field(at)).max())


def test_the_circulation_of_the_field_is_the_current(joined):
    """Ampere's law along the middle of legs, base and bar, through both sheets."""
    leg, low, high, gap = WIDTH / 2 - THICKNESS / 2, THICKNESS / 2, 0.03 + THICKNESS / 2, 0.5e-3
    steps = (np.arange(200) + 0.5) / 200

    def line(start, end, permeability):
        start, end = (np.array([x, 0.0, z]) for x, z in (start, end))
        along = joined.field(start + steps[:, None] * (end - start)) @ (end - start)
        return along.mean() / (permeability * mu_0)

    joint = 0.03 - gap
    parts = [
        line((-leg, low), (-leg, joint), 1000),
        line((-leg, joint), (-leg, 0.03), 1),
        line((-leg, 0.03), (-leg, high), 1000),
        line((-leg, high), (leg, high), 1000),
        line((leg, high), (leg, 0.03), 1000),
        line((leg, 0.03), (leg, joint), 1),
        line((leg, joint), (leg, low), 1000),
        line((leg, low), (-leg, low), 1000),
    ]
    assert sum(parts) == pytest.approx(100.0, rel=5e-3)
    assert parts[1] + parts[5] > 80.0


def test_pieces_that_a_joint_holds_together_have_one_force(joined):
    assert joined.pieces_of_iron == (("base", "bar"),)
    on_coil = joined.force_on("coil")
    total = joined.force_on(["base", "bar"]) + on_coil
    assert np.abs(total).max() < 2e-2 * np.abs(on_coil).max()
    with pytest.raises(InputError):
        joined.force_on("base")


def test_hysteresis_passes_a_joint():
    steel = fm.Froehlich("steel", 2000.0, 2.0)
    device = c_core(JOINT, material=steel)
    solver = HysteresisSolver(device, Pinning(400.0))
    forth = solver.step([5.0], solver.demagnetised)
    back = solver.step([0.0], forth.memory)
    at = [[0.0, 0.0, 0.02]]
    assert 0 < np.linalg.norm(back.field(at)) < 0.5 * np.linalg.norm(forth.field(at))
    # The gap shears the loop: a closed core keeps more.
    closed = HysteresisSolver(c_core(material=steel), Pinning(400.0))
    kept = closed.step([0.0], closed.step([5.0], closed.demagnetised).memory)
    ratio = abs(back.section_flux("leg").flux / kept.section_flux("leg").flux)
    assert ratio < 0.5


def test_a_map_holds_the_joints(tmp_path):
    """A map equals the solution that it is made of, and differs from a map of the core without joints."""
    box = fm.WorkspaceBox(np.array([-0.004, -0.004, 0.045]), np.array([0.004, 0.004, 0.053]))
    device = c_core(JOINT, size=0.006, edge=0.006).replace(workspace=box)
    m = fm.open_map(fm.generate(device, tmp_path / "core.h5", spacing=2e-3))
    at = np.array([[0.001, 0.002, 0.05]])
    solved = fm.solve_linear(device).field(at, [1.0])
    np.testing.assert_allclose(m.field(at, [1.0]), solved, rtol=1e-3)
    without = fm.solve_linear(device.replace(joints=())).field(at, [1.0])
    assert np.abs(without - solved).max() > 0.1 * np.abs(solved).max()
    assert any("joint of 0.5 mm" in words for words in m.assumptions)


# ---- files and mistakes ----


def test_a_device_with_joints_is_written_and_read():
    joints = (fm.Joint(0.1e-3), fm.Joint(0.2e-3, ("b*", "bar"), mu_r=2.0, name="ends"))
    device = c_core(joints)
    again = fm.read_device(device.to_toml())
    assert again.joints == joints
    changed = fm.read_device(device.to_toml(), {"joint.ends.gap_mm": 0.4, "joint.1.gap_mm": 0.0})
    assert [joint.gap for joint in changed.joints] == [0.0, 0.4e-3]


def test_joints_of_nothing_are_refused():
    with pytest.raises(InputError) as told:
        c_core((fm.Joint(-1e-3), fm.Joint(1e-4, ("base", "roof")), fm.Joint(1e-4, mu_r=0.0), fm.Joint(1e-7)))
    assert len(told.value.problems) == 4
    apart = c_core((fm.Joint(1e-4, ("base", "bar")),), gap=0.5e-3)
    with pytest.raises(GeometryError) as told:
        fm.solve_linear(apart)
    assert len(told.value.problems) == 1
    with pytest.raises(InputError):
        fm.solve_linear(c_core(JOINT), form="surface")


def test_joints_less_permeable_than_air_take_the_flux_form():
    joints = (fm.Joint(0.1e-3, mu_r=0.01),)
    assert fm.solve_linear(c_core(joints)).report.form == "flux"
    with pytest.raises(InputError):
        fm.solve_linear(c_core(joints), form="potential")
    with pytest.raises(InputError):
        fm.solve(c_core(joints, material=fm.Froehlich("steel", 2000.0, 2.0)), [1.0])
