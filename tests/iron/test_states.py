"""Solutions as fields: one interface for linear and for saturating iron, and states that are solved once."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.field import Field, FieldAtCurrents, dipole_wrench
from fieldmap.iron import FluxDensityAt, HysteresisSolver, NonlinearSolver, Pinning
from fieldmap.sources import bare_inductance
from tests.iron.shared import STEEL, core_and_coils

AIR = np.array([[0.0, 0.002, -0.006], [0.012, 0.0, 0.02]])
INSIDE = np.array([[0.0, 0.001, 0.013]])


@pytest.fixture(scope="module")
def unit():
    return fm.solve_linear(core_and_coils())


@pytest.fixture(scope="module")
def with_magnet():
    return fm.solve_linear(core_and_coils(magnet=True))


@pytest.fixture(scope="module")
def solver():
    return NonlinearSolver(core_and_coils())


@pytest.fixture(params=["linear", "nonlinear"])
def field(request, unit, solver):
    return unit if request.param == "linear" else solver


def test_solutions_are_fields(field):
    state = field.at([2.0, -1.0])
    assert isinstance(field, Field)
    assert isinstance(state, FieldAtCurrents)
    assert field.coil_names == state.coil_names == ("around", "beside")
    assert np.array_equal(state.currents, [2.0, -1.0])
    for bounds in (field.bounds, state.bounds, (field.lower, field.upper)):
        assert np.allclose(bounds, [[-0.004, -0.003, -0.012], [0.004, 0.005, -0.004]], rtol=0, atol=1e-15)
    assert set(field.assumptions) <= set(state.assumptions)
    assert state.assumptions == state.report.assumptions != ()


def test_currents_by_name_by_number_and_in_order(field):
    values = field.field(AIR, [2.0, -1.0])
    assert np.array_equal(field.field(AIR, {"beside": -1.0, "around": 2.0}), values)
    assert np.array_equal(field.at(1.5).currents, [1.5, 1.5])
    with pytest.raises(InputError) as caught:
        field.at({"around": 1.0, "behind": 1.0})
    assert "behind" in caught.value.problems[0].received
    assert np.array_equal(field.at({"around": 1.0}).currents, [1.0, 0.0])


def test_a_field_with_currents_is_that_of_the_state(field):
    currents = [2.0, -1.0]
    state = field.at(currents)
    moments = [[0.1, 0.0, 0.3], [0.0, 0.2, 0.0]]
    for name, points in (("field", AIR), ("field", INSIDE[0]), ("gradient", AIR), ("second_gradient", AIR)):
        assert np.array_equal(getattr(field, name)(points, currents), getattr(state, name)(points))
    wrench = state.wrench(AIR, moments)
    assert np.array_equal(field.wrench(AIR, moments, currents), wrench)
    of_parts = dipole_wrench(state.field(AIR), state.gradient(AIR), moments)
    assert wrench == pytest.approx(of_parts, rel=1e-12, abs=1e-15)
    assert np.array_equal(state.wrench(AIR[0], moments[0]), wrench[0])


def test_second_gradient_is_the_derivative_of_the_gradient_and_harmonic(unit):
    state, step = unit.at([2.0, -1.0]), 5e-4
    second = state.second_gradient(AIR)
    size = np.abs(second).max()
    for axis in range(3):
        aside = step * np.eye(3)[axis]
        difference = (state.gradient(AIR + aside) - state.gradient(AIR - aside)) / (2 * step)
        assert second[..., axis] == pytest.approx(difference, abs=0.01 * size)
    assert np.abs(np.einsum("nijj->ni", second)).max() < 1e-3 * size
    assert np.abs(second - np.swapaxes(second, 1, 3)).max() < 1e-3 * size


def test_linear_iron_gives_the_same_state_in_either_solver(unit, solver):
    currents = [2.0, -1.0]
    linear, other = unit.at(currents), solver.at(currents)
    assert linear.field(AIR) == pytest.approx(other.field(AIR), rel=1e-5)
    assert linear.field(INSIDE) == pytest.approx(other.field(INSIDE), rel=1e-5)
    of_core = other.flux_density("core")
    assert linear.flux_density("core") == pytest.approx(of_core, abs=1e-5 * np.linalg.norm(of_core))
    assert linear.element_flux_density.shape == other.element_flux_density.shape == (len(unit.mesh.tets), 3)
    assert linear.largest_flux_density == pytest.approx(other.largest_flux_density, rel=1e-5)
    assert other.largest_flux_density == other.report.largest_flux_density
    assert linear.section_flux("middle").flux == pytest.approx(other.section_flux("middle").flux, rel=1e-5)
    assert linear.flux_linkage() == pytest.approx(other.flux_linkage(), rel=1e-5)
    assert linear.energy() == pytest.approx(other.energy(), rel=1e-5)
    assert linear.coenergy() == pytest.approx(other.coenergy(), rel=1e-5)
    assert linear.force_on("core") == pytest.approx(other.force_on("core"), rel=1e-4)
    size = np.linalg.norm(linear.torque_on("core", [0.0, 0.0, 0.1]))
    ours, theirs = (state.torque_on("core", [0.0, 0.0, 0.1]) for state in (linear, other))
    assert ours == pytest.approx(theirs, abs=1e-4 * size)


@pytest.mark.parametrize("make", [fm.solve_linear, NonlinearSolver])
def test_progress_rises_to_the_whole(make):
    told = []
    make(core_and_coils(), refinement=0.6, progress=lambda _, fraction: told.append(fraction))
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 1.0)
    assert len(set(told)) > 3


def test_saturating_iron_at_rest_follows_currents_as_linear_iron_does():
    """Without any field the law is its initial slope: derivatives by currents are the solution of linear iron, and
    stored energy and linkage are zero."""
    steel = fm.Froehlich("iron", 500.0, 2.0)
    solver, unit = (
        NonlinearSolver(core_and_coils(steel), 0.6),
        fm.solve_linear(core_and_coils(), refinement=0.6),
    )
    state = solver.at([0.0, 0.0])
    for values in (state.field(AIR), state.field(INSIDE), state.polarisation(INSIDE), state.flux_linkage()):
        assert not values.any()
    assert (state.coenergy(), state.report.below_table, state.report.largest_flux_density) == (0.0, 0, 0.0)
    by = state.derivative(FluxDensityAt(AIR), ["current.around", "current.beside"])
    for k, name in enumerate(("around", "beside")):
        assert by[f"current.{name}"] == pytest.approx(unit.at(np.eye(2)[k]).field(AIR), rel=1e-4, abs=1e-9)
    assert solver.differential_inductance(state) == pytest.approx(unit.inductance(), rel=1e-4)
    remembered = HysteresisSolver(core_and_coils(steel), Pinning(50.0), refinement=0.6)
    rest = remembered.step([0.0, 0.0], remembered.demagnetised)
    assert (rest.loss, rest.parts) == (0.0, 1)
    assert not rest.field(INSIDE).any()
    flux = fm.solve_linear(core_and_coils(), form="flux", refinement=0.6).at([0.0, 0.0])
    assert not flux.field(INSIDE).any()


def test_methods_with_currents_are_short_for_the_state(with_magnet):
    currents = [2.0, -1.0]
    state = with_magnet.at(currents)
    pairs = (
        (with_magnet.flux_density("core", currents), state.flux_density("core")),
        (with_magnet.section_flux_density("middle", currents), state.section_flux_density("middle")),
        (with_magnet.force_on("magnet", currents), state.force_on("magnet")),
        (with_magnet.torque_on("magnet", currents, [0, 0, 1]), state.torque_on("magnet", [0, 0, 1])),
        (with_magnet.flux_linkage(currents), state.flux_linkage()),
        (with_magnet.energy(currents), state.energy()),
    )
    for with_currents, of_state in pairs:
        assert np.array_equal(with_currents, of_state)


def test_proportional_unless_magnets_add_their_field(unit, with_magnet, solver):
    assert (unit.proportional, with_magnet.proportional, solver.proportional) == (True, False, False)
    off = with_magnet.at(0.0)
    assert off.field(AIR) == pytest.approx(with_magnet.constant_fields(AIR)[0], rel=1e-12)
    assert off.largest_flux_density > 0.5


def test_linkage_of_a_linear_state_with_a_magnet_is_the_derivative_of_its_coenergy(with_magnet):
    currents, step = np.array([2.0, -1.0]), 1e-3
    for k, linkage in enumerate(with_magnet.at(currents).flux_linkage()):
        change = step * np.eye(2)[k]
        up, down = (with_magnet.at(currents + sign * change).coenergy() for sign in (1, -1))
        assert (up - down) / (2 * step) == pytest.approx(linkage, rel=1e-8)


def test_coils_alone_have_states_too():
    device = replace(core_and_coils(), bodies=(), materials={}, sections=())
    unit = fm.solve_linear(device)
    state = unit.at([2.0, -1.0])
    assert unit.inductance() == pytest.approx(bare_inductance(device.coils))
    assert state.element_flux_density.shape == (0, 3)
    assert np.isnan(state.largest_flux_density)
    assert state.force_on("around") == pytest.approx(-state.force_on("beside"), rel=1e-4)
    assert state.iron is None
    assert state.bounds is not None


def test_a_state_is_solved_once_and_the_next_begins_at_the_last():
    solver = NonlinearSolver(core_and_coils(STEEL))
    currents = np.array([3.0, 0.0])
    first = solver.at(currents)
    assert solver.is_solved([3.0, 0.0])
    currents[1] = 1.0
    assert np.array_equal(first.currents, [3.0, 0.0])
    assert not solver.is_solved(currents)
    second = solver.at(currents)
    fresh = solver.solve(currents, start=first)
    assert np.array_equal(second.state.potential, fresh.state.potential)
    assert solver.at({"around": 3.0, "beside": 0.0}) is first
    third = solver.at([3.5, 1.0])
    assert np.array_equal(third.state.potential, solver.solve([3.5, 1.0], start=first).state.potential)
    assert not np.array_equal(third.state.potential, solver.solve([3.5, 1.0], start=second).state.potential)
    assert solver.states == (first, second, third)


def test_the_tolerance_of_a_solver_is_that_of_its_states():
    device = core_and_coils(STEEL)
    fine, coarse = (NonlinearSolver(device, tolerance=tolerance).at(3.0) for tolerance in (1e-6, 0.1))
    assert fine.report.residual < 1e-9
    assert 1e-9 < coarse.report.residual < 1e-4
