"""What levitates a magnet under a loop in air, against the field on a loop's axis; the six-coil unit against a linear
program."""

import numpy as np
import pytest
from scipy.constants import g, mu_0
from scipy.optimize import brentq, linprog

import fieldmap as fm
from fieldmap.errors import FieldmapError, Infeasible
from fieldmap.field import as_field
from fieldmap.levitation import find_equilibrium
from fieldmap.studies import run_study
from fieldmap.studies.equilibrium_area import equilibrium_area
from fieldmap.studies.variant_result import controllable_share, lowest_lift_height
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
    # A vertical dipole in a harmonic field: the three stiffnesses add up to nothing (Earnshaw).
    for axis in "xy":
        assert float(at[f"stiffness_{axis}"]) == pytest.approx(-vertical / 2, rel=1e-4)
    # While force is proportional to displacement, pi (f m g)^2 / (k_x k_y); here f = 1 %.
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
    """A harmonic field whose force on a unit moment is F = (-k_x x, -k_y y, LIFT - k_z z); b bends it along x."""
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
    """Six air coils on a ring: the share of the workspace in which a linear program finds currents."""
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
