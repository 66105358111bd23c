"""The C header: the numbers of Python, under strict compilers and checkers of memory, from sound and broken files."""

import re
import shutil
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldmap.core.headers import FOLDER
from fieldmap.errors import InputError
from fieldmap.interop import c_header, write_c_map
from fieldmap.lookup import interpolate, open_map
from fieldmap.store import Grid, MapData, StoredReaction
from tests.docs.pages import blocks
from tests.interop.conftest import STRICT

HERE = Path(__file__).parent / "c"

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


def build(source, target, *flags, compiler="gcc"):
    command = [compiler, *flags, "-I", str(c_header().parent), str(HERE / source), "-o", str(target)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return target


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """The program that asks, as users build it."""
    return build("ask.c", tmp_path_factory.mktemp("c") / "ask", *STRICT, "-O1")


@pytest.fixture(scope="module")
def data():
    """Two coils: harmonic fields with derivatives of every order on a grid of unequal sides."""
    grid = Grid([-0.01, -0.01, -0.02], [0.004, 0.005, 0.0025], (6, 5, 5))
    x, y, z = np.moveaxis(grid.points().reshape(6, 5, 5, 3), -1, 0)
    units = [wave(x, y, z, 60.0, 0.3), wave(y, z, x, 45.0, 1.1)]
    turned = [
        units[0],
        tuple(np.roll(part, 1, axis=axes) for part, axes in zip(units[1], (-1, (-2, -1)), strict=True)),
    ]
    flux, slope = (np.stack(parts) for parts in zip(*turned, strict=True))
    return MapData(grid, ("left", "rechts ä"), [1.0, 1.0], flux_density=flux, gradient=slope)


def wave(x, y, z, k, phase):
    """B and G of the potential exp(k z) sin(3/5 k x + phase) cos(4/5 k y) / k^2 in its own axes."""
    a, b = 0.6 * k, 0.8 * k
    sines = np.stack([np.sin(a * x + phase), a * np.cos(a * x + phase), -a * a * np.sin(a * x + phase)])
    cosines = np.stack([np.cos(b * y), -b * np.sin(b * y), -b * b * np.cos(b * y)])
    rises = np.stack([np.exp(k * z), k * np.exp(k * z), k * k * np.exp(k * z)])
    unit = np.eye(3, dtype=int)

    def derivative(order):
        return sines[order[0]] * cosines[order[1]] * rises[order[2]] / k**2

    flux = np.stack([derivative(unit[i]) for i in range(3)], axis=-1)
    slope = np.stack(
        [np.stack([derivative(unit[i] + unit[j]) for j in range(3)], axis=-1) for i in range(3)], axis=-2
    )
    return flux, slope


def questions(m, n, seed=1):
    rng = np.random.default_rng(seed)
    points = m.lower + rng.random((n, 3)) * (m.upper - m.lower)
    points[:3] = m.lower, m.upper, (m.lower + m.upper) / 2
    return rng.normal(size=(n, len(m.coil_names))), points, rng.normal(size=(n, 3))


def ask(program, path, rows, folder):
    np.hstack(rows).tofile(folder / "questions")
    done = subprocess.run(
        [program, path, folder / "questions", folder / "answers"], capture_output=True, text=True, check=True
    )
    answers = np.fromfile(folder / "answers").reshape(-1, 46)
    sizes = np.split(answers, [3, 12, 39, 45], axis=1)
    return [
        part.reshape(len(answers), *shape) for part, shape in zip(sizes, SHAPES, strict=True)
    ], done.stdout


SHAPES = [(3,), (3, 3), (3, 3, 3), (6,), ()]


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_ten_thousand_points_give_the_numbers_of_python(programs, data, tmp_path, kind):
    m = interpolate(data, kind)
    path = write_c_map(m, tmp_path / "field.fmap")
    currents, points, moments = questions(m, 10_000)
    (flux, slope, second, wrench, status), said = ask(programs, path, (currents, points, moments), tmp_path)
    assert not status.any()
    assert said.splitlines()[:2] == ["left", "rechts ä"]
    np.testing.assert_allclose(
        [float(x) for x in said.splitlines()[2].split()], [m.lower[0], m.lower[2], m.upper[0], m.upper[2]]
    )
    expected = [*m.field_and_gradient(points, currents), m.second_gradient(points, currents)]
    expected.append(np.hstack(wrench_by_hand(expected, moments)))
    for ours, python in zip((flux, slope, second, wrench), expected, strict=True):
        assert np.abs(ours - python).max() < 1e-13 * np.abs(python).max()


@pytest.fixture(scope="module")
def reacting(data):
    """`data` with three fields of the iron's reaction to magnets, of which one counts negatively."""
    x, y, z = np.moveaxis(data.grid.points().reshape(6, 5, 5, 3), -1, 0)
    parts = [wave(x, y, z, k, phase) for k, phase in ((50.0, 0.2), (70.0, 0.9), (40.0, 2.0))]
    flux, slope = (np.stack(values) for values in zip(*parts, strict=True))
    return replace(data, reaction=StoredReaction(flux, slope, repelled=1))


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_the_reaction_of_the_iron(programs, reacting, tmp_path, kind):
    """Against its formula by hand, with a map made of the reaction's fields alone."""
    m, fields = interpolate(reacting, kind), interpolate(reacting.reaction.on(reacting.grid), kind)
    path = write_c_map(m, tmp_path / "field.fmap")
    currents, points, moments = questions(m, 500)
    (_, _, _, wrench, status), _ = ask(programs, path, (currents, points, moments), tmp_path)
    assert not status.any()
    b, g = fields.unit_field(points), fields.unit_gradient(points)
    weights = np.array([1.0, 1.0, -1.0]) * np.einsum("nki,ni->nk", b, moments)
    back = [np.einsum("nk,nk...->n...", weights, values) for values in (b, g)]
    there = m.field_and_gradient(points, currents)
    expected = np.hstack(wrench_by_hand([there[0] + back[0], there[1] + back[1]], moments))
    assert np.abs(wrench - expected).max() < 1e-13 * np.abs(expected).max()
    assert np.abs(m.wrench(points, moments, currents) - expected).max() < 1e-13 * np.abs(expected).max()
    # A count other than that of the fields in the file, and counts that no file has.
    good = path.read_bytes()
    counts = good.index(np.float64(3.0).tobytes() + np.float64(1.0).tobytes())
    for number in (2.0, 4.0, 65.0, np.nan):
        wrong = bytearray(good)
        wrong[counts : counts + 8] = np.float64(number).tobytes()
        wrong[24:28] = zlib.crc32(wrong[28:]).to_bytes(4, "little")
        (tmp_path / "case").write_bytes(wrong)
        assert opened(programs, tmp_path / "case") == 8


def wrench_by_hand(field, moments):
    return np.einsum("nij,ni->nj", field[1], moments), np.cross(moments, field[0])


def test_fixed_currents_and_outside(programs, data, tmp_path):
    rows = (
        np.ones((4, 1)),
        np.array([[0, 0, -0.015], [0, 0, 1.0], [0.5, 0, np.nan], [0, np.inf, 0]]),
        np.ones((4, 3)),
    )
    currents = np.array([2.0, -1.0])
    for outside, codes in (("nan", [0, 1, 2, 2]), ("clamp", [0, 0, 2, 2])):
        m = interpolate(data, outside=outside)
        path = write_c_map(m.at(currents), tmp_path / "fixed.fmap")
        (flux, slope, _, _, status), said = ask(programs, path, rows, tmp_path)
        assert status.tolist() == codes
        assert said.startswith("fixed currents\n")
        expected = (
            m.field_and_gradient(rows[1], currents)
            if outside == "clamp"
            else m.at(currents).field_and_gradient(rows[1])
        )
        np.testing.assert_allclose(flux, expected[0], rtol=0, atol=1e-12 * np.nanmax(np.abs(expected[0])))
        np.testing.assert_allclose(slope, expected[1], rtol=0, atol=1e-12 * np.nanmax(np.abs(expected[1])))


def opened(program, path):
    done = subprocess.run([program, "-", path, "-"], capture_output=True, text=True, check=True)
    return int(done.stdout.split()[0])


def test_broken_files_are_refused_with_their_reason(programs, data, tmp_path):
    good = write_c_map(interpolate(data), tmp_path / "good.fmap").read_bytes()
    flipped = bytearray(good)
    flipped[-5] ^= 1
    cases = {
        good: 0,
        b"": 5,
        b"not a map": 5,
        good[:30]: 4,
        good[:-8]: 4,
        good + b"12345678": 8,
        bytes(flipped): 8,
        good[:8] + good[8:12][::-1] + good[12:]: 7,
        good[:12] + (2).to_bytes(4, "little") + good[16:]: 8,
        good[:12] + (3).to_bytes(4, "little") + good[16:]: 8,
        good[:12] + (4).to_bytes(4, "little") + good[16:]: 8,
        good[:12] + (5).to_bytes(4, "little") + good[16:]: 6,
    }
    for content, code in cases.items():
        (tmp_path / "case").write_bytes(content)
        assert opened(programs, tmp_path / "case") == code
    assert opened(programs, tmp_path / "nowhere") == 3
    # Linux opens a folder but does not read it: the code of a missing file, not that of a lack of memory.
    assert opened(programs, tmp_path) == 3


def sanitizers_work(folder):
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    command = ["gcc", "-fsanitize=address,undefined", folder / "empty.c", "-o", folder / "empty"]
    return (
        subprocess.run(command, capture_output=True).returncode == 0
        and not subprocess.run([folder / "empty"]).returncode
    )


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_no_damage_makes_it_read_out_of_bounds(data, tmp_path, kind):
    if not sanitizers_work(tmp_path):
        pytest.skip("gcc has no address sanitizer here")
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
    program = build("fuzz.c", tmp_path / "fuzz", *STRICT, *checks)
    path = write_c_map(interpolate(data, kind), tmp_path / "field.fmap")
    done = subprocess.run([program, path, "4000"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[0]) > 100  # enough of them still open, so evaluation is tried too


def test_clean_under_valgrind(data, clean_under_valgrind, tmp_path):
    m = interpolate(data)
    path = write_c_map(m, tmp_path / "field.fmap")
    program = build("ask.c", tmp_path / "ask", *STRICT, "-g", "-O1")
    np.hstack(questions(m, 200)).tofile(tmp_path / "questions")
    clean_under_valgrind(program, path, tmp_path / "questions", tmp_path / "answers")


def test_compiles_as_cpp_too(tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("no g++ on this machine")
    build("ask.c", tmp_path / "ask", "-x", "c++", "-Wall", "-Wextra", "-Werror", compiler="g++")


def test_a_hermite_form_is_refused_and_nothing_is_left(data, tmp_path):
    with pytest.raises(InputError) as caught:
        write_c_map(interpolate(data, "hermite"), tmp_path / "field.fmap")
    assert caught.value.problems[0].received == "hermite"
    (tmp_path / "file").touch()
    with pytest.raises(InputError) as caught:
        write_c_map(interpolate(data), tmp_path / "file" / "field.fmap")
    assert str(tmp_path / "file") in caught.value.problems[0].where
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_the_example_of_the_documentation(tmp_path):
    (tmp_path / "lift.c").write_text(blocks("c.md", "c")[0])
    command = ["gcc", *STRICT, "-I", c_header().parent, tmp_path / "lift.c", "-o", tmp_path / "lift"]
    subprocess.run(command, check=True, capture_output=True)
    grid = Grid([-0.01, -0.01, -0.11], [0.01, 0.01, 0.01], (3, 3, 3))
    slope = np.tile(np.diag([-1.0, -1.0, 2.0]), (1, 3, 3, 3, 1, 1))
    flux = np.einsum("cxyzij,xyzj->cxyzi", slope, grid.points().reshape(3, 3, 3, 3))
    m = interpolate(MapData(grid, ("coil",), [1.0], flux_density=flux, gradient=slope))
    path = write_c_map(m, tmp_path / "workspace.fmap")
    done = subprocess.run([tmp_path / "lift", path], capture_output=True, text=True, check=True)
    assert done.stdout == "Bz -0.3 T, dBz/dz 3 T/m\nFz 2.4 N\n"
    failed = subprocess.run([tmp_path / "lift", tmp_path / "none"], capture_output=True, text=True)
    assert (failed.returncode, failed.stderr) == (3, "file cannot be opened or read\n")


def test_the_body_and_the_controller_of_the_documentation(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "c.md").read_text()
    example, printed = re.search(
        r"^```c\n(#include <stdio.h>\n#include \"controller.h\"\n.*?)^```$.*?^```text\n(.*?)^```$",
        page,
        re.DOTALL | re.MULTILINE,
    ).groups()
    (tmp_path / "hold.c").write_text(example)
    command = ["gcc", *STRICT, "-I", FOLDER, tmp_path / "hold.c", "-o", tmp_path / "hold", "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    write_c_map(open_map("sample"), tmp_path / "sample.fmap")
    done = subprocess.run([tmp_path / "hold"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == printed
