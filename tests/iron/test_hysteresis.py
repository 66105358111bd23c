"""Iron with hysteresis in the solver: against the sphere's scalar equation, the energy that the coil loses, and the
solver without hysteresis."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.optimize import brentq

from fieldmap.device.model import Background, Body, CircularCoil, Device, Froehlich, Part, Sphere, placed
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.iron import NonlinearSolver, solve_linear
from fieldmap.iron.elements.bh_law import law_tables
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.solvers.hysteresis import (
    HysteresisForm,
    HysteresisMagnetisation,
    HysteresisSolver,
    Pinning,
)

RADIUS = 0.05
STEEL = Froehlich("steel", 1000.0, 2.0)
DIRECTION = np.array([0.48, -0.6, 0.64])
# Strong enough to be seen against the sphere's own demagnetising field: 31 mT.
PINNING = Pinning(25e3, cells=3)


@pytest.fixture(scope="module")
def ball():
    return Device("ball", "", (), (Body("ball", "steel", (Part(Sphere(RADIUS)),), 0.017),), {"steel": STEEL})


@pytest.fixture(scope="module")
def form(ball):
    return HysteresisForm(assemble(generate_mesh(ball)))


def material(form, pinning):
    count = len(form.elements.volume)
    return HysteresisMagnetisation(
        np.zeros(count, np.int64),
        law_tables([STEEL]),
        np.zeros((1, count, 3)),
        mu_0 * pinning.fields[None],
        pinning.weights,
        np.zeros((count, 4, pinning.cells, 4)),
    )


def uniform(form, applied):
    return form.elements.coil_field(lambda p: np.broadcast_to(applied * DIRECTION, (1, *p.shape)))


def sphere_by_formula(applied, remembered):
    """Polarisation J of the sphere, J + 3 h = 3 B0, and the state of its cells afterwards, one-dimensional plays."""
    kappa = mu_0 * PINNING.fields

    def polarisation(h):
        r = np.clip(remembered, h - kappa, h + kappa)
        chi = STEEL.mu_r - 1
        return (chi * r / (1 + chi * np.abs(r) / STEEL.saturation)) @ PINNING.weights

    h = brentq(lambda x: polarisation(x) + 3 * x - 3 * applied, -3.0, 3.0, xtol=1e-15)
    return polarisation(h), np.clip(remembered, h - kappa, h + kappa)


def test_sphere_through_a_cycle(form):
    """Uniformly magnetised, B + 2 mu0 H = 3 B0, on the first curve, both branches and a minor loop; with remanence."""
    iron, potential, remembered = material(form, PINNING), None, np.zeros(PINNING.cells)
    volume = form.elements.volume / form.elements.volume.sum()
    for applied in (0.1, 0.4, 0.9, 0.3, 0.0, -0.5, -0.9, -0.2, -0.5, 0.0, 0.9):
        field = uniform(form, applied)
        state = form.solve(iron, field, 1e-7, potential)
        potential = state.potential
        h = form.elements.strength_at_points(potential, field, iron)[0]
        mean = volume @ iron.polarisation(h, 0).mean(axis=1)
        iron = iron.after(h)
        expected, remembered = sphere_by_formula(applied, remembered)
        assert mean == pytest.approx(expected * DIRECTION, abs=0.006)
        if applied == 0.0:
            assert 0.05 < abs(expected) < 0.1


def test_tangent_is_the_derivative_of_the_residual(form):
    """Taylor test of the Newton matrix away from where cells let go, on the way back from saturation."""
    iron = material(form, PINNING)
    forth, back = uniform(form, 0.8), uniform(form, 0.5)
    state = form.solve(iron, forth, 1e-6)
    iron = iron.after(form.elements.strength_at_points(state.potential, forth, iron)[0])
    phi = form.solve(iron, back, 1e-6, state.potential).potential[:, 0]
    step = np.random.default_rng(0).normal(size=phi.size) * np.abs(phi).max() * 1e-4
    slope = -form.tangent(phi, back, iron) @ step
    base = form._residual(phi, back, 0, iron)
    left = [
        np.linalg.norm(form._residual(phi + a * step, back, 0, iron) - base - a * slope)
        for a in (0.2, 0.1, 0.05)
    ]
    # A cell that lets go within the step makes a kink: the mean order of both halvings is tested.
    assert 0.5 * np.log2(left[0] / left[2]) > 1.7


@pytest.fixture(scope="module")
def solver(ball):
    coil = CircularCoil("coil", 0.08, 0.1, 0.02, 1000.0)
    body = replace(ball.bodies[0], mesh_size=0.03)
    return HysteresisSolver(replace(ball, coils=(coil,), bodies=(body,)), PINNING)


def test_energy_lost_in_a_cycle(solver):
    """The area of a closed cycle of current against linkage is the energy that the cells dissipated. Each step is a
    minimum: the energy stored and lost is at least old current, at most new current, times change of linkage."""
    memory = solver.step([100.0], solver.demagnetised).memory
    state = solver.step([80.0], memory)
    current, linkage, loss = [100.0, 80.0], [], state.loss
    first = solver.step([100.0], memory)
    assert first.loss == pytest.approx(0.0, abs=1e-6 * state.loss)
    linkage = [first.iron_linkage[0], state.iron_linkage[0]]
    for value in [*np.linspace(60.0, -100.0, 9), *np.linspace(-80.0, 100.0, 10)]:
        state = solver.step([value], state.memory)
        linkage.append(state.iron_linkage[0])
        current.append(value)
        loss += state.loss
    i, change = np.array(current), np.diff(linkage)
    assert linkage[-1] == pytest.approx(linkage[0], rel=2e-3)
    assert i[:-1] @ change < loss < i[1:] @ change
    assert 0.5 * (i[:-1] + i[1:]) @ change == pytest.approx(loss, rel=0.04)


def test_without_pinning_it_is_the_solver_without_memory(solver):
    plain = NonlinearSolver(solver.device).solve([30.0])
    point = np.array([[0.0, 0.01, 0.08]])
    memory = solver.with_pinning(Pinning(0.0, 2)).demagnetised
    for current in (-40.0, 30.0):
        state = solver.step([current], memory)
        memory = state.memory
    assert state.loss == 0.0
    assert state.field(point) == pytest.approx(plain.field(point), rel=1e-5)
    assert state.gradient(point) == pytest.approx(plain.gradient(point), rel=1e-5, abs=1e-8)
    assert state.flux_linkage() == pytest.approx(plain.flux_linkage(), rel=1e-5)


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda s: Pinning(-1.0), "coercive_field"),
        (lambda s: Pinning(100.0, 0), "cells"),
        (lambda s: s.step([1.0, 2.0], s.demagnetised), "currents"),
        (lambda s: s.step([1.0], s.demagnetised, tolerance=0.0), "tolerance"),
    ],
)
def test_bad_input(solver, call, where):
    with pytest.raises(InputError) as caught:
        call(solver)
    (problem,) = caught.value.problems
    assert where in problem.where


@pytest.mark.parametrize("power", [1, 2, 3])
def test_shares_of_the_cells_are_those_of_a_uniform_distribution(power):
    """Moments of the pinning fields against those of a uniform distribution from 0 to twice the coercive field,
    (2 H)^p / (p + 1): the second falls with the square of the number of cells, as a trapezoidal rule's does."""
    errors = []
    for cells in (5, 9, 17):
        pinning = Pinning(300.0, cells=cells)
        assert pinning.weights.sum() == pytest.approx(1.0, abs=1e-14)
        errors.append(pinning.fields**power @ pinning.weights / (600.0**power / (power + 1)) - 1.0)
    if power == 1:
        assert np.abs(errors).max() < 1e-14
    else:
        np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=1e-6)


def test_one_cell_has_the_coercive_field():
    one = Pinning(100.0, cells=1)
    assert (one.fields.tolist(), one.weights.tolist()) == ([100.0], [1.0])
    assert "100 A/m (one cell)" in one.assumption
    assert "100 A/m (4 cells from 0 to twice that)" in Pinning(100.0, 4).of("steel")
    assert Pinning(100.0, 4).of("steel").startswith("iron 'steel'")
    assert Pinning(100.0, 4).fields.tolist() == pytest.approx([0.0, 200 / 3, 400 / 3, 200.0])


def test_a_background_is_refused(ball):
    with pytest.raises(InputError) as caught:
        HysteresisSolver(replace(ball, background=Background(np.array([0.0, 0.0, 0.1]))))
    assert caught.value.problems[0].received == "a background field"


def test_cells_lose_their_pinning_field_times_their_way(form):
    """Each element of the ball has two cells; one of them moves along x until its polarisation is reversed."""
    cells = Pinning(50.0, cells=2)
    before = material(form, cells)
    volume, count = form.elements.volume, len(form.elements.volume)
    j = STEEL.mu_r - 1
    polarised = j * 0.01 / (1 + j * 0.01 / STEEL.saturation)
    there, back = np.zeros((count, 4, 2, 4)), np.zeros((count, 4, 2, 4))
    there[:, :, 1, ::3], back[:, :, 1, ::3] = (0.01, polarised / 0.01), (-0.01, polarised / 0.01)
    up, down = replace(before, remembered=there), replace(before, remembered=back)
    # Half of the cells have no pinning field, the others twice the coercive field.
    lost = mu_0 * 100.0 * 0.5 * polarised * volume.sum()
    assert before.dissipated(up, volume) == pytest.approx(lost, rel=1e-6)
    assert up.dissipated(down, volume) == pytest.approx(2 * lost, rel=1e-6)
    assert up.dissipated(up, volume) == 0.0


def test_materials_bring_their_own_coercive_fields(ball, solver):
    """A coercive field of the material against the same field for the whole solver; a second material keeps its own."""
    hard = replace(STEEL, coercive_field=25e3)
    coil = CircularCoil("coil", 0.08, 0.1, 0.02, 1000.0)
    body = replace(ball.bodies[0], mesh_size=0.03)
    own = HysteresisSolver(replace(ball, coils=(coil,), bodies=(body,), materials={"steel": hard}))
    stated = solver.with_pinning(Pinning(25e3))
    found = [one.step([100.0], one.demagnetised).memory for one in (own, stated)]
    np.testing.assert_array_equal(found[0].potential, found[1].potential)
    assert own.assumptions[0].startswith("iron 'steel'")
    assert "25000 A/m" in own.assumptions[0]
    # Solutions without hysteresis state that they leave it out; iron without a coercive field needs no such note.
    for material, said in ((hard, True), (replace(STEEL, coercive_field=0.0), False)):
        device = replace(ball, coils=(coil,), bodies=(body,), materials={"steel": material})
        assert any("25000 A/m" in text for text in solve_linear(device).assumptions) is said
    beside = replace(body, name="soft", material="soft", parts=(Part(Sphere(0.01), placed((0, 0, 0.1))),))
    both = HysteresisSolver(
        replace(
            ball,
            coils=(coil,),
            bodies=(body, beside),
            materials={"steel": hard, "soft": Froehlich("soft", 500.0, 1.5, 10.0)},
        )
    )
    iron = both.demagnetised.material
    np.testing.assert_allclose(iron.pinning.mean(axis=1), mu_0 * np.array([25e3, 10.0]))
    # At 0.2 T both are all but saturated, one at 2.0 T and one at 1.5 T; the cells of the hard one lag behind.
    j = iron.polarisation(np.full((len(iron.law), 4, 3), 0.2 * DIRECTION), 0) @ DIRECTION
    assert j[iron.law == 1] == pytest.approx(1.5 * 499 * 0.2 / (1.5 + 499 * 0.2), rel=1e-4)
    lagging = 0.2 - mu_0 * Pinning(25e3).fields
    behind = 999 * lagging / (1 + 999 * lagging / 2.0)
    assert j[iron.law == 0] == pytest.approx(behind @ Pinning(25e3).weights, rel=2e-3)


def test_where_newton_begins_leaves_no_trace(solver):
    """A start near the wanted state saves steps and changes the result only within the solver's tolerance."""
    memory = solver.step([100.0], solver.demagnetised).memory
    plain = solver.step([-30.0], memory)
    near = solver.step([-30.0], memory, near=solver.step([-30.5], memory))
    assert near.steps < plain.steps
    point = np.array([[0.0, 0.01, 0.08]])
    np.testing.assert_allclose(near.field(point), plain.field(point), rtol=1e-6)
    assert near.loss == pytest.approx(plain.loss, rel=1e-5)


@pytest.mark.parametrize("currents", [[80.0], [20.0], [-40.0]])
def test_first_guess_of_a_step(solver, currents):
    """The last step is extrapolated, or the potential is scaled with currents that turn back."""
    memory = solver.step([60.0], solver.step([40.0], solver.demagnetised).memory).memory
    found = solver.step(currents, memory).memory.potential
    guess = memory.continued(np.array(currents))
    assert np.linalg.norm(guess - found) < 0.4 * np.linalg.norm(memory.potential - found)


def test_a_step_that_fails_is_divided(solver, monkeypatch):
    """Newton's method is made to fail for more than 30 A at once: from 60 to 160 A the same as four steps of 25 A."""
    memory = solver.step([60.0], solver.demagnetised).memory
    at = HysteresisSolver._at

    def hard(self, currents, memory, residual, start):
        if np.abs(currents - memory.currents).max() > 30.0:
            raise NotConverged(Problem("made", "must be near", "too far", "none"))
        return at(self, currents, memory, residual, start)

    monkeypatch.setattr(HysteresisSolver, "_at", hard)
    whole = solver.step([160.0], memory)
    loss, steps = 0.0, 0
    one = memory
    for current in (85.0, 110.0, 135.0, 160.0):
        # A divided step begins at the state before.
        state = solver._at(np.array([current]), one, 1e-3 * 1e-3, one.potential)
        one, loss, steps = state.memory, loss + state.loss, steps + state.steps
    assert whole.parts == 4
    assert whole.loss == pytest.approx(loss, rel=1e-4)
    assert loss > 2 * state.loss
    np.testing.assert_allclose(whole.iron_linkage, state.iron_linkage, rtol=1e-6)
    with pytest.raises(NotConverged):
        solver.step([60.0 + 30.0 * 17], memory)


def test_what_the_iron_did_along_a_path_is_read_from_its_potentials(solver):
    """Polarisation at the points from the cells' memory at each state; a magnet's remanence is not part of it."""
    path, memory, states = np.array([[100.0], [-20.0], [60.0]]), solver.demagnetised, []
    for currents in path:
        states.append(solver.step(currents, memory))
        memory = states[-1].memory
    magnet = replace(solver.demagnetised.material, remanence=np.full((1, len(memory.material.law), 3), 0.3))
    for begin in (solver.demagnetised, replace(solver.demagnetised, material=magnet)):
        found = solver.magnetised(begin, path, np.array([state.memory.potential for state in states]))
        for state, (polarisation, derivative) in zip(states, found, strict=True):
            of = state.memory.material
            reversible = of.remembered[..., :3]
            size = np.linalg.norm(reversible, axis=-1, keepdims=True)
            # Froehlich: J = chi h Js / (Js + chi h), chi = 999.
            chord = 999.0 * 2.0 / (2.0 + 999.0 * size)
            cells = (chord * reversible).reshape(len(polarisation), -1, 3)
            np.testing.assert_allclose(polarisation, PINNING.weights @ cells, rtol=2e-3, atol=2e-4)
            assert derivative.shape == (len(polarisation), 6)
