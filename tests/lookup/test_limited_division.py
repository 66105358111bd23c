"""Currents of a division whose signals a map holds, but of which one coil's is beyond the limit of the division."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import CurrentDomain, LiftAndDirections
from fieldmap.lookup.current_model import CurrentModel

DIVISION = LiftAndDirections(n=1.25, limit=2.0)
DOMAIN = CurrentDomain(DIVISION, np.array([0.5, -0.4, -0.4]), np.array([2.0, 0.4, 0.4]))


def problem_of(signals):
    model = CurrentModel.__new__(CurrentModel)
    model.model, model._names = SimpleNamespace(domain=DOMAIN), tuple("123456")
    return model._outside_domain(DIVISION.currents(signals))


def test_a_coil_within_the_limit_is_not_told():
    assert problem_of([1.0, 0.3, 0.3]) is None
    # 1.3 times 1.3 times this is the limit.
    assert problem_of([2.0 / 1.69, 0.3, 0.3]) is None


def test_a_coil_beyond_the_limit_is_named_with_the_limit():
    problem = problem_of([1.5, 0.3, 0.3])
    # Most has the coil at positive x and y, the last of its row.
    assert problem.where == "current of coil 6"
    assert float(problem.received.split()[0]) == pytest.approx(1.5 * 1.3 * 1.3, rel=1e-5)
    assert " 2 A" in problem.must_hold
