"""Study files with [optimise]: what they become, and all their mistakes at once."""

import numpy as np
import pytest

from fieldmap.errors import StudyError
from fieldmap.studies import Linked, read_design_problem, read_study, solve_problem
from tests.refusals import refused

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
    """The radius of the strongest gradient 60 mm below a thin loop, and the current at its limit."""
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
