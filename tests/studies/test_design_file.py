"""Study files with [optimise]: how they are read, and all their mistakes at once."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from fieldmap.errors import StudyError
from fieldmap.iron.sensitivity.quantities import FluxDensityAt
from fieldmap.studies import Limit, Linked, Number, Variable, read_design_problem, read_study, solve_problem
from fieldmap.studies.design import number_of
from fieldmap.studies.search import problem_fingerprint
from tests.conftest import DEVICES
from tests.refusals import refused
from tests.studies.conftest import LOOP

GOOD = """
format = 1
title = "Strongest pull of a loop at 8 W"
device = "thin_loop.toml"
currents = [{ name = "given", amperes_A = 1.0 }]
record = { points_mm = [[0.0, 0.0, -60.0]] }

[optimise]
maximise = { number = "gradient 1 z z" }
tolerance = 1e-7
method = "trust-constr"

[[optimise.variable]]
key = "current.loop"
lower = 0.5
upper = 5.0

[[optimise.variable]]
key = "coil.loop.inner_radius_mm"
lower = 30.0
upper = 70.0
start = 40.0
linked = [{ keys = ["coil.loop.outer_radius_mm"], offset = 1.0 }]

[[optimise.constraint]]
number = "common_current"
currents = "given"
upper = 2.0
"""


def test_a_file_becomes_a_problem(devices):
    problem = read_design_problem(devices.study("best.toml", GOOD))
    assert (problem.sign, problem.method, problem.iron.saturating) == (-1.0, "trust-constr", False)
    assert [number.label for number in problem.numbers] == ["gradient 1 z z", "common_current"]
    (current, radius), (limit,) = problem.variables, problem.limits
    assert (current.lower, current.start, current.upper) == (0.5, 1.0, 5.0)
    assert radius.linked == (Linked(("coil.loop.outer_radius_mm",), 1.0, 1.0),)
    assert (limit.lower, limit.upper) == (-np.inf, 2.0)


def test_what_a_file_asks_for(devices, tmp_path):
    """The radius with the strongest gradient 60 mm below a thin loop, and the current at its limit."""
    found = solve_problem(read_design_problem(devices.study("best.toml", GOOD)), tmp_path / "best.nc")
    assert found.values["coil.loop.inner_radius_mm"] == pytest.approx(60 * np.sqrt(2 / 3) - 0.5, abs=0.1)
    assert found.values["current.loop"] == pytest.approx(2.0, rel=1e-3)
    outer, inner = (found.settings[f"coil.loop.{name}_radius_mm"] for name in ("outer", "inner"))
    assert outer == inner + 1.0
    assert found.device.coils[0].outer_radius == pytest.approx(1e-3 * outer)
    assert (tmp_path / "best.csv").is_file()


@pytest.mark.parametrize(
    ("before", "after", "places"),
    [
        ('"gradient 1 z z"', '"gradient 2 z z"', [(9, "optimise.maximise.number")]),
        ('"common_current"', '"largest_flux_density"', [(26, "optimise.constraint.1.number")]),
        ("lower = 0.5", "lower = 6.0", [(15, "optimise.variable.1.lower")]),
        ("start = 40.0", "start = 80.0", [(22, "optimise.variable.2.start")]),
        ('"current.loop"', '"coil.loop.kind"', [(14, "optimise.variable.1.key")]),
        ("upper = 2.0", "", [(25, "optimise.constraint.1")]),
        ('method = "trust-constr"', 'method = "simplex"', [(11, "optimise.method")]),
        ("maximise = {", "minimise = { number = 'power' }\nmaximise = {", [(8, "optimise")]),
        ("amperes_A = 1.0", "amperes_A = [1.0, 2.0]", [(5, "currents.given.amperes_A")]),
        ("-60.0]] }", '-60.0]], quantities = ["field"] }', [(6, "record.quantities")]),
        (
            'key = "current.loop"',
            'key = "coil.loop.turn"\nstep = -1.0',
            [(15, "optimise.variable.1.step")],
        ),
    ],
)
def test_mistakes_and_their_places(devices, before, after, places):
    assert GOOD.count(before) == 1
    with pytest.raises(StudyError) as caught:
        read_design_problem(devices.study("mistake.toml", GOOD.replace(before, after)))
    where = [problem.where.split("mistake.toml:")[1] for problem in caught.value.problems]
    assert where == [f"{line}: {key}" for line, key in places]


def test_all_at_once(devices):
    text = GOOD.replace("gradient 1", "gradient 3").replace('currents = "given"', 'currents = "other"')
    text = text.replace("loop.inner", "loop.middle").replace("lower = 0.5", "lower = -6.0")
    with pytest.raises(StudyError) as caught:
        read_design_problem(devices.study("mistakes.toml", text))
    keys = [problem.where.split(": ")[1] for problem in caught.value.problems]
    assert keys == ["optimise.maximise.number", "optimise.variable.2.key", "optimise.constraint.1.currents"]


def test_each_reader_names_the_other(devices, grid):
    with refused(StudyError, remedy="fieldmap optimise"):
        read_study(devices.study("best.toml", GOOD))
    with refused(StudyError, remedy="fieldmap study"):
        read_design_problem(grid)


def test_violations_and_scales_of_limits():
    both = Limit("power", -3.0, 2.0)
    assert [both.violation(value) for value in (-4.5, -3.0, 0.5, 2.0, 2.25)] == [1.5, 0.0, 0.0, 0.0, 0.25]
    assert [Limit("power", upper=2.0).violation(value) for value in (-9.0, 3.0)] == [0.0, 1.0]
    limits = (
        both,
        Limit("power", upper=2.0),
        Limit("power", lower=-0.5),
        Limit("power", 0.0),
        Limit("power", 0.0, 0.25),
    )
    assert [limit.scale for limit in limits] == [3.0, 2.0, 0.5, 1.0, 0.25]


def test_steps_of_variables():
    """A fiftieth of the range unless given; for a key of the device or the current of coils."""
    assert Variable("coil.a.turns", 10.0, 60.0).difference == pytest.approx(1.0)
    assert Variable("coil.a.turns", 10.0, 60.0, step=0.25).difference == 0.25
    assert [Variable(key, 0.0, 1.0).is_current for key in ("current.a", "coil.current.turns")] == [
        True,
        False,
    ]
    linked = (Linked(("b", "c"), 2.0, 1.0),)
    assert Variable("a", 0.0, 1.0, linked=linked).settings(3.0) == (("a", 3.0), ("b", 7.0), ("c", 7.0))
    assert Variable("current.a", 0.0, 1.0).settings(3.0) == ()


def test_numbers_have_labels_and_parts():
    one = Number("power", "low", minus="high")
    assert [(sign, part.label) for sign, part in one.parts] == [(1.0, "power, low"), (-1.0, "power, high")]
    assert [(sign, part.label) for sign, part in Number("power").parts] == [(1.0, "power")]

    def stroke(device, state):
        return 0.0

    flux = FluxDensityAt([0.0, 0.0, 0.0])
    named = [number_of(given) for given in (one, "power", stroke, flux, functools.partial(stroke, None))]
    assert [number.name for number in named] == ["power", "power", "stroke", "FluxDensityAt", "function"]
    assert [number.of for number in named[:4]] == [None, None, stroke, flux]


TWO = """format = 1
title = "Two coils"
device = "pair.toml"
record = { points_mm = [[0.0, 0.0, 0.0]] }
currents = [{ name = "unequal", amperes_A = [3.0, -1.0] }, { name = "same", amperes_A = 2.0 }]

[optimise]
minimise = { number = "power", currents = "same", minus = "unequal" }

[[optimise.variable]]
key = "current.lower"
lower = -2.0
upper = 2.0
"""


def test_currents_that_vary(devices):
    """The variable applies to each set with given currents; other coils keep theirs; the start is the first set's."""
    (devices.folder / "pair.toml").write_text((DEVICES / "pair.toml").read_text())
    problem = read_design_problem(devices.study("two.toml", TWO))
    assert (problem.starts.tolist(), problem.keys, problem.sign) == ([-1.0], ("current.lower",), 1.0)
    assert problem.objective.label == "power, same - unequal"
    unequal, same = problem.currents_at(np.array([1.0]))
    assert (unequal.name, unequal.common, unequal.shares.tolist()) == ("unequal", 2.0, [1.5, 0.5])
    assert (same.name, same.common) == ("same", 1.5)
    np.testing.assert_allclose(same.common * same.shares, [2.0, 1.0])
    text = TWO.replace("current.lower", "current.*").replace("upper = 2.0", "upper = 4.0")
    problem = read_design_problem(devices.study("two.toml", text))
    assert problem.starts.tolist() == [3.0]
    for value, common in ((0.5, 0.5), (0.0, 0.0)):
        for entry in problem.currents_at(np.array([value])):
            assert entry.common == common
            np.testing.assert_allclose(common * entry.shares, [value, value])
    # A key of the device starts at the device's value.
    text = (
        TWO.replace('"current.lower"', '"coil.lower.turns"')
        .replace("-2.0", "100.0")
        .replace("= 2.0\n", "= 300.0\n")
    )
    problem = read_design_problem(devices.study("two.toml", text))
    assert problem.starts.tolist() == [200.0]
    assert problem.document_at(np.array([150.0])).data["coil"][1]["turns"] == 150.0
    assert problem.values({"coil.lower.turns": 7.0}).tolist() == [7.0]
    assert problem.named(np.array([9.0])) == {"coil.lower.turns": 9.0}


@pytest.mark.parametrize(
    ("before", "after", "places"),
    [
        ('minimise = { number = "power", currents = "same", minus = "unequal" }', "", [":7: optimise"]),
        ('minus = "unequal"', 'minus = "other"', [":8: optimise.minimise.minus"]),
        ('currents = "same", ', "", [":8: optimise.minimise.currents"]),
        ("current.lower", "current.middle", [":11: optimise.variable.1.key"]),
        ("upper = 2.0", "upper = -2.0", [":12: optimise.variable.1.lower"]),
        ("upper = 2.0", "upper = -1.5", [":10: optimise.variable.1.start"]),
        ("lower = -2.0", "lower = -1.0", []),
        ("lower = -2.0", "lower = -0.999", [":10: optimise.variable.1.start"]),
        ("upper = 2.0", "upper = -1.0", []),
        ("[optimise]\n", "[optimise]\ncheck_refinement = 10.0\n", []),
        ("[optimise]\n", "[optimise]\ncheck_refinement = 10.1\n", [":8: optimise.check_refinement"]),
        ("[optimise]\n", "[optimise]\ncheck_refinement = 1.0\n", [":8: optimise.check_refinement"]),
        ("[optimise]\n", "iron = { accuracy = 0.01 }\n[optimise]\n", [":7: iron.accuracy"]),
        ("amperes_A = 2.0", "carries_at_mm = [0, 0, 0]", [":5: currents.same.carries_at_mm"]),
        ("amperes_A = [3.0, -1.0]", "carries_at_mm = [0, 0, 0]", [":5: currents.unequal.carries_at_mm"]),
    ],
)
def test_mistakes_of_two_sets(devices, before, after, places):
    (devices.folder / "pair.toml").write_text((DEVICES / "pair.toml").read_text())
    assert TWO.count(before) == 1
    path = devices.study("mistake.toml", TWO.replace(before, after))
    try:
        read_design_problem(path)
        found = []
    except StudyError as error:
        found = [problem.where.removeprefix(str(path)) for problem in error.problems]
    assert found == places


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("lower = 0.5", "lower = 0.6", True),
        ("start = 40.0", "start = 41.0", True),
        ("tolerance = 1e-7", "tolerance = 1e-6\nsolves = 9\nseed = 3\ncheck_refinement = 2.0", True),
        ('method = "trust-constr"', 'method = "COBYQA"', True),
        ("upper = 2.0", "upper = 2.5", True),
        ("maximise = {", "minimise = {", True),
        ("[optimise]", "iron = { refinement = 0.7 }\n[optimise]", True),
        ("[optimise]", "iron = { mu_r = 100.0 }\n[optimise]", False),
        ("offset = 1.0", "offset = 1.5", False),
        ("amperes_A = 1.0", "amperes_A = 1.5", False),
        ("-60.0", "-61.0", False),
        ('"gradient 1 z z"', '"gradient 1 z x"', False),
        ("-60.0]] }", "-60.0]], force_share = 0.02 }", False),
        ("-60.0]] }", "-60.0]], current_limit_A = 2.0 }", False),
        ("-60.0]] }", "-60.0]], box_mm = [[0, 0, -60], [1, 1, -59]] }", False),
    ],
)
def test_designs_of_an_earlier_search_are_taken_where_their_numbers_are_the_same(
    devices, before, after, same
):
    """Bounds, starts, methods, limits and the mesh do not change the fingerprint; each design records its mesh."""
    assert GOOD.count(before) == 1
    one, other = (
        read_design_problem(devices.study("good.toml", text)) for text in (GOOD, GOOD.replace(before, after))
    )
    assert (problem_fingerprint(one) == problem_fingerprint(other)) == same


def test_every_key_that_follows_counts(devices):
    """In a list of any length."""
    keys = [f'"coil.loop.position_mm.{1 + k % 3}"' for k in range(9)]
    found = set()
    for last in keys[:3]:
        listed = ", ".join(['"coil.loop.outer_radius_mm"', *keys, last])
        text = GOOD.replace('keys = ["coil.loop.outer_radius_mm"]', f"keys = [{listed}]")
        found.add(problem_fingerprint(read_design_problem(devices.study("many.toml", text))))
    assert len(found) == 3


def test_designs_of_another_device_or_function_are_not_taken(devices):
    problem = read_design_problem(devices.study("good.toml", GOOD))
    devices.loop.write_text(LOOP.replace("height_mm = 1.0", "height_mm = 1.5"))
    try:
        other = read_design_problem(devices.study("good.toml", GOOD))
    finally:
        devices.loop.write_text(LOOP)
    assert problem_fingerprint(problem) != problem_fingerprint(other)

    def mine(device, state):
        return 0.0

    def other(device, state):
        return 0.0

    numbers = [
        problem_fingerprint(replace(problem, besides=(Number("own", of=one),))) for one in (mine, mine, other)
    ]
    assert (numbers[0] == numbers[1], numbers[0] == numbers[2]) == (True, False)
