"""Derivatives of saturated states by their currents: inductance and field, against differences of states."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.field import dipole_wrench
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import wrench_actuation
from tests.iron.shared import core_and_coils


def device(material):
    """A core in a coil, a second coil to its side, and a magnet beside it."""
    return core_and_coils(material, magnet=True).replace(workspace=None, sections=())


@pytest.fixture(scope="module")
def solver():
    return NonlinearSolver(device(fm.Arctangent("steel", 2000.0, 2.0)))


@pytest.mark.parametrize("currents", [[0.0, 0.0], [60.0, 20.0]])
def test_derivative_of_the_linkages(solver, currents):
    """Central differences of flux linkage, below and in saturation; symmetric."""
    currents, step = np.array(currents), 0.05
    state = solver.solve(currents, tolerance=1e-6)
    matrix = solver.differential_inductance(state)
    for k in range(2):
        ahead, behind = (
            solver.solve(currents + s * step * np.eye(2)[k], tolerance=1e-6, start=state).flux_linkage()
            for s in (1, -1)
        )
        assert matrix[:, k] == pytest.approx((ahead - behind) / (2 * step), rel=2e-4)
    assert matrix == pytest.approx(matrix.T, rel=1e-4)


def test_a_state_of_another_solver_is_refused(solver):
    other = NonlinearSolver(device(fm.LinearMaterial("iron", 300.0)), refinement=0.7).solve([1.0, 0.0])
    with pytest.raises(InputError) as caught:
        solver.differential_inductance(other)
    assert caught.value.problems[0].where == "differential_inductance, state"


PLACES = np.array([[0.003, -0.002, 0.042], [0.02, 0.01, 0.03], [0.0, 0.03, 0.0]])


@pytest.mark.parametrize("currents", [[0.0, 0.0], [60.0, 20.0]])
def test_derivative_of_the_field(currents):
    """With a magnet and a background; central differences of states, and the state itself."""
    whole = device(fm.Arctangent("steel", 2000.0, 2.0))
    whole = whole.replace(background=fm.Background(np.array([1e-3, -2e-3, 5e-3])))
    solver = NonlinearSolver(whole, tolerance=1e-6)
    currents, step = np.array(currents), 0.05
    flux, slope, by_flux, by_slope = solver.by_currents(PLACES, currents)
    assert solver.states == ()
    state = solver.at(currents)
    np.testing.assert_allclose(flux, state.field(PLACES), rtol=0, atol=1e-8 * np.abs(flux).max())
    np.testing.assert_allclose(slope, state.gradient(PLACES), rtol=0, atol=1e-8 * np.abs(slope).max())
    assert by_flux.shape == (3, 2, 3)
    assert by_slope.shape == (3, 2, 3, 3)
    for k in range(2):
        ahead, behind = (
            solver.solve(currents + s * step * np.eye(2)[k], tolerance=1e-6, start=state) for s in (1, -1)
        )
        exact = (ahead.field(PLACES) - behind.field(PLACES)) / (2 * step)
        np.testing.assert_allclose(by_flux[:, k], exact, rtol=0, atol=2e-4 * np.abs(exact).max())
        exact = (ahead.gradient(PLACES) - behind.gradient(PLACES)) / (2 * step)
        np.testing.assert_allclose(by_slope[:, k], exact, rtol=0, atol=2e-4 * np.abs(exact).max())
    one = solver.by_currents(PLACES[1], currents)
    for single, many in zip(one, (flux, slope, by_flux, by_slope), strict=True):
        np.testing.assert_allclose(single, many[1], rtol=0, atol=1e-8 * np.abs(many).max())
    # Functions that need derivatives by the currents accept the solver itself.
    found = wrench_actuation(solver, PLACES[1], [0.0, 0.0, 0.5], currents)
    np.testing.assert_allclose(found.matrix[:3], 0.5 * by_slope[1, :, 2].T, rtol=1e-9)
    np.testing.assert_allclose(
        found.matrix @ currents + found.constant,
        dipole_wrench(flux[1:2], slope[1:2], [0.0, 0.0, 0.5])[0],
        rtol=1e-6,
    )
    with pytest.raises(InputError):
        solver.by_currents([0.0, 0.0, np.nan], currents)
