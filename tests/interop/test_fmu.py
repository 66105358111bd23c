"""FMUs: called as an importer calls them, and run by FMPy in an environment that has no fieldmap (`fmpy`)."""

import ctypes
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap
from fieldmap.dynamics import RigidBody, move_adaptively, prepare, read_scenario, state_of
from fieldmap.errors import FieldmapError, InputError
from fieldmap.interop import fmu, write_fmu
from fieldmap.lookup import FiniteMagnet, interpolate, magnetic_body
from fieldmap.store import write_map
from tests.docs.pages import blocks
from tests.interop.conftest import STRICT
from tests.refusals import refused

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
MOMENT, MASS, HEIGHT = 0.8, 0.01119, -0.09


def magnet(moment=MOMENT):
    return FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, moment]]))


BODY = RigidBody(MASS, np.array([6.8e-7, 7.1e-7, 1.9e-7]), magnet(), magnet_at=np.array([1e-4, 0.0, 1e-3]))


INSIDE = {"field": {"magnet": [0.1, -0.2, MOMENT]}, "body": {"body": BODY}}


class Units(dict):
    """Units by what is inside and version of FMI, each written and compiled by the first test that asks. Units of
    version 3 are compiled with the options of users."""

    def __init__(self, field, folder, write_fmu_quickly):
        self.field, self.folder, self.write_quickly = field, folder, write_fmu_quickly

    def __missing__(self, key):
        name, version = key
        self[key] = self.write(self.folder / f"{name} {version}.fmu", name, version)
        return self[key]

    def write(self, path, name, version):
        write = write_fmu if version == 3 else self.write_quickly
        return write(self.field, path, version=version, **INSIDE[name])


@pytest.fixture(scope="module")
def units(ring, tmp_path_factory, write_fmu_quickly):
    return Units(ring.map, tmp_path_factory.mktemp("units"), write_fmu_quickly)


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_compiles_sources_alone(ring, fmpy, tmp_path, version, monkeypatch):
    """Without a compiler the unit has no binary; elsewhere FMPy makes one, with cmake."""
    if shutil.which("cmake") is None:
        pytest.skip("no cmake on this machine")
    with monkeypatch.context() as patch:
        patch.setenv("CC", "no-compiler-of-this-name")
        path = write_fmu(ring.map, tmp_path / "lift.fmu", [0.1, -0.2, MOMENT], version=version, binary=False)
    with zipfile.ZipFile(path) as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())
    fmpy.program.run(str(fmpy.python), "-m", "fmpy", "compile", str(path))
    where, currents = poses(ring.map, 50)
    found = fmpy(tmp_path, kind="ask", path=str(path), poses=where, currents=currents)
    compare(found["outputs"], expected(ring.map, where, currents, [0.1, -0.2, MOMENT]))


def poses(m, n, seed=3):
    rng = np.random.default_rng(seed)
    points = m.lower + rng.random((n, 3)) * (m.upper - m.lower)
    return np.hstack([points, rng.normal(size=(n, 4))]), rng.normal(size=(n, 6))


def expected(m, where, currents, moment):
    """Field, gradient and wrench (n, 18)."""
    turned = Rotation.from_quat(where[:, [4, 5, 6, 3]]).apply(moment)
    flux, slope = m.field_and_gradient(where[:, :3], currents)
    return np.hstack([flux, slope.reshape(-1, 9), m.wrench(where[:, :3], turned, currents)])


def compare(found, exact):
    for part in (slice(0, 3), slice(3, 12), slice(12, 15), slice(15, 18)):
        assert np.abs(found[:, part] - exact[:, part]).max() < 1e-12 * np.abs(exact[:, part]).max()


@pytest.mark.parametrize("version", [2, 3])
def test_what_fmpy_reads_is_the_wrench_of_the_map(units, ring, fmpy, tmp_path, version):
    where, currents = poses(ring.map, 500)
    found = fmpy(tmp_path, kind="ask", path=str(units["field", version]), poses=where, currents=currents)
    compare(found["outputs"], expected(ring.map, where, currents, [0.1, -0.2, MOMENT]))


SCENARIO = """
format = 1
title = "Held for a second, from beside, leaning, with a step of the depth"
map = "linear.h5"
device = "drive_unit"
duration_s = 1.0

[body]
radius_mm = 5.9
height_mm = 25.0

[coils]
dynamics = false

[sensors]
zero_depth_mm = 0.0

[control]
period_ms = 1.0
step_ms = {step_ms}
allocation = "least_power"

[control.coupled]
kind = "lqg"

[start]
depth_mm = 75.0
shift_mm = [0.01, -0.01, 0.1]
lean_deg = 0.2

[[reference]]
kind = "step"
axis = "depth"
at_s = 0.5
by_mm = 0.05

[noise]
off = true
"""


def scenario(folder, step_ms):
    path = folder / f"held {step_ms}.toml"
    path.write_text(SCENARIO.format(step_ms=step_ms))
    return path


@pytest.mark.parametrize("version", [2, 3])
def test_the_body_inside_moves_as_in_the_simulator(ring, fmpy, tmp_path, version):
    """One second of `simulate`, against the unit with the scenario's controller outside it: the simulator approaches
    the unit with the square of its step."""
    write_map(tmp_path / "linear.h5", ring.data)
    prepared = prepare(read_scenario(scenario(tmp_path, 0.1)))
    machine, schedule, block = prepared.machine, prepared.schedule, prepared.controller.arrays
    path = write_fmu(ring.map, tmp_path / "body.fmu", body=machine.body, version=version)
    gain, allocation = machine.drive.amplifier.gain, machine.allocation.numbers()
    assert schedule.feedforward is None or not np.any(schedule.feedforward)
    found = fmpy(
        tmp_path,
        kind="loop",
        path=str(path),
        state=prepared.state,
        seen_at=machine.body.seen_at,
        references=schedule.references,
        period=schedule.period,
        memory=prepared.controller.memory,
        matrix=gain * allocation.matrix,
        constant=gain * allocation.constant,
        **{name: getattr(block, name)[0] for name in "ABCDE"},
    )["states"]
    off = []
    for step in (0.1, 0.025):
        run = fieldmap.simulate(scenario(tmp_path, step))
        assert run.event is None
        assert len(run.rows) == len(found) == 1000
        off.append(np.abs(found - run.rows[:, :13]).max(axis=0))
    # Currents stay within the limits, which the controller outside does not have.
    assert np.abs(run.rows[:, 13:25]).max() < 3.5
    assert np.ptp(found[:, 2]) > 1e-4
    assert np.ptp(found[:, 10]) > 0.1
    print(
        "largest difference of places, m, and angular velocities, rad/s:", off[1][:3].max(), off[1][10:].max()
    )
    assert off[1][:3].max() < 5e-9
    assert off[1][10:].max() < 5e-4
    for part in (slice(0, 3), slice(10, 13)):
        assert 10 < off[0][part].max() / off[1][part].max() < 22


@pytest.mark.parametrize("version", [2, 3])
def test_model_exchange_and_co_simulation(units, ring, fmpy, tmp_path, version):
    """FMPy's CVODE, and the integrator inside, against our own adaptive one."""
    slope = ring.map.gradient([0, 0, HEIGHT], np.ones(6))[2, 2]
    currents = np.full(6, MASS * BODY.gravity / (MOMENT * slope))
    state = state_of([0.002, 0.001, HEIGHT], angular_velocity=[0.5, -1.0, 3.0])
    found = fmpy(
        tmp_path,
        kind="integrate",
        path=str(units["body", version]),
        state=state,
        currents=currents,
        duration=0.1,
    )
    times = np.linspace(0.0, 0.1, 51)
    exact = move_adaptively(ring.map.at(currents), BODY, state, times)
    size = np.abs(exact).max(axis=0)
    assert np.abs(found["CoSimulation"] - exact).max() < 1e-8
    assert (np.abs(found["ModelExchange"] - exact).max(axis=0) < 1e-6 * size).all()
    assert np.abs(exact[-1] - exact[0])[:3].max() > 1e-4


CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)

LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class Callbacks(ctypes.Structure):
    _fields_ = [("logger", CALLBACK), *((name, ctypes.c_void_p) for name in "abcd")]


def strict_and_within_its_memory(path, folder):
    """The sources compile without a warning, and no argument makes them touch memory that is not their own."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    command = ["gcc", *STRICT, "-fPIC", "-shared", "fmu.c", "-o", "strict.so", "-lm"]
    subprocess.run(command, cwd=folder / "sources", check=True, capture_output=True)
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    source = Path(__file__).parent / "c" / "drive_fmu.c"
    command = ["gcc", "-std=c99", "-I", folder / "sources", source, "-o", folder / "drive", "-lm"]
    if subprocess.run([*command, *checks], capture_output=True).returncode:
        # No address sanitizer on this machine: build without it.
        subprocess.run(command, check=True, capture_output=True)
    done = subprocess.run([folder / "drive", folder / "resources"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def unpacked(path, folder):
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    root = ElementTree.parse(folder / "modelDescription.xml").getroot()
    (binary,) = (folder / "binaries").rglob("*.so")
    references = {each.get("name"): int(each.get("valueReference")) for each in root.find("ModelVariables")}
    return root, binary, references


def numbers(values):
    return (ctypes.c_double * len(values))(*values)


def ask_by_hand(path, folder, where, currents):
    """Outputs and statuses of an FMU that is called as an importer would, and what it logged."""
    root, binary, references = unpacked(path, folder)
    library, said = ctypes.CDLL(str(binary)), []
    names = [*references]
    inputs = (ctypes.c_uint * 13)(
        *(references[f"current_{k + 1}"] for k in range(6)), *range(1, 4), *range(7, 11)
    )
    assert [n for n in names if references[n] in range(7, 11)] == [f"quaternion_{p}" for p in "wxyz"]
    outputs, n, k = (ctypes.c_uint * 18)(*range(40, 58)), ctypes.c_size_t(13), ctypes.c_size_t(18)
    if root.get("fmiVersion") == "2.0":
        log = CALLBACK(lambda env, name, status, kind, text: said.append(status))
        made, free = library.fmi2Instantiate, library.fmi2FreeInstance
        made.restype = ctypes.c_void_p
        callbacks = Callbacks(log)
        resources = (folder / "resources").as_uri().encode()
        unit = made(b"one", 1, root.get("guid").encode(), resources, ctypes.byref(callbacks), 0, 1)
        write, read, more = library.fmi2SetReal, library.fmi2GetReal, ()
    else:
        log = LOGGER(lambda env, status, kind, text: said.append(status))
        made, free = library.fmi3InstantiateModelExchange, library.fmi3FreeInstance
        made.restype = ctypes.c_void_p
        token, resources = root.get("instantiationToken").encode(), str(folder / "resources").encode()
        no = ctypes.c_bool(False)
        unit = made(b"one", token, resources, no, no, None, log)
        # FMI 3 wants the number of values too.
        write, read, more = library.fmi3SetFloat64, library.fmi3GetFloat64, (n, k)
    assert unit
    rows, statuses = [], []
    for pose, amperes in zip(where, currents, strict=True):
        out = numbers([0.0] * 18)
        assert write(ctypes.c_void_p(unit), inputs, n, numbers([*amperes, *pose]), *more[:1]) == 0
        statuses.append(read(ctypes.c_void_p(unit), outputs, k, out, *more[1:]))
        rows.append(list(out))
    free(ctypes.c_void_p(unit))
    return np.array(rows), statuses, said


@pytest.mark.parametrize("version", [2, 3])
def test_an_importer_gets_the_wrench_of_the_map(units, ring, tmp_path, version):
    where, currents = poses(ring.map, 50)
    found, statuses, said = ask_by_hand(units["field", version], tmp_path, where, currents)
    assert statuses == [0] * 50
    assert said == []
    compare(found, expected(ring.map, where, currents, [0.1, -0.2, MOMENT]))


@pytest.mark.parametrize("version", [2, 3])
def test_outside_the_map_it_discards(units, ring, tmp_path, version):
    where, currents = poses(ring.map, 2)
    where[1, 2] = 1.0
    found, statuses, said = ask_by_hand(units["field", version], tmp_path, where, currents)
    assert statuses == [0, 2]
    assert said == [2]
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize("name", ["field", "body"])
@pytest.mark.parametrize("version", [2, 3])
def test_the_source_is_strict_and_a_unit_the_same_each_time(units, ring, tmp_path, name, version):
    strict_and_within_its_memory(units[name, version], tmp_path / "a unit%")
    again = units.write(tmp_path / units[name, version].name, name, version)
    assert again.read_bytes() == units[name, version].read_bytes()
    assert "python" not in (tmp_path / "a unit%" / "sources" / "fmu.c").read_text().lower()


def test_fixed_currents_have_no_inputs_for_them(ring, tmp_path):
    path = write_fmu(ring.map.at(np.ones(6)), tmp_path / "1 fixed.fmu", magnet=[0, 0, MOMENT])
    root, binary, references = unpacked(path, tmp_path / "unit")
    assert not any(name.startswith("current_") for name in references)
    assert binary.stem == root.find("CoSimulation").get("modelIdentifier") == "fmu_1_fixed"


def test_what_cannot_be_written(ring, tmp_path, monkeypatch):
    for field, what in ((interpolate(ring.data, "hermite"), {}), (ring.map, {"version": 4})):
        with pytest.raises(InputError):
            write_fmu(field, tmp_path / "a.fmu", **what)
    monkeypatch.setenv("CC", "no-compiler-of-this-name")
    with pytest.raises(FieldmapError) as caught:
        write_fmu(ring.map, tmp_path / "a.fmu")
    assert caught.value.problems[0].remedy
    assert "CC" in caught.value.problems[0].received
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FieldmapError):
        write_fmu(ring.map, tmp_path / "a.fmu")
    assert not list(tmp_path.iterdir())


def test_the_lines_of_the_documentation(ring, fmpy, tmp_path):
    from fieldmap.cli import main

    write_map(tmp_path / "linear.h5", ring.data)
    written = [str(tmp_path / name) for name in ("linear.h5", "lift.fmu")]
    assert main(["export", written[0], "--to", "fmu", "-o", written[1], "--moment", "0.8"]) == 0
    lines = blocks("simulators.md", below="## FMI")[0] + "\nprint(repr(float(force)))"
    done = subprocess.run(
        [fmpy.python, "-c", lines], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    exact = ring.map.wrench([0.0, 0.0, -0.1], [0, 0, 0.8], np.full(6, 1.5))[2]
    assert abs(float(done.stdout.splitlines()[-1]) / exact - 1) < 1e-12


@pytest.mark.parametrize(
    ("step", "duration"), [(1e-300, 1e-3), (1e-3, 1e300), (1e-3, np.inf), (np.nan, 1e-3)]
)
def test_a_step_without_end_is_an_error(units, tmp_path, step, duration):
    """An importer sets the length of the inner steps, and 1e297 of them would take for ever."""
    root, binary, _ = unpacked(units["body", 2], tmp_path)
    library, log = ctypes.CDLL(str(binary)), CALLBACK(lambda *_: None)
    library.fmi2Instantiate.restype = ctypes.c_void_p
    callbacks = Callbacks(log)
    guid, resources = root.get("guid").encode(), (tmp_path / "resources").as_uri().encode()
    unit = ctypes.c_void_p(library.fmi2Instantiate(b"one", 1, guid, resources, ctypes.byref(callbacks), 0, 1))
    assert library.fmi2SetReal(unit, (ctypes.c_uint * 1)(39), ctypes.c_size_t(1), numbers([step])) == 0
    assert library.fmi2DoStep(unit, ctypes.c_double(0.0), ctypes.c_double(duration), 0) == 3
    library.fmi2FreeInstance(unit)


# Name, first reference, causality, initial, unit and starts.
EVERY_UNIT = """time 0 independent - s -
current_{1,2,3,4,5,6} 58 input - A 0 0 0 0 0 0
strength 33 parameter exact - 1
field_{x,y,z} 40 output calculated T -
gradient_{xx,xy,xz,yx,yy,yz,zx,zy,zz} 43 output calculated T/m -
force_{x,y,z} 52 output calculated N -
torque_{x,y,z} 55 output calculated N.m -
"""
OF_FIELDS = """position_{x,y,z} 1 input - m 0 0 -0.09
quaternion_{w,x,y,z} 7 input - - 1 0 0 0"""
OF_BODIES = """position_{x,y,z} 1 output exact m 0 0 -0.09
quaternion_{w,x,y,z} 7 output exact - 1 0 0 0
velocity_{x,y,z} 4 output exact m/s 0 0 0
angular_velocity_{x,y,z} 11 output exact rad/s 0 0 0
push_{x,y,z} 27 input - N 0 0 0
twist_{x,y,z} 30 input - N.m 0 0 0
mass 34 parameter exact kg 0.01119
inertia_{x,y,z} 35 parameter exact kg.m2 6.8e-7 7.1e-7 1.9e-7
gravity 38 parameter exact m/s2 9.80665
step 39 parameter exact s 5e-5
der(position_{x,y,z}) 14 local calculated m/s -
der(velocity_{x,y,z}) 17 local calculated m/s2 -
der(quaternion_{w,x,y,z}) 20 local calculated 1/s -
der(angular_velocity_{x,y,z}) 24 local calculated rad/s2 -"""


def listed(table):
    """Reference, causality, variability, initial, unit and start by name."""
    found = {}
    for line in table.splitlines():
        name, first, causality, *words = line.split()
        head, _, rest = name.partition("{")
        parts, _, tail = rest.partition("}")
        initial, unit, *starts = (None if word == "-" else word for word in words)
        kind = "fixed" if causality == "parameter" else "continuous"
        for k, part in enumerate(parts.split(",")):
            start = None if starts == [None] else float(starts[k])
            found[head + part + tail] = (int(first) + k, causality, kind, initial, unit, start)
    return found


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["field", "body"])
def test_what_importers_read(ring, tmp_path, name, version):
    path = write_fmu(ring.map, tmp_path / "a-unit.fmu", version=version, binary=False, **INSIDE[name])
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        assert {one.date_time for one in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        header = archive.read("sources/fmu_model.h").decode()
    listing = {
        "resources/map.fmap",
        *(f"sources/{one}" for one in ("fmu.c", "fieldmap_body.h", "fmu_model.h")),
    }
    built = {"sources/buildDescription.xml"} if version == 3 else set()
    assert set(names) == listing | built | {"modelDescription.xml"}
    variables = list(root.find("ModelVariables"))
    inner = [one[0] for one in variables] if version == 2 else variables
    keys = ("causality", "variability", "initial")
    found, derived, by_number = {}, {}, {}
    for k, (one, real) in enumerate(zip(variables, inner, strict=True)):
        reference, start = int(one.get("valueReference")), real.get("start")
        start = None if start is None else float(start)
        found[one.get("name")] = (reference, *map(one.get, keys), real.get("unit"), start)
        by_number[str(k + 1 if version == 2 else reference)] = one.get("name")
        if real.get("derivative"):
            derived[one.get("name")] = real.get("derivative")
    exact = listed(EVERY_UNIT + {"field": OF_FIELDS, "body": OF_BODIES}[name])
    assert found == exact
    assert {key: f"der({by_number[number]})" for key, number in derived.items()} == {
        key: key for key in derived
    }
    states = [key for key in exact if key.startswith("der")]
    assert sorted(derived) == sorted(states)
    # The structure names outputs, derivatives, and what is computed from the start on.
    calculated = [key for key, one in exact.items() if one[3] == "calculated"]
    outputs = [key for key, one in exact.items() if one[1] == "output"]
    structure = {}
    for one in root.find("ModelStructure"):
        numbers = [part.get("index") for part in one] or [one.get("valueReference")]
        structure.setdefault(one.tag.removesuffix("s"), []).extend(by_number[number] for number in numbers)
    prefix = "ContinuousState" if version == 3 else ""
    groups = {"Output": outputs, f"{prefix}Derivative": states, "InitialUnknown": calculated}
    assert {k: sorted(v) for k, v in structure.items()} == {k: sorted(v) for k, v in groups.items() if v}
    assert {one.get("name") for one in root.find("UnitDefinitions")} == {one[4] for one in exact.values()} - {
        None
    }
    token = root.get("guid" if version == 2 else "instantiationToken")
    assert f'FMU_TOKEN "{token}"' in header
    assert (root.get("fmiVersion"), root.get("modelName")) == (f"{version}.0", "a_unit")
    assert root.get("numberOfEventIndicators") == ("0" if version == 2 else None)
    assert root.find("DefaultExperiment").attrib == {"startTime": "0", "stopTime": "1", "stepSize": "0.001"}
    keeps = f"canGetAndSetFMU{'s' if version == 2 else 'S'}tate"
    for kind, more in (
        ("ModelExchange", {}),
        ("CoSimulation", {"canHandleVariableCommunicationStepSize": "true"}),
    ):
        assert root.find(kind).attrib == {"modelIdentifier": "a_unit", keeps: "true", **more}
        sources = [one.get("name") for one in root.iterfind(f"{kind}/SourceFiles/File")]
        assert sources == (["fmu.c"] if version == 2 else [])


def test_the_body_inside_obeys_newton_and_euler(units, ring, tmp_path):
    """Rates of its state under the map's wrench, a push and a twist; the magnet lies off its centre."""
    root, binary, _ = unpacked(units["body", 2], tmp_path)
    library, log = ctypes.CDLL(str(binary)), CALLBACK(lambda *_: None)
    library.fmi2Instantiate.restype = ctypes.c_void_p
    callbacks = Callbacks(log)
    guid, resources = root.get("guid").encode(), (tmp_path / "resources").as_uri().encode()
    unit = ctypes.c_void_p(library.fmi2Instantiate(b"one", 0, guid, resources, ctypes.byref(callbacks), 0, 1))

    def values(first, count, given=None):
        out = numbers([0.0] * count if given is None else given)
        call = library.fmi2GetReal if given is None else library.fmi2SetReal
        assert (
            call(unit, (ctypes.c_uint * count)(*range(first, first + count)), ctypes.c_size_t(count), out)
            == 0
        )
        return np.array(out)

    place, velocity = np.array([0.003, -0.002, -0.095]), np.array([0.1, -0.2, 0.3])
    turn, spin = Rotation.from_rotvec([0.3, -0.4, 0.5]), np.array([5.0, -7.0, 11.0])
    push, twist, currents = np.array([0.01, 0.02, -0.03]), np.array([1e-5, -2e-5, 3e-5]), np.arange(1.0, 7.0)
    x, y, z, w = turn.as_quat()
    for first, given in ((1, place), (4, velocity), (7, [w, x, y, z]), (11, spin), (27, push), (30, twist)):
        values(first, len(given), list(given))
    values(58, 6, list(currents))
    values(33, 1, [0.5])
    moment, seat = 0.5 * turn.apply([0, 0, MOMENT]), turn.apply(BODY.magnet_at)
    flux, slope = ring.map.field_and_gradient(place + seat, currents)
    force = moment @ slope
    torque = np.cross(moment, flux) + np.cross(seat, force)
    for first, exact in ((40, flux), (43, slope.ravel()), (52, force), (55, torque)):
        np.testing.assert_allclose(values(first, len(exact)), exact, rtol=1e-11, atol=1e-13)
    inertia = np.array([6.8e-7, 7.1e-7, 1.9e-7])
    about = turn.inv().apply(torque + twist)
    rate = Rotation.from_quat([x, y, z, w]).as_quat()
    turning = 0.5 * np.array([-spin @ rate[:3], *(w * spin + np.cross(rate[:3], spin))])
    exact = [*velocity, *((force + push) / MASS - [0, 0, 9.80665]), *turning]
    exact += [*((about - np.cross(spin, inertia * spin)) / inertia)]
    np.testing.assert_allclose(values(14, 13), exact, rtol=1e-9, atol=1e-11)
    library.fmi2FreeInstance(unit)


PLACES = [
    ("linux", "x86_64", 2, "linux64/lift.so"),
    ("darwin", "arm64", 2, "darwin64/lift.dylib"),
    ("win32", "AMD64", 2, "win64/lift.dll"),
    ("linux", "aarch64", 3, "aarch64-linux/lift.so"),
    ("darwin", "arm64", 3, "aarch64-darwin/lift.dylib"),
    ("win32", "AMD64", 3, "x86_64-windows/lift.dll"),
]


@pytest.mark.parametrize(("system", "machine", "version", "place"), PLACES)
def test_the_library_lies_where_importers_look(ring, tmp_path, monkeypatch, system, machine, version, place):
    """With a stand-in for the compiler."""
    monkeypatch.setattr(fmu, "sys", SimpleNamespace(platform=system))
    monkeypatch.setattr(fmu, "platform", SimpleNamespace(machine=lambda: machine))
    compiler(monkeypatch, tmp_path, 'while [ "$1" != -o ]; do shift; done; echo library > "$2"')
    with zipfile.ZipFile(write_fmu(ring.map, tmp_path / "lift.fmu", version=version)) as archive:
        (library,) = (name for name in archive.namelist() if name.startswith("binaries/"))
        assert library == f"binaries/{place}"
        assert archive.read(library) == b"library\n"


def compiler(monkeypatch, folder, script):
    (folder / "compiler").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "compiler").chmod(0o755)
    monkeypatch.setenv("CC", str(folder / "compiler"))


@pytest.mark.parametrize(
    ("script", "received"),
    [
        ("echo 'a.c: warning: odd' >&2; echo 'a.c: error: bad' >&2; exit 3", "error: bad"),
        ("exit 3", "exit code 3"),
    ],
)
def test_what_a_compiler_says_is_told(ring, tmp_path, monkeypatch, script, received):
    compiler(monkeypatch, tmp_path, script)
    with refused(FieldmapError, where="write_fmu", received=received):
        write_fmu(ring.map, tmp_path / "lift.fmu")


def test_soft_iron_has_no_place_in_a_unit(ring, tmp_path):
    pieces = [
        fieldmap.PayloadPiece(fieldmap.SoftSphere(8e-3, mu_r=200.0), fieldmap.placed([x, 0, 0]))
        for x in (0, 0.01)
    ]
    with refused(InputError, where="write_fmu(magnet)", received="2 soft pieces"):
        write_fmu(ring.map, tmp_path / "lift.fmu", magnetic_body(fieldmap.Payload(MASS, pieces=pieces)))
