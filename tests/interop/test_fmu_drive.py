"""Units whose coils are driven by voltages, against the simulator and laws of the coils: by hand and by FMPy."""

import ctypes
import re
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from fieldmap import Driver, read_device
from fieldmap.cli import main
from fieldmap.dynamics import (
    Bridge,
    CoilDrive,
    CurrentController,
    Heating,
    Machine,
    MatrixAllocation,
    RigidBody,
    Sensors,
    modelled,
    state_of,
)
from fieldmap.errors import InputError
from fieldmap.instruments import Amplifier
from fieldmap.interop import write_fmu
from fieldmap.lookup import MagneticBody, interpolate
from fieldmap.lookup.current_model import STEP_TOLERANCE
from fieldmap.lookup.current_solver import COMPILED_TOLERANCE
from fieldmap.store import StoredLinkage, write_map
from tests.interop.iron_maps import CELLS, KINDS, saturating_data
from tests.interop.test_fmu import strict_and_within_its_memory, unpacked
from tests.interop.test_fmu_iron import Unit

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
PLACE, STEP, EACH = np.array([0.002, -0.001, -0.09]), 1e-4, 10
MAGNET = MagneticBody(
    np.array([[0.0, 0.0, 2e-3], [1e-3, 0.0, 0.0]]), np.array([[0.0, 0.1, 0.5], [0.2, 0.0, 0.3]])
)
BODY = RigidBody(0.01, np.array([6e-7, 7e-7, 2e-7]), MAGNET, magnet_at=np.array([1e-4, 0.0, 1e-3]))
WIDE = Amplifier(1.0, current_lower=-1e9, current_upper=1e9)
TURNING = state_of(PLACE, velocity=[0.02, -0.05, 0.3], angular_velocity=[2.0, -1.0, 3.0])
KINDS_OF_IRON = {"linear": None, "saturating": {}, "remembering": {"cells": CELLS}}
DRIVES = {
    "voltage": {"supply": (-4.0, 4.0), "slope": 2e4},
    "current_controller": {
        "supply": (-4.0, 4.0),
        "controller": CurrentController(proportional=20.0, integral=4e3),
    },
}
HEATING = Heating(thermal_resistance=20.0, thermal_capacity=1e-3)


def coils(n, mode="voltage"):
    more = {"amplifier": WIDE, "heating": HEATING} | DRIVES[mode]
    return CoilDrive(coils=n, resistance=2.0 + np.arange(n), mode=mode, **more)


@pytest.fixture(scope="module")
def maps(ring):
    """Maps by kind of iron, with linkages drawn at random."""
    drawn = np.random.default_rng(5).normal(size=(6, 6))
    inductance = 1e-3 * (drawn @ drawn.T + 6.0 * np.eye(6))
    found = {}
    for name, more in KINDS_OF_IRON.items():
        data = ring.data if more is None else saturating_data(ring, *KINDS["free"], **more)
        if more is not None:
            # A smaller core has the same state, and its linkages are as large as those of coils of some 10 mH.
            of = data.reduced_model
            data = replace(data, reduced_model=replace(of, weights=1e-7 * of.weights, air=1e-7 * of.air))
        n = len(data.coil_names)
        linkage = StoredLinkage(inductance[:n, :n], 1e-4 * np.arange(1.0, n + 1.0))
        found[name] = interpolate(replace(data, linkage=linkage))
    return found


class Written(dict):
    """Units by kind of iron, drive, version of FMI and whether a body is inside. Units with saturating iron in version
    3 are compiled with the options of users."""

    def __init__(self, maps, folder, write_fmu_quickly):
        self.maps, self.folder, self.write_quickly = maps, folder, write_fmu_quickly

    def __missing__(self, key):
        iron, mode, version, inside = key
        m, path = self.maps[iron], self.folder / f"{iron} {mode} {version} {inside}.fmu"
        what = {"body": BODY} if inside else {"magnet": MAGNET}
        write = write_fmu if (iron, version) == ("saturating", 3) else self.write_quickly
        self[key] = write(m, path, **what, drive=coils(len(m.coil_names), mode), version=version)
        return self[key]


@pytest.fixture(scope="module")
def written(maps, tmp_path_factory, write_fmu_quickly):
    return Written(maps, tmp_path_factory.mktemp("driven"), write_fmu_quickly)


def asked(n, mode):
    """What is asked of the drives (60, n): it jumps, and some of it needs more than the supply gives."""
    drawn = np.random.default_rng(8).uniform(-1.0, 1.0, (3, n))
    return np.repeat(drawn * {"voltage": 2.5, "current_controller": 0.6}[mode], 20, axis=0)


def simulated(m, body, state, rows, mode):
    """By our own simulator: states (q, 13), currents and linkages (q, n) after each call of EACH steps."""
    n = len(m.coil_names)
    drive = coils(n, mode)
    of = replace(modelled(m), tolerance=STEP_TOLERANCE if m.remembers else COMPILED_TOLERANCE)
    machine = Machine(of, body, drive, Sensors(), MatrixAllocation(np.eye(n), np.zeros(n)))
    core, load = machine.core(STEP), np.zeros(6)
    state, currents = state.copy(), np.array(m.last_currents if m.remembers else np.zeros(n))
    core.follow(currents)
    core.load(state, load)
    found = []
    for row in rows:
        assert core.advance(STEP, EACH, row, state, currents, load) == 0
        found.append(np.concatenate([state, currents, core.coil_state.linkage]))
    return np.array(found)


NAMES = {"position_": "xyz", "velocity_": "xyz", "quaternion_": "wxyz", "angular_velocity_": "xyz"}
STATES = [f"{name}{part}" for name, parts in NAMES.items() for part in parts]


def numbered(n):
    return range(1, n + 1)


def start(path, folder, state):
    unit = Unit(path, folder)
    begin = 0
    for name, parts in NAMES.items():
        unit.set(name, parts, state[begin : begin + len(parts)])
        begin += len(parts)
    unit.set("step", [""], [STEP])
    return unit


def along(unit, n, rows, kind, computed=("flux_linkage_",)):
    """States, currents and computed outputs after a call of EACH steps at each of the rows."""
    found = []
    for row in rows:
        unit.set(kind, numbered(n), row)
        assert unit.step(EACH * STEP) == 0
        states = [unit.get(name, parts) for name, parts in NAMES.items()]
        others = [unit.get(name, numbered(n)) for name in ("current_", *computed)]
        found.append(np.concatenate([*states, *others]))
    return np.array(found)


INPUTS = {"voltage": "voltage_", "current_controller": "reference_"}
# Differences between two compilers on the same steps, and between solves of the iron, each to 1e-4 of the state.
# Rounding decides whether a cell at the end of its play moves: in the simulator itself, a start that differs by 1e-14
# makes as large a difference.
BOUNDS = {"linear": 1e-10, "saturating": 1e-4, "remembering": 0.05}


def agree(found, exact, relative):
    """Places, velocities, turns, spins, currents and linkages, each relative to its largest."""
    n = (exact.shape[1] - 13) // 2
    for part in np.split(np.arange(exact.shape[1]), [3, 6, 10, 13, 13 + n]):
        size = np.abs(exact[:, part]).max()
        assert np.abs(found[:, part] - exact[:, part]).max() < relative * size


@pytest.mark.parametrize("mode", DRIVES)
@pytest.mark.parametrize("iron", KINDS_OF_IRON)
def test_a_machine_is_that_of_the_simulator(written, maps, tmp_path, iron, mode):
    """Voltages that jump, a magnet that flies and turns, windings that warm up, limits that hold."""
    m = maps[iron]
    n, unit = len(m.coil_names), start(written[iron, mode, 2, True], tmp_path, TURNING)
    rows = asked(n, mode)
    exact = simulated(m, BODY, TURNING, rows, mode)
    found = along(unit, n, rows, INPUTS[mode])
    agree(found, exact, BOUNDS[iron])
    # In the first rows cells end their play as in the simulator. The iron's Newton steps are in single precision.
    first = 2 if m.remembers else 6
    agree(found[:first], exact[:first], min(BOUNDS[iron], np.finfo(np.float32).eps))
    # The body moves, and the currents change.
    assert np.ptp(exact[:, 2]) > 1e-3
    assert np.ptp(exact[:, 13 : 13 + n]) > 0.1
    unit.close()


@pytest.mark.parametrize("iron", ["linear", "saturating"])
def test_outputs_are_those_of_the_map(written, maps, tmp_path, iron):
    """Linkages, voltages of the motion, and force at the state that the unit has reached."""
    m = maps[iron]
    n, unit = len(m.coil_names), start(written[iron, "voltage", 3, True], tmp_path, TURNING)
    unit.set("current_", numbered(n), 0.1 * np.arange(1.0, n + 1.0))
    body = MagneticBody(BODY.magnet.points + BODY.magnet_at, BODY.magnet.moments)
    # Solves of the iron are exact to 1e-4 of its state, and Newton's method leaves a rest of each step to the next.
    relative = {"linear": 1e-11, "saturating": 1e-3}[iron]
    for rows in (np.zeros((0, n)), asked(n, "voltage")[15:30]):
        found = along(unit, n, rows, "voltage_")
        currents, state = unit.get("current_", numbered(n)), found[-1, :13] if len(rows) else TURNING
        turn = Rotation.from_quat(state[[7, 8, 9, 6]]).as_matrix()
        place = state[:3]
        for names, parts, wanted in (
            ("flux_linkage_", numbered(n), m.flux_linkage(currents, place, body, turn)),
            ("emf_", numbered(n), m.back_emf(place, currents, body, state[3:6], turn @ state[10:], turn)),
            ("force_", "xyz", m.wrench(place, body, currents, turn)[:3]),
            ("torque_", "xyz", m.wrench(place, body, currents, turn)[3:]),
        ):
            assert np.abs(unit.get(names, parts) - wanted).max() < relative * np.abs(wanted).max()
    unit.close()


def test_a_magnet_that_the_importer_moves(written, maps, tmp_path):
    """Without a body the pose is an input. At rest the currents are those of the matrix L and R in closed form; along a
    straight line they are the simulator's for a body too heavy to be moved."""
    m, volts = maps["linear"], np.array([1.0, -0.5, 0.3, 0.0, 0.7, -1.2])
    unit = start(written["linear", "voltage", 2, False], tmp_path / "rest", state_of(PLACE))
    drive, inductance = coils(6), m.inductance()
    unit.set("voltage_", numbered(6), volts)
    for _ in range(20):
        assert unit.step(EACH * STEP) == 0
    resistance = np.diag(drive.resistance)
    final = np.linalg.solve(resistance, volts)
    exact = final - expm(-np.linalg.solve(inductance, resistance) * 20 * EACH * STEP) @ final
    # The bound allows for windings that warm up a little and a voltage of limited slope.
    assert np.abs(unit.get("current_", numbered(6)) - exact).max() < 0.02 * np.abs(exact).max()
    unit.close()
    unit = start(written["linear", "voltage", 2, False], tmp_path / "line", TURNING)
    heavy = RigidBody(1e30, [1e30] * 3, MAGNET, gravity=0.0)
    rows, found = asked(6, "voltage"), []
    wanted = simulated(m, heavy, TURNING, rows, "voltage")
    for k, row in enumerate(rows):
        if k:
            state, begin = wanted[k - 1], 0
            for name, parts in NAMES.items():
                unit.set(name, parts, state[begin : begin + len(parts)])
                begin += len(parts)
        unit.set("voltage_", numbered(6), row)
        assert unit.step(EACH * STEP) == 0
        found.append(
            np.concatenate([unit.get("current_", numbered(6)), unit.get("flux_linkage_", numbered(6))])
        )
    for part in (slice(0, 6), slice(6, 12)):
        exact = wanted[:, 13:][:, part]
        assert np.abs(np.array(found)[:, part] - exact).max() < 1e-10 * np.abs(exact).max()
    unit.close()


@pytest.mark.parametrize("iron", ["saturating", "remembering"])
@pytest.mark.parametrize("version", [2, 3])
def test_a_stored_state_goes_on_to_the_last_bit_and_asking_leaves_no_trace(
    written, maps, tmp_path, version, iron
):
    n, rows, kept = 4, asked(4, "voltage")[12:30], ctypes.c_void_p(None)
    # Under lasting voltages the currents settle until steps take the tangent.
    rows = np.concatenate([rows[:3], np.repeat(rows[3:4], 30, axis=0), rows[3:]])
    path = written[iron, "voltage", version, True]
    whole = along(start(path, tmp_path / "whole", TURNING), n, rows, "voltage_", ())
    unit = start(path, tmp_path / "parts", TURNING)
    unit.get("emf_", numbered(n))
    first = []
    for row in rows[:25]:
        first.append(along(unit, n, [row], "voltage_", ())[0])
        # Reading the voltages solves the iron.
        unit.get("emf_", numbered(n))
    np.testing.assert_array_equal(first, whole[:25])
    assert unit.kept(kept) == 0
    along(unit, n, rows[3:7], "voltage_")
    assert unit.reset() == 0
    assert unit.restore(kept) == 0
    np.testing.assert_array_equal(along(unit, n, rows[25:], "voltage_", ()), whole[25:])
    unit.close(kept)


@pytest.mark.parametrize("iron", ["linear", "remembering"])
@pytest.mark.parametrize("inside", [False, True])
def test_the_source_is_strict_and_touches_no_other_memory(written, tmp_path, iron, inside):
    strict_and_within_its_memory(written[iron, "voltage", 3, inside], tmp_path / "unit")


def test_currents_beyond_the_domain_are_discarded(maps, write_fmu_quickly, tmp_path):
    m = maps["saturating"]
    free = CoilDrive(coils=4, resistance=1.0, mode="voltage", amplifier=WIDE, supply=(-1e3, 1e3))
    unit = start(write_fmu_quickly(m, tmp_path / "a.fmu", MAGNET, drive=free), tmp_path, state_of(PLACE))
    unit.set("voltage_", numbered(4), [50.0, 0.0, 0.0, 0.0])
    statuses = [unit.step(EACH * STEP) for _ in range(10)]
    assert statuses[-1] == 2
    assert sorted(statuses) == statuses
    unit.close()


def test_names_units_and_what_cannot_be_written(ring, maps, written, write_fmu_quickly, tmp_path):
    root, _, references = unpacked(written["linear", "current_controller", 2, True], tmp_path)
    assert root.find("ModelExchange") is None
    kinds = {each.get("name"): each.get("causality") for each in root.find("ModelVariables")}
    units = {each.get("name"): each.find("Real").get("unit") for each in root.find("ModelVariables")}
    for name, kind, unit in (
        ("reference_2", "input", "A"),
        ("current_2", "output", "A"),
        ("flux_linkage_2", "output", "Wb"),
        ("emf_2", "output", "V"),
        ("velocity_x", "output", "m/s"),
    ):
        assert (kinds[name], units[name]) == (kind, unit)
    assert not any(name.startswith(("voltage_", "der(")) for name in references)
    root, *_ = unpacked(written["linear", "voltage", 2, False], tmp_path / "free")
    kinds = {each.get("name"): each.get("causality") for each in root.find("ModelVariables")}
    assert kinds["voltage_6"] == kinds["velocity_x"] == "input"
    # A drive that is a source of current gives the same unit as no drive.
    ideal = CoilDrive(WIDE, 6)
    plain = [
        write_fmu_quickly(ring.map, tmp_path / f"{k}" / "a.fmu", drive=one)
        for k, one in enumerate((ideal, None))
    ]
    assert plain[0].read_bytes() == plain[1].read_bytes()
    for field, drive in (
        (ring.map, coils(6)),
        (maps["linear"], coils(4)),
        (maps["linear"].at(1.0), coils(6)),
    ):
        with pytest.raises(InputError):
            write_fmu(field, tmp_path / "b.fmu", drive=drive)


def test_a_bandwidth_is_met_at_zero_currents(ring, tmp_path):
    """As in the simulator; here zero currents lie beyond the domain, and the unit begins in its middle."""
    data = saturating_data(ring, *KINDS["division"])
    data = replace(data, linkage=StoredLinkage(1e-3 * np.eye(6), np.zeros(6)))
    controller = CurrentController(bandwidth=50.0)
    drive = CoilDrive(WIDE, 6, resistance=2.0, mode="current_controller", controller=controller)
    path = write_fmu(interpolate(data), tmp_path / "a.fmu", MAGNET, drive=drive, binary=False)
    with zipfile.ZipFile(path) as archive:
        (line,) = [
            one for one in archive.read("sources/fmu_model.h").decode().splitlines() if "FMU_DRIVES" in one
        ]
    rows = np.array([[float(x) for x in row.split(",")] for row in re.findall(r"{([^{}]+)}", line)])
    free = interpolate(data, outside_currents="evaluate")
    ends = [[free.flux_linkage(side * coil)[k] for side in (1e-3, -1e-3)] for k, coil in enumerate(np.eye(6))]
    inductance = np.array([a - b for a, b in ends]) / 2e-3
    assert rows[:, 3] == pytest.approx(2 * np.pi * 50.0 * inductance, rel=1e-4)
    assert rows[:, 4] == pytest.approx(np.full(6, 2 * np.pi * 50.0 * 2.0), rel=1e-12)


def by_fmpy(fmpy, folder, path, state, rows, names):
    """Outputs of these names after a call of EACH steps at each of the rows of voltages."""
    starts = dict(zip(STATES, state, strict=True)) | {"step": STEP}
    inputs = [f"voltage_{k}" for k in numbered(rows.shape[1])]
    task = {"names": list(starts), "starts": list(starts.values()), "inputs": inputs, "outputs": list(names)}
    task = {name: np.array(values) for name, values in task.items()} | {"rows": rows, "period": EACH * STEP}
    return fmpy(folder, kind="follow", path=str(path), **task)["outputs"]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("iron", ["linear", "saturating"])
def test_fmpy_gets_the_simulator_s_currents(written, maps, fmpy, tmp_path, version, iron):
    """A step of one coil's voltage with a magnet that flies past: currents of all coils, linkages, and the body."""
    m = maps[iron]
    n = len(m.coil_names)
    rows = np.zeros((40, n))
    rows[:, 1] = 3.0
    names = [f"{one}_{k}" for one in ("current", "flux_linkage") for k in numbered(n)]
    unit = written[iron, "voltage", version, True]
    found = by_fmpy(fmpy, tmp_path, unit, TURNING, rows, [*STATES, *names])
    exact = simulated(m, BODY, TURNING, rows, "voltage")
    agree(found, exact, BOUNDS[iron])
    assert np.abs(exact[-1, 13]) > 1e-3


def test_fmpy_gets_what_a_bridge_leaves_of_its_voltage(ring, maps, fmpy, tmp_path):
    """Settled currents times R: the voltage less that of 2 dead times and the drop, a loss in proportion to the current
    within the ripple. The bridge comes from a device file."""
    path, unit, ohms = tmp_path / "a.h5", read_device("drive_unit"), 2.0 + np.arange(6)
    write_map(path, replace(ring.data, linkage=maps["linear"].linkage))
    bridge = Bridge(20e3, dead_time=0.5e-6, drop=0.7, ripple=4e-3)
    coils = [replace(coil, resistance=ohm) for coil, ohm in zip(unit.coils, ohms, strict=True)]
    export = [
        "export",
        path,
        "--to",
        "fmu",
        "--fmi",
        "3",
        "-o",
        tmp_path / "a.fmu",
        "--drive",
        tmp_path / "a.toml",
    ]
    for driver, code in (
        (Driver(0.4, 2.0, 12.0), 2),
        (Driver(0.4, 2.0, 12.0, mode="bridge", bridge=bridge), 0),
    ):
        (tmp_path / "a.toml").write_text(unit.replace(coils=coils, driver=driver).to_toml())
        assert main([*map(str, export)]) == code
    rows = np.tile([3.0, -3.0, 0.2, 1.0, -20.0, 0.0], (200, 1))
    names = [f"current_{k}" for k in numbered(6)]
    found = by_fmpy(fmpy, tmp_path, tmp_path / "a.fmu", state_of(PLACE), rows, names)[-1]
    lost = 2 * 0.5e-6 * 20e3 * 12.0 + 0.7
    wanted = [3.0 - lost, lost - 3.0, 0.2, 1.0 - lost, lost - 12.0, 0.0]
    ohms[2] += lost / 4e-3
    assert found == pytest.approx(wanted / ohms, rel=1e-6, abs=1e-9)
