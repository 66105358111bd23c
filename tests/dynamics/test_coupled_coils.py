"""Coils coupled by the linkages of a map: closed forms, other integrators, energies, and solvers of the iron."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import fieldmap as fm
from fieldmap.core.iron import heat_of
from fieldmap.core.library import LIBRARY
from fieldmap.dynamics import (
    Bridge,
    CoilDrive,
    CurrentController,
    Heating,
    Machine,
    MatrixAllocation,
    RigidBody,
    Sensors,
    linearised,
    modelled,
    prepare,
    read_scenario,
    sampled_field,
    state_of,
    superposed,
)
from fieldmap.dynamics.loop_run import recorded
from fieldmap.errors import InputError
from fieldmap.instruments import Amplifier
from fieldmap.lookup import MagneticBody, interpolate
from fieldmap.lookup.soft_body import soft_rule
from fieldmap.sources import CoilSet
from fieldmap.store import StoredLinkage
from tests.dynamics.conftest import saturating_data
from tests.dynamics.machines import ANY_BODY
from tests.lookup.test_heat_and_loops import DATA, MODEL, PINNING, SHARES, energies

WIDE = Amplifier(1.0, current_lower=-1e9, current_upper=1e9)
L, R = np.array([[0.02, 0.004], [0.004, 0.01]]), np.array([2.0, 3.0])
MASS, MOMENT, WEIGHT = 0.01, 0.8, 0.01 * 9.80665
TWO = (0.01, 0.08, -12.0), (0.02, -0.05, 3.0)


class Bench:
    """A machine whose coils are driven step by step, with its currents and energies."""

    def __init__(self, of, resistance, step, currents, state=None, body=ANY_BODY, **drive):
        n = len(resistance)
        drive = {"mode": "voltage", "amplifier": WIDE, "supply": (-1e3, 1e3)} | drive
        coils = CoilDrive(coils=n, resistance=resistance, **drive)
        self.machine = Machine(of, body, coils, Sensors(), MatrixAllocation(np.eye(n), np.zeros(n)))
        self.core, self.step = self.machine.core(step), step
        self.state = state_of([0, 0, 0]) if state is None else state
        self.currents, self.load = np.array(currents, float), np.zeros(6)
        self.core.follow(self.currents)
        self.core.load(self.state, self.load)

    def run(self, count, command):
        """Currents (count, n) after each step; `command` is constant or a function of the time at mid-step."""
        found = []
        for k in range(count):
            asked = np.array(command((k + 0.5) * self.step) if callable(command) else command, float)
            assert self.core.advance(self.step, 1, asked, self.state, self.currents, self.load) == 0
            found.append(self.currents.copy())
        return np.array(found)

    @property
    def left(self):
        """Energy from the drives less the heat of the windings, J."""
        return float(np.sum(self.core.coil_state.input - self.core.coil_state.heat))


def two_coils(axial, constant=(1e-3, -2e-3)):
    return replace(superposed(axial.map(*TWO)), linkage=StoredLinkage(L, np.array(constant)))


def test_a_step_of_one_and_of_two_coupled_coils(axial):
    """L di/dt + R i = V by the matrix exponential; the error is of second order in the step."""
    volts, errors = np.array([12.0, -5.0]), []
    for step in (4e-4, 2e-4):
        found = Bench(two_coils(axial), R, step, [0, 0]).run(round(0.02 / step), volts)
        times = step * np.arange(1, len(found) + 1)
        wanted = np.array(
            [volts / R - expm(-np.linalg.solve(L, np.diag(R)) * t) @ (volts / R) for t in times]
        )
        errors.append(np.abs(found - wanted).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)
    one = replace(superposed(axial.map(TWO[0])), linkage=StoredLinkage([[0.05]], [0.0]))
    assert Bench(one, [4.0], 1e-4, [0.5]).run(100, [10.0])[-1] == pytest.approx(
        2.5 - 2.0 * np.exp(-0.8), rel=1e-5
    )


def test_a_magnet_that_passes_a_loop_drives_a_current_in_it():
    """Against an ODE with the linkage of a dipole on the axis, mu0 N m R^2 / (2 (R^2 + z^2)^1.5), by scipy."""
    turns, radius, speed, moment, inductance, ohms = 100, 0.02, 2.0, 1.3, 2e-3, 0.5
    coil = fm.CircularCoil("loop", 0.019, 0.021, 2e-3, turns, placement=fm.Placement([0, 0, 0.0]))
    thin = CoilSet([coil], (np.array([-2e-3, -2e-3, -0.031]), np.array([2e-3, 2e-3, -4e-3])))
    of = replace(superposed(sampled_field(thin, 1e-3)), linkage=StoredLinkage([[inductance]], [0.0]))
    # A body of a tonne, without gravity, hardly changes its speed.
    body = RigidBody(1e3, [1e3] * 3, MagneticBody.dipole([0, 0, moment]), gravity=0.0)
    begin = state_of([0, 0, -0.03], velocity=[0, 0, speed])
    bench = Bench(of, [ohms], 1e-5, [0.0], begin, body)
    found = bench.run(1200, [0.0])[:, 0]

    def rate(time, current):
        z = -0.03 + speed * time
        linkage = mu_0 * turns * moment * radius**2 / 2 * np.array([1.0])
        induced = linkage * -3.0 * z * speed * (radius**2 + z**2) ** -2.5
        return -(induced + ohms * current) / inductance

    times = 1e-5 * np.arange(1, 1201)
    wanted = solve_ivp(rate, (0, times[-1]), [0.0], t_eval=times, rtol=1e-9, atol=1e-12).y[0]
    # The coil is 2 mm wide and high: its field equals the loop's to (width / radius)^2 / 24.
    assert np.abs(found - wanted).max() < 2e-3 * np.abs(wanted).max()
    # The kinetic energy lost became heat and field energy.
    lost = 0.5 * 1e3 * (speed**2 - bench.state[5] ** 2)
    assert lost == pytest.approx(-bench.left + 0.5 * inductance * found[-1] ** 2, rel=1e-6)


def swing(axial, step, time, constant=(1e-3, -2e-3), turning=False):
    """The largest error of the energy balance in a run, the energy put in, J, and the last state."""
    body = RigidBody(MASS, [6e-7, 6e-7, 2e-7], axial.dipole(MOMENT), upright=not turning)
    held = np.array([WEIGHT / MOMENT / TWO[0][1], 0.0])
    lean = [np.cos(0.02), np.sin(0.02), 0.0, 0.0] if turning else None
    begin = state_of([0, 0, 3e-3], quaternion=lean) if turning else state_of([0, 0, 3e-3])
    bench = Bench(two_coils(axial, constant), R, step, held, begin, body)

    def energy():
        moving, spin = bench.state[3:6], bench.state[10:13]
        kinetic = 0.5 * MASS * moving @ moving + 0.5 * np.array([6e-7, 6e-7, 2e-7]) @ spin**2
        return kinetic + WEIGHT * bench.state[2] + 0.5 * bench.currents @ L @ bench.currents

    first, worst, count = energy(), 0.0, round(time / step)
    for k in range(count):
        bench.run(1, R * held + np.array([0.3, 0.5]) * np.sin(40.0 * (k + 0.5) * step))
        worst = max(worst, abs(bench.left - (energy() - first)))
        if not turning:
            # Keeps the body on the axis, which it would leave by rounding alone.
            bench.state[[0, 1, 3, 4]] = 0.0
    return worst, float(bench.core.coil_state.input.sum()), bench.state


@pytest.mark.parametrize("turning", [False, True])
def test_energy_put_in_is_heat_field_and_work(axial, turning):
    """With a swinging magnet; the error of the balance is of second order in the step."""
    time = 0.1 if turning else 1.0
    (coarse, _, _), (fine, given, _) = (swing(axial, step, time, turning=turning) for step in (4e-4, 2e-4))
    assert fine < 1e-8 * given
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
def test_energy_put_in_over_ten_seconds(axial):
    worst, given, state = swing(axial, 1e-4, 10.0)
    assert worst < 1e-6 * given
    assert abs(state[2]) < 5e-3


def test_a_magnet_swings_as_an_integrator_of_all_states_has_it(axial):
    """Currents and path against scipy's integration with force and voltage from the polynomial of the field."""
    body = RigidBody(MASS, [6e-7, 6e-7, 2e-7], axial.dipole(MOMENT), upright=True)
    held = np.array([WEIGHT / MOMENT / TWO[0][1], 0.0])
    slopes, curves = np.array(TWO)[:, 1], np.array(TWO)[:, 2]

    def rates(time, s):
        z, v, i = s[0], s[1], s[2:]
        per_ampere = MOMENT * (slopes + curves * z)
        volts = R * held + np.array([3.0, 5.0]) * np.sin(40.0 * time)
        return [v, i @ per_ampere / MASS - 9.80665, *np.linalg.solve(L, volts - R * i - per_ampere * v)]

    wanted = solve_ivp(rates, (0, 0.2), [3e-3, 0.0, *held], rtol=1e-10, atol=1e-12).y[:, -1]
    errors = []
    for step in (2e-4, 1e-4):
        bench = Bench(two_coils(axial), R, step, held, state_of([0, 0, 3e-3]), body)
        bench.run(round(0.2 / step), lambda t: R * held + np.array([3.0, 5.0]) * np.sin(40.0 * t))
        errors.append(np.abs([bench.state[2], bench.state[5], *bench.currents] - wanted))
    assert errors[1] == pytest.approx(np.zeros(4), abs=2e-3 * np.abs(wanted).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_moments_of_soft_iron_follow_the_currents(axial):
    """The moments m = c B of a ball of soft iron change the inductance to L + c b b^T; exact at rest."""
    piece = soft_rule(fm.SoftSphere(4e-3, mu_r=1000.0))[0]
    body = RigidBody(
        1.0, [1.0] * 3, MagneticBody(np.zeros((0, 3)), np.zeros((0, 3)), soft=(piece,)), gravity=0.0
    )
    strong = replace(
        superposed(axial.map((0.5, 0.0, 0.0), (0.2, 0.0, 0.0))), linkage=StoredLinkage(L * 1e-3, [0.0, 0.0])
    )
    found = Bench(strong, R, 1e-6, [0, 0], body=body).run(20, [1.0, 0.3])
    unit = np.array([0.5, 0.2])
    # For a ball of 4 mm: 3 V (mu_r - 1) / (mu_r + 2) / mu0.
    volume = 4 / 3 * np.pi * 2e-3**3
    whole = L * 1e-3 + 3 * volume * 999 / 1002 / mu_0 * np.outer(unit, unit)
    rates, steady = np.linalg.solve(whole, np.diag(R)), np.array([1.0, 0.3]) / R
    assert np.abs(whole / L * 1e3 - 1).max() > 0.1
    assert found[-1] == pytest.approx(steady - expm(-rates * 2e-5) @ steady, rel=2e-3)


SHAPE = np.array([3.0, -2.0, 1.0, 2.0, -1.0, 1.5])
AIR = StoredLinkage(1e-2 * (np.eye(6) + 0.1), 1e-4 * np.arange(6.0))


@pytest.fixture(scope="module")
def saturating():
    return interpolate(replace(saturating_data(free=True), linkage=AIR), outside_currents="evaluate")


def test_coils_of_saturating_iron_follow_the_maps_linkages(saturating):
    """A step of one coil against an ODE in scipy that inverts the map's inductance; the others are short-circuited."""
    ohms, volts = np.full(6, 0.5), np.array([0.0, 1.2, 0.0, 0.0, -0.7, 0.0])
    step = np.abs(saturating.inductance(0.0)).max() / 0.5 / 2000
    found = Bench(modelled(saturating), ohms, step, np.zeros(6)).run(4000, volts)[99::100]

    def rates(_, currents):
        return np.linalg.solve(saturating.inductance(currents), volts - ohms * currents)

    times = step * np.arange(100, 4001, 100)
    wanted = solve_ivp(rates, (0, times[-1]), np.zeros(6), t_eval=times, rtol=1e-7, atol=1e-9).y.T
    softer = saturating.inductance(wanted[-1])[1, 1] / saturating.inductance(0.0)[1, 1]
    assert softer < 0.7
    # Also coils driven by mutual inductance alone.
    assert np.abs(wanted[:, 2]).max() > 0.1
    assert np.abs(found - wanted).max() < 1e-4 * np.abs(wanted).max()


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_iron_is_solved_only_as_often_as_its_tolerance_asks(saturating, tolerance):
    """Between solves the tangent is used, with at most twice the tolerance: currents against an ODE in scipy with the
    map's inductances, forces against the map's at the same currents; at rest the iron is not solved."""
    ohms, at, moment = np.full(6, 0.5), np.array([0.4, -0.3, 0.5, 0.2, -0.4, 0.1]), np.array([0.0, 0.3, 0.8])
    body = RigidBody(1e30, [1e30] * 3, MagneticBody.dipole(moment), gravity=0.0)
    largest = saturating.info.reduced_model.domain.upper.max()
    volts = ohms * (at + 0.05 * largest * np.array([1.0, -0.5, 0.8, -1.0, 0.3, 0.6]))
    step = 2e-3 / np.linalg.eigvals(np.linalg.solve(saturating.inductance(at), np.diag(ohms))).real.max()
    bench = Bench(replace(modelled(saturating), tolerance=tolerance), ohms, step, at, body=body)
    bench.run(10, ohms * at)
    assert bench.core.solves.solves <= 2
    bench.run(1, volts)
    begin, before = bench.currents.copy(), bench.core.solves.solves

    def rates(_, currents):
        return np.linalg.solve(saturating.inductance(currents), volts - ohms * currents)

    times = step * np.arange(20, 1001, 20)
    wanted = solve_ivp(rates, (0, times[-1]), begin, t_eval=times, rtol=1e-8, atol=1e-10).y.T
    place, misses, pulls = bench.state[:3], [], []
    for row in wanted:
        bench.run(20, volts)
        misses.append(bench.currents - row)
        pulls.append(bench.load - saturating.wrench(place, moment, bench.currents))
    assert np.ptp(wanted, axis=0).max() > 0.03 * largest
    assert np.abs(misses).max() < 2.0 * tolerance * largest
    assert np.abs(pulls).max() < 10.0 * tolerance * np.abs(bench.load).max()
    assert bench.core.solves.solves - before < 300


def test_magnets_fly_through_cells_of_the_map_while_the_tangent_holds(saturating):
    """Linkages and forces of two magnets equal the map's in every cell, with few solves of the iron."""
    ohms, at = np.full(6, 0.5), np.array([0.4, -0.3, 0.5, 0.2, -0.4, 0.1])
    points = np.array([[0.0, 0.0, 0.004], [0.002, 0.0, -0.004]])
    magnets = MagneticBody(points, 1e5 * np.array([[0.0, 0.3, 0.8], [0.2, 0.0, -0.5]]))
    begin = state_of([-0.012, -0.011, -0.013], velocity=[3.0, 2.5, 3.5])
    body = RigidBody(1e30, [1e30] * 3, magnets, gravity=0.0)
    bench = Bench(modelled(saturating), ohms, 1e-4, at, begin, body)
    cells, shares, misses = set(), [], []
    for _ in range(70):
        bench.run(1, ohms * at)
        place, alone = bench.state[:3], saturating.flux_linkage(bench.currents)
        linkage, pull = bench.core.coil_state.linkage, saturating.wrench(place, magnets, bench.currents)
        cells.add(tuple(np.floor((place - saturating.lower) / 0.01)))
        shares.append(linkage - alone)
        misses.append(saturating.flux_linkage(bench.currents, place, magnets) - linkage)
        assert np.abs(bench.load - pull).max() < 1e-5 * np.abs(pull).max()
    assert np.abs(misses).max() < 5e-3 * np.ptp(shares, axis=0).max()
    assert len(cells) > 4
    assert bench.core.solves.solves < 10


@pytest.mark.parametrize("seed", range(3))
def test_steps_into_and_out_of_saturation_do_not_run_away(saturating, seed):
    """Voltages jump at every step, and inductances change a hundredfold. The map's linkages at the currents differ from
    the integrated ones by a part of a step, and the currents settle at V / R."""
    ohms, drawn = np.full(6, 0.5), np.random.default_rng(seed)
    assert np.linalg.norm(saturating.inductance(0.0)) > 100.0 * np.linalg.norm(saturating.inductance(3.0))
    step = 0.02 * np.abs(saturating.inductance(0.0)).max() / 0.5
    bench = Bench(modelled(saturating), ohms, step, drawn.uniform(-3.0, 3.0, 6))
    begin = saturating.flux_linkage(bench.currents)
    for volts in drawn.uniform(-1.5, 1.5, (40, 6)):
        (currents,), end = bench.run(1, volts), bench.core.coil_state.linkage.copy()
        assert np.abs(saturating.flux_linkage(currents) - end).max() < 0.5 * np.abs(end - begin).max()
        begin = end
    assert bench.run(1000, volts)[-1] == pytest.approx(volts / ohms, rel=1e-5)


def test_a_magnet_that_passes_saturating_iron_drives_currents(saturating):
    """Against scipy with the map's linkages, including the payload's part through the iron."""
    ohms, speed, moment, at = np.full(6, 0.5), 2.0, np.array([0.0, 3e5, 1e6]), np.full(6, 0.2)
    body = RigidBody(1e12, [1e12] * 3, MagneticBody.dipole(moment), gravity=0.0)
    begin = state_of([0, 0, -0.01], velocity=[0, 0, speed])
    bench = Bench(replace(modelled(saturating), tolerance=1e-6), ohms, 1e-5, at, begin, body)
    found = bench.run(800, ohms * at)[-1] - at

    def rates(time, currents):
        place = [0.0, 0.0, -0.01 + speed * time]
        ends = [
            [saturating.flux_linkage(currents + side * coil, place, moment) for side in (1e-4, -1e-4)]
            for coil in np.eye(6)
        ]
        slopes = np.array([(a - b) / 2e-4 for a, b in ends]).T
        induced = saturating.back_emf(place, currents, moment, [0, 0, speed])
        return np.linalg.solve(slopes, ohms * (at - currents) - induced)

    wanted = solve_ivp(rates, (0, 8e-3), at, rtol=1e-6, atol=1e-8).y[:, -1] - at
    assert np.abs(wanted).max() > 0.01
    assert np.abs(found - wanted).max() < 8e-3 * np.abs(wanted).max()


def test_linearised_iron_has_the_inductance_at_its_currents(saturating):
    at = np.full(6, 0.4)
    of = linearised(saturating, at)
    assert of.linkage.inductance @ at + of.linkage.constant == pytest.approx(saturating.flux_linkage(at))
    ohms = np.full(6, 0.5)
    bench = Bench(of, ohms, 1e-4, at)
    volts = ohms * at + 1e-3 * np.arange(6)
    found = bench.run(50, volts)[-1] - at
    rates = np.linalg.solve(saturating.inductance(at), np.diag(ohms))
    steady = 1e-3 * np.arange(6) / ohms
    assert found == pytest.approx(steady - expm(-rates * 5e-3) @ steady, rel=1e-4, abs=1e-9)


def test_a_map_without_linkages_is_refused(axial):
    coils = CoilDrive(WIDE, 1, resistance=1.0, mode="voltage")
    with pytest.raises(InputError) as caught:
        Machine(
            superposed(axial.map(TWO[0])),
            ANY_BODY,
            coils,
            Sensors(),
            MatrixAllocation(np.eye(1), np.zeros(1)),
        )
    assert caught.value.problems[0].where == "Machine(magnetic)"


def one_coil(axial, inductance=0.05):
    return replace(superposed(axial.map(TWO[0])), linkage=StoredLinkage([[inductance]], [0.0]))


def test_a_current_controller_answers_with_its_bandwidth(axial):
    """P = w L and I = w R cancel the pole of the coil: the current answers a step as 1 - exp(-w t)."""
    controller = CurrentController(bandwidth=100.0)
    drive = {"mode": "current_controller", "controller": controller}
    found = Bench(one_coil(axial), [4.0], 1e-5, [0.5], **drive).run(500, [1.5])[:, 0]
    times = 1e-5 * np.arange(1, 501)
    assert found == pytest.approx(1.5 - np.exp(-200 * np.pi * times), abs=1e-4)
    given = CurrentController(proportional=200 * np.pi * 0.05, integral=200 * np.pi * 4.0)
    again = Bench(one_coil(axial), [4.0], 1e-5, [0.5], **drive | {"controller": given}).run(500, [1.5])[:, 0]
    assert again == pytest.approx(found, rel=1e-12)
    # With a stated inductance in place of the map's.
    other = Bench(one_coil(axial, 0.1), [4.0], 1e-5, [0.5], **drive, inductance=0.05).run(500, [1.5])[:, 0]
    slow = solve_ivp(
        lambda _, s: (
            [s[1] - 4.0 * s[0] + given.proportional * (1.5 - s[0]), given.integral * (1.5 - s[0])]
            @ np.diag([10.0, 1.0])
        ),
        (0, 5e-3),
        [0.5, 2.0],
        rtol=1e-9,
        atol=1e-12,
    )
    assert other[-1] == pytest.approx(slow.y[0, -1], abs=1e-5)


def test_a_supply_limits_a_current_controller_which_does_not_wind_up(axial):
    """At the limit the current rises as with a constant voltage; then the error falls with the bandwidth."""
    drive = {"mode": "current_controller", "controller": CurrentController(bandwidth=200.0)}
    bench = Bench(one_coil(axial), [4.0], 1e-5, [0.0], **drive, supply=(-12.0, 12.0))
    found = bench.run(400, [2.0])[:, 0]
    times = 1e-5 * np.arange(1, 401)
    assert found == pytest.approx(3.0 * (1.0 - np.exp(-80.0 * times)), rel=1e-5)
    assert bench.core.coil_state.voltage == pytest.approx([12.0])
    assert list(bench.core.coil_state.source) == [1.0]
    # The voltage leaves the limit where P (2 A - i) + R i is 12 V; from there the error falls with the bandwidth.
    error, gain = 2.0 - bench.run(2000, [2.0])[:, 0], 400.0 * np.pi * 0.05
    after = error[error < 4.0 / (gain - 4.0)]
    assert 0.05 < after[0] < 4.0 / (gain - 4.0)
    assert after == pytest.approx(after[0] * np.exp(-400e-5 * np.pi * np.arange(len(after))), abs=1e-5)
    back = bench.run(100, [-2.0])[:, 0]
    assert back == pytest.approx(-3.0 + 5.0 * np.exp(-80.0 * times[:100]), rel=1e-4)


def test_stiff_controllers_of_strongly_coupled_coils_stay_within_the_supply(axial):
    """Each voltage is R i of the start plus P (asked - mean current), limited to the supply; no other voltages satisfy
    Faraday's law too."""
    row = np.array([2.9, -0.95, -0.35, -0.2, -0.35, -0.95])
    inductance = np.array([np.roll(row, k) for k in range(6)])
    of = replace(superposed(axial.map(*[TWO[0]] * 6)), linkage=StoredLinkage(inductance, np.zeros(6)))
    gain, supply, ohms, random = 1e5, 40.0, np.full(6, 4.25), np.random.default_rng(0)
    drive = {"mode": "current_controller", "controller": CurrentController(proportional=gain, integral=0.0)}
    bench = Bench(of, ohms, 1e-4, np.full(6, 1.5), **drive, supply=(-supply, supply))
    limited = 0
    for _ in range(300):
        before, asked = bench.currents.copy(), 1.5 + 0.05 * random.normal(size=6)
        middle = 0.5 * (before + bench.run(1, asked)[0])
        voltage = bench.core.coil_state.voltage
        given = 2e4 * inductance @ (middle - before) + ohms * middle
        assert voltage == pytest.approx(given, abs=1e-6)
        wanted = np.clip(ohms * 1.5 + gain * (asked - middle), -supply, supply)
        assert voltage == pytest.approx(wanted, abs=1e-6)
        limited += np.sum(np.abs(voltage) == supply)
    assert 300 < limited < 1790


def test_limits_of_a_source_of_voltage(axial):
    """Supply, current and slope; the current leaves its limit as soon as the voltage reverses."""
    limited = Amplifier(1.0, current_lower=-1.0, current_upper=1.2)
    bench = Bench(one_coil(axial), [4.0], 1e-5, [0.0], amplifier=limited, supply=(-10.0, 10.0))
    rising = bench.run(2000, [100.0])[:, 0]
    times = 1e-5 * np.arange(1, 2001)
    free = 2.5 * (1.0 - np.exp(-80.0 * times))
    assert rising == pytest.approx(np.minimum(free, 1.2), rel=1e-4)
    assert bench.core.coil_state.voltage == pytest.approx([4.8], rel=1e-5)
    assert list(bench.core.coil_state.source) == [2.0]
    falling = bench.run(2000, [-10.0])[:, 0]
    wanted = np.maximum(-2.5 + 3.7 * np.exp(-80.0 * times), -1.0)
    assert falling == pytest.approx(wanted, abs=1e-4)
    # 2 V per ms: a ramp of voltage for 4 ms, then 8 V.
    ramped = Bench(one_coil(axial), [4.0], 1e-5, [0.0], slope=2000.0).run(800, [8.0])[:, 0]
    wanted = solve_ivp(
        lambda t, i: (min(2000.0 * t, 8.0) - 4.0 * i) / 0.05, (0, 8e-3), [0.0], rtol=1e-9, max_step=1e-4
    ).y[0, -1]
    assert ramped[-1] == pytest.approx(wanted, rel=2e-3)


def test_two_coils_at_limits_of_their_own(axial):
    """One coil at its current limit, one free: the free one has its own inductance alone."""
    limited = Amplifier(1.0, current_lower=-1e3, current_upper=1.0)
    found = Bench(two_coils(axial), R, 1e-5, [1.0, 0.0], amplifier=limited).run(500, [10.0, -6.0])
    times = 1e-5 * np.arange(1, 501)
    assert found[:, 0] == pytest.approx(np.ones(500), rel=1e-5)
    assert found[:, 1] == pytest.approx(-2.0 * (1.0 - np.exp(-300.0 * times)), rel=1e-4)


def test_a_bridge_gives_its_duty_less_what_it_loses(axial):
    """The loss 2 t f U plus the drop opposes the current; near zero it is proportional to the current."""
    bridge = Bridge(20e3, dead_time=1e-6, drop=1.1, ripple=0.01)
    drive = {"mode": "bridge", "bridge": bridge, "supply": (-12.0, 12.0)}
    loss = 2 * 1e-6 * 20e3 * 12 + 1.1
    for sign in (1.0, -1.0):
        bench = Bench(one_coil(axial), [4.0], 1e-4, [0.0], **drive)
        found = bench.run(3000, [0.6 * 12 * sign])[-1]
        assert found == pytest.approx([sign * (0.6 * 12 - loss) / 4.0], rel=1e-6)
    # The voltage of a duty of 5 % is below the loss, so almost no current flows.
    bench = Bench(one_coil(axial), [4.0], 1e-4, [0.3], **drive)
    assert bench.run(5000, [0.6])[-1] == pytest.approx([0.6 / (4.0 + loss / 0.01)], rel=1e-6)
    # The amplifier's gain is duty per volt: 0.5 of 12 V at 5 V.
    coils = CoilDrive(Amplifier(0.1), 1, resistance=4.0, **drive)
    assert coils.drives[0, 3:5] * 5.0 == pytest.approx([6.0, 0.0])
    assert coils.steady_response[0] * 5.0 == pytest.approx([1.5])


def test_windings_warm_up(axial):
    """At constant voltage: heat against an ODE of temperature and current in scipy, and in closed form with constant
    resistance."""
    heating = Heating(5.0, 0.2, ambient=30.0)
    bench = Bench(one_coil(axial, 1e-3), [4.0], 1e-3, [2.0], heating=heating)
    bench.run(2000, [8.0])

    def rate(_, s):
        ohms = 4.0 * (1.0 + 3.93e-3 * (s[0] - 20.0))
        return [(64.0 / ohms - (s[0] - 30.0) / 5.0) / 0.2]

    wanted = solve_ivp(rate, (0, 2.0), [30.0], rtol=1e-9).y[0, -1]
    assert bench.core.coil_state.temperature == pytest.approx([wanted], rel=1e-3)
    assert bench.currents == pytest.approx([8.0 / (4.0 * (1 + 3.93e-3 * (wanted - 20.0)))], rel=1e-3)
    steady = Bench(one_coil(axial, 1e-3), [4.0], 1e-3, [2.0], heating=replace(heating, coefficient=0.0))
    steady.run(1000, [8.0])
    assert steady.core.coil_state.temperature == pytest.approx([30.0 + 80.0 * (1.0 - np.exp(-1.0))], rel=1e-6)


@pytest.mark.parametrize("coefficient", [0.0, 3.93e-3])
@pytest.mark.parametrize("given", [{"current": 3.0}, {"voltage": 9.0}])
def test_the_time_until_a_winding_is_too_hot(coefficient, given):
    """The time at which scipy's ODE reaches a limit, far below the final temperature and just below; never above."""
    of = Heating(5.0, 0.2, coefficient, reference=25.0, ambient=30.0)

    def rate(_, s):
        ohms = 4.0 * (1.0 + coefficient * (s[0] - 25.0))
        power = given.get("current", 0.0) ** 2 * ohms + given.get("voltage", 0.0) ** 2 / ohms
        return [(power - (s[0] - 30.0) / 5.0) / 0.2]

    path = solve_ivp(rate, (0, 40.0), [30.0], rtol=1e-10, atol=1e-10, dense_output=True)
    last = path.y[0, -1]
    for time in (0.2, 1.0, 9.0):
        limit = float(path.sol(time)[0])
        assert replace(of, limit=limit).time_to_limit(4.0, **given) == pytest.approx(time, rel=1e-5)
    assert (
        replace(of, limit=last + 1.0).time_to_limit(4.0, **given) == of.time_to_limit(4.0, **given) == np.inf
    )
    with pytest.raises(InputError):
        of.time_to_limit(4.0, current=1.0, voltage=1.0)


def test_coils_of_iron_that_remembers_take_the_heat_of_hysteresis():
    """Energy put in = heat of windings and hysteresis + field energy, from the energies of the cells in numpy; in
    steps that reverse their currents twice."""
    model = replace(MODEL, pinning=PINNING[None], shares=SHARES)
    m = interpolate(replace(DATA, reduced_model=model, linkage=AIR), outside_currents="evaluate")
    begin, ohms, misses = m.last_currents, np.full(6, 2.0), []
    of = replace(modelled(m), tolerance=1e-6)
    for step in (1e-3, 5e-4):
        bench = Bench(of, ohms, step, begin)
        first = energies([m])[1][0] + 0.5 * begin @ AIR.inductance @ begin
        found = bench.run(round(0.1 / step), lambda t: ohms * begin + SHAPE * np.sin(90.0 * t))
        memory = LIBRARY.iron_remembered(bench.core.plant.iron)
        stored = energies([SimpleNamespace(remembered=memory)])[1][0]
        last = stored + 0.5 * found[-1] @ AIR.inductance @ found[-1]
        heat = (heat_of(memory) - heat_of(m.remembered)) / mu_0
        misses.append((bench.left - (last - first) - heat) / heat)
        assert heat > 0.02 * bench.left
    assert np.abs(misses).max() < 2e-4
    assert bench.core.coil_state.steps < 1.2 * len(found)


PLAIN = fm.read_device("desk_levitator").replace(driver=fm.Driver(0.4, 2.0, 24.0))


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    return fm.open_map(fm.generate(PLAIN, tmp_path_factory.mktemp("desk") / "desk.h5", spacing=4e-3))


FAST = {"coils.drive": "current_controller", "coils.controller.bandwidth_Hz": 500.0, "duration_s": 0.6}
SWITCHED = {
    "coils.drive": "bridge",
    "coils.bridge.frequency_kHz": 20.0,
    "coils.bridge.dead_time_us": 0.5,
    "coils.bridge.drop_V": 0.7,
    "coils.bridge.ripple_mA": 4.0,
    "coils.heating.thermal_resistance_K_per_W": 5.0,
    "coils.heating.thermal_capacity_J_per_K": 0.01,
    "coils.heating.limit_degC": 22.5,
    "coils.slope_per_s": 1e5,
    "duration_s": 0.2,
}


def test_scenarios_name_drives(desk):
    """A fast controller holds like an ideal source; each row of a run has voltages, and V = R i at rest."""
    ideal = fm.simulate("hold", {"duration_s": 0.6, "noise.off": True}, field_map=desk)
    run = fm.simulate("hold", FAST | {"noise.off": True}, field_map=desk)
    assert run.event is None
    assert run.sensed == pytest.approx(ideal.sensed, abs=2e-5)
    assert run.outputs.shape == ideal.outputs.shape
    assert run.voltages[0] == pytest.approx(6.0 * run.currents[0])
    assert np.abs(run.voltages / run.currents / 6.0 - 1).max() > 1e-2
    assert ideal.voltages.shape == (len(ideal.time), 0)
    assert run.metrics.hottest_degC is ideal.metrics.hottest_degC is None
    balance = run.windings.energy - run.windings.heat
    assert np.abs(balance) < 0.02 * run.windings.heat


def test_a_scenario_of_a_bridge_with_windings_that_warm_up(desk, tmp_path):
    experiment = prepare(read_scenario("hold", SWITCHED), desk)
    drive = experiment.machine.drive
    assert drive.bridge == Bridge(20e3, 0.5e-6, 0.7, 4e-3)
    assert drive.heating == Heating(5.0, 0.01, limit=22.5)
    assert drive.slope == 1e5
    # 1 V gives 0.4 A at rest, like the device's amplifier; with 24 V and 6 ohm that is a duty of a tenth.
    assert drive.steady_response[0] == pytest.approx([0.4])
    assert drive.amplifier.gain == pytest.approx(0.1)
    run = experiment.run(0)
    # From 20 degC towards 20 + 5 P within 50 ms: `too_hot` is the time of the first recorded row above the limit.
    hot = run.temperatures[:, 0] > 22.5
    assert run.windings.too_hot == pytest.approx([run.time[np.argmax(hot)]])
    assert 0.0 < run.windings.too_hot[0] < 0.19
    found = experiment.judged(run).metrics
    assert found.hottest_degC == run.temperatures.max() > 22.5
    assert found.too_hot_s == run.windings.too_hot[0]
    record = recorded(run, ("coil",))
    assert record.about["windings"]["too_hot_s"] == run.windings.too_hot.tolist()
    assert record.arrays["temperatures"][0].shape == record.arrays["voltages"][0].shape == (len(run.time), 1)


NAMED = {
    "current_controller": {"mode": "current_controller", "controller": CurrentController(bandwidth=500.0)},
    "voltage": {"mode": "voltage", "slope": 1e5},
    "bridge": {
        "mode": "bridge",
        "bridge": Bridge(20e3, 0.5e-6, 0.7, 4e-3),
        "heating": Heating(5.0, 0.01, limit=22.5),
        "slope": 1e5,
    },
}
BY_KEYS = {
    "current_controller": {"coils.drive": "current_controller", "coils.controller.bandwidth_Hz": 500.0},
    "voltage": {"coils.drive": "voltage", "coils.slope_per_s": 1e5},
    "bridge": {key: value for key, value in SWITCHED.items() if key.startswith("coils.")},
}


@pytest.mark.parametrize("mode", NAMED)
def test_a_scenario_that_says_nothing_takes_the_drive_of_the_device(desk, tmp_path, mode):
    """The drive read back from the device's file gives the same run as a scenario that names the drive."""
    (tmp_path / "own.toml").write_text(PLAIN.replace(driver=replace(PLAIN.driver, **NAMED[mode])).to_toml())
    device = fm.read_device(tmp_path / "own.toml")
    runs = [
        fm.simulate("hold", {"duration_s": 0.1, **changes}, field_map=desk, device=of)
        for changes, of in (
            ({}, device),
            (BY_KEYS[mode], PLAIN),
            ({"coils.drive": "ideal"}, device),
            ({}, PLAIN),
        )
    ]
    np.testing.assert_array_equal(runs[0].rows, runs[1].rows)
    np.testing.assert_array_equal(runs[2].rows, runs[3].rows)
    assert np.abs(runs[0].currents - runs[3].currents).max() > 1e-4


@pytest.mark.parametrize("mode", NAMED)
def test_a_run_at_rest_stays_there_until_its_first_command(desk, mode):
    """The first command acts after a period; until then the voltage holds the current, at a bridge with its loss."""
    device = PLAIN.replace(driver=replace(PLAIN.driver, **NAMED[mode] | {"heating": None, "slope": 100.0}))
    quiet = {"duration_s": 0.02, "noise.off": True, "control.delay_ms": 2.0, "control.step_ms": 0.1}
    run = fm.simulate("hold", quiet, field_map=desk, device=device)
    assert run.currents[0, 0] > 0.1
    np.testing.assert_allclose(run.currents, run.currents[0, 0], rtol=1e-6)


def test_a_scenario_replaces_single_keys_of_the_device(desk):
    device = PLAIN.replace(driver=replace(PLAIN.driver, **NAMED["bridge"]))
    changes = {"coils.bridge.frequency_kHz": 8.0, "coils.slope_per_s": 3e4}
    drive = prepare(read_scenario("hold", changes), desk, device).machine.drive
    assert (drive.mode, drive.bridge, drive.slope) == ("bridge", Bridge(8e3), 3e4)
    assert drive.heating == NAMED["bridge"]["heating"]


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ('drive = "bridge"', "driver.bridge"),
        ('drive = "current_controller"', "driver.controller"),
        ('drive = "voltage"', "driver.drive"),
        ('drive = "bridge"\nbridge.frequency_kHz = 20', "driver.drive"),
        ('drive = "valve"', "driver.drive"),
        ("bridge = { frequency_kHz = 20, dead_time_us = 25 }", "driver.bridge.dead_time_us"),
        (
            "controller = { bandwidth_Hz = 20, proportional_V_per_A = 2 }",
            "driver.controller.integral_V_per_A_s",
        ),
        ("controller.proportional_V_per_A = 2", "driver.controller.integral_V_per_A_s"),
        (
            "heating = { thermal_resistance_K_per_W = 1, thermal_capacity_J_per_K = 1, limit_degC = 20 }",
            "driver.heating.limit_degC",
        ),
    ],
)
def test_a_device_file_lacks_what_its_drive_needs(desk, tmp_path, text, where):
    """A voltage source needs the coil's resistance, a bridge its supply; each message names the line of the key."""
    written = PLAIN.replace(driver=fm.Driver(0.4, 2.0)).to_toml()
    if "voltage" in text:
        written = written.replace("resistance_ohm = 6.0\n", "")
    assert "[driver]\n" in written
    (tmp_path / "own.toml").write_text(written.replace("[driver]\n", f"[driver]\n{text}\n"))
    with pytest.raises(InputError) as caught:
        fm.read_device(tmp_path / "own.toml")
    (problem,) = caught.value.problems
    assert problem.where.endswith(f": {where}")
    assert ".toml:" in problem.where


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"coils.drive": "bridge"}, "coils.bridge"),
        ({"coils.drive": "current_controller"}, "coils.controller"),
        (FAST | {"coils.controller.bandwidth_Hz": -1.0}, "coils.controller.bandwidth_Hz"),
        ({"coils.drive": "valve"}, "coils.drive"),
    ],
)
def test_drives_that_do_not_fit_are_refused_by_their_keys(desk, changes, where):
    with pytest.raises(InputError) as caught:
        fm.simulate("hold", changes, field_map=desk)
    assert where in caught.value.problems[0].where
