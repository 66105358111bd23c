"""The numbers and assumptions that compiled loops get from a machine, for made-up parameters that all differ."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.constants import MU0
from fieldmap.device.model import Driver
from fieldmap.dynamics import CoilDrive, Drag, Machine, MatrixAllocation, Plate, RigidBody, Sensors, Walls
from fieldmap.dynamics.allocation import least_power_allocation, lift_and_directions
from fieldmap.dynamics.machine import CONTACTS, ChainKeys, drive_of_device
from fieldmap.dynamics.rigid_body import body_of_payload
from fieldmap.dynamics.scenario.controllers import _noise, limits_of
from fieldmap.errors import InputError
from fieldmap.instruments import Amplifier, Converter, Rig, SensorFrame
from fieldmap.lookup import MagneticBody
from tests.refusals import refused

AMPLIFIER = Amplifier(0.4, -9.0, 8.0, offset=0.1, current_lower=-2.5, current_upper=3.5)


@pytest.mark.parametrize(
    ("amplifier", "converter", "row", "steady"),
    [
        # The current limits in V are (-2.5 - 0.1) / 0.4 and (3.5 - 0.1) / 0.4.
        (AMPLIFIER, None, [0.0, -6.5, 8.0, 0.4, 0.1, -2.5, 3.5], (-2.5, 3.3)),
        (AMPLIFIER, Converter(5.0, 3), [1.25, -5.0, 5.0, 0.4, 0.1, -2.5, 3.5], (-1.9, 2.1)),
        (replace(AMPLIFIER, lower=-4.0, upper=9.0), None, [0.0, -4.0, 8.5, 0.4, 0.1, -2.5, 3.5], (-1.5, 3.5)),
    ],
)
def test_a_drive_is_limited_by_what_ends_first(amplifier, converter, row, steady):
    drive = CoilDrive(amplifier, 2, converter=converter)
    np.testing.assert_allclose(drive.drives, [row] * 2, rtol=1e-12)
    np.testing.assert_allclose(drive.steady, np.transpose([steady] * 2), rtol=1e-12)
    # The steady current of a winding is limited to supply / resistance.
    wound = replace(drive, resistance=[2.0, 100.0], inductance=3e-3, supply=(-20.0, 30.0))
    np.testing.assert_allclose(wound.steady, [[steady[0], -0.2], [steady[1], 0.3]], rtol=1e-12)


def test_windings_and_answers_of_one_step():
    """exp(-R h / L), exp(-h / tau), and the steady currents at the supply's limits, highest first."""
    largest = np.finfo(float).max
    at_once = CoilDrive(AMPLIFIER, 2)
    np.testing.assert_array_equal(at_once.numbers(1e-4), [[0.0, 0.0, largest, -largest]] * 2)
    wound = CoilDrive(AMPLIFIER, 2, [2.0, 4.0], [1e-3, 4e-3], (-8.0, 12.0), 5e-4)
    expected = [[np.exp(-0.2), np.exp(-0.2), 6.0, -4.0], [np.exp(-0.1), np.exp(-0.2), 3.0, -2.0]]
    np.testing.assert_allclose(wound.numbers(1e-4), expected, rtol=1e-12)
    free = replace(wound, supply=(-np.inf, np.inf))
    np.testing.assert_array_equal(free.numbers(1e-4)[:, 2:], [[largest, -largest]] * 2)


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"resistance": 2.0}, "CoilDrive(resistance, inductance)"),
        ({"inductance": 2.0}, "CoilDrive(resistance, inductance)"),
        ({"resistance": [1.0, 0.0], "inductance": 1.0}, "CoilDrive(resistance)(smallest)"),
        ({"resistance": 1.0, "inductance": [1.0, -1.0]}, "CoilDrive(inductance)(smallest)"),
        ({"supply": (2.0, 1.0)}, "CoilDrive(supply)"),
        ({"time_constant": -1e-9}, "CoilDrive(time_constant)"),
    ],
)
def test_drives_that_cannot_be(given, where):
    with pytest.raises(InputError) as caught:
        CoilDrive(AMPLIFIER, 2, **given)
    assert caught.value.problems[0].where.replace(" ", "").startswith(where[:12])
    assert where.split("(")[1][:8] in caught.value.problems[0].where


def test_the_drive_of_a_device_file():
    """Its windings and supply; without the numbers of one coil, currents follow at once."""
    coils = [fm.CircularCoil(name, 0.01, 0.02, 0.01, 100, resistance=r, inductance=2e-3) for name, r in
             (("a", 1.5), ("b", 2.5))]  # fmt: skip
    device = SimpleNamespace(coils=coils, driver=Driver(0.5, 3.0, 24.0))
    drive = drive_of_device(device)
    amplifier = (0.5, -6.0, 6.0, -3.0, 3.0)
    of = drive.amplifier
    assert (of.gain, of.lower, of.upper, of.current_lower, of.current_upper) == amplifier
    assert (drive.coils, drive.supply, drive.time_constant) == (2, (-24.0, 24.0), 0.0)
    assert (drive.resistance.tolist(), drive.inductance.tolist()) == ([1.5, 2.5], [2e-3, 2e-3])
    assert drive_of_device(device, 0.0, time_constant=1e-3).supply == (0.0, 24.0)
    assert drive_of_device(device, 0.0, time_constant=1e-3).time_constant == 1e-3
    device.driver = Driver(0.5, 3.0)
    device.coils = [coils[0], replace(coils[1], resistance=None)]
    bare = drive_of_device(device)
    assert (bare.supply, bare.resistance, bare.inductance) == ((-np.inf, np.inf), None, None)
    device.driver = None
    with refused(InputError, where="drive_of_device(device)"):
        drive_of_device(device)


def test_crossed_sensors_as_loops_take_them():
    """Turned by 30 degrees and off the axis: readings of each sensor at (x, y), and back; depth counts downward."""
    frame = SensorFrame(np.pi / 6, offset=0.02, radius=0.005, bias=(1e-3, -2e-3))
    sensors = Sensors(
        frame, 0.07, (1e-6, 2e-6, 3e-6), scan_rate=500.0, averages=(4, 9, 16), latency=3, measured_with=25
    )
    into, shift, chains, back, scan, field = sensors.numbers
    assert field is None
    for place in ([1e-3, 2e-3, -0.1], [-3e-3, 0.0, -0.08]):
        readings = frame.to_local(np.array(place))
        np.testing.assert_allclose(into @ place + shift, [*readings[:2], -place[2] - 0.07], atol=1e-15)
    np.testing.assert_allclose(back @ into, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(scan, [2e-3, 3.0, 4.0, 9.0, 16.0])
    # No scaling, rounding or clipping.
    np.testing.assert_array_equal(chains[2], [0, 1, 0, -np.inf, np.inf, 0, 0, 0, -np.inf, np.inf])
    np.testing.assert_allclose(sensors.scan_deviations, [5e-6, 1e-5, 1.5e-5])
    np.testing.assert_allclose(replace(sensors, measured_with=None).scan_deviations, [2e-6, 6e-6, 1.2e-5])
    assert (replace(sensors, averages=2).means, sensors.means) == ((2, 2, 2), (4, 9, 16))
    assert [sensors.scans(time) for time in (0.0, 0.0019, 0.002, 0.0059)] == [1, 1, 2, 3]
    assert (Sensors().scans(1.0), Sensors().numbers.scan.tolist()) == (0, [0.0, 0.0, 1.0, 1.0, 1.0])
    with refused(InputError, where="Sensors(voltage_noise)"):
        Sensors(voltage_noise=-1e-9)
    # Deviations along the axes of the map, at least 1 um.
    machine = SimpleNamespace(sensors=replace(sensors, deviations=(3e-6, 4e-6, 1e-7)))
    expected = np.hypot([3e-6 * np.sqrt(0.75), 3e-6 * 0.5], [4e-6 * 0.5, 4e-6 * np.sqrt(0.75)])
    np.testing.assert_allclose(_noise(machine), [*expected, 1e-6], rtol=1e-12)
    machine.sensors = Sensors(deviations=(1e-7, 2e-6, 3e-6))
    assert _noise(machine) == (1e-6, 2e-6, 3e-6)


def test_the_keys_of_a_measuring_chain():
    made = ChainKeys(
        angle_deg=30.0, step_mm=0.01, input_bits=12, input_range_V=5.0, mm_per_V=4.0, input_noise_V=1e-3
    ).also_makes()
    assert (made["frame"].angle, made["frame"].offset) == (pytest.approx(np.pi / 6), 0.0)
    assert made["voltage_noise"] == 1e-3
    rig = made["rigs"][0]
    assert made["rigs"] == (rig, rig, rig)
    # Zero, m per V, step in V, range; gain and offset error; the converter.
    expected = [0.0, 4e-3, 0.0025, -1e3, 1e3, 0.0, 0.0, 10.0 / 4096, -5.0, 5.0]
    np.testing.assert_allclose(rig.chain, expected, rtol=1e-12)
    assert rig.input.random_noise == 1e-3
    plain = ChainKeys().also_makes()
    assert (plain["frame"], plain["rigs"], plain["voltage_noise"]) == (None, (None,) * 3, 0.0)
    (only_steps, *_) = ChainKeys(step_mm=0.01).also_makes()["rigs"]
    assert isinstance(only_steps, Rig)
    assert only_steps.chain[2] == pytest.approx(0.005)
    assert (only_steps.input.range, only_steps.chain[7]) == (10.0, pytest.approx(20.0 / 2**48))


BODY = RigidBody(
    0.02, [1e-6, 2e-6, 2.5e-6], MagneticBody(np.zeros((1, 3)), np.eye(3)[2:]), assumptions=("b",)
)


def machine(**more):
    allocation = MatrixAllocation(np.eye(2), np.zeros(2), assumptions=("c",))
    field = SimpleNamespace(assumptions=("a",), constant=False)
    return Machine(field, BODY, CoilDrive(AMPLIFIER, 2), Sensors(assumptions=("s",)), allocation, **more)


def test_a_machine_tells_what_it_rests_on_in_order():
    plain = ("a", "b", "c", "currents follow at once", "s")
    assert machine().assumptions == plain
    drag, plate = Drag(linear=(0.0, 2.0, 0.0), turning=(1e-6,) * 3), Plate(3.5e7, 0.012, (0, 0, 0))
    driven = CoilDrive(AMPLIFIER, 2, 2.0, 1e-3, (-8.0, 12.0))
    told = replace(machine(drag=drag, plate=plate), drive=driven).assumptions
    assert told[:3] == plain[:3]
    assert told[3].endswith("-8 to 12 V")
    assert told[4:6] == ("drag 0, 2, 0 N s/m", "drag 1e-06, 1e-06, 1e-06 N m s about the body's axes")
    assert "12 mm of 3.5e+07 S/m" in told[6]
    assert told[7:] == ("s",)
    every = Drag((1.0,) * 3, (2.0,) * 3, (3.0,) * 3, (4.0,) * 3, (5.0,) * 3)
    assert [words.split(" ", 4)[4] for words in every.assumptions] == [
        "N s/m",
        "N s/m along the body's axes",
        "N s^2/m^2 along the body's axes",
        "N m s about the body's axes",
        "N m s^2 about the body's axes",
    ]
    np.testing.assert_array_equal(every.numbers, np.arange(1.0, 6.0)[:, None] * np.ones(3))


@pytest.mark.parametrize(
    ("ending", "contacts"),
    [((), ()), (("floor", "currents"), ("floor", "currents")), (("ceiling", "tube"), ("ceiling", "tube"))],
)
def test_what_ends_a_run(ending, contacts):
    numbers = machine(ending=ending, longest_saturation=0.0101).end_numbers(2e-3)
    assert [name for name, bit in CONTACTS.items() if numbers[0] & bit] == [
        n for n in CONTACTS if n in contacts
    ]
    assert numbers[1] == 6
    with refused(InputError, where="Machine(ending)", received="wall"):
        machine(ending=("wall",))


def test_limits_of_outputs_unless_they_are_given():
    """The amplifiers' largest current over their gain, and 1; with magnets a matrix has a negative limit too."""
    amplifier = replace(AMPLIFIER, offset=0.0)
    plain = replace(machine(), drive=CoilDrive(amplifier, 2))
    most = amplifier.largest_current / 0.4
    for constant, divided, lower, upper in (
        (False, False, [0.0, -1.0, -1.0], [most, 1.0, 1.0]),
        (True, False, [-most, -1.0, -1.0], [most, 1.0, 1.0]),
        (True, True, [0.0, -1.0, -1.0], [most, 1.0, 1.0]),
    ):
        one = replace(plain, magnetic=SimpleNamespace(assumptions=(), constant=constant))
        one = replace(one, allocation=lift_and_directions(1.3)) if divided else one
        np.testing.assert_array_equal(limits_of(one, None, None), [lower, upper])
        given = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
        np.testing.assert_array_equal(limits_of(one, *given), given)


def test_an_allocation_of_least_power_tells_its_shares_and_volts():
    force = [[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]]
    told = least_power_allocation(force, [1.0, 0.8754], 2.3456).assumptions
    assert "lift in the shares 1, 0.875;" in told[0]
    assert "a signal x of 1 adds 2.35 V to a coil" in told[0]
    assert told[1].startswith("the coils do not push along y")
    still = least_power_allocation([[0.0, 0.0], [0.0, 0.0], [0.3, 0.3]], [1.0, 1.0], 2.0)
    assert "signal x" not in still.assumptions[0]
    assert still.idle == ("x", "y")
    with refused(InputError, where="least_power_allocation(volts)"):
        least_power_allocation(force, [1.0, 1.0], 0.0)


def test_a_matrix_of_outputs_in_numbers():
    allocation = MatrixAllocation(np.array([[1, 2], [3, 4], [5, 6]]), np.array([7, 8, 9]))
    assert (allocation.coils, allocation.output_names) == (3, ("output_0", "output_1"))
    assert allocation.voltages(np.array([10.0, 100.0])).tolist() == [217.0, 438.0, 659.0]
    assert allocation.derivative(np.zeros(2)).tolist() == [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    numbers = allocation.numbers()
    assert (numbers[0], numbers[1]) == (0, 1.0)
    np.testing.assert_array_equal(numbers[2], allocation.matrix)
    np.testing.assert_array_equal(numbers[3], [7.0, 8.0, 9.0])
    np.testing.assert_array_equal(replace(allocation, constant=2.0).numbers()[3], [2.0] * 3)


def test_a_plate_and_walls_in_numbers():
    plate = Plate(4e7, 0.02, (1.0, 2.0, 3.0), (0.0, 3.0, 4.0))
    np.testing.assert_allclose(plate.numbers, [4e7, 0.02, 1.0, 2.0, 3.0, 0.0, 0.6, 0.8])
    assert plate.critical_speed == pytest.approx(2.0 / (MU0 * 4e7 * 0.02))
    none = Walls().numbers(0.03)
    np.testing.assert_array_equal(none[4:], [-np.inf, np.inf, np.inf, 0.0, 0.0])
    walls = Walls(-0.1, 0.2, 0.03, (4e-3, -5e-3), 2e-3, 0.6, 0.4, 7e-3)
    k, c, *rest = walls.numbers(0.03)
    # Half a period of m z'' + c z' + k z = 0 takes 2 ms, after which the speed is 0.6 times as large.
    pole = np.roots([0.03, c, k])[0]
    assert np.pi / abs(pole.imag) == pytest.approx(2e-3)
    assert np.exp(pole.real * 2e-3) == pytest.approx(0.6)
    assert rest == [0.4, 7e-3, -0.1, 0.2, 0.03, 4e-3, -5e-3]


def test_a_body_in_numbers():
    upright = replace(BODY, upright=True, magnet_at=[1e-3, 2e-3, 3e-3], skin=[[1.0, 2.0, 3.0]], gravity=5.0)
    drag, plate, walls = Drag((1.0, 2.0, 3.0)), Plate(4e7, 0.02, (1.0, 2.0, 3.0)), Walls(floor=-0.1)
    numbers = upright.numbers(drag, plate, walls)
    assert numbers.mass == 0.02
    assert (np.asarray(numbers.inertia) > 1e9).all()
    np.testing.assert_array_equal(numbers.gravity, [0.0, 0.0, -5.0])
    np.testing.assert_array_equal(numbers.seen_by_plate, [1e-3, 2e-3, 3e-3, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal([numbers.force, numbers.torque], np.zeros((2, 3)))
    np.testing.assert_array_equal(numbers.drag, drag.numbers)
    np.testing.assert_array_equal(numbers.plate, plate.numbers)
    np.testing.assert_array_equal(numbers.walls, walls.numbers(0.02))
    np.testing.assert_array_equal(numbers.skin, [[1.0, 2.0, 3.0]])
    bare = BODY.numbers()
    np.testing.assert_array_equal(bare.inertia, BODY.inertia)
    np.testing.assert_array_equal(bare.plate, np.zeros(8))
    assert np.shape(bare.skin) == (0, 3)
    for wrong, where in (({"mass": 0.0}, "RigidBody(mass)"), ({"gravity": -1.0}, "RigidBody(gravity)")):
        with refused(InputError, where=where):
            replace(BODY, **wrong)


CYLINDER, BLOCK, BALL = (
    fm.MagnetCylinder(0.02, 0.03, 1.2),
    fm.MagnetBlock((0.01, 0.02, 0.04), 1.2),
    fm.MagnetSphere(0.02, 1.2),
)
RING = 2 * np.pi * np.arange(8) / 8


def rims(radius, low, high):
    ring = np.column_stack([radius * np.cos(RING), radius * np.sin(RING)])
    return np.concatenate([np.column_stack([ring, np.full(8, z)]) for z in (low, high)])


SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
SPHERE = np.concatenate([rims(0.01, 0.0, 0.0)[:8], [[0, 0, -0.01], [0, 0, 0.01]]])
TURNED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("payload", "given", "skin"),
    [
        ({"magnet": CYLINDER}, {}, rims(0.01, -0.015, 0.015)),
        ({"magnet": CYLINDER}, {"radius": 0.03}, rims(0.03, -0.015, 0.015)),
        ({"magnet": CYLINDER}, {"height": 0.05, "below": 0.01}, rims(0.01, -0.01, 0.04)),
        ({"magnet": BLOCK}, {}, SIGNS * [0.005, 0.01, 0.02]),
        ({"magnet": BALL}, {}, SPHERE),
        ({"magnet": BALL}, {"radius": 0.03, "height": 0.05}, rims(0.03, 0.0, 0.05)),
        ({"magnet": BALL}, {"radius": 0.03, "height": 0.05, "below": 0.01}, rims(0.03, -0.01, 0.04)),
        (
            {
                "pieces": [fm.PayloadPiece(CYLINDER, fm.Placement((0.01, 0.02, 0.03), TURNED)), BLOCK],
                "inertia": (1e-5,) * 3,
            },
            {},
            np.concatenate(
                [rims(0.01, -0.015, 0.015) @ TURNED.T + [0.01, 0.02, 0.03], SIGNS * [0.005, 0.01, 0.02]]
            ),
        ),
    ],
)
def test_the_skin_of_a_body_is_that_of_its_shapes(payload, given, skin):
    """About the centre of mass, which lies 4 mm above the magnet's centre."""
    body = body_of_payload(fm.Payload(0.05, **payload, magnet_offset=0.007), centre_of_mass=0.004, **given)
    np.testing.assert_allclose(body.skin, skin - [0.0, 0.0, 0.004], atol=1e-15)
    np.testing.assert_allclose([body.magnet_at[2], body.seen_at[2]], [-0.004, 0.003])
    told = "\n".join(body.assumptions)
    assert "centre of mass 4 mm above" in told
    assert "sensed point 7 mm above" in told


@pytest.mark.parametrize(
    ("payload", "given", "words"),
    [
        ({"magnet": CYLINDER}, {}, "cylinder of 20 x 30 mm, the magnet's"),
        ({"magnet": CYLINDER}, {"radius": 0.03}, "cylinder of 60 x 30 mm"),
        ({"magnet": BLOCK}, {}, "block of 10 x 20 x 40 mm, the magnet's"),
        ({"magnet": BALL}, {}, "sphere of 20 mm, the magnet's"),
        ({"pieces": [BALL]}, {}, "body of its pieces"),
        ({"magnet": BALL, "inertia": (1e-6, 1e-6, 1e-6)}, {}, None),
    ],
)
def test_what_an_inertia_was_taken_for(payload, given, words):
    body = body_of_payload(fm.Payload(0.05, **payload), **given)
    told = [note for note in body.assumptions if "inertia" in note]
    assert told == ([f"inertia of a uniform {words}"] if words else [])
    upright = body_of_payload(fm.Payload(0.05, **payload), upright=True, **given)
    assert (upright.upright, body.upright) == (True, False)
    assert "stays upright" in upright.assumptions[0]


@pytest.mark.parametrize("given", [{"radius": 0.01}, {"height": 0.01}, {}])
def test_a_moment_alone_has_no_inertia(given):
    with refused(InputError, where="body_of_payload(payload)"):
        body_of_payload(fm.Payload(0.05, moment=0.8), **given)


def test_what_stands_for_magnets_and_soft_iron():
    bead = fm.SoftSphere(4e-3, mu_r=50.0)
    for pieces, words in (
        ([BALL], ["point dipole"]),
        ([BALL, fm.PayloadPiece(BALL, fm.Placement((0, 0, 0.03)))], ["magnet of 2 dipoles"]),
        ([bead], ["soft iron: 1 induced dipole"]),
        ([BALL, bead, bead], ["point dipole", "soft iron: 2 induced dipoles"]),
    ):
        told = body_of_payload(fm.Payload(0.05, pieces=pieces)).assumptions
        assert [note for note in told if note in words] == words
    down = body_of_payload(fm.Payload(0.05, magnet=BALL, direction="down"))
    assert down.magnet.moments[0, 2] < 0.0
