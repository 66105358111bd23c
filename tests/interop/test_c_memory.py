"""Iron with hysteresis in C: the bits of Python along a path, also when the run is stopped and resumed."""

import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.cli import main
from fieldmap.core.compile import libraries, machine
from fieldmap.core.library import loaded
from fieldmap.currents import IndependentCurrents
from fieldmap.interop import c_header, write_c_iron_map, write_csv, write_fmu
from fieldmap.store import write_map
from tests.docs.pages import blocks
from tests.interop.conftest import STRICT
from tests.interop.iron_maps import CELLS, KINDS, saturating, saturating_data

SOURCE, STEPS, HALF = Path(__file__).parent / "c" / "remember.c", 30, 13
UNIT = Path(__file__).parents[2] / "maps" / "out" / "remembering.h5"
# Code for the oldest processor fuses no products and sums, so every compiler makes the same bits from the same source.
OLDEST = libraries(machine(), sys.platform).get("x86-64-v2")
AS_THE_LIBRARY = ["-O3", "-march=x86-64-v2", "-fno-math-errno"]

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


def build(target, *flags):
    command = ["gcc", "-I", c_header().parent, *flags, SOURCE, "-lm", "-o", target]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return target


@pytest.fixture(scope="module")
def as_the_library(tmp_path_factory):
    """Path of remember.c compiled with the options of the core."""
    return build(tmp_path_factory.mktemp("c") / "remember", *STRICT, *AS_THE_LIBRARY)


@pytest.fixture
def oldest_library(monkeypatch):
    """Python with the library of the oldest processor."""
    if OLDEST is None:
        pytest.skip("compilers fuse products and sums on this machine, each in its own way")
    found = loaded(OLDEST)
    for name, module in tuple(sys.modules.items()):
        if name.startswith("fieldmap.core.") and hasattr(module, "LIBRARY"):
            monkeypatch.setattr(module, "LIBRARY", found)


def remembering(ring):
    return saturating(ring, *KINDS["free"], cells=CELLS)


def drawn(m, seed=8):
    """Rows of currents, other currents, point and moment. In one row the currents are those of the row before."""
    random, domain = np.random.default_rng(seed), m.info.reduced_model.domain
    currents = domain.at(random.random((2 * STEPS, len(domain.lower)))).reshape(STEPS, -1)
    coils = len(m.coil_names)
    currents[HALF, :coils] = currents[HALF - 1, :coils]
    points = m.lower + random.random((STEPS, 3)) * (m.upper - m.lower)
    return np.hstack([currents, points, random.standard_normal((STEPS, 3))])


def by_python(m, rows):
    """What remember.c prints, and the memory at the end."""
    coils, found = len(m.coil_names), []
    for row in rows:
        currents, other = row[:coils], row[coils : 2 * coils]
        point, moment = row[2 * coils : -3], row[-3:]
        asked = m.field(point, other)
        m = m.step(currents)
        flux, slope = m.field_and_gradient(point, currents)
        found.append([*asked, *flux, *slope.ravel(), *m.wrench(point, moment, currents)])
    return np.array(found), m.remembered


def by_c(program, path, rows, folder, *parts):
    """What remember.c prints for parts of a path, each in a run of its own, and the memory at the end."""
    rows.tofile(folder / "rows")
    text = ""
    for start, stop in parts:
        words = [path, folder / "rows", str(start), str(stop), folder / "stored"]
        text += subprocess.run([program, *words], capture_output=True, text=True, check=True).stdout
    found = [[float.fromhex(word) for word in line.split()] for line in text.splitlines()]
    return np.array(found), np.fromfile(folder / "stored")


def compare(m, folder, program):
    path = write_c_iron_map(m, folder / "iron.fmap")
    rows = drawn(m)
    exact, memory = by_python(m, rows)
    for parts in ([(0, STEPS)], [(0, HALF), (HALF, STEPS)]):
        found, remembered = by_c(program, path, rows, folder, *parts)
        np.testing.assert_array_equal(found, exact)
        np.testing.assert_array_equal(remembered, memory)
    # The memory matters: straight from the beginning, the same currents give other fields.
    coils = len(m.coil_names)
    straight = np.array([m.field(row[2 * coils : -3], row[:coils]) for row in rows])
    assert np.abs(straight - exact[:, 3:6]).max() > 0.01 * np.abs(straight).max()


def test_a_path_has_the_bits_of_python_stopped_or_not(ring, as_the_library, oldest_library, tmp_path):
    compare(remembering(ring), tmp_path, as_the_library)


@pytest.mark.skipif(not UNIT.exists(), reason="no map of the drive unit: fieldmap map remembering")
def test_so_has_a_path_of_the_drive_unit(as_the_library, oldest_library, tmp_path):
    compare(fm.open_map(UNIT), tmp_path, as_the_library)


@pytest.mark.parametrize(("history", "level"), [("shaken", [0.2, 0.3, -0.1, 0.4]), ("demagnetised", None)])
def test_a_program_begins_with_the_memory_that_was_written(
    ring, as_the_library, oldest_library, tmp_path, history, level
):
    m = remembering(ring).memory(history, level)
    found, memory = by_c(as_the_library, write_c_iron_map(m, tmp_path / "a.fmap"), drawn(m), tmp_path, (0, 3))
    exact, remembered = by_python(m, drawn(m)[:3])
    np.testing.assert_array_equal(found, exact)
    np.testing.assert_array_equal(memory, remembered)
    # The same with the memory that a path has left.
    later = m.step([0.5, -0.5, 0.5, -0.5])
    by_c(as_the_library, write_c_iron_map(later, tmp_path / "b.fmap"), drawn(m), tmp_path, (0, 0))
    np.testing.assert_array_equal(np.fromfile(tmp_path / "stored"), later.remembered)


def test_the_file_has_version_2_and_the_memory_behind_the_model(ring, tmp_path):
    m = remembering(ring)
    raw = write_c_iron_map(m, tmp_path / "iron.fmap").read_bytes()
    _, _, version, _, _, count, numbers = struct.unpack_from("=8sIIQIIQ", raw)
    assert (version, count) == (2, len(m.remembered))
    np.testing.assert_array_equal(np.frombuffer(raw, offset=40 + 8 * numbers, count=count), m.remembered)
    assert raw[40 + 8 * (numbers + count) :][:8] == b"fieldmap"


def test_the_example_of_the_documentation(ring, tmp_path):
    (example,) = (code for code in blocks("c.md", "c") if "fieldmap_iron_step" in code)
    (tmp_path / "path.c").write_text(example)
    command = ["gcc", *STRICT, "-I", c_header().parent, tmp_path / "path.c", "-o", tmp_path / "path", "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    m = saturating(ring, 6, IndependentCurrents(6), [0.0] * 6, [2.5] * 6, cells=CELLS)
    write_c_iron_map(m, tmp_path / "remembering.fmap")
    done = subprocess.run([tmp_path / "path"], cwd=tmp_path, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    levels = [1.65, 1.75, 1.85, 1.95, 1.85, 1.75, 1.65, 1.55]
    assert [line[0] for line in lines] == [f"{level:.2f}" for level in levels]
    for line, level in zip(lines, levels, strict=True):
        m = m.step(level)
        assert float(line[3]) == pytest.approx(m.field([0.0, 0.0, -0.1], level)[2], rel=1e-5)


def test_damaged_memories_are_refused_or_safe(ring, tmp_path):
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
    try:
        program = build(tmp_path / "checked", *STRICT, *checks)
    except subprocess.CalledProcessError:
        pytest.skip("gcc has no address sanitizer here")
    good = write_c_iron_map(remembering(ring), tmp_path / "good.fmap").read_bytes()
    count, numbers = struct.unpack_from("=IQ", good, 28)

    def said(change):
        """What the program prints for a file with a changed number (format, offset, value) and a correct checksum."""
        changed = bytearray(good)
        struct.pack_into(change[0], changed, *change[1:])
        struct.pack_into("=I", changed, 24, zlib.crc32(bytes(changed[28:])))
        (tmp_path / "case").write_bytes(changed)
        done = subprocess.run([program, tmp_path / "case"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    assert said(("=I", 28, count)) == "opened, done\n"
    sizes = [("=I", 28, wrong) for wrong in (0, count - 1, count + 1, 2**32 - 1)]
    cells = [("=d", 40 + 8 * 17, wrong) for wrong in (0.0, 3.0, 5.0, -1.0, float("nan"))]
    for change in (*sizes, *cells, ("=I", 12, 1)):
        assert said(change) == "damaged: sizes or checksum do not fit\n"
    assert "newer version" in said(("=I", 12, 3))
    random = np.random.default_rng(5)
    for k in (0, 1, 2, *random.integers(3, count, 10)):
        for value in (-1.0, 0.5, 1e300, float("nan"), float("inf")):
            assert said(("=d", 40 + 8 * (numbers + int(k)), value)).startswith("opened")


@pytest.fixture
def map_file(ring, tmp_path):
    write_map(tmp_path / "iron.h5", saturating_data(ring, *KINDS["free"], cells=CELLS))
    return tmp_path / "iron.h5"


@pytest.mark.parametrize(
    ("words", "history"),
    [
        ("", ()),
        ("--history demagnetised", ("demagnetised",)),
        ("--level 0.2 0.3 -0.1 0.4", ("shaken", [0.2, 0.3, -0.1, 0.4])),
        ("--history shaken --level b=0.5", ("shaken", {"b": 0.5})),
    ],
)
def test_the_command_writes_the_memory_of_a_history(map_file, tmp_path, words, history):
    m = fm.open_map(map_file, outside="nan").memory(*history)
    target = tmp_path / "one.fmap"
    assert main(["export", str(map_file), "--to", "c", "-o", str(target), *words.split()]) == 0
    assert target.read_bytes() == write_c_iron_map(m, tmp_path / "same.fmap").read_bytes()
    target = tmp_path / "one.fmu"
    assert main(["export", str(map_file), "--to", "fmu", "--sources", "-o", str(target), *words.split()]) == 0
    (tmp_path / "same").mkdir()
    assert target.read_bytes() == write_fmu(m, tmp_path / "same" / "one.fmu", binary=False).read_bytes()
    target, at = tmp_path / "one.csv", [0.1, 0.2, 0.3, -0.4]
    line = ["export", str(map_file), "--to", "csv", "-o", str(target), "--currents", "0.1,0.2,0.3,-0.4"]
    assert main([*line, *words.split()]) == 0
    assert target.read_bytes() == write_csv(m, tmp_path / "same.csv", at).read_bytes()


@pytest.mark.parametrize(
    ("source", "words", "where"),
    [
        ("plain.h5", "c --history shaken", "--history"),
        ("plain.h5", "fmu --level 1", "--history"),
        ("drive_unit", "csv --spacing-mm 5 --history shaken", "--history"),
        ("iron.h5", "c --history shakn", "history"),
        ("iron.h5", "c --level 1 2", "--level"),
        ("iron.h5", "c --history demagnetised --level 1", "--level"),
        ("iron.h5", "c --level no=2", "--level"),
        ("iron.h5", "c32", "--to c32"),
    ],
)
def test_what_the_command_refuses(ring, map_file, tmp_path, capsys, source, words, where):
    write_map(tmp_path / "plain.h5", saturating_data(ring, *KINDS["free"]))
    named = str(tmp_path / source) if source.endswith(".h5") else source
    target = tmp_path / ("none.h" if "c32" in words else "none.csv" if "csv" in words else "none.fmap")
    if "fmu" in words:
        target = tmp_path / "none.fmu"
    assert main(["export", named, "-o", str(target), "--to", *words.split()]) == 2
    assert where in capsys.readouterr().err
    assert not target.exists()
