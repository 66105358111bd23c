"""Callers as words with addresses, called as a program in C calls them."""

import ctypes
import gc
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.core.block import HARMONIC
from fieldmap.core.body import CoreBody
from fieldmap.core.caller import COILS, ROOM, caller, functions
from fieldmap.core.current_table import CoreTable, Table
from fieldmap.core.iron import CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.currents import divide_currents
from fieldmap.interpolants.form import contract, header
from fieldmap.lookup.current_solver import compiled_model
from tests.core.iron_cases import CASES
from tests.core.map_cases import CURRENTS, GRID, KINDS, block_of, no_reaction
from tests.core.test_soft_iron import DIPOLES, POSE, pieces

POINT = np.array([-0.2, 0.25, 1.1])
INSIDE = divide_currents(1.4, 0.1, -0.2, 1.25)
_NUMBERS, _REAL = ctypes.POINTER(ctypes.c_double), ctypes.c_double
_KINDS = {
    "call_field": ctypes.CFUNCTYPE(_NUMBERS, ctypes.c_void_p, _REAL, _REAL, _REAL),
    "call_field_of": ctypes.CFUNCTYPE(_NUMBERS, ctypes.c_void_p, ctypes.c_void_p, _REAL, _REAL, _REAL),
    **dict.fromkeys(
        ("call_wrench", "call_linkages"), ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    ),
}


@pytest.fixture
def call(library):
    """The functions of a library, by name."""
    return {name: _KINDS[name](address) for name, address in functions().items()}


def field_of(call, words, currents, point=POINT):
    """B (3,) and G (3, 3)."""
    if currents is None:
        found = call["call_field"](words.ctypes.data, *point)
    else:
        found = call["call_field_of"](words.ctypes.data, currents.ctypes.data, *point)
    twelve = np.array(found[:12])
    return twelve[:3], twelve[3:].reshape(3, 3)


def block_with(sets):
    """A block of harmonic cells with this many sets."""
    start = header(HARMONIC, GRID, sets, "nan", 5, 0.2)
    return np.concatenate([start, np.random.default_rng(sets).normal(size=6 * 36 * sets)])


def superposed(block, weights, point=POINT):
    """The sum of single fields times weights, in numpy."""
    flux, gradient = np.empty((1, len(weights), 3)), np.empty((1, len(weights), 3, 3))
    CoreMap(block).each_field(point[None], flux, gradient)
    return weights @ flux[0], np.tensordot(weights, gradient[0], 1)


def assert_same(found, wanted):
    for ours, exact in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("kind", KINDS)
def test_sums_of_fields(call, kind):
    block, size = block_of(kind)
    words = caller(CoreMap(block))
    assert words[COILS] == 2
    assert_same(field_of(call, words, CURRENTS), superposed(block, CURRENTS))
    assert_same(
        field_of(call, caller(CoreMap(contract(block, CURRENTS, size))), None), superposed(block, CURRENTS)
    )
    for found in (
        field_of(call, words, CURRENTS, POINT + 10.0),
        field_of(call, words, CURRENTS, POINT * np.nan),
        # A map without fixed currents has no field without currents.
        field_of(call, words, None),
    ):
        assert np.isnan(found[0]).all()
        assert np.isnan(found[1]).all()
    constant = caller(CoreMap(block, constant=True))
    assert constant[COILS] == 1
    assert_same(field_of(call, constant, CURRENTS[:1]), superposed(block, np.array([CURRENTS[0], 1.0])))


@pytest.mark.parametrize("checked", [True, False])
def test_iron_that_saturates(call, checked):
    model = CASES["fixed"]
    iron = CoreIron(core_numbers(compiled_model(model, checked=checked)))
    count = model.coil_count + model.field_count + 1
    words, block = caller(CoreMap(block_with(count)), iron.state()), block_with(count)
    assert words[COILS] == 3
    for currents in (np.array([0.4, -0.2, 1.1]), np.array([0.5, -0.2, 1.0]), np.array([0.1, 0.8, 0.3])):
        weights = np.empty(count)
        assert iron.state().solve(currents, weights, tolerance=1e-10) == 0
        for ours, exact in zip(field_of(call, words, currents), superposed(block, weights), strict=True):
            np.testing.assert_allclose(ours, exact, rtol=0, atol=2e-3 * np.abs(exact).max())
    beyond = field_of(call, words, np.array([3.0, 0.0, 1.0]))
    assert np.isnan(beyond[0]).all() == checked
    assert np.isnan(field_of(call, words, np.full(3, np.nan))[1]).all()


def table():
    """A table of three fields with random numbers."""
    rng, axes = np.random.default_rng(4), [np.linspace(1.0, 2.0, 5), np.linspace(-0.4, 0.4, 5)]
    nodes = (axes[0], axes[1], axes[1])
    knots = tuple(np.concatenate([[a[0]] * 4, a[2:3], [a[-1]] * 4]) for a in nodes)
    ends = np.array([a[0] for a in nodes]), np.array([a[-1] for a in nodes])
    return CoreTable(
        Table(
            1.25,
            np.inf,
            1e-6,
            *ends,
            knots,
            nodes,
            rng.normal(size=(5, 5, 5, 3)),
            rng.normal(size=(5, 5, 5, 6, 3)),
        )
    )


def test_tables_answer_for_their_divisions_alone(call):
    tabled, block, weights = table(), block_with(9), np.empty(9)
    words = caller(CoreMap(block), tabled)
    assert words[COILS] == 6
    assert tabled.weights(INSIDE, weights) == 0
    assert_same(field_of(call, words, INSIDE), superposed(block, weights))
    for currents in (INSIDE + [0.1, 0, 0, 0, 0, 0], 2.0 * INSIDE, np.full(6, np.nan)):
        assert np.isnan(field_of(call, words, currents)[0]).all()


def wrench_of(call, words, currents, place, turn=POSE):
    coils = len(currents)
    numbers = np.empty(words[ROOM])
    numbers[: coils + 12] = [*currents, *place, *turn.ravel()]
    status = call["call_wrench"](words.ctypes.data, numbers.ctypes.data)
    wrench, slopes = np.split(numbers[coils + 12 : coils + 18 + 6 * coils], [6])
    return status, wrench, slopes.reshape(6, coils)


def wrench_of_weights(block, body, points, weights):
    """By the core's own sum over points, which the tests of bodies check."""
    n = len(weights)
    flux, gradient = np.empty((len(points), n, 3)), np.empty((len(points), n, 3, 3))
    CoreMap(block).each_field(points, flux, gradient)
    wrench, slopes = np.empty(6), np.empty((6, n))
    body.wrench_slopes(POSE, weights, (flux, gradient), no_reaction(flux), wrench, slopes)
    return wrench, slopes


def test_wrenches_and_their_slopes_by_currents(call):
    body = CoreBody(DIPOLES, pieces())
    points = POINT + np.array([DIPOLES[0, :3], *(piece.centre for piece in pieces())]) @ POSE.T
    block, model = block_with(3), CASES["fixed"]
    status, *found = wrench_of(call, caller(CoreMap(block), None, body), np.array([1.0, -0.5, 0.2]), POINT)
    assert status == 0
    assert_same(found, wrench_of_weights(block, body, points, np.array([1.0, -0.5, 0.2])))
    # A constant field has no slope by currents.
    status, *found = wrench_of(call, caller(CoreMap(block, constant=True), None, body), CURRENTS, POINT)
    wrench, slopes = wrench_of_weights(block, body, points, np.array([*CURRENTS, 1.0]))
    assert_same(found, (wrench, slopes[:, :2]))

    iron, count = CoreIron(core_numbers(compiled_model(model, checked=True))), 3 + model.field_count + 1
    words, block = caller(CoreMap(block_with(count)), iron.state(), body), block_with(count)
    currents, weights, by_current = np.array([0.4, -0.2, 1.1]), np.empty(count), np.empty((count, 3))
    assert iron.state().solve(currents, weights, by_current, tolerance=1e-8) == 0
    wrench, slopes = wrench_of_weights(block, body, points, weights)
    status, *found = wrench_of(call, words, currents, POINT)
    assert status == 0
    for ours, exact in zip(found, (wrench, slopes @ by_current), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-4 * np.abs(exact).max())
    for wrong in ((currents, POINT + [0.0, 10.0, 0.0]), (np.array([3.0, 0.0, 1.0]), POINT)):
        status, wrench, slopes = wrench_of(call, words, *wrong)
        assert status != 0
        assert np.isnan(wrench).all()
        assert np.isnan(slopes).all()


def test_words_of_another_process_give_not_a_number(call):
    block, _ = block_of("harmonic")
    words = caller(CoreMap(block), None, CoreBody(DIPOLES))
    stale = words.copy()
    stale[:2] = 8, stale[1] + 1
    assert np.isnan(field_of(call, stale, CURRENTS)[0]).all()
    assert np.isnan(field_of(call, stale, None)[0]).all()
    assert wrench_of(call, stale, CURRENTS, POINT)[0] != 0
    assert not words.flags.writeable
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(words)), words)


def test_the_words_keep_alive_what_they_lead_to(call):
    block, _ = block_of("harmonic")
    wanted = superposed(block, CURRENTS)
    words = caller(CoreMap(block.copy()))
    gc.collect()
    filler = [np.full(len(block), np.nan) for _ in range(20)]
    assert_same(field_of(call, words, CURRENTS), wanted)
    assert len(filler) == 20


def test_several_threads_use_one_caller(call):
    block, _ = block_of("harmonic")
    words = caller(CoreMap(block))
    points = GRID.lower + np.random.default_rng(1).random((400, 3)) * (GRID.upper - GRID.lower)
    wanted = [field_of(call, words, CURRENTS, point)[0] for point in points]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda point: field_of(call, words, CURRENTS, point)[0], points))
    np.testing.assert_array_equal(found, wanted)


def test_what_does_not_belong_together_is_refused():
    iron = CoreIron(core_numbers(compiled_model(CASES["fixed"], checked=True)))
    for weights in (iron.state(), table()):
        with pytest.raises(ValueError, match="a field for each weight"):
            caller(CoreMap(block_with(5)), weights)
