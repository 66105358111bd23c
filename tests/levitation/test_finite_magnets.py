"""Bodies of magnets of finite size above four coils, against their pull on the coils.

The reference has no volume rule: the closed field of each magnet (magpylib) acts on the windings, in a dense product of
Gauss rules over their section and even angles around them. The force on the magnets is the opposite.
"""

from dataclasses import replace
from functools import cache
from itertools import product

import magpylib
import numpy as np
import pytest
from scipy.optimize import brentq

import fieldmap as fm
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.field import as_field
from fieldmap.levitation import (
    GRAVITY,
    LiftReadings,
    calibrate,
    equilibrium_sensitivity,
    equilibrium_surface,
    find_equilibrium,
    fit_force,
    follow_equilibrium,
    lift_by_height,
    lift_current,
    stationary_points,
)
from fieldmap.lookup import finite_magnet, interpolate, magnetic_body
from fieldmap.sources import CoilSet
from fieldmap.store import Grid, MapData
from tests.refusals import refused

INNER, OUTER, HIGH, TURNS = 0.008, 0.022, 0.020, 600
PLACES = [(x, y, -HIGH / 2) for x, y in product((-0.026, 0.026), repeat=2)]
COILS = tuple(
    fm.CircularCoil(str(k), INNER, OUTER, HIGH, TURNS, polarity=-1, placement=fm.placed(at))
    for k, at in enumerate(PLACES)
)
"""Their currents run so that they push magnets up that point up."""
BOX = np.array([-0.045, -0.045, 0.006]), np.array([0.045, 0.045, 0.09])
FIELD = as_field(CoilSet(COILS, BOX))
EQUAL = 3.0 * np.ones(4)


def body(mass, *magnets):
    return fm.Payload(mass, pieces=[fm.PayloadPiece(shape, fm.placed(at)) for shape, at in magnets])


def ring(shape, radius, count):
    angles = 2 * np.pi * np.arange(count) / count
    return [(shape, (radius * np.cos(a), radius * np.sin(a), 0.0)) for a in angles]


FLAT, BAR = fm.MagnetCylinder(0.020, 0.005, 1.3), fm.MagnetBlock((0.012, 0.008, 0.010), 1.2)
DISC = body(0.070, *[(FLAT, (x, y, 0.0)) for x, y in product((-0.016, 0.016), repeat=2)])
RINGS = body(0.060, *ring(BAR, 0.012, 4), *ring(fm.MagnetCylinder(0.008, 0.008, 1.3), 0.027, 8))
STACK = body(0.040, (FLAT, (0, 0, -0.008)), (BAR, (0, 0, 0.002)), (FLAT, (0, 0, 0.012)))
LOPSIDED = body(0.070, *[(shape, np.add(at, (0.004, -0.006, 0.003))) for shape, at in ring(FLAT, 0.016, 4)])
BODIES = {"disc": DISC, "two rings": RINGS, "stack": STACK, "off the centre": LOPSIDED}
CURRENTS = {"disc": 3.0, "two rings": 5.0, "stack": 8.0, "off the centre": 8.0}


@cache
def _windings(sections=8, angles=48):
    """Points about a coil's centre, and current elements J dV per ampere."""
    nodes, weights = np.polynomial.legendre.leggauss(sections)
    r = (INNER + OUTER) / 2 + (OUTER - INNER) / 2 * nodes
    t = 2 * np.pi * (np.arange(angles) + 0.5) / angles
    share = TURNS / 4 * weights[:, None, None] * weights[:, None] * np.full(angles, 2 * np.pi / angles)
    r, z, t = (part.ravel() for part in np.meshgrid(r, HIGH / 2 * nodes, t, indexing="ij"))
    element = (share.ravel() * r)[:, None] * np.stack([-np.sin(t), np.cos(t), 0 * t], axis=1)
    return np.stack([r * np.cos(t), r * np.sin(t), z], axis=1), element


def pull(payload, position):
    """Force (3, 4) per ampere of each coil on the body centred at a position (3,), N/A."""
    sources = magpylib.Collection()
    for piece in payload.pieces:
        shape, about = piece.shape, {"position": np.add(position, piece.placement.position)}
        about["polarization"] = (0.0, 0.0, shape.remanence)
        if isinstance(shape, fm.MagnetBlock):
            sources.add(magpylib.magnet.Cuboid(dimension=shape.size, **about))
        else:
            sources.add(magpylib.magnet.Cylinder(dimension=(shape.diameter, shape.height), **about))
    points, element = _windings()
    return np.column_stack([np.cross(element, sources.getB(points + at)).sum(axis=0) for at in PLACES])


@cache
def height(name):
    """Height at which a body of four-fold symmetry floats, m: its middle on the axis, above the place of most lift."""
    payload = BODIES[name]
    middle = -magnetic_body(payload).points.mean(axis=0)
    weight = payload.mass * GRAVITY

    def lift(z):
        return pull(payload, middle + [0, 0, z])[2].sum() * CURRENTS[name] - weight

    return middle + [0, 0, brentq(lift, max(np.linspace(0.02, 0.05, 4), key=lift), 0.08, xtol=1e-10)]


@pytest.mark.parametrize("name", BODIES)
def test_a_body_of_magnets_floats_where_the_coils_carry_it(name):
    exact, payload, offs = height(name), BODIES[name], []
    for level in (1, 2, 3):
        found = find_equilibrium(FIELD, CURRENTS[name], replace(payload, volume_level=level), start=exact)
        off = np.linalg.norm(found.position - exact)
        # The estimate is true to a third: neither smaller nor larger than the error.
        assert off == pytest.approx(found.volume_error, rel=0.35, abs=2e-9)
        words = "point dipole" if level == 1 else f"quadrature of level {level}"
        assert found.assumptions[0].startswith(f"magnets: {words}, error about ")
        offs.append(off)
    # Point dipoles of the disc are off by ten times the requested accuracy.
    assert offs[0] > (1e-3 if name == "stack" else 9e-4 if name == "disc" else 1e-5)
    assert offs[2] < 1e-8


def test_the_shipped_disc_floats_where_this_one_does():
    device = fm.read_device("floating_disc")
    found = find_equilibrium(as_field(CoilSet(device.coils, BOX)), EQUAL, device.payload)
    np.testing.assert_allclose(found.position, height("disc"), atol=1e-8)


@pytest.fixture(scope="module")
def opened():
    """A map of the coils with cells of 4 mm."""
    lower, spacing = np.array([-0.040, -0.040, 0.020]), 0.004
    grid = Grid(lower, [spacing] * 3, (21, 21, 13))
    points, shape = grid.points(), (4, *grid.shape, 3)
    flux, slope = (np.swapaxes(of(points), 0, 1) for of in (FIELD.unit_field, FIELD.unit_gradient))
    about = {"flux_density": flux.reshape(shape), "gradient": slope.reshape(*shape, 3)}
    return interpolate(MapData(grid, FIELD.coil_names, np.ones(4), **about))


def test_where_a_body_floats_on_a_map(opened):
    found = find_equilibrium(opened, CURRENTS["off the centre"], LOPSIDED)
    np.testing.assert_allclose(found.position, height("off the centre"), atol=2e-5)
    # The map ends 1 mm below the lowest place at which the magnets lie in it.
    low = opened.lower - magnetic_body(LOPSIDED).points.min(axis=0)
    np.testing.assert_allclose(found.report.lower, low, atol=1e-9)
    with refused(OutsideMapError, where="lift_current(position)"):
        lift_current(opened, LOPSIDED, [*height("off the centre")[:2], low[2] - 1e-4])
    # Rules are compared at the places of each magnet: an arm may lead out of the map.
    inside = [[0.0, 0.0, 0.045]]
    assert finite_magnet(FLAT, opened, 1e-3, inside).error < 1e-3
    with pytest.raises(OutsideMapError):
        finite_magnet(FLAT, opened, 1e-3, inside, arm=[0.1, 0.0, 0.0])
    force = magnetic_body(LOPSIDED, field=opened).wrench(opened, found.position, found.currents)[2]
    assert force == pytest.approx(LOPSIDED.mass * GRAVITY, rel=1e-4)
    # Where the finer rule leaves the map, there is no estimate.
    edge = lift_current(opened, fm.Payload(0.01, magnet=FLAT, volume_level=1), [0.0, 0.0, opened.lower[2]])
    assert np.isnan(edge.volume_error)
    assert edge.assumptions[0] == "magnets: point dipole, error not known"


@pytest.mark.parametrize("name", BODIES)
def test_the_current_that_carries_a_body(name):
    at, payload = height(name), BODIES[name]
    for level in (1, 2, 3):
        found = lift_current(FIELD, replace(payload, volume_level=level), at)
        off = abs(found.current - CURRENTS[name])
        assert off == pytest.approx(found.volume_error, rel=0.35, abs=1e-7)
    assert off < 1e-4
    assert found.force_per_ampere[2] == pytest.approx(pull(payload, at)[2].sum(), rel=1e-5)


def test_branches_stationary_points_and_sensitivity_of_a_disc():
    at, weight = height("disc"), DISC.mass * GRAVITY
    (point,) = stationary_points(
        FIELD, EQUAL, DISC, at[2], samples=8, window=([-0.002] * 2, [0.002] * 2)
    ).points
    assert point.lift == pytest.approx(weight, rel=1e-6)
    step = 2e-4 * np.eye(3)
    change = [(pull(DISC, at + s) - pull(DISC, at - s)) @ EQUAL / 4e-4 for s in step]
    np.testing.assert_allclose(point.stiffness, -np.transpose(change), atol=2e-3 * np.abs(change).max())
    slopes = equilibrium_sensitivity(FIELD, EQUAL, DISC, at)
    np.testing.assert_allclose(slopes.force_per_current, pull(DISC, at), rtol=1e-4, atol=1e-7)
    exact = np.linalg.solve(-np.transpose(change)[:2, :2], pull(DISC, at)[:2])
    np.testing.assert_allclose(slopes.at_held_height, exact, rtol=5e-3)
    # Up by 2 mm with the lift held: the level carries the disc at each height.
    heights = at[2] + 1e-3 * np.arange(3)
    about = (FIELD, DISC, lambda z, level: (level * np.ones(4), z))
    branch = follow_equilibrium(*about, [0.0, 0.0], heights, 3.0, hold_height=True)
    levels = [weight / pull(DISC, [0, 0, z])[2].sum() for z in heights]
    np.testing.assert_allclose(branch.levels_at_stops, levels, rtol=1e-5)
    for stated in (branch, slopes):
        assert stated.assumptions[0].startswith("magnets: quadrature of level 3, error about ")


def test_a_surface_over_signals_is_that_of_the_disc():
    """Coils that push by x and y move the disc to where the reference has no force."""
    at = height("disc")
    found = equilibrium_surface(FIELD, DISC, [0.0, 0.02], [0.0], 3.0, at[2], hold_height=False)
    place = found.positions[1, 0]
    assert abs(place[0]) > 1e-4
    push = equilibrium_sensitivity(FIELD, EQUAL, DISC, at).at_held_height
    currents = np.linalg.lstsq(push, place[:2])[0]
    assert np.abs(pull(DISC, place) @ (EQUAL + currents))[:2].max() < 0.05 * np.abs(pull(DISC, place)).max()


def test_a_calibration_by_a_disc_of_magnets():
    """Readings of a rig with 0.9 of the calculated force and its sensed point 12 mm above the disc's centre."""
    heights = np.linspace(0.022, 0.040, 6)
    amperes = [DISC.mass * GRAVITY / (0.9 * pull(DISC, [0, 0, z])[2].sum()) for z in heights]
    readings = LiftReadings(heights + 0.012, np.outer(amperes, np.ones(4)), deviation=1e-3)
    found = calibrate(FIELD, replace(DISC, magnet_offset=0.01), lift=readings)
    assert found.values["field_scale"] == pytest.approx(0.9, rel=1e-4)
    assert found.values["magnet_offset"] == pytest.approx(0.012, abs=2e-6)
    assert found.assumptions[0].startswith("magnets: quadrature of level 3, error about ")
    dipoles = calibrate(FIELD, replace(DISC, magnet_offset=0.01, volume_level=1), lift=readings)
    assert abs(dipoles.values["magnet_offset"] - 0.012) > 1e-4


def test_lift_currents_by_height_of_bodies_larger_than_dipoles():
    raised = body(0.070, *[(FLAT, (x, y, 0.006)) for x, y in product((-0.016, 0.016), repeat=2)])
    rows = lift_by_height(FIELD, raised)
    assert len(rows) == 4
    low, high = BOX[0][2], BOX[1][2]
    np.testing.assert_allclose(
        [row.height + 0.006 for row in rows], high + np.arange(1, 5) / 5 * (low - high)
    )
    for row in rows:
        exact = raised.mass * GRAVITY / pull(raised, [0, 0, row.height])[2].sum()
        assert row.current == pytest.approx(exact, rel=1e-4)
    measured = [replace(row, measured=1.1 * row.current, lift_share=1.1) for row in rows]
    fit = fit_force(FIELD, raised, measured)
    assert fit.factor == pytest.approx(1 / 1.1)
    np.testing.assert_allclose(fit.deviations, 0.0, atol=1e-9)


def test_a_rule_is_chosen_where_the_body_will_be():
    """Coils have no box, so that places must be given."""
    coils = as_field(CoilSet(COILS))
    with refused(InputError, where="finite_magnet, places"):
        finite_magnet(FLAT, coils)
    near, far = (finite_magnet(FLAT, coils, 1e-5, [[0.0, 0.0, z]]) for z in (0.02, 0.3))
    assert len(near.points) > len(far.points)
    assert max(near.error, far.error) < 1e-5
    place = np.array([0.01, 0.0, 0.06])
    chosen = magnetic_body(DISC, field=coils, tolerance=1e-4, places=place)
    force = pull(DISC, place) @ EQUAL
    np.testing.assert_allclose(chosen.wrench(coils, place, EQUAL)[:3], force, atol=1e-4 * np.abs(force).max())
    assert chosen.error < 1e-4
    # A field at fixed currents has no fields of single coils, and needs none.
    state = finite_magnet(FLAT, FIELD.at(EQUAL), 1e-4, [[0.0, 0.0, 0.03]])
    assert state.error < 1e-4


def test_what_a_payload_says_of_its_magnets():
    """Size counts for every shape except a sphere, unless the payload asks for a point."""
    single = fm.Payload(0.01, magnet=FLAT)
    sphere = fm.Payload(0.01, magnet=fm.MagnetSphere(0.01, 1.3))
    moment = fm.Payload(0.01, moment=0.5)
    bead = fm.Payload(0.01, pieces=[fm.SoftSphere(4e-3, mu_r=100.0)])
    points = replace(single, volume_level=1)
    assert [p.rule for p in (single, sphere, moment, bead, points)] == [
        "quadrature of level 3",
        "point dipole",
        "point dipole",
        "",
        "point dipole",
    ]
    assert [p.extended for p in (single, sphere, moment, bead, points)] == [True, False, False, True, False]
    assert [len(magnetic_body(p).points) for p in (single, points)] == [36, 1]
    # Spheres are exact: the estimated error is zero.
    at = np.array([0.0, 0.0, 0.03])
    assert lift_current(FIELD, sphere, at).volume_error == 0.0
    assert lift_current(FIELD, sphere, at).assumptions[0] == "magnets: point dipole"
