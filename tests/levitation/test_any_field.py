"""Equilibria and lift currents in solutions, solvers of saturating iron and their states, without wrappers."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Payload
from fieldmap.errors import InputError
from fieldmap.iron import NonlinearSolver
from fieldmap.levitation import DifferencedField, FixedCurrents, find_equilibrium, lift_current

PAYLOAD = Payload(mass=2e-4, moment=0.02)


@pytest.fixture(scope="module")
def device():
    return fm.read_device("loop_and_sphere")


def same(ours, theirs):
    for name in ("position", "stiffness", "field", "currents"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_a_linear_solution(device):
    unit = fm.solve_linear(device)
    point = 0.5 * (unit.bounds[0] + unit.bounds[1])
    lift = lift_current(unit, PAYLOAD, point)
    assert lift.history == ()
    assert lift.force[2] == pytest.approx(PAYLOAD.mass * 9.80665, rel=1e-12)
    found = fm.find_equilibrium(unit, currents=float(lift.current), payload=PAYLOAD, start=point)
    with pytest.warns(DeprecationWarning, match="DifferencedField"):
        former = DifferencedField(unit, *unit.bounds)
    same(found, find_equilibrium(former, lift.currents, PAYLOAD, start=point))
    assert found.position == pytest.approx(point, abs=1e-6)


def test_a_solver_of_saturating_iron_and_its_state(device):
    solver = NonlinearSolver(device)
    point = 0.5 * (solver.bounds[0] + solver.bounds[1])
    lift = lift_current(solver, PAYLOAD, point, tolerance=1e-6)
    assert len(lift.history) > 1
    found = fm.find_equilibrium(solver, currents=lift.currents, payload=PAYLOAD, start=point)
    state = solver.at(lift.currents)
    with pytest.warns(DeprecationWarning, match=r"levitation\.(Fixed|Differenced)"):
        former = DifferencedField(FixedCurrents(state), *solver.bounds)
    same(found, find_equilibrium(former, lift.currents, PAYLOAD, start=point))
    if state.bounds is not None:
        same(found, fm.find_equilibrium(state, payload=PAYLOAD, start=point))
    assert found.position == pytest.approx(point, abs=1e-5)


def test_currents_are_needed_where_a_field_has_none_of_its_own(device):
    with pytest.raises(InputError) as caught:
        fm.find_equilibrium(fm.solve_linear(device), payload=PAYLOAD)
    assert caught.value.problems[0].where == "currents"
