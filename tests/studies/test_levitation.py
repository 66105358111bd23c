"""Levitation of a magnet under a loop in air against the field on the loop's axis; the six-coil unit against
linear programs."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g, mu_0
from scipy.optimize import brentq, linprog

import fieldmap as fm
from fieldmap.errors import FieldmapError, Infeasible
from fieldmap.field import as_field
from fieldmap.levitation import find_equilibrium
from fieldmap.sources import CoilSet
from fieldmap.studies import read_study, run_study, variant_result
from fieldmap.studies.equilibrium_area import area_outline, equilibrium_area
from fieldmap.studies.variant_result import controllable_share, lowest_lift_height
from tests.conftest import DEVICES
from tests.levitation.conftest import PolynomialField, lifting_above, slope_on_axis
from tests.refusals import refused

A, WEIGHT, MOMENT = 0.044, 0.010 * g, 0.8
LIFT = 0.1

STUDY = """
format = 1
title = "Turns of a loop that carries a magnet"
device = "thin_loop.toml"

[[vary]]
name = "turns"
key = "coil.loop.turns"
values = [500, 1000]

[[currents]]
name = "carries"
carries_at_mm = [0, 0, -90]

[[currents]]
name = "2 A"
amperes_A = 2.0

[record]
points_mm = [[0, 0, -90]]
"""


def curvature(z, turns):
    """d2Bz/dz2 on the axis."""
    return -1.5 * mu_0 * turns * A**2 * ((A**2 + z**2) ** -2.5 - 5 * z**2 * (A**2 + z**2) ** -3.5)


@pytest.fixture(scope="module")
def run(devices, tmp_path_factory):
    return run_study(devices.study("loop.toml", STUDY), tmp_path_factory.mktemp("loop") / "loop.nc")


def place(at):
    return [float(at[f"equilibrium_{axis}"]) for axis in "xyz"]


@pytest.mark.parametrize("turns", [500, 1000])
def test_lift_current_stiffness_and_area(run, turns):
    at = run.data.sel(turns=turns, currents="carries")
    current = WEIGHT / (MOMENT * slope_on_axis(-0.09, turns=turns))
    assert float(at.common_current) == pytest.approx(current, rel=1e-4)
    np.testing.assert_allclose(at.force_per_ampere[0], [0, 0, WEIGHT / current], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(place(at), [0, 0, -0.09], atol=1e-9)
    vertical = -MOMENT * current * curvature(-0.09, turns)
    assert float(at.stiffness_z) == pytest.approx(vertical, rel=1e-4)
    # A vertical dipole in a harmonic field: the three stiffnesses sum to zero (Earnshaw).
    for axis in "xy":
        assert float(at[f"stiffness_{axis}"]) == pytest.approx(-vertical / 2, rel=1e-4)
    # For a force proportional to displacement the area is pi (f m g)^2 / (k_x k_y); here f = 1 %.
    ellipse = np.pi * (0.01 * WEIGHT / (vertical / 2)) ** 2
    assert float(at.equilibrium_area) == pytest.approx(ellipse, rel=2e-3)


def test_given_currents_have_their_own_equilibrium(run):
    at = run.data.sel(turns=1000, currents="2 A")
    z = brentq(lambda z: 2.0 * MOMENT * slope_on_axis(z) - WEIGHT, -0.124, -0.05)
    np.testing.assert_allclose(place(at), [0, 0, z], atol=2e-6)
    assert float(at.common_current) == 2.0


def test_reach_is_where_the_limit_lifts_the_weight(run):
    for turns in (500, 1000):
        z = brentq(lambda z, n=turns: 3.0 * MOMENT * slope_on_axis(z, turns=n) - WEIGHT, -0.2, -0.05)
        heights = run.data.reach_height.sel(turns=turns, currents=["carries", "2 A"])
        np.testing.assert_allclose(heights, max(z, -0.124), rtol=2e-5)


def test_more_turns_do_what_more_current_does(run):
    common = run.data.common_current.sel(currents="carries")
    assert float(common.sel(turns=500)) == pytest.approx(2 * float(common.sel(turns=1000)), rel=1e-9)
    for name, share in (("stiffness_z", 1.0), ("equilibrium_area", 1.0), ("force_per_ampere", 0.5)):
        few, many = (run.data[name].sel(turns=turns, currents="carries").values for turns in (500, 1000))
        np.testing.assert_allclose(few, share * many, rtol=1e-6, atol=1e-12)


def springs(kx, ky, b=0.0):
    """A harmonic field with the force F = (-k_x x, -k_y y, LIFT - k_z z) on a unit moment; b adds curvature along x."""
    g = np.zeros((4, 3))
    g[2, 0], g[0, 2], g[3, 0], g[1, 2] = -kx / 2, -ky / 2, b / 3, -b
    return PolynomialField([lifting_above(g, LIFT)], np.full(3, -0.05), np.full(3, 0.05))


def area(field, share):
    payload = fm.Payload(mass=LIFT / g, moment=1.0)
    found = find_equilibrium(field, [1.0], payload, start=[0, 0, 0])
    return equilibrium_area(as_field(field), found, payload, share)


@pytest.mark.parametrize(("k_x", "bound"), [(2.0, 1e-4), (0.5, 1e-3)])
def test_area_of_springs_is_an_ellipse(k_x, bound):
    assert area(springs(k_x, 3.0), 0.05) == pytest.approx(np.pi * 0.005**2 / (3.0 * k_x), rel=bound)


def test_area_of_bent_springs_is_that_of_a_fine_grid():
    edge = np.linspace(-0.012, 0.012, 1201)
    x, y = np.meshgrid(edge, edge, indexing="ij")
    inside = np.hypot(-2.0 * x + 150.0 * (x**2 - y**2), -2.0 * y - 300.0 * x * y) < 0.004
    counted = inside[np.hypot(x, y) < 0.008].sum() * (edge[1] - edge[0]) ** 2
    assert area(springs(2.0, 2.0, b=150.0), 0.04) == pytest.approx(counted, rel=5e-3)


@pytest.mark.parametrize(
    ("k", "share", "must_hold"), [((-1.0, 3.0), 0.05, "stable"), ((0.05, 0.05), 0.1, "workspace")]
)
def test_no_area_without_horizontal_stability_or_room(k, share, must_hold):
    with refused(FieldmapError, must_hold=must_hold):
        area(springs(*k), share)


def test_reach_says_how_much_is_missing(devices):
    device = fm.read_device(devices.loop)
    field = as_field(fm.solve_linear(device), device.bounds)
    with pytest.raises(Infeasible, match=r"0\.\d+ of the weight"):
        lowest_lift_height(field, np.array([0.01]), device.payload, np.zeros(3))
    reach = lowest_lift_height(field, np.array([100.0]), device.payload, np.zeros(3))
    assert reach == device.workspace.lower[2]


def test_controllable_share_is_that_of_linear_programs():
    """Six air coils on a ring: the share of the workspace where a linear program finds currents."""
    limit = 12.0
    device = fm.read_device("drive_unit_a3")
    unit = fm.solve_linear(type(device)(name="air", title="air", coils=device.coils))
    lower, upper = np.array([-0.02, -0.02, -0.14]), np.array([0.02, 0.02, -0.076])
    axes = [a + (np.arange(n) + 0.5) / n * (b - a) for a, b, n in zip(lower, upper, (7, 7, 9), strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = device.payload.moment * unit.unit_fields(points)[1][:, :, 2, :]
    wanted = np.array([0.0, 0.0, device.payload.mass * g])
    how = {"b_eq": 1e3 * wanted, "bounds": [(-limit, limit)] * 6}
    held = [linprog(np.zeros(6), A_eq=1e3 * rows[:, k].T, **how).status == 0 for k in range(len(points))]
    ours = controllable_share(unit, device.payload, lower, upper, limit)
    assert ours == np.mean(held)
    assert 0.1 < ours < 0.9


SIDES = [(0, -1), (0, 1), (1, -1), (1, 1)]


class Elsewhere:
    """Springs whose rest is away from the middle of a box."""

    place, coil_names = np.array([0.002, -0.001, 0.003]), ("one",)

    def __init__(self, field, lower, upper):
        self.inner, self.lower, self.upper = field, np.array(lower), np.array(upper)

    def field(self, points, currents):
        return self.inner.field(np.asarray(points) - self.place, currents)

    def gradient(self, points, currents):
        return self.inner.gradient(np.asarray(points) - self.place, currents)


def outline(side=None, room=0.0):
    """The outline at 5 mN with springs of 2 and 3 N/m: 2.5 mm and 5/3 mm; room: distance to one side of the box, m."""
    lower, upper = Elsewhere.place - 0.05, Elsewhere.place + 0.05
    if side is not None:
        axis, sense = side
        (lower if sense < 0 else upper)[axis] = Elsewhere.place[axis] + sense * room
    field = as_field(Elsewhere(springs(2.0, 3.0), lower, upper))
    payload = fm.Payload(mass=LIFT / g, moment=1.0)
    found = find_equilibrium(field, [1.0], payload, start=Elsewhere.place)
    return area_outline(field, found, payload, 0.05)


def test_the_outline_of_an_area_is_where_the_force_reaches_the_limit():
    radii, rays = outline()
    angle = np.arange(64) * np.pi / 32
    np.testing.assert_allclose(rays, np.column_stack([np.cos(angle), np.sin(angle)]), atol=1e-12)
    np.testing.assert_allclose(radii, 0.005 / np.hypot(2 * np.cos(angle), 3 * np.sin(angle)), rtol=2e-5)


@pytest.mark.parametrize("side", SIDES)
def test_the_outline_stays_in_the_workspace(side):
    reach = (0.0025, 0.005 / 3)[side[0]]
    assert outline(side, 1.01 * reach)[0].max() == pytest.approx(0.0025, rel=2e-5)
    with refused(
        FieldmapError, where="equilibrium_area", must_hold="0.05 of the weight inside the workspace"
    ):
        outline(side, 0.99 * reach)


class Lifting:
    """Coils with given force per ampere, N/A, on an upward moment of 1 A m^2, and a constant force without current."""

    def __init__(self, coils, constant):
        self.coils, self.constant, self.points = coils, constant, None

    def unit_fields(self, points):
        self.points = points
        slope = np.zeros((len(self.coils), len(points), 3, 3))
        for k, force in enumerate(self.coils):
            slope[k, :, 2] = np.array([force(*point) for point in points])
        return None, slope

    def constant_fields(self, points):
        slope = np.zeros((len(points), 3, 3))
        slope[:, 2] = self.constant
        return None, slope


UP = [lambda x, y, z: (0.0, 0.0, z)]
# Two coils whose horizontal forces cancel at equal currents.
PAIR = [lambda x, y, z: (2.0, y, 0.5 * z), lambda x, y, z: (-2.0, -y, 0.5 * z)]
BESIDE = [*UP, lambda x, y, z: (1.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("coils", "constant", "share"),
    [
        (UP, (0, 0, 0), 6 / 9),
        (PAIR, (0, 0, 0), 6 / 9),
        (UP, (0, 0, 1.0), 7 / 9),
        (UP, (0, 0, -1.0), 5 / 9),
        (UP, (0, 0, 3.2), 1.0),
        (UP, (0.5, 0, 0), 0.0),
        ([lambda x, y, z: (1.0, 0.0, z)], (0, 0, 0), 0.0),
        (BESIDE, (0.99, 0, 0), 6 / 9),
        (BESIDE, (1.01, 0, 0), 0.0),
        ([lambda x, y, z: (0.0, 0.0, 9.0 * (x > 0.2))], (0, 0, 0), 5 / 7),
        ([lambda x, y, z: (0.0, 0.0, 9.0 * (y > 3.1))], (0, 0, 0), 6 / 7),
    ],
)
def test_controllable_share_counts_cells(coils, constant, share):
    """A weight of 3.2 N and at most 1 A, at the centres of 7 x 7 x 9 cells, with heights of 0.5 m to 8.5 m."""
    field = Lifting(coils, constant)
    payload = fm.Payload(mass=3.2 / 9.80665, moment=1.0)
    found = controllable_share(field, payload, np.array([0.0, 3.0, 0.0]), np.array([0.7, 3.7, 9.0]), 1.0)
    assert found == pytest.approx(share)
    for axis, centres in enumerate(
        (0.05 + 0.1 * np.arange(7), 3.05 + 0.1 * np.arange(7), 0.5 + np.arange(9.0))
    ):
        np.testing.assert_allclose(np.unique(field.points[:, axis].round(9)), centres)


def test_reach_of_a_loop(devices):
    """For either sign of the current; messages name the share carried; a lift at every height gives the lower end."""
    device = fm.read_device(devices.loop)
    field = as_field(fm.solve_linear(device), device.bounds)
    exact = brentq(lambda z: 3.0 * MOMENT * slope_on_axis(z) - WEIGHT, -0.2, -0.05)
    exact = max(exact, -0.124)
    for current in (3.0, -3.0):
        reach = lowest_lift_height(field, np.array([current]), device.payload, np.zeros(3))
        assert reach == pytest.approx(exact, abs=1e-6)
    one = brentq(lambda z: 1.0 * MOMENT * slope_on_axis(z) - WEIGHT, -0.2, -0.05)
    assert lowest_lift_height(field, np.array([1.0]), device.payload, np.zeros(3)) == pytest.approx(
        one, abs=2e-6
    )
    # The lift of 0.01 A is largest at the upper end, -40 mm.
    most = 0.01 * MOMENT * slope_on_axis(-0.04) / WEIGHT
    with refused(Infeasible, where="reach", received="with 0.01 A") as caught:
        lowest_lift_height(field, np.array([-0.01]), device.payload, np.zeros(3))
    assert float(caught.value.problems[0].received.split()[0]) == pytest.approx(most, rel=2e-3)


PAIRED = """
format = 1
title = "Two coils by hand"
device = "pair_that_lifts.toml"
vary = [{ name = "turns", key = "coil.lower.turns", values = [200] }]
currents = [{ name = "carries", carries_at_mm = [1, 2, -1], shares = [2, -1] }, { name = "given", amperes_A = [3, -1] }]

[record]
quantities = ["currents", "field", "force_per_ampere", "reach", "power", "homogeneity", "inductance"]
points_mm = [[1, 2, -1], [-3, 4, 5]]
box_mm = [[-1, -2, -3], [3, 2, 1]]
"""
LIFTED = """
[payload]
mass_g = 12.0
moment_A_m2 = 0.5

[driver]
gain_A_per_V = 1.0
current_limit_A = 5.0
"""


def test_every_number_of_two_coils_by_hand(devices, tmp_path):
    text = (DEVICES / "pair.toml").read_text().replace("turns = 100\n", "turns = 100\nresistance_ohm = 2.0\n")
    text = text.replace("turns = 200\n", "turns = 200\nresistance_ohm = 3.0\n") + LIFTED
    (devices.folder / "pair_that_lifts.toml").write_text(text)
    data = run_study(devices.study("paired.toml", PAIRED), tmp_path / "paired.nc").data.isel(turns=0)
    coils = CoilSet(fm.read_device(text).coils)
    points, weight = np.array([[0.001, 0.002, -0.001], [-0.003, 0.004, 0.005]]), 0.012 * 9.80665

    def lift(currents, point):
        return 0.5 * coils.gradient(np.array(point), np.array(currents))[2, 2]

    # The mean of the shares is 1; the current carries the weight.
    shares = np.array([4 / 3, -2 / 3])
    common = weight / lift(shares, points[0])
    box = np.stack(
        np.meshgrid(*(np.linspace(a, b, 5) for a, b in ((-1, 3), (-2, 2), (-3, 1))), indexing="ij"), -1
    )
    for name, currents in (("carries", common * shares), ("given", np.array([3.0, -1.0]))):
        at = data.sel(currents=name)
        np.testing.assert_allclose(at.current, currents, rtol=1e-6)
        assert float(at.common_current) == pytest.approx(np.abs(currents).mean(), rel=1e-6)
        np.testing.assert_allclose(at.flux_density, coils.field(points, currents), rtol=1e-6, atol=1e-12)
        force = 0.5 * coils.gradient(points, currents)[:, 2]
        np.testing.assert_allclose(
            at.force_per_ampere, force / np.abs(currents).mean(), rtol=1e-6, atol=1e-12
        )
        assert float(at.power) == pytest.approx(2.0 * currents[0] ** 2 + 3.0 * currents[1] ** 2, rel=1e-6)
        flux = coils.field(1e-3 * box.reshape(-1, 3), currents)
        apart = np.linalg.norm(flux - flux.mean(axis=0), axis=1) / np.linalg.norm(flux.mean(axis=0))
        assert float(at.inhomogeneity) == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-5)
        assert float(at.largest_inhomogeneity) == pytest.approx(apart.max(), rel=1e-5)
        np.testing.assert_allclose(at.inductance, fm.solve_linear(fm.read_device(text)).inductance())
        # With the larger current at its limit of 5 A, above the carried place or the middle of the box.
        over = points[0, :2] if name == "carries" else [0.0, 0.0]
        at_limit = currents * 5.0 / np.abs(currents).max()
        heights = np.linspace(-0.012, 0.012, 33)

        def missing(z, over=over, currents=at_limit):
            return abs(lift(currents, [*over, z])) - weight

        k = [missing(z) >= 0.0 for z in heights].index(True)
        lowest = brentq(missing, *heights[k - 1 : k + 1]) if k else heights[0]
        assert float(at.reach_height) == pytest.approx(lowest, abs=2e-6)
    assert float(data.sel(currents="given").reach_height) > -0.012
    assert data.attrs["current_limit_A"] == "5.0"
    assert data.attrs["force_share"] == "0.01"
    assert "copper at 20 C" in data.attrs["assumptions"]
    assert data.attrs["assumptions"].startswith("the payload is a vertical point dipole")


ERRORS = """
format = 1
title = "Meshes"
device = "sphere.toml"
iron = { model = "saturating", accuracy = 0.03, refinement = 0.5 }
vary = [{ name = "turns", key = "coil.loop.turns", values = [100] }]
currents = [{ name = "one", amperes_A = 1.0 }, { name = "two", amperes_A = 2.0 }]
record = { quantities = ["error"] }
"""


@pytest.mark.parametrize(("falls", "meshes"), [(2, 3), (4, 2), (0, 6)])
def test_meshes_are_refined_until_the_worst_error_is_small_enough(devices, monkeypatch, falls, meshes):
    """By 1.4 each time, at most six times: the larger error of two currents is 10 % at first and falls by a power."""
    seen = []

    class Made:
        surface_faces, field = 7, SimpleNamespace(assumptions=("made up",))

        def __init__(self, device, model):
            seen.append(model.refinement)

        def error(self, currents):
            flux = 0.05 * currents[0] * (seen[-1] / 0.5) ** -falls
            return SimpleNamespace(flux_density=flux, gradient=2 * flux)

    monkeypatch.setattr(variant_result, "SolvedIron", Made)
    of = read_study(devices.study("errors.toml", ERRORS))
    task = variant_result.Task(of.variants[0].document, of.current_sets, of.iron, of.record)
    found = variant_result.solve_variant(task)
    np.testing.assert_allclose(seen, 0.5 * 1.4 ** np.arange(meshes))
    if falls:
        errors = [0.05 * current * 1.4 ** (-falls * (meshes - 1)) for current in (1, 2)]
        assert errors[1] <= 0.03 < 1.4**falls * errors[1]
        numbers = [{"error_flux_density": e, "error_gradient": 2 * e, "surface_faces": 7} for e in errors]
        for row, exact in zip(found.rows, numbers, strict=True):
            assert row.numbers == pytest.approx(exact)
        assert found.assumptions == ("made up",)
        return
    for row in found.rows:
        assert row.numbers == {}
        assert "received 0.1, 0.1, 0.1, 0.1, 0.1, 0.1;" in row.problems[0]
        assert "0.03 within 6 refinements" in row.problems[0]
