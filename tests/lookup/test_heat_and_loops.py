"""Maps of iron with hysteresis: their heat against the energy of the coils, Madelung's rules, slopes of loops.

The map is made up: six coils, twelve points of iron with five play cells each; the fields turn in space.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.interpolate import PPoly

from fieldmap.errors import InputError, OutsideMapError
from fieldmap.lookup import current_model, interpolate
from tests.dynamics.conftest import saturating_data

DATA = saturating_data(free=True)
MODEL = DATA.reduced_model
PINNING, SHARES = np.linspace(0.0, 0.02, 5), np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / 4.0
POINTS, CELLS = len(MODEL.weights), len(SHARES)
PLACES = np.array([[0.0, 0.0, 0.0], [5e-3, -8e-3, 4e-3], [-0.01, 2e-3, -7e-3]])
# b(h) of the table, and the integral of J = b - h.
LAW = PPoly(MODEL.law_coefficients.T, np.append(MODEL.law_knots, 1e3))
POTENTIAL = LAW.antiderivative()


def map_of(pinning=PINNING, outside="raise", **changes):
    model = replace(MODEL, pinning=pinning[None], shares=SHARES, **changes)
    return interpolate(replace(DATA, reduced_model=model), outside_currents=outside)


@pytest.fixture(scope="module")
def m():
    return map_of()


@pytest.fixture(scope="module")
def plain():
    return interpolate(DATA)


def energies(memories):
    """Flux linkages that the iron adds (n, 6), Wb, and energies of iron and air (n,), J, of memories."""
    numbers = np.array([memory.remembered[-4 * POINTS * CELLS :] for memory in memories])
    r = numbers.reshape(-1, POINTS, CELLS, 4)[..., :3]
    size = np.linalg.norm(r, axis=-1)
    j = LAW(size) - size
    stored = size * j - (POTENTIAL(size) - size**2 / 2.0)
    with np.errstate(invalid="ignore"):
        turned = np.where(size[..., None] > 0.0, j[..., None] / size[..., None] * r, 0.0)
    moments = MODEL.weights[:, None] * np.einsum("npkd,k->npd", turned, SHARES)
    flat = moments.reshape(len(numbers), -1)
    # The projected equation: A a = G^T w J.
    right = flat @ MODEL.gradients.astype(np.float32).astype(float)
    amplitudes = np.linalg.solve(MODEL.air, right.T).T
    energy = np.einsum("npk,p,k->n", stored, MODEL.weights, SHARES) + 0.5 * np.sum(right * amplitudes, axis=1)
    return flat @ MODEL.source / mu_0, energy / mu_0


def led(memory, path):
    """Memories at the ends of steps to currents (n, 6)."""
    found = []
    for currents in path:
        memory = memory.step(currents)
        found.append(memory)
    return found


def delivered(currents, memories):
    """Energy, J, that the coils deliver to the iron along currents (n, 6): the area against the linkages, by the
    trapezoidal rule."""
    middle = 0.5 * (currents[1:] + currents[:-1])
    return np.sum(middle * np.diff(energies(memories)[0], axis=0))


def cycle(count):
    """Currents of a closed cycle in which no two coils move together."""
    turn = 2.0 * np.pi * np.arange(count + 1)[:, None] / count
    waves = np.sin(turn * [1, 1, 1, 2, 1, 1] + np.arange(6.0))
    return 1.0 + waves * [1.0, 0.7, 0.4, 0.5, 1.0, 0.8]


def test_over_a_closed_cycle_the_coils_deliver_the_heat(m):
    """In space a cycle closes after some turns; each turn reduces the gap by a third. The trapezoidal rule is
    of second order, and extrapolation removes its error."""
    shares, errors = [], []
    for count in (400, 800):
        path = cycle(count)
        begin = led(led(m, np.tile(cycle(200)[1:], (14, 1)))[-1], np.tile(path[1:], (4, 1)))[-1]
        memories = [begin, *led(begin, path[1:])]
        heat = memories[-1].dissipated - begin.dissipated
        energy = energies(memories)[1]
        shares.append(np.ptp(energy) / heat)
        errors.append(delivered(path, memories) / heat - 1.0)
    # The iron stores and gives back more in a turn than the heat.
    assert min(shares) > 1.0
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert abs(4.0 * errors[1] - errors[0]) / 3.0 < 1e-6


def test_along_any_path_the_coils_deliver_what_is_stored_and_the_heat(m):
    turns, left = np.random.default_rng(8).uniform(-2.0, 2.5, (6, 6)), []
    for parts in (100, 200):
        share = np.arange(1, parts + 1)[:, None] / parts
        path = np.vstack([a + share * (b - a) for a, b in pairwise(turns)])
        begin = m.step(turns[0])
        memories = [begin, *led(begin, path)]
        heat, energy = memories[-1].dissipated - begin.dissipated, energies([begin, memories[-1]])[1]
        left.append(delivered(np.vstack([turns[:1], path]), memories) - np.diff(energy)[0] - heat)
    assert abs(np.diff(energy)[0]) > 0.05 * heat
    assert abs(4.0 * left[1] - left[0]) / 3.0 < 2e-6 * heat


def test_a_thousand_paths_of_random_steps_obey_the_second_law(m):
    """Each step is a minimum: stored energy plus heat lies between the energies that the old currents and the new
    currents would deliver."""
    random = np.random.default_rng(3)
    for _ in range(1000):
        size = 10.0 ** random.uniform(-3.0, 0.5, (5, 1))
        path = np.clip(1.0 + np.cumsum(size * random.standard_normal((5, 6)), axis=0), -3.0, 3.0)
        memories = [m, *led(m, path)]
        linkage, energy = energies(memories)
        heat = np.diff([memory.dissipated for memory in memories])
        assert np.all(heat >= 0.0)
        currents = np.vstack([m.last_currents, path])
        change, spent = np.diff(linkage, axis=0), np.diff(energy) + heat
        least, most = np.sum(currents[:-1] * change, axis=1), np.sum(currents[1:] * change, axis=1)
        rounding = 1e-7 * np.abs(energy).max()
        assert np.all(least - rounding <= spent)
        assert np.all(spent <= most + rounding)


@pytest.fixture(scope="module")
def on_one_axis():
    """The map with all fields in the iron along one axis, which all currents drive alike."""
    along = np.tile([1.0, 0.0, 0.0], POINTS)[:, None]
    return map_of(source=0.06 * np.abs(MODEL.source) * along, gradients=0.1 * MODEL.gradients * along)


def fields(memories, currents):
    pairs = zip(memories, currents, strict=True)
    return np.array([memory.field(PLACES, np.full(6, level)) for memory, level in pairs])


def stepped(memory, levels):
    """Memories after steps of all currents to levels, A."""
    return led(memory, np.array(levels)[:, None] * np.ones(6))


def test_on_one_axis_turns_are_remembered_and_ways_divide(on_one_axis):
    """Madelung's rules for memories of a map: they are exact where fields do not turn."""
    demagnetised = on_one_axis.memory("demagnetised")
    levels = [2.0, 0.3, 1.4, 0.8, 1.4, 0.3, 2.0]
    memories = stepped(demagnetised, levels)
    found, branch = fields(memories, levels), fields(stepped(demagnetised, [0.8]), [0.8])[0]
    size = np.abs(found).max()
    assert np.abs(found[3] - branch).max() > 0.01 * size
    # Inner loops close and are wiped out: later steps do not depend on them.
    for first, again in ((2, 4), (1, 5), (0, 6)):
        np.testing.assert_allclose(found[again], found[first], rtol=0.0, atol=1e-8 * size)
    on = [2.5, 1.1]
    np.testing.assert_allclose(
        fields(stepped(memories[-1], on), on), fields(stepped(memories[0], on), on), atol=1e-8 * size
    )
    # A straight path has the same field and heat in one step and in many.
    for parts in (2, 7, 40):
        divided = stepped(memories[1], np.linspace(0.3, 1.4, parts + 1)[1:])[-1]
        np.testing.assert_allclose(
            fields([divided], [1.4])[0], found[2], rtol=0.0, atol=1e-8 * size, err_msg=str(parts)
        )
        assert divided.dissipated == pytest.approx(memories[2].dissipated, rel=1e-7)
    # The second round costs as much heat as the first.
    heat = np.diff([memory.dissipated for memory in stepped(memories[3], [1.4, 0.8, 1.4, 0.8, 1.4])])
    np.testing.assert_allclose(heat[2:], heat[:2], rtol=1e-6)


def test_in_space_what_the_division_of_a_way_changes_vanishes_with_the_steps(m):
    """The drag follows the path: the difference is of first order in the steps."""
    here, there = np.array([2.0, -1.0, 0.5, 1.0, -2.0, 0.3]), np.array([-1.5, 1.0, 2.5, -0.5, 1.0, 2.0])
    begin = m.step(here)

    def after(parts):
        way = here + np.arange(1, parts + 1)[:, None] / parts * (there - here)
        return led(begin, way)[-1].field(PLACES, there)

    found = [after(parts) for parts in (1, 8, 16, 32, 256)]
    off = [np.abs(one - found[-1]).max() / np.abs(found[-1]).max() for one in found[:-1]]
    assert off[0] < 0.03
    assert np.all(np.divide(off[1:-1], off[2:]) > 1.7)


def test_nothing_is_remembered_of_a_way_back_that_was_asked_for_only(m):
    asked = m.step(2.0)
    before = asked.dissipated
    asked.field(PLACES, 0.0)
    assert asked.dissipated == before
    assert m.recalled(asked.remembered).dissipated == before
    # A step to the present currents changes nothing, also for a memory that was stored.
    for memory in (asked, m.recalled(asked.remembered)):
        again = memory.step(2.0)
        assert again.dissipated == before
        np.testing.assert_allclose(again.field(PLACES, 1.0), asked.field(PLACES, 1.0), atol=1e-15)
    assert m.memory("demagnetised").dissipated == 0.0


@pytest.fixture
def closely(monkeypatch):
    """Lookups are solved to the last digits."""
    monkeypatch.setattr(current_model, "_OF_LOOKUPS", 1e-12)


def test_without_pinning_a_map_is_that_of_iron_without_cells(closely, plain):
    without = map_of(0.0 * PINNING)
    random, memory = np.random.default_rng(1), without
    for currents in random.uniform(-3.0, 3.0, (20, 6)):
        memory = memory.step(currents)
        for ours, expected in zip(
            memory.by_currents(PLACES, currents), plain.by_currents(PLACES, currents), strict=True
        ):
            # Tangents are summed in single precision.
            np.testing.assert_allclose(ours, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())
        for ours, expected in zip(
            memory.field_and_gradient(PLACES, currents),
            plain.field_and_gradient(PLACES, currents),
            strict=True,
        ):
            np.testing.assert_allclose(ours, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
    assert memory.dissipated == 0.0


def test_the_reversible_slope_is_that_of_a_way_back(closely, on_one_axis):
    """At the present currents, cells at the end of their play stay when the currents turn back, and move when the
    currents go on."""
    memory, apart = on_one_axis.memory("demagnetised"), []
    for level in (1.0, 0.3, -0.6, 0.4, 1.5):
        step = np.full(6, 1e-5 * np.sign(level - memory.last_currents[0]))
        memory = memory.step(level)
        here = memory.last_currents
        at, before, behind = (memory.field(PLACES, here + turn * step) for turn in (0.0, -1.0, 1.0))
        found = np.einsum("pnd,n->pd", memory.by_currents(PLACES, here)[2], step)
        size = np.abs(found).max()
        np.testing.assert_allclose(found, at - before, rtol=0.0, atol=1e-4 * size)
        apart.append(np.abs(behind - 2.0 * at + before).max() / size)
    assert min(apart) > 0.02


def by_hand(memory, currents, swing):
    """Flux density and gradient at the places per unit swing of the currents, on the second of two loops."""
    memory = memory.step(currents).step(currents + swing).step(currents - swing).step(currents + swing)
    ends = [memory.field_and_gradient(PLACES, currents + swing)]
    memory = memory.step(currents - swing)
    ends.append(memory.field_and_gradient(PLACES, currents - swing))
    return [0.5 * (plus - minus) for plus, minus in zip(*ends, strict=True)]


@pytest.mark.parametrize("loop", [0.02, 0.5])
def test_slopes_of_loops_are_those_between_the_ends_of_the_second_loop(closely, m, loop):
    memory, at = m.step([2.0, -1.0, 0.5, 1.0, -2.0, 0.3]), np.array([1.0, 0.4, -0.3, 1.2, 0.8, -1.0])
    flux, slope, by_flux, by_slope = memory.by_currents(PLACES, at, loop=loop)
    here = memory.field_and_gradient(PLACES, at)
    np.testing.assert_allclose(flux, here[0], atol=1e-9)
    np.testing.assert_allclose(slope, here[1], atol=1e-9)
    for k, swing in enumerate(loop * np.eye(6)):
        of_flux, of_slope = by_hand(memory, at, swing)
        np.testing.assert_allclose(loop * by_flux[:, k], of_flux, atol=1e-8 * np.abs(flux).max())
        np.testing.assert_allclose(loop * by_slope[:, k], of_slope, atol=1e-8 * np.abs(slope).max())
    matrix = memory.actuation(PLACES[1], at, loop=loop).matrix
    np.testing.assert_allclose(matrix[:3], by_flux[1].T, atol=1e-12)
    looped = memory.after_loop(at, loop * np.eye(6)[2])
    np.testing.assert_array_equal(looped.last_currents, at + loop * np.eye(6)[2])
    ends = [looped.field(PLACES, at + turn * loop * np.eye(6)[2]) for turn in (1.0, -1.0)]
    np.testing.assert_allclose((ends[0] - ends[1]) / (2.0 * loop), by_flux[:, 2], atol=1e-8)
    small = memory.by_currents(PLACES, at, loop=1e-3)[2]
    assert np.abs(by_flux - small).max() > (0.002 if loop < 0.1 else 0.02) * np.abs(small).max()


def test_small_loops_have_the_reversible_slope_and_iron_without_cells_its_derivative(closely, m, plain):
    stepped_far = m.step([2.0, -1.0, 0.5, 1.0, -2.0, 0.3])
    for memory, sizes, bound in ((m, (0.04, 4e-3, 4e-4), 2e-6), (stepped_far, (4e-3, 4e-4, 4e-5), 3e-3)):
        here = memory.last_currents
        reversible = memory.by_currents(PLACES, here)[2]
        off = [np.abs(memory.by_currents(PLACES, here, loop=a)[2] - reversible).max() for a in (0.4, *sizes)]
        size = np.abs(reversible).max()
        assert off[0] > 0.1 * size
        # After a large step the twelve points still move each other's cells in the second loop, even a small one.
        assert off[-1] < bound * size
        if memory is m:
            np.testing.assert_allclose(np.divide(off[1:-1], off[2:]), 10.0, rtol=0.6)
    # The derivative is known to single precision.
    exact = plain.by_currents(PLACES, here)[2]
    left = [np.abs(plain.by_currents(PLACES, here, loop=a)[2] - exact).max() for a in (0.4, 0.2, 0.1)]
    np.testing.assert_allclose(np.log2(np.divide(left[:-1], left[1:])), 2.0, atol=0.25)


def test_loops_swing_the_signals_of_a_map():
    """A map over a division: the currents of one signal swing together, up to the size of the loop. Across them no path
    of the map leads, and slopes are the reversible ones."""
    data = saturating_data()
    cells = {"pinning": 0.1 * PINNING[None], "shares": SHARES}
    m = interpolate(
        replace(data, reduced_model=replace(data.reduced_model, **cells)), outside_currents="evaluate"
    )
    of, loop = m.parametrisation, 0.2
    at = of.currents([1.6, 0.1, -0.05])
    memory = m.memory("shaken", at)
    by_flux = memory.by_currents(PLACES, at, loop=loop)[2]
    directions = of.derivative([1.6, 0.1, -0.05])
    for direction in directions.T:
        swing = loop * direction / np.abs(direction).max()
        along = np.einsum("pnd,n->pd", by_flux, swing)
        np.testing.assert_allclose(along, by_hand(memory, at, swing)[0], atol=1e-6 * np.abs(along).max())
    across = np.linalg.svd(directions.T)[2][3:]
    reversible = memory.by_currents(PLACES, at)[2]
    np.testing.assert_allclose(across @ by_flux, across @ reversible, atol=1e-6 * np.abs(reversible).max())
    assert np.abs(by_flux - reversible).max() > 0.01 * np.abs(reversible).max()


@pytest.mark.parametrize("loop", [0.0, -0.1, np.nan])
def test_a_loop_has_a_size(m, loop):
    for ask in (
        lambda: m.by_currents(PLACES, 1.0, loop=loop),
        lambda: m.actuation(PLACES[0], 1.0, loop=loop),
    ):
        with pytest.raises(InputError):
            ask()


def test_loops_stay_in_the_domain(m, plain):
    for one in (m, plain):
        assert np.isfinite(one.by_currents(PLACES, 2.9, loop=0.1 - 1e-9)[2]).all()
        with pytest.raises(OutsideMapError):
            one.by_currents(PLACES, 2.9, loop=0.11)
    free = map_of(outside="evaluate")
    assert np.isfinite(free.by_currents(PLACES, 2.9, loop=0.11)[2]).all()


def test_no_field_without_memory_has_heat(plain):
    with pytest.raises(InputError):
        print(plain.dissipated)
    assert plain.after_loop(1.0, np.full(6, 0.1)) is plain
