"""Flux linkages and inductances in C: of linear, saturating and remembering maps, in double and in single precision."""

import shutil
import struct
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.core.iron import FOUND, CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.interop import c_header, write_c32_files, write_c_iron_map, write_c_map
from fieldmap.lookup import compiled_currents, interpolate
from fieldmap.store import MapData, StoredLinkage
from tests.interop.conftest import STRICT
from tests.interop.iron_maps import CELLS, KINDS, saturating_data
from tests.interop.test_c32 import cut

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
SOURCE = Path(__file__).parent / "c" / "ask_linkages.c"


def stored(n):
    """Linkages of n coils, drawn at random."""
    drawn = np.random.default_rng(5).normal(size=(n, n))
    return StoredLinkage(1e-3 * (drawn @ drawn.T + np.eye(n)), 1e-4 * np.arange(1.0, n + 1.0))


def build(target, *flags):
    command = ["gcc", *STRICT, "-O1", "-I", c_header().parent, *flags, SOURCE, "-lm", "-o", target]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return target


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("c")
    return {"linear": build(folder / "linear"), "iron": build(folder / "iron", "-DIRON")}


def ask(folder, rows, n, *command, number=np.float64):
    """Linkages with the dipole and without (q, n), inductances (q, n, n), status (q,)."""
    np.hstack(rows).astype(number).tofile(folder / "questions")
    subprocess.run([*command, folder / "questions", folder / "answers"], check=True, capture_output=True)
    answers = np.fromfile(folder / "answers", number).reshape(len(rows[0]), -1).astype(float)
    with_dipole, alone, inductance, status = np.split(answers, [n, 2 * n, 2 * n + n * n], axis=1)
    return with_dipole, alone, inductance.reshape(-1, n, n), status[:, 0]


def questions(m, currents, seed=1):
    rng = np.random.default_rng(seed)
    points = m.lower + rng.random((len(currents), 3)) * (m.upper - m.lower)
    return currents, points, rng.normal(size=(len(currents), 3))


def agree(found, exact, relative):
    assert np.abs(found - exact).max() < relative * np.abs(exact).max()


def linked(ring, constant=False):
    """The ring's six coils, or five and a field that no current drives."""
    if not constant:
        return replace(ring.data, linkage=stored(6))
    data = ring.data
    fields = {name: getattr(data, name) for name in ("flux_density", "gradient")}
    names, ones = data.coil_names[:5], np.ones(5)
    sources = {"constant_field": True, "fixed_sources": ("background",)}
    return MapData(data.grid, names, ones, **fields, **sources, linkage=stored(5))


@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_linear_maps(programs, ring, tmp_path, kind, constant):
    """L I + constant + m . b of every coil, by hand."""
    m = interpolate(linked(ring, constant), kind)
    n, known = len(m.coil_names), stored(len(m.coil_names))
    rows = questions(m, np.random.default_rng(2).normal(size=(200, n)))
    path = write_c_map(m, tmp_path / "field.fmap")
    with_dipole, alone, inductance, status = ask(tmp_path, rows, n, programs["linear"], path)
    assert not status.any()
    of_coils = rows[0] @ known.inductance + known.constant
    agree(alone, of_coils, 1e-14)
    agree(with_dipole, of_coils + np.einsum("qki,qi->qk", m.unit_field(rows[1]), rows[2]), 1e-13)
    np.testing.assert_array_equal(inductance, np.tile(known.inductance, (200, 1, 1)))
    agree(with_dipole[0], m.flux_linkage(rows[0][0], rows[1][0], rows[2][0]), 1e-13)


def test_outside_and_of_maps_without(programs, ring, tmp_path):
    m = interpolate(linked(ring))
    rows = (np.ones((3, 6)), np.array([[0, 0, 1.0], [0, 0, -0.1], [0, 0, np.nan]]), np.ones((3, 3)))
    rows[0][1, 2] = np.inf
    path = write_c_map(m, tmp_path / "field.fmap")
    with_dipole, alone, _, status = ask(tmp_path, rows, 6, programs["linear"], path)
    assert status.tolist() == [1, 2, 2]
    assert np.isnan(with_dipole).all()
    assert np.isfinite(alone).all(axis=1).tolist() == [True, False, True]
    for other in (ring.map, interpolate(ring.data, "global")):
        path = write_c_map(other, tmp_path / "field.fmap")
        assert ask(tmp_path, rows, 6, programs["linear"], path)[3].tolist() == [12, 12, 12]
    bare = interpolate(saturating_data(ring, *KINDS["free"]))
    path = write_c_iron_map(bare, tmp_path / "iron.fmap")
    asked = questions(bare, np.zeros((2, 4)))
    assert ask(tmp_path, asked, 4, programs["iron"], path)[3].tolist() == [12, 12]


@pytest.mark.parametrize("kind", KINDS)
def test_saturating_iron(programs, ring, tmp_path, kind):
    """The iron's part by its core at the same tolerance, the payload's part by the slopes of the weights."""
    data = saturating_data(ring, *KINDS[kind])
    n = len(data.coil_names)
    m, known = interpolate(replace(data, linkage=stored(n))), stored(n)
    domain = m.info.reduced_model.domain
    drawn = domain.at(0.5 + 0.4 * np.sin(np.arange(30.0 * len(domain.lower)).reshape(30, -1)))
    rows = questions(m, drawn)
    path = write_c_iron_map(m, tmp_path / "iron.fmap")
    with_dipole, alone, inductance, status = ask(tmp_path, rows, n, programs["iron"], path)
    assert not status.any()
    state = CoreIron(core_numbers(compiled_currents(m))).state()
    sets = {name: getattr(data, name) for name in ("flux_density", "gradient")}
    count = len(data.flux_density)
    fields = interpolate(MapData(data.grid, tuple(f"field{f}" for f in range(count)), np.ones(count), **sets))
    for q, (currents, point, moment) in enumerate(zip(*rows, strict=True)):
        added, slopes = np.empty(n), np.empty((n, n))
        assert state.linkages(currents, added, slopes, tolerance=1e-13) == FOUND
        whole = known.constant + known.inductance @ currents + added / mu_0
        agree(alone[q], whole, 1e-9)
        agree(inductance[q], known.inductance + 0.5 * (slopes + slopes.T) / mu_0, 1e-9)
        weights, by_currents = np.empty(count), np.empty((count, n))
        assert state.solve(currents, weights, by_currents, tolerance=1e-13) == FOUND
        payload = (fields.unit_field(point) @ moment) @ by_currents
        agree(with_dipole[q], whole + payload, 1e-9)
        agree(with_dipole[q], m.flux_linkage(currents, point, moment), 1e-6)
        agree(inductance[q], m.inductance(currents), 1e-5)


def test_iron_that_remembers(programs, ring, tmp_path):
    """At 0.9 of the currents of each step along a path, against Python; straight from the start, linkages differ."""
    m = interpolate(replace(saturating_data(ring, *KINDS["free"], cells=CELLS), linkage=stored(4)))
    path = np.random.default_rng(11).uniform(-1.0, 1.0, (20, 4))
    rows = questions(m, path)
    file = write_c_iron_map(m, tmp_path / "iron.fmap")
    with_dipole, alone, inductance, status = ask(tmp_path, rows, 4, programs["iron"], file)
    assert not status.any()
    led, straight = m, []
    for q, (currents, point, moment) in enumerate(zip(*rows, strict=True)):
        led = led.step(currents)
        agree(alone[q], led.flux_linkage(0.9 * currents), 1e-9)
        # Rounding decides whether a cell at the end of its play moves: slopes jump by that much.
        agree(inductance[q], led.inductance(0.9 * currents), 0.05)
        agree(with_dipole[q], led.flux_linkage(0.9 * currents, point, moment), 1e-5)
        straight.append(m.flux_linkage(0.9 * currents))
    assert np.abs(straight - alone).max() > 1e-3 * np.abs(alone).max()


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_single_precision(ring, tmp_path, kind):
    m = interpolate(replace(cut(ring.data), linkage=stored(6)), kind)
    header, _ = write_c32_files(m, tmp_path / "lift.h")
    program = build(tmp_path / "ask", f'-DMAP="{header}"', "-DNAME=lift")
    rows = questions(m, np.random.default_rng(2).normal(size=(200, 6)))
    found = ask(tmp_path, rows, 6, program, number=np.float32)
    assert not found[3].any()
    exact = [
        np.array([m.flux_linkage(*row) for row in zip(*rows, strict=True)]),
        np.array([m.flux_linkage(row) for row in rows[0]]),
    ]
    for ours, wanted in zip(found[:2], exact, strict=True):
        assert 1e-9 < np.abs(ours - wanted).max() / np.abs(wanted).max() < 1e-6
    agree(found[2], np.tile(m.inductance(), (200, 1, 1)), 1e-7)


def test_damaged_counts_of_linkages_are_refused(programs, ring, tmp_path):
    m = interpolate(linked(ring))
    good = write_c_map(m, tmp_path / "field.fmap").read_bytes()
    where = good.index(np.float64([6.0, 0.0, 0.0]).tobytes(), 40 + 16 * 8)
    rows = questions(m, np.ones((1, 6)))
    for number in (0.0, 5.0, 7.0, -1.0, 0.5, np.nan, 1e6):
        wrong = bytearray(good)
        struct.pack_into("=d", wrong, where, number)
        struct.pack_into("=I", wrong, 24, zlib.crc32(bytes(wrong[28:])))
        (tmp_path / "case").write_bytes(wrong)
        with pytest.raises(subprocess.CalledProcessError) as caught:
            ask(tmp_path, rows, 6, programs["linear"], tmp_path / "case")
        assert caught.value.returncode == 2
