"""Starts of runs: currents of least power that carry the body, by closed forms and other optimisers."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

import fieldmap as fm
from fieldmap.constants import MU0
from fieldmap.dynamics import (
    RigidBody,
    WeightBalance,
    body_of_payload,
    modelled,
    open_machine,
    prepare,
    read_scenario,
    sampled_field,
    state_of,
    superposed,
)
from fieldmap.errors import Infeasible, OutsideMapError
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import FiniteMagnet, open_map
from fieldmap.maps import generate
from fieldmap.sources import CoilSet
from tests.conftest import DEVICES
from tests.dynamics.conftest import saturating_map
from tests.dynamics.machines import machine_in
from tests.refusals import refused

GRAVITY = 9.80665
BODY = RigidBody(6e-3, np.full(3, 2e-7), FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]])))
# Constant outputs instead of a regulator.
AXES = {"control.coupled": None} | {f"control.{axis}": {"kind": "constant"} for axis in "xyz"}
WIDE = np.full(6, -1e3), np.full(6, 1e3)


def slope_on_axis(distance, inner=10.5e-3, outer=20e-3, length=60e-3, turns=300):
    """dB/dz, T/(m A), on the axis of a winding; `distance` from its middle."""

    def flux(z):
        ends = [z + length / 2, z - length / 2]
        parts = [e * np.log((outer + np.hypot(outer, e)) / (inner + np.hypot(inner, e))) for e in ends]
        return MU0 * turns / (2 * length * (outer - inner)) * (parts[0] - parts[1])

    return (flux(distance + 1e-6) - flux(distance - 1e-6)) / 2e-6


@pytest.fixture(scope="module")
def planar():
    device = fm.read_device(DEVICES / "planar_five.toml")
    return device, sampled_field(CoilSet(device.coils, device.bounds), 2e-3)


def test_five_coils_around_a_bead_begin_with_currents_of_both_signs(planar):
    """The coil below lifts with slope s, the side coils push down with half of it, because div B = 0: least power gives
    w / (2 m s) and -w / (4 m s)."""
    device, field = planar
    moment = device.payload.moment
    below = device.payload.mass * GRAVITY / (2 * moment * abs(slope_on_axis(58e-3)))
    expected = below * np.array([-0.5, -0.5, -0.5, -0.5, 1.0])
    # Without a depth the start is the middle of this map; upright, because the field there is opposite to the moment.
    for given in ({"start.depth_mm": 0.0}, {"body.turning": "upright"}):
        experiment = prepare(read_scenario("hold", AXES | given), field, device)
        np.testing.assert_allclose(experiment.currents, expected, rtol=1e-3)
        np.testing.assert_allclose(experiment.operating_point.sensed, 0.0, atol=2e-5)
        machine = open_machine("hold", given, field_map=field, device=device)
        np.testing.assert_allclose(machine.operating_point.currents, expected, rtol=1e-3)


CORES = """
[material.steel]
kind = "bh_table"
file = "materials/steel_a3"

[defaults.body]
material = "steel"
shape = "cylinder"
radius_mm = 10
height_mm = 70
mesh_size_mm = 10
edge_size_mm = 6

[[body]]
name = "core {k}"
repeat = { count = 4, about = "z" }
position_mm = [25, 0, 0]
rotation_deg = [0, 90, 0]

[[body]]
name = "core below"
position_mm = [0, 0, -25]
rotation_deg = [180, 0, 0]
"""


def test_so_they_do_with_cores_that_saturate(tmp_path):
    """Against the solver's force at the start, without the map; and the run stays."""
    path = tmp_path / "planar.toml"
    path.write_text((DEVICES / "planar_five.toml").read_text() + CORES)
    device = fm.read_device(path)
    made = generate(
        device, tmp_path / "planar.h5", spacing=4e-3, currents=(-8, 8), iron={"model": "saturating"}
    )
    changes = {"body.turning": "upright", "duration_s": 1.0}
    run = fm.simulate("hold", changes, field_map=open_map(made, outside_currents="evaluate"), device=device)
    assert run.event is None
    assert abs(run.sensed[-1, 2] - run.references[-1, 2]) < 1e-4
    currents = run.currents[0]
    assert currents[:4].max() < 0.0 < currents[4]
    np.testing.assert_allclose(currents[:4], currents[:4].mean(), rtol=2e-2)
    force = NonlinearSolver(device).wrench(run.sensed[0], [0.0, 0.0, device.payload.moment], currents)[:3]
    np.testing.assert_allclose(force / (device.payload.mass * GRAVITY), [0, 0, 1], atol=2e-2)


@pytest.mark.parametrize(("height", "sign"), [(-50e-3, 1.0), (50e-3, -1.0)], ids=["hangs", "stands"])
def test_one_coil_carries_from_above_and_from_below(height, sign):
    """A coil above pulls, a coil below pushes, with the moment up: w / (m s) in both cases."""
    device = fm.read_device(DEVICES / "planar_five.toml")
    coil = replace(device.coils[4], placement=fm.placed([0.0, 0.0, 0.0]))
    box = np.array([[-5e-3, -5e-3, height - 5e-3], [5e-3, 5e-3, height + 5e-3]])
    one = sampled_field(CoilSet([coil], tuple(box)), 1e-3)
    body = body_of_payload(device.payload)
    found = WeightBalance(one, body, (np.full(1, -8.0), np.full(1, 8.0))).currents([0.0, 0.0, height])
    needed = body.mass * GRAVITY / (body.magnet.moment * abs(slope_on_axis(50e-3)))
    np.testing.assert_allclose(found, [sign * needed], rtol=1e-3)


@pytest.mark.parametrize("scale", [1.0, 0.6])
def test_saturating_iron_takes_no_more_than_another_optimiser_finds(scale):
    """SLSQP from several starts, and the condition of an optimum: currents along the gradient of the lift. The fields
    of this map have one axis, so the coils push along z alone."""
    field = saturating_map(free=True)
    body = replace(BODY, mass=0.01)
    place, moment = np.array([2e-3, -1e-3, 3e-3]), scale * np.array([0.0, 0.0, 0.8])

    def lift(amperes):
        return field.wrench(place, moment, amperes)[2] / (body.mass * GRAVITY)

    found = WeightBalance(field, body, WIDE, scale).currents(place)
    assert lift(found) == pytest.approx(1.0, rel=1e-8)
    slope = np.array([lift(found + h) - lift(found - h) for h in 1e-4 * np.eye(6)])
    assert found @ slope == pytest.approx(np.linalg.norm(found) * np.linalg.norm(slope), rel=1e-6)
    powers = []
    for first in np.random.default_rng(1).uniform(-2, 2, (6, 6)):
        carries = {"type": "eq", "fun": lambda i: lift(i) - 1.0}
        one = scipy.optimize.minimize(lambda i: i @ i, first, constraints=[carries], bounds=[(-3, 3)] * 6)
        powers += [one.fun] if one.success else []
    assert found @ found <= 1.0001 * min(powers)
    assert found.min() < 0.0 < found.max()


def bead_and_magnet(mass):
    pieces = [
        fm.PayloadPiece(fm.SoftSphere(4e-3, mu_r=50.0), fm.placed([0.5e-3, 0.0, -1e-3])),
        fm.PayloadPiece(fm.MagnetSphere(1e-3, 0.3), fm.placed([0.0, 0.0, 2e-3])),
    ]
    return fm.Payload(mass=mass, pieces=pieces, inertia=(1e-9, 1e-9, 1e-9))


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("iron", ["air", "saturating"])
def test_soft_iron_beside_a_magnet_is_carried_as_the_simulated_machine_feels_it(iron, scale):
    """Against the load of the compiled machine. The scale of the field acts squared on soft iron, once on a magnet."""
    if iron == "air":
        device = fm.read_device(DEVICES / "five_coils_above_a_bead.toml")
        field = sampled_field(CoilSet(device.coils, device.bounds), 1.5e-3)
        of, place, body = (
            superposed(field, scale),
            [0.0, 0.0, -0.015],
            body_of_payload(bead_and_magnet(0.2e-3)),
        )
    else:
        field = saturating_map(free=True)
        of, place, body = modelled(field, scale), [1e-3, 0.0, 2e-3], body_of_payload(bead_and_magnet(3e-5))
    coils = len(field.coil_names)
    balance = WeightBalance(field, body, (np.full(coils, -50.0), np.full(coils, 50.0)), scale)
    currents = balance.currents(place)
    machine = machine_in(of, coils, body)

    def force(amperes):
        load = np.empty(6)
        machine.follow(np.ascontiguousarray(amperes))
        assert machine.load(state_of(np.subtract(place, body.magnet_at)), load) == (0, 0)
        return load[:3]

    # The fields of the map of iron have no sideways force.
    pushed = [2] if iron == "saturating" else [0, 1, 2]
    np.testing.assert_allclose(force(currents)[pushed], 0.0, atol=1e-4 * balance.weight)
    step = 1e-3 * np.abs(currents).max()
    slopes = [(force(currents + h) - force(currents - h)) / (2 * step) for h in step * np.eye(coils)]
    by_currents = balance.force_per_ampere(place, currents)
    np.testing.assert_allclose(by_currents, np.transpose(slopes), atol=2e-3 * np.abs(slopes).max())


def dipoles(dipole_map, places, folder):
    """A map of dipoles of 8 A m^2 per ampere, 26 mm above the origin."""
    places = np.column_stack([places, np.full(len(places), 0.026)])
    return open_map(dipole_map(places, folder / "some.h5")), places


def lift_of_dipoles(places, moment, height=-0.1):
    """Force (3, n), N/A, of a magnet that points up on the axis: grad of mu0 m M (3 z^2 - r^2) / (4 pi r^5)."""
    arms = np.array([0.0, 0.0, height]) - places
    x, y, z = arms.T
    r = np.linalg.norm(arms, axis=1)
    factor = MU0 * 8.0 * moment / (4 * np.pi)
    across = factor * (3 / r**5 - 15 * z**2 / r**7)
    return np.array([across * x, across * y, factor * (9 * z / r**5 - 15 * z**3 / r**7)])


def test_an_axis_along_which_nothing_pushes_asks_for_nothing(dipole_map, tmp_path):
    """Three coils in a row along x, one of them 1 um off it: forbidding the force along y, ten thousand times weaker,
    would determine the lift of each coil."""
    places = np.array([[-0.04, 0.0], [0.0, 1e-6], [0.04, 0.0]])
    opened, at = dipoles(dipole_map, places, tmp_path)
    found = WeightBalance(opened, BODY, (WIDE[0][:3], WIDE[1][:3])).currents([0.0, 0.0, -0.1])
    lift = lift_of_dipoles(at, 0.8)[2]
    np.testing.assert_allclose(found, BODY.mass * GRAVITY * lift / (lift @ lift), rtol=1e-3)


def test_what_a_coil_may_not_take_the_others_take(dipole_map, tmp_path):
    opened, at = dipoles(
        dipole_map, np.array([[0.04, 0.0], [0.0, 0.04], [-0.04, 0.0], [0.0, -0.04]]), tmp_path
    )
    free = WeightBalance(opened, BODY, (WIDE[0][:4], WIDE[1][:4])).currents([0.0, 0.0, -0.1])
    high = np.array([0.5, 1e3, 1e3, 1e3]) * free[0]
    found = WeightBalance(opened, BODY, (-high, high)).currents([0.0, 0.0, -0.1])
    # A tenth of each limit is reserved for control.
    np.testing.assert_allclose(found / free[0], [0.45, 1.55, 0.45, 1.55], rtol=1e-3)
    np.testing.assert_allclose(
        lift_of_dipoles(at, 0.8) @ found, [0, 0, BODY.mass * GRAVITY], atol=1e-4 * 6e-2
    )
    # The reserved tenth is used where needed; beyond it the message names the share carried.
    narrow = np.full(4, 1.05 * free[0])
    np.testing.assert_allclose(
        WeightBalance(opened, BODY, (-narrow, narrow)).currents([0, 0, -0.1]), free, rtol=1e-6
    )
    with refused(Infeasible) as caught:
        WeightBalance(opened, BODY, (-0.6 * narrow, 0.6 * narrow)).currents([0, 0, -0.1])
    (problem,) = caught.value.problems
    assert caught.value.share == pytest.approx(0.63, rel=1e-3)
    assert problem.received.startswith("0.63 of the weight with 1 at ")
    assert "[0.0, 0.0, -100.0] mm" in problem.must_hold


def test_a_place_outside_the_map_is_refused(planar):
    device, field = planar
    with pytest.raises(OutsideMapError):
        WeightBalance(field, body_of_payload(device.payload), (WIDE[0][:5], WIDE[1][:5])).currents(
            [0, 0, 0.011]
        )


def test_a_map_beside_the_origin_begins_in_its_own_middle(planar):
    device, _ = planar
    coils = [replace(device.coils[4], placement=fm.placed([0.05, -0.03, 0.0]))]
    bounds = np.array([0.04, -0.04, -0.06]), np.array([0.06, -0.02, -0.05])
    aside = replace(device, coils=tuple(coils))
    field = sampled_field(CoilSet(coils, bounds), 2e-3)
    point = prepare(read_scenario("hold", AXES), field, aside).operating_point
    np.testing.assert_allclose(point.sensed, [0.05, -0.03, -0.055], atol=1e-5)
    heavy = replace(aside, payload=replace(device.payload, mass=1.0))
    # No key of the start is given.
    with refused(Infeasible, where=": the start"):
        prepare(read_scenario("hold", AXES), field, heavy)
    with refused(Infeasible, where=": start"):
        prepare(read_scenario("hold", AXES | {"start.depth_mm": 55.0}), field, heavy)
