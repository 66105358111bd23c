"""Linear models of machines on iron with hysteresis: slopes over output loops, against loops stepped by hand."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.control import plant_from_map
from fieldmap.device.model import Payload
from fieldmap.dynamics import (
    CoilDrive,
    MatrixAllocation,
    find_operating_point,
    linearise,
    linearised,
    modelled,
)
from fieldmap.dynamics.scenario.schema import FieldSettings
from fieldmap.errors import InputError
from fieldmap.instruments import Amplifier
from fieldmap.lookup import interpolate
from tests.dynamics.conftest import saturating_data
from tests.dynamics.test_modelled_iron import MOMENT, machine_of

PINNING, SHARES = np.linspace(0.0, 0.02, 5), np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / 4.0
GAIN, LOOP, MASS = 0.4, 0.3, 2e-4
PATTERNS = np.array(
    [[1.0, 0.5, -0.3, 0.8, 0.2, 0.1], [0.0, 1.0, -1.0, 0.3, 0.4, 0.0], [0.2, 0.0, 0.6, -0.5, 1.0, 0.7]]
).T
HERE = np.zeros(3)


@pytest.fixture(scope="module")
def memory():
    data = saturating_data(free=True)
    model = replace(data.reduced_model, pinning=PINNING[None], shares=SHARES)
    m = interpolate(replace(data, reduced_model=model), outside_currents="evaluate")
    return m.memory("shaken", np.array([0.5, 0.2, -0.4, 0.6, 0.3, -0.2]))


def machine_on(field, time_constant=0.0):
    drive = CoilDrive(Amplifier(GAIN, -10.0, 10.0), 6, time_constant=time_constant)
    allocation = MatrixAllocation(PATTERNS, np.zeros(6), ("a", "b", "c"))
    machine = replace(machine_of(field), drive=drive, allocation=allocation)
    return replace(machine, body=replace(machine.body, mass=MASS))


def at_rest(machine):
    return find_operating_point(machine, [0.0, 0.0, 0.0], [np.nan] * 3, [0.1, 0.1, 0.1])


def by_hand(memory, currents, swing):
    """Half the change of the force between the ends of the second of two loops of the currents."""
    for turn in (0.0, 1.0, -1.0, 1.0):
        memory = memory.step(currents + turn * swing)
    plus = memory.wrench(HERE, MOMENT, currents + swing)[:3]
    return 0.5 * (plus - memory.step(currents - swing).wrench(HERE, MOMENT, currents - swing)[:3])


def slopes_by_hand(memory, currents, loop):
    """Force per volt of each output (3, 3), N/V."""
    found = []
    for pattern in GAIN * PATTERNS.T:
        step = loop / np.abs(pattern).max()
        found.append(by_hand(memory, currents, step * pattern) / step)
    return np.transpose(found)


@pytest.mark.parametrize("loop", [LOOP, None])
def test_the_linear_machine_has_the_slopes_of_loops(memory, loop):
    machine = machine_on(modelled(memory, loop=loop))
    point = at_rest(machine)
    linear = linearise(machine, point)
    wanted = slopes_by_hand(memory, point.currents, loop or 5e-3)
    np.testing.assert_allclose(linear.B[3:6] * MASS, wanted, rtol=0.0, atol=1e-4 * np.abs(wanted).max())
    other = slopes_by_hand(memory, point.currents, 5e-3 if loop else LOOP)
    assert np.abs(wanted - other).max() > 0.02 * np.abs(wanted).max()
    assert any(f"loops of {loop or 5e-3:g} A" in text for text in linear.assumptions)
    # With amplifiers of finite speed the steady force is the same.
    slow = linearise(machine_on(modelled(memory, loop=loop), 1e-3), point)
    force = slow.A[3:6, 6:] @ np.linalg.solve(-slow.A[6:, 6:], slow.B[6:])
    np.testing.assert_allclose(force, linear.B[3:6], atol=1e-9 * np.abs(linear.B).max())


def test_a_loop_in_iron_without_memory_is_a_central_difference():
    plain = interpolate(saturating_data(free=True), outside_currents="evaluate")
    machine = machine_on(modelled(plain))
    point = at_rest(machine)
    exact = linearise(machine, point).B
    # The iron's law is only piecewise smooth, so the ratio of two errors is not a measure of order. Measured errors are
    # 0.04 to 0.3 loop^2 of the slope.
    for loop in (0.4, 0.2, 0.1, 0.05, 0.025, 0.0125):
        off = np.abs(linearise(machine_on(modelled(plain, loop=loop)), point).B - exact).max()
        assert 0.02 * loop**2 < off / np.abs(exact).max() < 0.5 * loop**2


def test_linearised_iron_takes_the_slopes_of_loops_of_each_coil(memory):
    at = np.array([0.4, 0.3, -0.2, 0.7, 0.1, -0.3])
    machine = machine_on(linearised(memory, at, loop=LOOP))
    one_each = replace(machine, allocation=MatrixAllocation(np.eye(6), at / GAIN, tuple("abcdef")))
    point = replace(at_rest(machine), currents=at, outputs=np.zeros(6))
    linear = linearise(one_each, point)
    for k, swing in enumerate(LOOP * np.eye(6)):
        wanted = GAIN / LOOP * by_hand(memory, at, swing)
        np.testing.assert_allclose(
            linear.B[3:6, k] * MASS, wanted, rtol=0.0, atol=1e-5 * np.abs(wanted).max()
        )


def test_a_plant_of_a_map_has_the_slopes_of_loops_of_its_steps(memory):
    payload = Payload(mass=MASS, moment=MOMENT[2], magnet=None, magnet_offset=0.0, inertia=None, drag=0.0)
    at, steps = memory.last_currents, np.array([0.3, 0.2, 0.1])
    plant = plant_from_map(memory, payload, HERE, at, PATTERNS, signal_steps=steps)
    for k, step in enumerate(steps):
        wanted = by_hand(memory, at, step * PATTERNS[:, k]) / step
        np.testing.assert_allclose(plant.force_per_signal[:, k], wanted, rtol=1e-5, atol=1e-9)
    small = plant_from_map(memory, payload, HERE, at, PATTERNS, signal_steps=np.full(3, 1e-3))
    assert (
        np.abs(small.force_per_signal - plant.force_per_signal).max()
        > 0.02 * np.abs(plant.force_per_signal).max()
    )


def test_a_scenario_gives_its_loop_to_every_kind_of_iron(memory):
    at = memory.last_currents
    assert FieldSettings(loop=LOOP).field(memory, at).loop == LOOP
    assert FieldSettings().field(memory, at).loop is None
    found = FieldSettings(iron="linearised", loop=LOOP).field(memory, at)
    np.testing.assert_array_equal(found.block, linearised(memory, at, loop=LOOP).block)
    assert np.abs(found.block - linearised(memory, at).block).max() > 0.0
    divided = interpolate(saturating_data(), outside_currents="evaluate")
    tabled = FieldSettings(table=(4, 4, 4), loop=LOOP).field(divided, np.full(6, 1.6))
    assert (tabled.iron, tabled.loop) == ("table", LOOP)
    for wrong in (lambda: modelled(memory, loop=0.0), lambda: linearised(memory, at, loop=0.0)):
        with pytest.raises(InputError):
            wrong()
