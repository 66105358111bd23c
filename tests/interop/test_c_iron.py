"""The C header of saturating iron: the numbers of Python, no memory taken, strict compilers, broken files."""

import re
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

from fieldmap.core.iron import FOUND, CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.currents import IndependentCurrents
from fieldmap.errors import InputError
from fieldmap.interop import c_header, c_iron_header, write_c_iron_files, write_c_iron_map
from fieldmap.lookup import compiled_currents
from tests.docs.pages import blocks
from tests.interop.conftest import STRICT
from tests.interop.iron_maps import KINDS, MODES, POINTS, saturating

HERE = Path(__file__).parent / "c"
COUNTED = ["-Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc"]

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


def build(target, *flags):
    command = ["gcc", *flags, "-I", c_header().parent, HERE / "ask_iron.c", *COUNTED, "-lm", "-o", target]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return target


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return build(tmp_path_factory.mktemp("c") / "ask", *STRICT, "-O1")


def ask(program, m, questions, folder, tolerance):
    """Weights, slopes, B, G, wrench and status of every row."""
    path = write_c_iron_map(m, folder / "iron.fmap")
    np.hstack(questions).tofile(folder / "questions")
    subprocess.run(
        [program, path, folder / "questions", folder / "answers", repr(tolerance)],
        check=True,
        capture_output=True,
    )
    coils = questions[0].shape[1]
    fields = len(m.coil_names) + m._model.fields_beside_coils
    answers = np.fromfile(folder / "answers").reshape(len(questions[0]), -1)
    return np.split(answers, np.cumsum([fields, fields * coils, 3, 9, 6]), axis=1)


def questions(m, n, seed=1):
    rng, domain = np.random.default_rng(seed), m.info.reduced_model.domain
    points = m.lower + rng.random((n, 3)) * (m.upper - m.lower)
    currents = domain.at(0.5 + 0.5 * np.sin(np.cumsum(rng.random((n, len(domain.lower))), axis=0) ** 2))
    return currents, points, rng.normal(size=(n, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_c_gives_the_numbers_of_python_and_takes_no_memory(program, ring, tmp_path, kind):
    m = saturating(ring, *KINDS[kind])
    currents, points, moments = questions(m, 300)
    weights, slopes, flux, slope, wrench, status = ask(
        program, m, (currents, points, moments), tmp_path, 1e-13
    )
    assert not status.any()
    state = CoreIron(core_numbers(compiled_currents(m))).state()
    for k, row in enumerate(currents):
        ours, ours_slopes = np.empty(weights.shape[1]), np.empty((weights.shape[1], len(row)))
        assert state.solve(row, ours, ours_slopes, tolerance=1e-13) == FOUND
        assert np.abs(weights[k] - ours).max() < 1e-12 * np.abs(ours).max()
        assert np.abs(slopes[k] - ours_slopes.ravel()).max() < 1e-12 * np.abs(ours_slopes).max()
    expected = [m.field(p, i) for p, i in zip(points, currents, strict=True)]
    assert np.abs(flux - expected).max() < 1e-5 * np.abs(expected).max()
    loads = [m.wrench(p, n, i) for p, n, i in zip(points, moments, currents, strict=True)]
    assert np.abs(wrench - loads).max() < 1e-5 * np.abs(loads).max()
    assert np.isfinite(slope).all()


def test_the_layout_of_the_file(ring, tmp_path):
    """As the module states it, read by hand; the fields lie behind the model, in the layout of a linear map."""
    m = saturating(ring, *KINDS["background"])
    raw = write_c_iron_map(m, tmp_path / "iron.fmap").read_bytes()
    head = struct.unpack("=8sIIQIIQ", raw[:40])
    count = head[6]
    assert head == (b"fmapiron", 0x01020304, 1, len(raw), zlib.crc32(raw[28:]), 0, count)
    numbers = np.frombuffer(raw[40:200])
    # Points, modes, numbers in a row, coils, fields of the iron, a background, laws, knots.
    assert numbers[[0, 1, 3, 4, 5, 6, 7]].tolist() == [POINTS, MODES, 3, 2, 1, 2, 6]
    behind = raw[40 + 8 * count :]
    mark, order, version, size, check, names, block = struct.unpack("=8sIIQIIQ", behind[:40])
    assert (mark, order, version, size, check) == (
        b"fieldmap",
        0x01020304,
        1,
        len(behind),
        zlib.crc32(behind[28:]),
    )
    assert names % 8 == 0
    assert size == 40 + names + 8 * block
    told = behind[40 : 40 + names].rstrip(b"\0").split(b"\0")
    assert told == [b"a", b"b", b"c", b"iron 1", b"iron 2", b"background"]
    with pytest.raises(InputError):
        write_c_iron_map(ring.map, tmp_path / "iron.fmap")


def test_at_the_stated_tolerance_and_outside(program, ring, tmp_path):
    m = saturating(ring, *KINDS["free"])
    currents, points, moments = questions(m, 50)
    currents[3, 0], currents[7, 1] = 1.5, np.nan
    weights, _, flux, _, wrench, status = ask(program, m, (currents, points, moments), tmp_path, 1e-5)
    assert status[[3, 7], 0].tolist() == [32, 2]
    assert np.flatnonzero(status).tolist() == [3, 7]
    for part in (weights, flux, wrench):
        assert np.isnan(part[[3, 7]]).all()
    inside = status[:, 0] == 0
    expected = [m.field(p, i) for p, i in zip(points[inside], currents[inside], strict=True)]
    assert np.abs(flux[inside] - expected).max() < 1e-3 * np.abs(expected).max()
    wide = saturating(ring, *KINDS["free"], outside_currents="evaluate")
    *_, status = ask(program, wide, (currents, points, moments), tmp_path, 1e-5)
    assert np.flatnonzero(status).tolist() == [7]


def test_broken_files_are_refused_or_safe(ring, tmp_path):
    """Every number of the model's head and some of its positions are damaged, under a correct checksum."""
    import struct
    import zlib

    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
    try:
        program = build(tmp_path / "checked", *STRICT, *checks)
    except subprocess.CalledProcessError:
        pytest.skip("gcc has no address sanitizer here")
    good = write_c_iron_map(saturating(ring, *KINDS["division"]), tmp_path / "good.fmap").read_bytes()
    rng, opened = np.random.default_rng(3), 0
    count = struct.unpack_from("=Q", good, 32)[0]
    cases = [good[:30], good[:-8], good + b"12345678", b"fieldmap" + good[8:], good]
    for k in [*range(20), *rng.integers(20, count, 15)]:
        for value in (-1.0, 0.0, 1e9, 0.5, float("nan"), float(rng.integers(0, 40))):
            changed = bytearray(good)
            struct.pack_into("=d", changed, 40 + 8 * int(k), value)
            struct.pack_into("=I", changed, 24, zlib.crc32(bytes(changed[28:])))
            cases.append(bytes(changed))
    for content in cases:
        (tmp_path / "case").write_bytes(content)
        done = subprocess.run([program, tmp_path / "case"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        opened += done.stdout.startswith("0 ")
    assert 20 < opened < len(cases) - 60


def test_clean_under_valgrind(ring, clean_under_valgrind, tmp_path):
    m = saturating(ring, *KINDS["division"])
    path = write_c_iron_map(m, tmp_path / "iron.fmap")
    program = build(tmp_path / "ask", *STRICT, "-g", "-O1")
    np.hstack(questions(m, 5)).tofile(tmp_path / "questions")
    clean_under_valgrind(program, path, tmp_path / "questions", tmp_path / "answers", "1e-6")


def test_files_lie_side_by_side_and_linear_maps_have_their_own(ring, tmp_path):
    written = write_c_iron_files(saturating(ring, *KINDS["groups"]), tmp_path / "iron.fmap")
    assert [path.name for path in written] == ["iron.fmap", c_iron_header().name, c_header().name]
    with pytest.raises(InputError):
        write_c_iron_map(ring.map, tmp_path / "linear.fmap")


def test_the_example_of_the_documentation(ring, tmp_path):
    (example,) = (code for code in blocks("c.md", "c") if code.startswith('#include "fieldmap_iron.h"'))
    (tmp_path / "lift.c").write_text(example)
    command = ["gcc", *STRICT, "-I", c_header().parent, tmp_path / "lift.c", "-o", tmp_path / "lift", "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    failed = subprocess.run([tmp_path / "lift"], cwd=tmp_path, capture_output=True, text=True)
    assert (failed.returncode, failed.stderr) == (3, "file cannot be opened or read\n")
    m = saturating(ring, 6, IndependentCurrents(6), [0.0] * 6, [2.0] * 6)
    write_c_iron_map(m, tmp_path / "workspace.fmap")
    done = subprocess.run([tmp_path / "lift"], cwd=tmp_path, capture_output=True, text=True, check=True)
    force = m.wrench([0.0, 0.0, -0.1], [0.0, 0.0, 0.8], [1.5] * 6)[2]
    assert float(re.fullmatch(r"Fz (\S+) N\n", done.stdout)[1]) == pytest.approx(force, rel=1e-3)
