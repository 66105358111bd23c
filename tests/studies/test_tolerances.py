"""Deviations of a result against closed forms, and random devices against them."""

import numpy as np
import pytest

from fieldmap.errors import Infeasible, InputError
from fieldmap.studies import Carrying, Linked, Number, Uncertain, analyse_tolerances
from tests.conftest import DEVICES
from tests.levitation.conftest import slope_on_axis
from tests.refusals import refused
from tests.studies.conftest import SPHERE

LOOP = DEVICES / "thin_loop_with_driver.toml"
DEPTH, RADIUS, TURNS, MASS = 0.06, 0.044, 1000.0, 0.01


def lift_current(turns=TURNS, mass=MASS, radius=RADIUS, depth=DEPTH):
    """A, in closed form: a dipole of 0.8 A m^2 on the axis of a thin loop."""
    return 9.80665 * mass / (0.8 * slope_on_axis(-depth, radius, turns))


# Key -> standard deviation, and the argument of the closed form with its scale.
NUMBERS = {
    "coil.loop.turns": (10.0, "turns", 1.0),
    "payload.mass_g": (0.2, "mass", 1e-3),
    "coil.loop.position_mm.3": (0.5, "depth", 1e-3),
    "coil.loop.inner_radius_mm": (0.8, "radius", 1e-3),
}
AT = {"turns": TURNS, "mass": MASS, "radius": RADIUS, "depth": DEPTH}
UNCERTAIN = [
    Uncertain(key, deviation, (Linked(("coil.loop.outer_radius_mm",), 1.0, 1.0),) if "radius" in key else ())
    for key, (deviation, _, _) in NUMBERS.items()
]


def first_order():
    """Contributions to the deviation of the lift current by key, A, from differences of the closed form."""
    found = {}
    for key, (deviation, name, scale) in NUMBERS.items():
        step = 1e-4 * AT[name]
        ahead, behind = (lift_current(**{name: AT[name] + side * step}) for side in (1, -1))
        found[key] = abs(ahead - behind) / (2 * step) * scale * deviation
    return found


# By how many of one more random windings of height 1 +- 1 mm can be made.
SEEDS = {
    good: next(
        k for k in range(99) if (np.random.default_rng(k).standard_normal(good + 1) > -1).sum() == good
    )
    for good in (1, 2)
}
CARRIES = Carrying([0, 0, -DEPTH])


def analysed(samples, output):
    """The lift current of the loop."""
    how = {"currents": CARRIES, "seed": 3, "output": output}
    return analyse_tolerances(LOOP, UNCERTAIN, ["common_current"], samples=samples, **how)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """60 random devices, and where they are kept."""
    target = tmp_path_factory.mktemp("tolerances") / "loop.nc"
    return analysed(60, target), target


def test_deviation_and_shares_to_first_order(kept):
    found = kept[0]["common_current"]
    parts = first_order()
    deviation = np.sqrt(sum(part**2 for part in parts.values()))
    assert found.value == pytest.approx(lift_current(), rel=1e-3)
    assert found.deviation == pytest.approx(deviation, rel=2e-3)
    shares = {key: (part / deviation) ** 2 for key, part in parts.items()}
    assert found.shares == pytest.approx(shares, abs=2e-3)
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert found.kinds == {key: "differences" if "mass" in key else "exact" for key in NUMBERS}
    assert set(kept[0].refused) == {"payload.mass_g"}


def test_random_devices_are_those_of_the_closed_form(kept):
    """Drawn as documented, normally distributed from the seed, each is the closed form at its numbers."""
    draws = np.random.default_rng(3).standard_normal((60, len(NUMBERS)))
    changes = {
        name: AT[name] + scale * deviation * column
        for (deviation, name, scale), column in zip(NUMBERS.values(), draws.T, strict=True)
    }
    expected = lift_current(**changes)
    sampled = kept[0]["common_current"].sampled
    assert sampled.count == 60
    assert sampled.mean == pytest.approx(expected.mean(), rel=1e-3)
    assert sampled.deviation == pytest.approx(expected.std(ddof=1), rel=2e-3)
    assert sampled.range == pytest.approx(np.quantile(expected, [0.025, 0.975]), rel=1e-3)
    assert sampled.mean_error == pytest.approx(sampled.deviation / np.sqrt(60))
    # First order and samples agree within what 60 of them can tell.
    assert abs(sampled.deviation - kept[0]["common_current"].deviation) < 3 * sampled.deviation_error


def test_a_run_goes_on_with_the_devices_that_it_has(kept):
    first, target = kept
    assert (first.kept, first.solves) == (0, 1 + 2 + 60)  # the mass alone is differenced
    more = analysed(64, target)
    assert (more.kept, more.solves) == (63, 4)
    assert more["common_current"].deviation == first["common_current"].deviation


def test_numbers_of_two_sets_and_a_function():
    """How much more current it takes 10 mm lower: turns move both alike."""

    def payload_share(device, state):
        return device.payload.mass * 1e3

    uncertain = [Uncertain("coil.loop.turns", 10.0), Uncertain("payload.mass_g", 0.2)]
    numbers = [Number("common_current", "low", minus="high"), Number("grams", "low", of=payload_share)]
    sets = {"high": CARRIES, "low": Carrying([0, 0, -DEPTH - 0.01])}
    found = analyse_tolerances(LOOP, uncertain, numbers, currents=sets)
    more, grams = found.numbers
    value = lift_current(depth=DEPTH + 0.01) - lift_current()
    assert more.value == pytest.approx(value, rel=2e-3)
    assert more.derivatives["coil.loop.turns"] == pytest.approx(-value / TURNS, rel=2e-3)
    assert more.derivatives["payload.mass_g"] == pytest.approx(value / 10.0, rel=2e-3)
    assert grams.deviation == pytest.approx(0.2)
    assert grams.shares == {"coil.loop.turns": 0.0, "payload.mass_g": pytest.approx(1.0)}
    assert grams.sampled is None


def test_random_devices_that_fail_are_recorded():
    """Windings of negative height; the rest counts."""
    height = Uncertain("coil.loop.height_mm", 1.0, step=0.1)
    found = analyse_tolerances(LOOP, [height], ["common_current"], currents=CARRIES, samples=12)
    heights = 1.0 + np.random.default_rng(0).standard_normal(12)
    assert 0 < len(found.failed) == np.sum(heights <= 0)
    assert all("height_mm" in why for why in found.failed.values())
    assert found["common_current"].sampled.count == np.sum(heights > 0)


@pytest.mark.parametrize(("seed", "solved"), [(SEEDS[1], 1), (SEEDS[2], 2)])
def test_two_random_devices_must_be_solved(seed, solved):
    """Windings of negative height cannot be made: of two or three devices one is left, or two."""
    height, samples = Uncertain("coil.loop.height_mm", 1.0, step=0.1), 1 + solved
    how = {"currents": CARRIES, "samples": samples, "seed": seed}
    if solved == 1:
        with refused(Infeasible, where="analyse_tolerances", must_hold="two"):
            analyse_tolerances(LOOP, [height], ["common_current"], **how)
        return
    found = analyse_tolerances(LOOP, [height], ["common_current"], **how)
    assert (found["common_current"].sampled.count, len(found.failed)) == (2, 1)


def test_a_device_that_cannot_be_solved():
    text, turns = SPHERE.replace("radius_mm = 10.0", "radius_mm = 12.3"), Uncertain("coil.loop.turns", 1.0)
    with pytest.raises(InputError) as caught:
        analyse_tolerances(text, [turns], ["flux_density 1 z"], points=[[0, 0, -0.02]], saturating=False)
    assert "GeometryError" in caught.value.problems[0].received


def test_all_mistakes_at_once():
    wrong = {"coil.loop.turn": 1.0, "coil.loop.turns": -1.0, "coil.loop.kind": 1.0}
    uncertain = [Uncertain(key, deviation) for key, deviation in wrong.items()]
    for *asked, samples, places in (
        (uncertain, [], 1, {"(numbers)", "(samples)", *(f", {key}" for key in wrong)}),
        ([Uncertain("current.coil", 1.0)], ["areas", "powers"], 0, {", current.coil", ", areas", ", powers"}),
    ):
        with pytest.raises(InputError) as caught:
            analyse_tolerances(LOOP, *asked, samples=samples)
        where = [problem.where.removeprefix("analyse_tolerances") for problem in caught.value.problems]
        assert set(where) == places
        assert len(where) == len(places)
