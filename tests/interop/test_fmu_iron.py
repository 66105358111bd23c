"""FMUs of saturating iron, with and without memory: called as an importer calls them, and run by FMPy."""

import ctypes
import shutil

import numpy as np
import pytest

from fieldmap.dynamics import RigidBody, move_adaptively, state_of
from fieldmap.interop import write_fmu
from fieldmap.lookup import FiniteMagnet
from tests.interop.iron_maps import CELLS, KINDS, saturating
from tests.interop.test_fmu import (
    CALLBACK,
    LOGGER,
    Callbacks,
    numbers,
    strict_and_within_its_memory,
    unpacked,
)

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
PLACE, MOMENT, STEPS, HALF = [0.002, -0.001, -0.09], [0.1, -0.2, 0.8], 30, 13
BODY = RigidBody(
    0.01, np.array([6e-7, 7e-7, 2e-7]), FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]]))
)
KINDS_OF_IRON = {
    "memory": {"cells": CELLS},
    "no memory": {},
}


class Written(dict):
    """Units by kind of iron, version of FMI and whether a body is inside, each made by the first test that asks.
    Units with memory in version 3 are compiled with the options of users."""

    def __init__(self, ring, folder, write_fmu_quickly):
        self.maps = {name: saturating(ring, *KINDS["free"], **more) for name, more in KINDS_OF_IRON.items()}
        self.folder, self.write_quickly = folder, write_fmu_quickly

    def __missing__(self, key):
        name, version, inside = key
        what = {"body": BODY} if inside else {"magnet": MOMENT}
        path = self.folder / f"{name} {version} {inside}.fmu"
        write = write_fmu if (name, version) == ("memory", 3) else self.write_quickly
        self[key] = write(self.maps[name], path, version=version, **what)
        return self[key]


@pytest.fixture(scope="module")
def written(ring, tmp_path_factory, write_fmu_quickly):
    return Written(ring, tmp_path_factory.mktemp("units"), write_fmu_quickly)


class Unit:
    """An FMU for co-simulation or model exchange of either version, with its place set."""

    def __init__(self, path, folder, exchange=False):
        root, binary, self.references = unpacked(path, folder)
        self.library, self.time, resources = ctypes.CDLL(str(binary)), 0.0, folder / "resources"
        self.two = root.get("fmiVersion") == "2.0"
        if self.two:
            self.log = CALLBACK(lambda *_: None)
            self.callbacks = Callbacks(self.log)
            made, token = self.library.fmi2Instantiate, root.get("guid").encode()
            words = (
                int(not exchange),
                token,
                resources.as_uri().encode(),
                ctypes.byref(self.callbacks),
                0,
                1,
            )
        else:
            self.log = LOGGER(lambda *_: None)
            made = getattr(self.library, f"fmi3Instantiate{'ModelExchange' if exchange else 'CoSimulation'}")
            no, token = ctypes.c_bool(False), root.get("instantiationToken").encode()
            early = () if exchange else (no, no, None, ctypes.c_size_t(0))
            more = (None, self.log) if exchange else (None, self.log, None)
            words = (token, str(resources).encode(), no, no, *early, *more)
        made.restype = ctypes.c_void_p
        self.unit = ctypes.c_void_p(made(b"one", *words))
        assert self.unit
        if "push_x" not in self.references:
            self.set("position_", "xyz", PLACE)

    def _values(self, write, first, names, out):
        chosen = (ctypes.c_uint * len(names))(*(self.references[first + str(name)] for name in names))
        count = ctypes.c_size_t(len(names))
        kind = "Real" if self.two else "Float64"
        call = getattr(self.library, f"fmi{2 if self.two else 3}{'Set' if write else 'Get'}{kind}")
        return call(self.unit, chosen, count, out, *(() if self.two else (count,)))

    def set(self, first, names, values):
        assert self._values(True, first, names, numbers(values)) == 0

    def get(self, first, names):
        out = numbers([0.0] * len(names))
        assert self._values(False, first, names, out) == 0
        return np.array(out)

    def drive(self, currents):
        self.set("current_", range(1, len(currents) + 1), currents)

    def outputs(self):
        """Field and wrench (9,)."""
        parts = ("field_", "force_", "torque_")
        return np.concatenate([self.get(part, "xyz") for part in parts])

    def step(self, length=1e-3):
        time, step, no = ctypes.c_double(self.time), ctypes.c_double(length), ctypes.c_bool(False)
        self.time += length
        if self.two:
            return self.library.fmi2DoStep(self.unit, time, step, 1)
        flags = [ctypes.byref(ctypes.c_bool(False)) for _ in range(3)]
        return self.library.fmi3DoStep(self.unit, time, step, no, *flags, ctypes.byref(ctypes.c_double(0.0)))

    def completed(self):
        flag = ctypes.c_int if self.two else ctypes.c_bool
        flags = [ctypes.byref(flag(0)) for _ in range(2)]
        return self._call("CompletedIntegratorStep", 1 if self.two else ctypes.c_bool(True), *flags)

    def kept(self, state):
        """A copy of the state, at the address `state`."""
        return self._call("GetFMUstate" if self.two else "GetFMUState", ctypes.byref(state))

    def restore(self, state):
        return self._call("SetFMUstate" if self.two else "SetFMUState", state)

    def reset(self):
        return self._call("Reset")

    def close(self, *states):
        for state in states:
            self._call("FreeFMUstate" if self.two else "FreeFMUState", ctypes.byref(state))
        getattr(self.library, f"fmi{2 if self.two else 3}FreeInstance")(self.unit)

    def _call(self, name, *words):
        return getattr(self.library, f"fmi{2 if self.two else 3}{name}")(self.unit, *words)


PATH = np.random.default_rng(11).uniform(-1.0, 1.0, (STEPS, 4))


def along(unit, path, asked=()):
    """Outputs (n, 9) after a step to each of the currents; asked: currents whose outputs are read before each step."""
    rows = []
    for currents in path:
        for other in asked:
            unit.drive(other)
            unit.outputs()
        unit.drive(currents)
        assert unit.step() == 0
        rows.append(unit.outputs())
    return np.array(rows)


def by_python(m, path):
    rows = []
    for currents in path:
        m = m.step(currents) if m.remembers else m
        rows.append([*m.field(PLACE, currents), *m.wrench(PLACE, MOMENT, currents)])
    return np.array(rows)


def compare(found, exact, relative):
    for part in (slice(0, 3), slice(3, 6), slice(6, 9)):
        assert np.abs(found[:, part] - exact[:, part]).max() < relative * np.abs(exact[:, part]).max()


@pytest.mark.parametrize(("iron", "relative"), [("memory", 1e-5), ("no memory", 1e-3)])
@pytest.mark.parametrize("version", [2, 3])
def test_a_path_is_that_of_python(written, tmp_path, version, iron, relative):
    """Without memory, solves have the tolerance of compiled callers, 1e-4."""
    unit, m = Unit(written[iron, version, False], tmp_path), written.maps[iron]
    # A unit begins with the currents of the memory, or with none.
    start = m.last_currents if m.remembers else np.zeros(4)
    np.testing.assert_array_equal(unit.get("current_", range(1, 5)), start)
    compare(along(unit, PATH), by_python(m, PATH), relative)
    if m.remembers:
        straight = np.array([m.field(PLACE, currents) for currents in PATH])
        assert np.abs(straight - by_python(m, PATH)[:, :3]).max() > 2e-3 * np.abs(straight).max()
    unit.close()


@pytest.mark.parametrize("version", [2, 3])
def test_a_stored_state_goes_on_to_the_last_bit_and_asking_leaves_no_trace(written, tmp_path, version):
    unit, state = Unit(written["memory", version, False], tmp_path), ctypes.c_void_p(None)
    whole = along(unit, PATH)
    assert unit.reset() == 0
    unit.set("position_", "xyz", PLACE)
    np.testing.assert_array_equal(along(unit, PATH[:HALF], asked=PATH[3:5]), whole[:HALF])
    assert unit.kept(state) == 0
    first = along(unit, PATH[:HALF:-1])
    assert unit.restore(state) == 0
    np.testing.assert_array_equal(unit.outputs(), whole[HALF - 1])
    np.testing.assert_array_equal(along(unit, PATH[HALF:]), whole[HALF:])
    assert unit.restore(state) == 0
    np.testing.assert_array_equal(along(unit, PATH[:HALF:-1]), first)
    unit.close(state)


@pytest.mark.parametrize("version", [2, 3])
def test_in_model_exchange_the_memory_steps_when_the_importer_has(written, tmp_path, version):
    """Trials between completed steps leave no trace."""
    led = along(Unit(written["memory", version, False], tmp_path / "led"), PATH)
    unit, rows = Unit(written["memory", version, False], tmp_path / "tried", exchange=True), []
    for k, currents in enumerate(PATH):
        for other in (PATH[k - 1], 0.5 * currents, currents):
            unit.drive(other)
            unit.outputs()
        assert unit.completed() == 0
        rows.append(unit.outputs())
    np.testing.assert_array_equal(rows, led)
    unit.close()


@pytest.mark.parametrize("version", [2, 3])
def test_currents_beyond_the_domain_are_discarded_and_leave_the_memory(written, tmp_path, version):
    unit = Unit(written["memory", version, False], tmp_path)
    along(unit, PATH[:3])
    before = unit.outputs()
    unit.drive([1.5, 0.0, 0.0, 0.0])
    assert unit.step() == 2
    assert unit._values(False, "field_", "xyz", numbers([0.0] * 3)) == 2
    unit.drive(PATH[2])
    np.testing.assert_array_equal(unit.outputs(), before)
    unit.close()


@pytest.mark.parametrize("version", [2, 3])
def test_the_body_moves_in_the_field_after_the_step(written, tmp_path, version):
    m, unit = written.maps["memory"], Unit(written["memory", version, True], tmp_path)
    start, rows = state_of(PLACE), []
    unit.set("position_", "xyz", PLACE)
    expected = start
    for currents in PATH[:4]:
        m = m.step(currents)
        expected = move_adaptively(m.at(currents), BODY, expected, np.array([0.0, 5e-3]))[-1]
        unit.drive(currents)
        assert unit.step(5e-3) == 0
        rows.append(np.concatenate([unit.get("position_", "xyz"), unit.get("velocity_", "xyz")]))
    np.testing.assert_allclose(rows[-1], expected[:6], atol=1e-6 * np.abs(expected[:6]).max())
    unit.close()


@pytest.mark.parametrize("iron", ["memory", "no memory"])
@pytest.mark.parametrize("version", [2, 3])
def test_the_source_is_strict_and_no_argument_makes_it_touch_other_memory(written, tmp_path, version, iron):
    for inside in (False, True):
        strict_and_within_its_memory(written[iron, version, inside], tmp_path / f"unit {inside}")


def test_it_begins_with_the_memory_of_the_map_and_within_the_domain(ring, write_fmu_quickly, tmp_path):
    m = saturating(ring, *KINDS["division"], cells=CELLS)
    for name, of in (("shaken", m.memory("shaken", 1.2)), ("demagnetised", m.memory("demagnetised"))):
        unit = Unit(write_fmu_quickly(of, tmp_path / f"{name}.fmu", MOMENT), tmp_path / name)
        currents = unit.get("current_", range(1, 7))
        assert m.info.reduced_model.domain.holds(currents)
        compare(unit.outputs()[None], by_python(of, currents[None]), 1e-5)
        unit.close()
    assert m.memory("shaken", 1.2).last_currents.tolist() == [1.2] * 6


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_leads_the_memory(written, fmpy, tmp_path, version):
    path = str(written["memory", version, False])
    poses = np.tile([*PLACE, 1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    found = fmpy(tmp_path, kind="ask", path=path, poses=poses, currents=PATH)["outputs"]
    compare(found[:, [0, 1, 2, *range(12, 18)]], by_python(written.maps["memory"], PATH), 1e-5)


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_moves_the_body_by_both_kinds(written, fmpy, tmp_path, version):
    """At constant currents. The integrator of model exchange tries states; the iron remembers only those it keeps."""
    m, currents = written.maps["memory"], PATH[0]
    path = str(written["memory", version, True])
    state = state_of(PLACE, angular_velocity=[0.5, -1.0, 3.0])
    found = fmpy(tmp_path, kind="integrate", path=path, state=state, currents=currents, duration=0.02)
    times = np.linspace(0.0, 0.02, 51)
    exact = move_adaptively(m.step(currents).at(currents), BODY, state, times)
    size = np.abs(exact).max(axis=0)
    for kind in ("CoSimulation", "ModelExchange"):
        assert (np.abs(found[kind] - exact).max(axis=0) < 1e-4 * size).all()
