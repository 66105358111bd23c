"""Deviations of a result against closed forms, and random devices against the same forms."""

import dataclasses

import numpy as np
import pytest

import fieldmap.interop
import fieldmap.studies
from fieldmap.errors import Infeasible, InputError
from fieldmap.studies import Carrying, Linked, Number, Uncertain, analyse_tolerances
from tests.conftest import DEVICES
from tests.levitation.conftest import slope_on_axis
from tests.refusals import refused
from tests.studies.conftest import SPHERE

LOOP = DEVICES / "thin_loop_with_driver.toml"
DEPTH, RADIUS, TURNS, MASS = 0.06, 0.044, 1000.0, 0.01


def lift_current(turns=TURNS, mass=MASS, radius=RADIUS, depth=DEPTH):
    """The lift current, A, of a dipole of 0.8 A m^2 on the axis of a thin loop, in closed form."""
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


# Number of positive heights -> a seed for which one more random height of 1 +- 1 mm is drawn.
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
    """60 random devices, and the path of their file."""
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
    """Drawn as documented, normally distributed from the seed; each number is the closed form at its draw."""
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
    # First order and samples agree within the uncertainty of 60 samples.
    assert abs(sampled.deviation - kept[0]["common_current"].deviation) < 3 * sampled.deviation_error


def test_a_run_goes_on_with_the_devices_that_it_has(kept):
    first, target = kept
    assert (first.kept, first.solves) == (0, 1 + 2 + 60)  # only the mass uses differences
    more = analysed(64, target)
    assert (more.kept, more.solves) == (63, 4)
    assert more["common_current"].deviation == first["common_current"].deviation


def test_numbers_of_two_sets_and_a_function():
    """The difference of the lift current 10 mm lower: turns change both currents by the same factor."""

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
    """Windings of negative height fail; the other devices count."""
    height = Uncertain("coil.loop.height_mm", 1.0, step=0.1)
    found = analyse_tolerances(LOOP, [height], ["common_current"], currents=CARRIES, samples=12)
    heights = 1.0 + np.random.default_rng(0).standard_normal(12)
    assert 0 < len(found.failed) == np.sum(heights <= 0)
    assert all("height_mm" in why for why in found.failed.values())
    assert found["common_current"].sampled.count == np.sum(heights > 0)


@pytest.mark.parametrize(("seed", "solved"), [(SEEDS[1], 1), (SEEDS[2], 2)])
def test_two_random_devices_must_be_solved(seed, solved):
    """Windings of negative height fail: one of two devices remains, or two of three."""
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


@pytest.mark.parametrize(
    ("samples", "deviation", "step", "fits"),
    [
        (0, 1.0, None, True),
        (1, 1.0, None, False),
        (2, 1.0, None, True),
        (-1, 1.0, None, False),
        (2.0, 1.0, None, False),
        (0, 1e-9, None, True),
        (0, 0.0, None, False),
        (0, -1.0, None, False),
        (0, np.inf, None, False),
        (0, 1.0, 1e-9, True),
        (0, 1.0, 0.0, False),
        (0, 1.0, np.nan, False),
    ],
)
def test_numbers_of_an_analysis(samples, deviation, step, fits):
    """A number that does not exist makes each call fail before a solve."""
    uncertain = [Uncertain("coil.loop.turns", deviation, step=step)]
    with pytest.raises(InputError) as caught:
        analyse_tolerances(LOOP, uncertain, ["no such number"], samples=samples)
    where = [problem.where for problem in caught.value.problems]
    assert (where == ["analyse_tolerances, no such number"]) == fits


def test_statistics_of_samples_are_those_of_the_textbook():
    """For a made-up number: errors of mean and deviation, the 95 % range, and the progress per device."""
    told = []
    grams = Number("grams", of=lambda device, state: 1e3 * device.payload.mass)
    how = {"samples": 12, "seed": 5, "progress": lambda text, share: told.append((text.split(",")[0], share))}
    found = analyse_tolerances(LOOP, [Uncertain("payload.mass_g", 0.5)], [grams], **how)
    values = 10.0 + 0.5 * np.random.default_rng(5).standard_normal(12)
    sampled = found["grams"].sampled
    mean = sum(values) / 12
    deviation = (sum((values - mean) ** 2) / 11) ** 0.5
    assert (sampled.count, sampled.mean, sampled.deviation) == (
        12,
        pytest.approx(mean),
        pytest.approx(deviation),
    )
    assert sampled.mean_error == pytest.approx(deviation / 12**0.5)
    assert sampled.deviation_error == pytest.approx(deviation / 22**0.5)
    ordered = np.sort(values)
    # 2.5 % of the eleven distances between twelve values.
    ends = [ordered[0] + 0.275 * (ordered[1] - ordered[0]), ordered[-1] - 0.275 * (ordered[-1] - ordered[-2])]
    assert sampled.range == pytest.approx(ends)
    assert (found["grams"].value, found["grams"].deviation) == (pytest.approx(10.0), pytest.approx(0.5))
    assert found["grams"].derivatives == {"payload.mass_g": pytest.approx(1.0)}
    assert (found.title, found.deviations, found.failed) == (
        "Tolerances of thin_loop",
        {"payload.mass_g": 0.5},
        {},
    )
    # The design itself, both sides of a difference, and 12 samples: 15 designs.
    assert found.solves == 15
    # Progress comes after each design; after the first, 14 of the same time remain.
    assert [text for text, _ in told] == [f"design {k + 1}" for k in range(15)]
    assert told[0][1] == pytest.approx(1 / 15)
    assert told[-1][1] == 1.0
    with pytest.raises(KeyError):
        found["kilograms"]


def test_a_current_that_is_uncertain_and_a_number_that_moves_to_one_side():
    def own(device, state):
        if device.payload.mass < 0.0099:
            raise ValueError("no number")
        return 7.0 * device.payload.mass

    uncertain = [Uncertain("current.loop", 0.02), Uncertain("payload.mass_g", 0.3, step=1.0)]
    found = analyse_tolerances(LOOP, uncertain, [Number("common_current"), own], currents=2.0)
    assert found["common_current"].value == 2.0
    assert found["common_current"].deviation == pytest.approx(0.02)
    assert found["common_current"].shares == {"current.loop": pytest.approx(1.0), "payload.mass_g": 0.0}
    # The number exists at 11 g, but not at 9 g.
    assert found["own"].derivatives["payload.mass_g"] == pytest.approx(7e-3)
    assert found["own"].deviation == pytest.approx(2.1e-3)
    with refused(InputError, where="analyse_tolerances, payload.mass_g", must_hold="to one side at least"):
        own = Number("own", of=lambda device, state: 1.0 if device.payload.mass == 0.01 else float("nan"))
        analyse_tolerances(LOOP, [Uncertain("payload.mass_g", 0.5)], [own])


@pytest.mark.parametrize("module", [fieldmap.studies, fieldmap.interop])
def test_records_do_not_change(module):
    """All data classes of the public interface are frozen."""
    found = [one for one in map(vars(module).get, module.__all__) if dataclasses.is_dataclass(one)]
    assert len(found) > 2
    assert [one.__name__ for one in found if not one.__dataclass_params__.frozen] == []


def test_differences_that_exact_derivatives_spare_are_not_waited_for():
    """The flux density by turns: one solve and the samples; the progress ends at 1."""
    told = []
    how = {"points": [[0.0, 0.0, -0.014]], "currents": 1.0, "samples": 3, "refinement": 0.5}
    found = analyse_tolerances(
        "loop_and_sphere",
        [Uncertain("coil.loop.turns", 0.5)],
        ["flux_density 1 z"],
        progress=lambda text, share: told.append(share),
        **how,
    )
    assert found.solves == 4 < 1 + 2 + 3
    assert told[-1] == 1.0
