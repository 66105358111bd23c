"""The bead of docs/own_controller.md, whose map takes minutes: its block runs on a small made-up map."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.currents import IndependentCurrents
from fieldmap.sources import CoilSet
from fieldmap.store import Grid, MapData, ReducedModel, write_map
from tests.docs.pages import blocks

PAGE = "own_controller.md"
COILS, GAIN, DEMAGNETISING, FIELD_PER_AMPERE = 8, 9.5, 0.1, 3e-3


def made_up_map():
    """The coils of eight_coils_bead, each with a core whose field is up to 9.5 times the coil's, and which saturates.

    One state of magnetisation per core: its field is h = 3 mT/A i - 0.1 a with a = 0.1 tanh(29 h), in tesla.
    """
    device = fm.read_device("eight_coils_bead")
    lower, upper, n = np.full(3, -0.01), np.full(3, 0.01), 6
    grid = Grid(lower, (upper - lower) / (n - 1), (n, n, n))
    coils, points = CoilSet(device.coils, (lower, upper)), grid.points()
    flux = np.moveaxis(coils.unit_field(points), 1, 0).reshape(COILS, n, n, n, 3)
    slope = np.moveaxis(coils.unit_gradient(points), 1, 0).reshape(COILS, n, n, n, 3, 3)
    knots = np.linspace(0.0, 0.3, 600)
    width, rise = knots[1], np.tanh(29.0 * knots)
    steep = 1.0 + 29.0 * (1.0 - rise**2)
    b = knots + rise
    step, begin, end = np.diff(b), width * steep[:-1], width * steep[1:]
    law = np.zeros((len(knots), 4))
    law[:-1, 0] = (begin + end - 2.0 * step) / width**3
    law[:-1, 1] = (3.0 * step - 2.0 * begin - end) / width**2
    law[:, 2], law[:, 3] = steep, b
    law[-1] = 0.0, 0.0, 1.0, b[-1]
    along = np.zeros((3 * COILS, COILS))
    along[3 * np.arange(COILS), np.arange(COILS)] = 1.0
    # Weight of the iron's field per ampere in the linear range.
    linear = DEMAGNETISING * 29.0 * FIELD_PER_AMPERE / (1.0 + 29.0 * DEMAGNETISING**2)
    model = ReducedModel(
        gradients=DEMAGNETISING * along,
        source=FIELD_PER_AMPERE * along,
        weights=np.ones(COILS),
        law=np.zeros(COILS, np.int64),
        law_offset=np.array([0, len(knots)]),
        law_knots=knots,
        law_coefficients=law,
        air=np.eye(COILS),
        constant=np.zeros(COILS),
        output=GAIN / linear * np.eye(COILS),
        known_currents=np.zeros((1, COILS)),
        known_amplitudes=np.zeros((1, COILS)),
        lower=np.full(COILS, -10.0),
        upper=np.full(COILS, 10.0),
        parametrisation=IndependentCurrents(COILS),
        reference_weights=np.ones(COILS),
    )
    return MapData(
        grid,
        tuple(device.coil_names),
        np.ones(COILS),
        flux_density=np.concatenate([flux, flux]),
        gradient=np.concatenate([slope, slope]),
        reduced_model=model,
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    (folder / "maps" / "out").mkdir(parents=True)
    write_map(folder / "maps" / "out" / "eight_coils_bead.h5", made_up_map())
    return folder


@pytest.fixture
def folder(written, monkeypatch):
    monkeypatch.chdir(written)
    return written


def the_block():
    """The block of the page that opens the map."""
    (found,) = (code for code in blocks(PAGE) if "eight_coils_bead.h5" in code)
    return found


def test_the_made_up_cores_saturate(folder):
    """Against the equation of one core, solved separately: coil 1 alone, relative to its field in air."""
    m = fm.open_map("maps/out/eight_coils_bead.h5")
    device = fm.read_device("eight_coils_bead")
    one, point = np.eye(COILS)[0], np.zeros(3)
    air = CoilSet(device.coils, (m.lower, m.upper)).field(point, one)
    shares = []
    for amperes in (0.01, 10.0):
        low, high = 0.0, 0.1
        for _ in range(80):
            middle = 0.5 * (low + high)
            rest = FIELD_PER_AMPERE * amperes - DEMAGNETISING * 0.1 * np.tanh(29.0 * middle) - middle
            low, high = (middle, high) if rest > 0.0 else (low, middle)
        per_ampere = DEMAGNETISING * np.tanh(29.0 * low) / amperes
        linear = DEMAGNETISING * 29.0 * FIELD_PER_AMPERE / (1.0 + 29.0 * DEMAGNETISING**2)
        wanted = air * (1.0 + GAIN * per_ampere / linear) * amperes
        np.testing.assert_allclose(m.field(point, amperes * one), wanted, rtol=2e-4, atol=1e-12)
        shares.append(per_ampere / linear)
    assert shares[0] > 0.9999
    assert shares[1] < 0.9


def test_the_bead_follows_its_circle_on_saturating_iron(folder):
    """The page's function in Python and in numba: equal bits, every solve converged, and the expected path. A run on
    iron linearised about the start deviates."""
    names: dict[str, object] = {}
    exec(compile(the_block(), PAGE, "exec"), names)
    run, controller = names["run"], names["controller"]
    assert run.event is None
    assert run.iron.model == "model"
    assert run.iron.solves > 80_000
    assert run.iron.unsolved == run.iron.outside == 0
    angle = 0.4 * np.pi * np.maximum(run.time - 1.0, 0.0)
    height = names["HEIGHT"] + 5e-4 * np.sin(2.0 * angle)
    wanted = np.stack([1e-3 * (np.cos(angle) - 1.0), 1e-3 * np.sin(angle), height], axis=1)
    later = run.time > 1.0
    rms = np.sqrt(np.mean((run.sensed - wanted)[later] ** 2, axis=0))
    assert rms.max() < 6e-5
    assert np.ptp(run.sensed[:, 0]) > 1.8e-3
    short = {**names["changes"], "duration_s": 1.2}
    python = replace(controller, function=names["hold"])
    in_python = fm.simulate("bead", short, field_map=names["m"], controller=python)
    np.testing.assert_array_equal(in_python.rows, run.rows[:1200])
    straight = fm.simulate(
        "bead", {**short, "field.iron": "linearised"}, field_map=names["m"], controller=controller
    )
    assert straight.iron.model == "linearised"
    assert 1e-8 < np.abs(straight.position - run.position[:1200]).max() < 1e-4
