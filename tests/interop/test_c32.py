"""The C header in single precision: numbers to float's rounding, no library, its stated size and operations."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldmap.core.headers import in_one
from fieldmap.errors import InputError
from fieldmap.interop import write_c32_files
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData
from tests.docs.pages import ROOT, blocks
from tests.refusals import refused

HERE = Path(__file__).parent / "c"
STRICT = ["-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wshadow"]
STRICT += ["-Wdouble-promotion", "-Wfloat-conversion"]

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")


@pytest.fixture(scope="module")
def whole(ring):
    """The ring's map as one polynomial."""
    return interpolate(ring.data, "global")


def cut(data, nodes=(5, 5, 5)):
    """A corner of a map, so that its constants are few."""
    i, j, k = nodes
    grid = Grid(data.grid.lower, data.grid.spacing, nodes)
    part = {name: getattr(data, name)[:, :i, :j, :k] for name in ("flux_density", "gradient")}
    return MapData(grid, data.coil_names, data.reference_current, **part)


def ask(folder, header, rows, *flags):
    if shutil.which("g++") is None:
        pytest.skip("no g++ on this machine")
    command = ["g++", *STRICT, *flags, f'-DMAP="{header}"', f"-DNAME={header.stem}", HERE / "ask32.cpp"]
    subprocess.run([*command, "-o", folder / "ask"], check=True, capture_output=True)
    given = np.hstack(rows).astype(np.float32).tobytes()
    return subprocess.run([folder / "ask"], input=given, capture_output=True, check=True).stdout


@pytest.mark.parametrize("kind", ["harmonic", "global"])
@pytest.mark.parametrize("fixed", [False, True])
def test_python_s_numbers_in_single_precision(ring, tmp_path, kind, fixed):
    m = interpolate(cut(ring.data), kind)
    currents = np.array([1.0, 2.0, 0.5, -1.0, 0.2, 1.5])
    header, _ = write_c32_files(m.at(currents) if fixed else m, tmp_path / "lift.h")
    rng = np.random.default_rng(2)
    points = m.lower + rng.random((500, 3)) * (m.upper - m.lower)
    points[:2] = m.lower, m.upper
    moments = rng.normal(size=(500, 3))
    amperes = np.ones((500, 1)) if fixed else np.tile(currents, (500, 1))
    found = np.frombuffer(ask(tmp_path, header, (amperes, points, moments), "-O2"), np.float32).reshape(
        -1, 19
    )
    assert not found[:, 18].any()
    # Points as single precision rounds them.
    told = points.astype(np.float32).astype(float).clip(m.lower, m.upper)
    flux, slope = m.field_and_gradient(told, currents)
    wrench = m.wrench(told, moments, currents)
    for ours, exact in (
        (found[:, :3], flux),
        (found[:, 3:12], slope.reshape(-1, 9)),
        (found[:, 12:15], wrench[:, :3]),
    ):
        assert 1e-9 < np.abs(ours - exact).max() / np.abs(exact).max() < 3e-6


def test_outside_and_what_is_no_number(ring, tmp_path):
    m = cut(ring.data, (3, 3, 3))
    points = np.array([[0.0, 0.0, 0.0], [np.nan, 0, 0], [0, np.inf, 0], [-0.01, -0.01, -0.11]])
    rows = (np.ones((4, 6)), points, np.ones((4, 3)))
    rows[0][3, 2] = np.inf
    for outside, codes in (("nan", [1, 2, 2, 2]), ("clamp", [0, 2, 2, 2])):
        field = interpolate(m, "global", outside)
        header, _ = write_c32_files(field, tmp_path / "2 lift.h")
        renamed = header.rename(tmp_path / "map_2_lift.h")
        found = np.frombuffer(ask(tmp_path, renamed, rows), np.float32).reshape(-1, 19)
        assert found[:, 18].tolist() == codes
        assert not found[1:, :18].any()
        exact = field.field([0.0, 0.0, 0.0], 1.0) if outside == "clamp" else np.zeros(3)
        np.testing.assert_allclose(found[0, :3], exact, rtol=1e-5, atol=1e-9)


def numbers_of_the_page():
    """{kind: (sums, products, quotients, bytes of stack)} that docs/c.md states."""
    page = (ROOT / "docs" / "c.md").read_text()
    rows = re.findall(r"^\| `--kind (\w+)` \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", page, re.MULTILINE)
    return {kind: tuple(map(int, rest)) for kind, *rest in rows}


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_operations_and_stack_are_those_of_the_page(ring, tmp_path, kind):
    m = interpolate(cut(ring.data), kind)
    header, _ = write_c32_files(m, tmp_path / "lift.h")
    rows = (np.ones((1, 6)), (m.lower + m.upper)[None] / 2, np.ones((1, 3)))
    counted = tuple(map(int, ask(tmp_path, header, rows, "-DCOUNT").split()))
    *expected, stack = numbers_of_the_page()[kind]
    assert counted == tuple(expected)
    compiler = ["gcc", "-std=c99", *STRICT, "-Os", "-ffreestanding", "-fno-builtin", "-fstack-usage"]
    # For a map that the compiler knows, and for any map.
    for parameter, asked in (("", "&lift"), ("const fm32_map *map, ", "map")):
        one = f"int32_t one({parameter}const float *i, const float *p, float *b, float *g)"
        (tmp_path / "one.c").write_text(
            f'#include "lift.h"\n{one};\n{one} {{ return fm32_field({asked}, i, p, b, g); }}\n'
        )
        # A pointer leaves the constants unused.
        command = [*compiler, "-Wno-unused-const-variable", "-c", "one.c"]
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
        used = [int(line.split("\t")[1]) for line in (tmp_path / "one.su").read_text().splitlines()]
        assert sum(used) <= stack
        wanted = subprocess.run(
            ["nm", "-u", "one.o"], cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout
        # A freestanding compiler may always ask for these.
        assert set(wanted.split()) - {"U", "w", "memset", "memcpy", "_GLOBAL_OFFSET_TABLE_"} == set()


@pytest.mark.parametrize("degree", [3, 5, 20])
def test_it_is_compiled_for_any_degree(tmp_path, degree):
    (tmp_path / "fieldmap32.h").write_text(in_one("fieldmap32.h"))
    asked = "(const fm32_map *map, const float *i, const float *p, const float *m, float *w)"
    (tmp_path / "one.c").write_text(
        f'#include "fieldmap32.h"\nint32_t one{asked};\nint32_t one{asked} {{ return fm32_wrench(map, i, p, m, w); }}\n'
    )
    command = ["gcc", "-std=c99", *STRICT, f"-DFM32_MAX_DEGREE={degree}", "-O2", "-c", "one.c"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.parametrize("headers", [("fieldmap.h", "fieldmap32.h"), ("fieldmap32.h", "fieldmap.h")])
def test_a_source_file_takes_one_precision(tmp_path, headers):
    for name in headers:
        (tmp_path / name).write_text(in_one(name))
    (tmp_path / "two.c").write_text("".join(f'#include "{name}"\n' for name in headers))
    command = ["gcc", "-std=c99", "-fsyntax-only", "two.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "a source file includes fieldmap.h or fieldmap32.h, not both" in done.stderr


def test_too_many_numbers_and_a_hermite_form_are_refused(ring, tmp_path, monkeypatch):
    monkeypatch.setattr("fieldmap.interop.c_map._MOST_CONSTANTS", 1000)
    for kind in ("hermite", "harmonic"):
        field = interpolate(ring.data, kind)
        with pytest.raises(InputError):
            write_c32_files(field, tmp_path / "lift.h")
    assert not list(tmp_path.iterdir())


def test_as_many_numbers_as_allowed_are_written(ring, tmp_path, monkeypatch):
    """Six coils of one polynomial of degree 6: 6 x 49."""
    field = interpolate(cut(ring.data, (2, 2, 3)), "global")
    for most in (294, 293):
        monkeypatch.setattr("fieldmap.interop.c_map._MOST_CONSTANTS", most)
        if most == 294:
            assert "lift_coefficients[294]" in write_c32_files(field, tmp_path / "lift.h")[0].read_text()
            continue
        with refused(InputError, where="write_c32_files, field", received="294"):
            write_c32_files(field, tmp_path / "lift.h")


def test_names_of_coils_stand_in_a_comment_whatever_they_hold(ring, tmp_path):
    """A name can end neither the comment nor its line."""
    names = ("left", "Spule ø", "*/ int bad; /*", "two\nlines", "a\x07bell", "tab\there")
    part = replace(cut(ring.data), coil_names=names)
    path, _ = write_c32_files(interpolate(part, "global"), tmp_path / "lift.h")
    lines = path.read_text(encoding="utf-8").splitlines()
    shown = ("left", "Spule ø", "* / int bad; /*", "two?lines", "a?bell", "tab?here")
    assert lines[1:8] == [*(f" *   {k}: {name}" for k, name in enumerate(shown)), " */"]


def test_the_loop_at_a_kilohertz(whole, tmp_path):
    """docs/examples/levitate_1khz.c, strictly compiled: it holds the magnet."""
    shutil.copy(ROOT / "docs" / "examples" / "levitate_1khz.c", tmp_path)
    write_c32_files(whole, tmp_path / "lift.h")
    strict = [flag for flag in STRICT if flag != "-Wdouble-promotion"]
    subprocess.run(
        ["gcc", "-std=c99", *strict, "-O2", "levitate_1khz.c", "-o", "levitate"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    for how, samples in (([], 10_000), (["real"], 1000)):
        done = subprocess.run([tmp_path / "levitate", *how], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout
        print(done.stdout)
        found = re.match(r"(\d+) samples, at most ([\d.]+) mm", done.stdout)
        assert int(found[1]) == samples
        assert float(found[2]) < 0.05


def test_the_lines_of_the_documentation(whole, tmp_path):
    (example,) = blocks("c.md", "c", "## For microcontrollers")
    write_c32_files(whole, tmp_path / "lift.h")
    rest = """
#include <stdio.h>
int main(void) { const float p[3] = {0.0f, 0.0f, -0.1f}; float f; printf("%d ", (int)lift_per_ampere(p, &f));
printf("%.9g\\n", (double)f); return 0; }
"""
    (tmp_path / "a.c").write_text(example.replace("int32_t lift_per", "static int32_t lift_per") + rest)
    command = ["gcc", "-std=c99", *STRICT, "a.c", "-o", "a"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    status, force = subprocess.run([tmp_path / "a"], capture_output=True, text=True).stdout.split()
    assert status == "0"
    exact = whole.wrench([0, 0, -0.1], [0, 0, 0.8], np.ones(6))[2]
    assert abs(float(force) / exact - 1) < 1e-5
