"""Equilibrium and lift current of soft iron, against the force itself."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.placement import rotation_matrix
from fieldmap.errors import Infeasible, InputError, NoEquilibrium, OutsideMapError
from fieldmap.field import as_field
from fieldmap.levitation import (
    GRAVITY,
    find_equilibrium,
    lift_current,
    magnet_balance,
    stationary_points,
)
from fieldmap.levitation.places import search_grid
from fieldmap.lookup import magnetic_body
from fieldmap.sources import CoilSet
from tests.refusals import refused

COIL = fm.CircularCoil("coil", inner_radius=0.01, outer_radius=0.02, height=0.02, turns=500)
BOX = np.array([-0.008, -0.008, -0.04]), np.array([0.008, 0.008, -0.005])
BEAD = fm.Payload(2.6e-4, pieces=[fm.SoftSphere(4e-3, fm.material("steel_a3"))])


@pytest.fixture(scope="module")
def field():
    return as_field(CoilSet((COIL,), BOX))


def test_a_bead_floats_where_its_weight_is_carried(field):
    found = find_equilibrium(field, 10.0, BEAD)
    bead = magnetic_body(BEAD)
    force = bead.wrench(field, found.position, 10.0)[:3]
    np.testing.assert_allclose(force, [0.0, 0.0, BEAD.mass * GRAVITY], atol=1e-7 * BEAD.mass * GRAVITY)
    np.testing.assert_allclose(found.position[:2], 0.0, atol=1e-8)
    steps = 1e-5 * np.eye(3)
    ahead, behind = (bead.wrench(field, found.position + s * steps, 10.0)[:, :3] for s in (1, -1))
    exact = -(ahead - behind).T / 2e-5
    np.testing.assert_allclose(found.stiffness, exact, atol=1e-4 * np.abs(exact).max())
    # Braunbek: a body that is drawn to strong fields is never stable.
    assert found.trace < 0.0
    np.testing.assert_allclose(found.moment, bead.induced_moment(field, found.position, 10.0)[0], rtol=1e-12)
    assert found.angle_to_field == pytest.approx(0.0, abs=1e-4)
    assert any("soft sphere of 4 mm" in words for words in found.assumptions)


def test_what_one_dipole_leaves_out_of_a_bead(field):
    """A result by one dipole states its error, here found with six dipoles."""
    six = replace(BEAD, soft_level=2)
    coarse, fine = (find_equilibrium(field, 10.0, bead) for bead in (BEAD, six))
    moved = np.linalg.norm(fine.position - coarse.position)
    assert coarse.volume_error == pytest.approx(moved, rel=0.05)
    assert 1e-5 < moved < 1e-3
    assert fine.volume_error == 0.0
    at = np.array([0.0, 0.0, -0.012])
    coarse, fine = (lift_current(field, bead, at) for bead in (BEAD, six))
    assert abs(coarse.volume_error) == pytest.approx(abs(fine.current - coarse.current), rel=0.05)


@pytest.mark.parametrize("depth", [0.012, 0.02])
def test_the_current_that_carries_a_bead(field, depth):
    at = np.array([0.0, 0.0, -depth])
    found = lift_current(field, BEAD, at)
    weight = BEAD.mass * GRAVITY
    assert found.force[2] == pytest.approx(weight, rel=1e-8)
    bead, step = magnetic_body(BEAD), 1e-4 * found.current
    ahead, behind = (bead.wrench(field, at, found.current + s * step)[:3] for s in (1, -1))
    np.testing.assert_allclose(found.force_per_ampere, (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-9)
    # Far from saturation the force goes with the square of the current.
    assert found.force_per_ampere[2] == pytest.approx(2 * weight / found.current, rel=1e-6)
    assert find_equilibrium(field, found.currents, BEAD, start=at).position == pytest.approx(at, abs=1e-7)


def test_a_magnet_among_pieces_points_as_its_rotation_says(field):
    sphere = fm.MagnetSphere(3e-3, 1.2)
    pieces = [fm.PayloadPiece(sphere, fm.Placement((0.0, 0.0, 0.0), rotation_matrix((180.0, 0.0, 0.0))))]
    found = find_equilibrium(field, -10.0, fm.Payload(2e-3, pieces=pieces))
    alone = find_equilibrium(field, -10.0, fm.Payload(2e-3, magnet=sphere, direction="down"))
    assert found.held == alone.held == "moment down, fixed"
    np.testing.assert_allclose(found.position, alone.position, atol=1e-7)
    np.testing.assert_allclose(found.moment, alone.moment, rtol=1e-12, atol=1e-12)
    with refused(NoEquilibrium, remedy="rotation of the pieces"):
        find_equilibrium(field, -10.0, fm.Payload(2e-3, pieces=[sphere]))
    with refused(InputError, where="Payload(direction)"):
        find_equilibrium(field, -10.0, fm.Payload(2e-3, pieces=[sphere], direction="down"))


def test_one_stationary_point_below_a_coil(field):
    found = stationary_points(field, 10.0, BEAD, -0.025, samples=8)
    assert found.complete
    assert [point.kind for point in found.points] == ["stable"]


def test_refusals(field):
    with refused(InputError, where="find_equilibrium(moment)"):
        find_equilibrium(field, 10.0, BEAD, moment="aligned")
    above = CoilSet((COIL,), (np.array([-0.008, -0.008, 0.03]), np.array([0.008, 0.008, 0.05])))
    with pytest.raises(Infeasible) as caught:
        lift_current(above, BEAD, [0.0, 0.0, 0.04])
    assert caught.value.problems[0].remedy


SPHERE = fm.MagnetSphere(8e-3, 1.3)
SPHERE_MOMENT = 1.3 / mu_0 * np.pi / 6 * 8e-3**3


def off_centre(offset, mass=5e-3):
    return fm.Payload(mass, pieces=[fm.PayloadPiece(SPHERE, fm.Placement(tuple(offset)))])


# For the last two the centre lies outside the map's box of 32 mm width and 40 mm height.
@pytest.mark.parametrize(
    "offset", [(0.004, -0.002, 0.003), (0.012, 0, 0), (0, 0, 0.03), (0, 0, -0.03), (0.05, 0, 0)]
)
def test_a_magnet_off_centre_floats_where_a_dipole_floats(offset):
    """The magnet must not be evaluated beyond the box of the map."""
    m, alone = fm.open_map("sample"), fm.Payload(5e-3, magnet=SPHERE)
    at = find_equilibrium(m, 12.0, alone)
    found = find_equilibrium(m, 12.0, off_centre(offset))
    np.testing.assert_allclose(found.position, at.position - offset, atol=1e-8)
    np.testing.assert_allclose(found.stiffness, at.stiffness, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.field, at.field, rtol=1e-6, atol=1e-9)
    again = find_equilibrium(m, 12.0, off_centre(offset), start=at.position - offset)
    np.testing.assert_allclose(again.position, found.position, atol=1e-8)
    place = np.array([0.0, 0.0, -0.1])
    lifted = lift_current(m, off_centre(offset), place - offset)
    assert lifted.current == pytest.approx(lift_current(m, alone, place).current, rel=1e-6)
    points = stationary_points(m, 12.0, off_centre(offset), -0.1 - offset[2], samples=4).points
    (dipole,) = stationary_points(m, 12.0, alone, -0.1, samples=4).points
    np.testing.assert_allclose([p.position for p in points], [dipole.position - offset], atol=1e-8)


def test_pieces_off_centre_where_a_polynomial_balances(axisymmetric):
    """B_z = 2 c2 z + 3 c3 z^2 on the axis carries the weight at z = (m g / (D i) - 2 c2) / (6 c3)."""
    c2, c3, weight, offset = 0.1, 1.0, off_centre([0, 0, 0]).mass * GRAVITY, np.array([0.013, 0.005, 0.13])
    z = (weight / SPHERE_MOMENT - 2 * c2) / (6 * c3)
    found = find_equilibrium(axisymmetric((0.0, c2, c3)), 1.0, off_centre(offset))
    np.testing.assert_allclose(found.position, [0, 0, z] - offset, atol=1e-9)


def test_pieces_that_do_not_fit_into_the_map():
    m = fm.open_map("sample")
    pair = [fm.PayloadPiece(SPHERE, fm.Placement((x, 0, 0))) for x in (-0.017, 0.017)]
    with refused(InputError, where="payload"):
        find_equilibrium(m, 12.0, fm.Payload(1e-2, pieces=pair))
    box, wide = "(32, 32, 40)", "(34, 0, 0)"
    with refused(InputError, received=f"they extend over {wide} mm, the box over {box} mm"):
        lift_current(m, fm.Payload(1e-2, pieces=pair), [0.0, 0.0, -0.1])
    start = [0.0, 0.0, -0.1]
    with refused(OutsideMapError, where="find_equilibrium(start)"):
        find_equilibrium(m, 12.0, off_centre([0.02, 0, 0]), start=start)
    with refused(OutsideMapError, where="lift_current(position)"):
        lift_current(m, off_centre([0.02, 0, 0]), start)
    with refused(OutsideMapError, where="stationary_points(window)"):
        stationary_points(m, 12.0, off_centre([0.02, 0, 0]), -0.1, window=([-0.01, -0.01], [0.01, 0.01]))


def test_the_currents_that_are_missing_for_a_bead(field):
    """The lift goes with the square of the current."""
    with pytest.raises(NoEquilibrium) as caught:
        find_equilibrium(field, 0.1, BEAD)
    missing = float(re.search(r"\(([\d.]+) times", caught.value.problems[0].remedy)[1])
    lift = magnetic_body(BEAD).wrench(field, search_grid(BOX), 0.1 * missing)[:, 2].max()
    assert lift == pytest.approx(BEAD.mass * GRAVITY, rel=1e-2)


def test_soft_iron_off_centre_is_not_turned_over(field):
    """A bead 3 mm above the middle of its body, without a magnet to turn: it floats where the bead alone does."""
    offset = np.array([0.002, -0.001, 0.003])
    body = fm.Payload(2.6e-4, pieces=[fm.PayloadPiece(BEAD.pieces[0].shape, fm.Placement(tuple(offset)))])
    places = np.array([[0.0, 0.0, -0.02], [0.001, 0.0, -0.025]])
    alone, off = (
        magnet_balance(field, np.array([10.0]), one, places - at) for one, at in ((BEAD, 0.0), (body, offset))
    )
    np.testing.assert_allclose(off.magnetic_force(places - offset), alone.magnetic_force(places), rtol=1e-9)
    np.testing.assert_allclose(off.arms, [offset])
    # The steps of a map are compared with the largest moment so far.
    moments = np.linalg.norm(alone.moments(places), axis=1)
    assert alone.magnitude == pytest.approx(moments.max(), rel=1e-9)
    assert off.evaluations == 2


@pytest.mark.parametrize("model", ["fixed", "rigid upright"])
def test_magnets_that_lean_are_as_large_as_the_sum_of_their_moments(field, model):
    """Two spheres with perpendicular moments."""
    pieces = [
        fm.PayloadPiece(SPHERE, fm.Placement((x, 0.0, 0.0), rotation_matrix(angles)))
        for x, angles in ((-0.006, (0.0, 0.0, 0.0)), (0.006, (0.0, 90.0, 0.0)))
    ]
    balance = magnet_balance(field, np.array([10.0]), fm.Payload(5e-3, pieces=pieces), None, model)
    assert balance.magnitude == pytest.approx(2 * SPHERE_MOMENT, rel=1e-9)
    moment = balance.moments(np.array([[0.0, 0.0, -0.02]]))[0]
    assert np.linalg.norm(moment) == pytest.approx(np.sqrt(2) * SPHERE_MOMENT, rel=1e-9)


@pytest.mark.parametrize(
    ("current", "remedy"), [(10.0, "put more current into"), (0.0, "turn the currents on")]
)
def test_above_a_coil_no_polarity_lifts_soft_iron(current, remedy):
    above = as_field(CoilSet((COIL,), (np.array([-0.008, -0.008, 0.03]), np.array([0.008, 0.008, 0.05]))))
    with refused(NoEquilibrium, remedy=remedy):
        find_equilibrium(above, current, BEAD)


@pytest.mark.parametrize("soft", [(), BEAD.pieces])
def test_beside_magnets_the_currents_that_are_missing_are_known_without_soft_iron_alone(field, soft):
    """The lift of the magnets goes with the current, the lift of soft iron with its square."""
    with pytest.raises(NoEquilibrium) as caught:
        find_equilibrium(field, 0.01, fm.Payload(0.5, pieces=[SPHERE, *soft]))
    assert ("times" in caught.value.problems[0].remedy) is not bool(soft)
