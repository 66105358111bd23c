"""Continuation in the currents where Newton's method alone fails."""

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.device.model import BHTable, Body, CircularCoil, Cylinder, Device, Froehlich, Part, Placement
from fieldmap.errors import NotConverged
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.elements import potential_form

CURRENT = np.array([20.0])


def solver_for(material):
    core = Body("core", "iron", (Part(Cylinder(0.005, 0.03)),), 0.008)
    place = Placement(np.array([0.0, 0.0, 0.015]), np.eye(3))
    coil = CircularCoil("coil", 0.006, 0.010, 0.02, 200.0, placement=place)
    return NonlinearSolver(Device("d", "", (coil,), (core,), {"iron": material}))


def nasty(h, b):
    h, b = np.array(h), np.array(b)
    return BHTable("nasty", h, b, "straight line to the origin", "slope mu0", b[0] / h[0] / mu_0)


# mu_r 150 000 up to 1.9 T, then saturated within 1e-2 A/m.
CLIFF = nasty([10.0, 10.01, 20.0], [1.9, 1.9001, 1.9002])
# Hardly magnetic up to 1000 A/m, and saturated 0.1 A/m later.
THRESHOLD = nasty([1000.0, 1000.1, 1001.0], [0.01, 1.9, 1.9002])


def test_a_state_by_continuation_is_the_state(monkeypatch):
    """With too few steps for Newton's method from zero, continuation by shares of the currents ends at the same
    field."""
    solver = solver_for(Froehlich("iron", 4000.0, 2.1))
    direct = solver.solve(CURRENT)
    assert direct.report.continuation == ()
    monkeypatch.setattr(potential_form, "_MAX_NEWTON_STEPS", direct.report.iterations - 2)
    by_steps = solver.solve(CURRENT)
    shares = by_steps.report.continuation
    assert shares[-1] == 1.0
    assert len(shares) > 1
    assert (np.diff(shares) > 0).all()
    assert f"{100 * shares[0]:.3g}" in str(by_steps.report)
    place = [0.0, 0.0, -0.005]
    assert by_steps.field(place) == pytest.approx(direct.field(place), rel=1e-5, abs=1e-8)


def test_newton_takes_few_steps_and_ends_quadratically():
    """Newton's method took 6, 13 and 15 steps from zero field to far saturation, and 4 steps to a current nearby."""
    solver = solver_for(Froehlich("iron", 4000.0, 2.1))
    states = [solver.solve(np.array([current])) for current in (0.5, 20.0, 200.0)]
    for state, most in zip(states, (8, 15, 17), strict=True):
        assert state.report.iterations <= most
        *_, before, last = state.state.iron.residuals
        assert last < 30 * before**1.5
    assert solver.solve(np.array([201.0]), start=states[-1]).report.iterations <= 5


def test_a_law_with_a_cliff_is_solved():
    """No step of Newton's method sees beyond the cliff. Saturation limits the flux density in the core's middle to 1.9
    T of polarisation plus the coil's own field."""
    state = solver_for(CLIFF).solve(CURRENT)
    assert len(state.report.continuation) > 1
    middle = state.field([[0.0, 0.0, 0.015]])[0]
    assert 1.8 < middle[2] < 1.9 + mu_0 * 200 * 20 / 0.02


def test_failure_comes_with_the_whole_history(monkeypatch):
    monkeypatch.setattr(potential_form, "_MAX_NEWTON_STEPS", 6)
    with pytest.raises(NotConverged) as caught:
        solver_for(THRESHOLD).solve(CURRENT)
    # The history holds the solve from zero, and then solves at a half, a quarter, ... of the currents.
    assert len(caught.value.residuals) >= 6 * 4
    (problem,) = caught.value.problems
    assert "continuation" in problem.where
    assert f"{caught.value.residuals[-1]:.2e}" in problem.received
