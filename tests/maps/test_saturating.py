"""A map of saturating iron, against direct solves at other currents; stopped and resumed; refused where it must be."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.cli.maps import print_summary
from fieldmap.core.machine import INSIDE
from fieldmap.currents import (
    CoilGroups,
    CurrentDomain,
    IndependentCurrents,
    LiftAndDirections,
    divide_currents,
)
from fieldmap.dynamics import RigidBody, linearised, modelled, state_of
from fieldmap.errors import InputError, NotConverged, OutsideMapError, Problem, RecipeError
from fieldmap.instruments import calibrate
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers import reduced
from fieldmap.lookup import MagneticBody
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.lookup.current_solver import COMPILED_TOLERANCE
from fieldmap.maps import generation
from fieldmap.maps.training import modes as modes_of
from fieldmap.maps.training import search
from fieldmap.maps.training import sequence as sequence_of
from fieldmap.maps.training.currents import corner_signals, sequence, training_signals
from fieldmap.maps.training.model_error import Trial
from fieldmap.maps.training.modes import SolvedModes, proper_modes
from fieldmap.maps.training.states import Snapshots, Solved, SolvedStates, Wanted
from fieldmap.parallel import Common, Workers
from fieldmap.store import Checkpoint, checkpoint_path, read_map
from tests.dynamics.machines import machine_in
from tests.maps.conftest import SATURATING
from tests.store.test_openpmd import validated

RECIPE = SATURATING.format(
    refinement=1.0, states=40, accuracy="1e-3", modes=40, points=250, fields=12, held_out=4
)


SENSOR = """
[[sensor]]
name = "under the left core"
position_mm = [-20.0, 1.0, -14.0]
axis = [0.3, 0.0, 1.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory, two_cores):
    path = tmp_path_factory.mktemp("two_cores")
    (path / "two_cores.toml").write_text(two_cores + SENSOR)
    (path / "recipe.toml").write_text(RECIPE)
    return path


@pytest.fixture(scope="module")
def data(folder):
    return read_map(fm.generate(folder / "recipe.toml", folder / "map.h5"))


@pytest.fixture(scope="module")
def solver(folder):
    return NonlinearSolver(fm.read_device(folder / "two_cores.toml"), symmetry="auto")


def field_of(data, currents):
    weights = CurrentModel(data.reduced_model, data.coil_names).weights(np.array(currents))
    return (np.tensordot(weights, values, 1) for values in (data.flux_density, data.gradient))


# Corners of the domain, opposed and equal currents, and currents at which the iron hardly carries flux.
@pytest.mark.parametrize("currents", [(0.5, -1.0), (2.0, 2.0), (2.0, -1.0), (1.3, 1.9), (0.6, 0.02)])
def test_the_map_agrees_with_direct_solves(data, solver, currents):
    flux, gradient = field_of(data, currents)
    state = solver.solve(currents)
    points = data.grid.points()
    for ours, truth in ((flux, state.field(points)), (gradient, state.gradient(points))):
        assert np.abs(ours.reshape(truth.shape) - truth).max() < 2e-3 * np.abs(truth).max()


@pytest.mark.usefixtures("data")
def test_sensors_in_loops_read_saturated_iron(folder):
    """By the map's model at any currents, or linear about some: there, and to first order, the readings of the map."""
    m, about, step = fm.open_map(folder / "map.h5"), np.array([1.3, 0.4]), 1e-3
    place, dipole = np.array([-5e-3, 2e-3, -9e-3]), MagneticBody.dipole([0.1, -0.2, 0.7])
    ends = [[m.readings(place, dipole, about + h * one)[0] for h in (-step, step)] for one in np.eye(2)]
    slopes = np.diff(ends, axis=1)[:, 0] / (2 * step)

    def read(of, currents):
        core, found = machine_in(of, 2, RigidBody(0.01, [1e-6] * 3, dipole)), np.empty(1)
        core.follow(np.array(currents))
        assert of.sensors.core.read(core, state_of(place), found) == INSIDE
        return found[0]

    for currents in ((2.0, 2.0), (0.5, -1.0)):
        truth = m.readings(place, dipole, currents)[0]
        assert read(modelled(m), currents) == pytest.approx(truth, rel=COMPILED_TOLERANCE)
    line, at = linearised(m, about), m.readings(place, dipole, about)[0]
    assert read(line, about) == pytest.approx(at, rel=1e-9)
    assert read(line, about + [0.2, -0.1]) == pytest.approx(at + slopes @ [0.2, -0.1], rel=1e-5)
    assert abs(read(line, (2.0, 2.0)) / m.readings(place, dipole, (2.0, 2.0))[0] - 1.0) > 1e-3
    upright = MagneticBody.dipole([0.0, 0.0, 0.7])
    curve = calibrate(m, upright, heights=(-0.014, -0.008), currents=about, scale=2.0)
    assert curve.per_ampere == pytest.approx(2.0 * slopes, rel=1e-5)
    bare = m.readings(place, np.zeros(3), about)[0]
    assert curve.constant + curve.per_ampere @ about == pytest.approx(2.0 * bare, rel=1e-9)


@pytest.mark.usefixtures("data")
def test_sensors_read_what_fresh_solves_have(folder, solver):
    """The share of the currents is that of saturating iron; a magnet adds the iron's response at zero currents."""
    m, sensor = fm.open_map(folder / "map.h5"), solver.device.sensors[0]
    for currents in ((0.5, -1.0), (2.0, 2.0), (1.3, 0.4)):
        truth = solver.solve(currents).field(sensor.position) @ sensor.direction
        assert m.readings([0.0, 0.0, -0.01], np.zeros(3), currents) == pytest.approx([truth], rel=5e-3)
    place, moment = np.array([-5e-3, 2e-3, -9e-3]), np.array([0.1, -0.2, 0.7])

    def dipole(points):
        # The dipole of 1 T m^3.
        r = points - place
        d = np.linalg.norm(r, axis=1)[:, None]
        along = (r @ moment)[:, None]
        return ((3 * along * r / d**5 - moment / d**3) / (4 * np.pi))[None]

    rest = np.zeros(2)

    def potential(points):
        r = points - place
        return ((r @ moment) / (4 * np.pi * np.linalg.norm(r, axis=1) ** 3))[None]

    answer = solver.magnetised_at(rest, solver.at(rest).state.potential[:, 0])(potential)
    at = sensor.position[None]
    iron = solver.surface.field_and_gradient(at, answer)[0][0, 0]
    truth = 4e-7 * np.pi * (iron + dipole(at)[0, 0]) @ sensor.direction
    alone = m.readings(place, moment, (1.3, 0.4)) - m.readings(place, np.zeros(3), (1.3, 0.4))
    assert abs(iron @ sensor.direction) > 0.1 * abs(dipole(at)[0, 0] @ sensor.direction)
    # Elements are 7 mm wide, the sensor is 4 mm below the core: reciprocity holds to 0.3 % of the iron's response.
    assert alone == pytest.approx([truth], rel=1e-3)
    assert any(one.startswith("sensors: ") for one in m.assumptions)


@pytest.mark.parametrize("currents", [(1.3, 0.4), (1.7, -0.6)])
def test_derivatives_by_the_currents_are_those_of_fresh_solves(data, folder, solver, currents):
    """Field, gradient, force and torque, by central differences of whole solves: within 1 % of each one's largest."""
    place, moment, step = np.array([1e-3, -5e-4, -11e-3]), np.array([0.1, -0.2, 0.7]), 0.02
    found = fm.open_map(folder / "map.h5").actuation(place, currents, moment).matrix

    def rows(shift):
        state = solver.solve(np.add(currents, shift))
        slope = state.gradient(place[None])[0]
        return np.concatenate(
            [
                state.field(place[None])[0],
                slope[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]],
                state.wrench(place, moment),
            ]
        )

    steps = step * np.eye(2)
    wanted = np.array([(rows(one) - rows(-one)) / (2 * step) for one in steps]).T
    for part in (slice(3), slice(3, 8), slice(8, 11), slice(11, 14)):
        assert np.abs(found[part] - wanted[part]).max() < 0.01 * np.abs(wanted[part]).max()


def test_superposition_would_be_wrong_here(data, solver):
    points = data.grid.points()
    one, two, both = (solver.solve(i).field(points) for i in ((2.0, 0.0), (0.0, 2.0), (2.0, 2.0)))
    assert np.abs(one + two - both).max() > 0.05 * np.abs(both).max()


def test_the_stated_errors_are_those_of_states_not_trained_on(data):
    report = data.provenance.solver_report
    tried = report["states_tried"]
    assert tried["at random"]["states"] == tried["at random"]["solved"] == 4
    assert tried["trained on"]["solved"] == report["states_trained_on_solved"]
    extremes = report["extremes"]
    # Four corners, equal and opposed currents, each coil alone. Only the mirror between the cores maps one onto another
    # in the domain.
    assert extremes["corners"] == 4
    assert extremes["looked_at"] == 19 >= extremes["different"] >= extremes["solved"] > 4
    assert tried["at extremes"]["solved"] + extremes["trained_on"] == extremes["solved"]
    assert 4 <= tried["searched for"]["solved"] < extremes["searched"]
    for errors in tried.values():
        assert 0 < errors["flux_density_share"] < 5e-3
        assert 0 < errors["gradient_share"] < 5e-3
    assert data.current_error.flux_density == max(errors["flux_density"] for errors in tried.values())
    assert data.current_error.gradient == max(errors["gradient"] for errors in tried.values())
    # The mirror between the cores exchanges the coils: (2, 0.6) and (0.6, 2) are one solve.
    assert report["states_trained_on"] > report["states_trained_on_solved"]
    assert (
        report["states_solved"]
        == report["states_trained_on_solved"]
        - extremes["trained_on"]
        + extremes["solved"]
        + tried["at random"]["solved"]
        + tried["searched for"]["solved"]
    )
    assert report["generation_processor_seconds"] > 0


def test_a_map_holds_fewer_modes_and_points_than_were_trained(data, folder, capsys):
    report, model = data.provenance.solver_report, data.reduced_model
    trained = report["condensed_from"]
    assert len(model.constant) == report["modes"] < trained["modes"] <= 40
    assert len(model.weights) == report["sample_points"] < trained["points"] <= 250
    assert 0.0 < trained["changed"] < 2.0
    print_summary(folder / "map.h5", False)
    text = " ".join(capsys.readouterr().out.split())
    assert f"condensed from {trained['modes']} and {trained['points']}" in text


def test_shares_of_sums_are_those_of_the_charges(solver):
    """Fields of charges, summed by weights, against the field of the summed charges."""
    points = np.random.default_rng(1).uniform(-2e-3, 2e-3, (9, 3)) + [0.0, 0.0, -25e-3]
    trial, random = Trial(solver, points, np.array([2.0, 1.5])), np.random.default_rng(2)
    currents = np.array([[1.0, 0.5], [2.0, -0.5], [1.5, 1.5]])
    charge = solver.charge_density(np.array([potential_at(solver, values) for values in currents]).T)
    weights, changes = np.eye(3), 1e-3 * random.standard_normal((3, 3))
    ours = trial.shares_of_sums(currents, trial.fields(charge), weights, changes)
    np.testing.assert_allclose(ours, trial.shares(currents, charge, changes @ charge), rtol=1e-9)
    # Without any field a thousandth of the largest field is the reference.
    none = trial.shares_of_sums(
        np.concatenate([currents, np.zeros((1, 2))]),
        trial.fields(charge),
        np.concatenate([weights, np.zeros((1, 3))]),
        np.concatenate([changes, changes[:1]]),
    )
    np.testing.assert_allclose(none[:3], ours, rtol=1e-12)
    assert np.isfinite(none[3]).all()
    assert (none[3] > 100.0 * ours[0]).all()


def worst_share(errors):
    return max(errors["flux_density_share"], errors["gradient_share"] / 2)


def test_no_more_states_are_solved_than_the_accuracy_asks_for(data):
    report = data.provenance.solver_report
    rounds = report["rounds"]
    assert rounds[0]["solved"] == 3
    chosen = report["states_trained_on_solved"] - report["corners_trained_on"]
    assert chosen == rounds[-1]["solved"] + 4 < 40
    shares = [worst_share(found["errors"]) for found in rounds]
    assert shares[-1] < 1e-3 < min(shares[:-1], default=1.0)


def test_a_lucky_round_does_not_end_the_training(folder, monkeypatch):
    """Every round is made to look perfect, so the sequence pauses after each: states at random decide when it ends."""
    true = sequence_of.next_round

    def lucky(*arguments):
        found = true(*arguments)
        return replace(found, errors=replace(found.errors, flux_density_share=0.0, gradient_share=0.0))

    monkeypatch.setattr(sequence_of, "next_round", lucky)
    monkeypatch.setattr(search, "HELD_OUT", 1.0)
    # Extremes beyond the corners would teach the model enough.
    monkeypatch.setattr(search, "extreme_signals", corner_signals)
    (folder / "finer.toml").write_text(RECIPE.replace("1e-3", "8e-6").replace("250", "600"))
    report = read_map(fm.generate(folder / "finer.toml", folder / "lucky.h5")).provenance.solver_report
    assert 1 < len(report["rounds"]) < 9
    # The accuracy of the training, plus the change by fewer modes and points.
    assert worst_share(report["states_tried"]["at random"]) < 2.1 * 8e-6
    # States that were requested again are not counted twice.
    others = sum(of["solved"] for kind, of in report["states_tried"].items() if kind != "trained on")
    assert report["states_solved"] == report["states_trained_on_solved"] + others


@pytest.mark.filterwarnings("ignore::fieldmap.errors.MapAccuracyWarning")
def test_info_says_where_the_accuracy_is_not_reached(folder, monkeypatch, capsys):
    recipe = RECIPE.replace("states = 40", "states = 5").replace("1e-3", "5e-7")
    (folder / "few.toml").write_text(recipe)
    print_summary(fm.generate(folder / "few.toml", folder / "few.h5", accept_error=True), False)
    assert "asks for 0.0001 % of B" in " ".join(capsys.readouterr().out.split())


def test_info_prints_the_errors_and_what_the_map_cost(data, folder, capsys):
    print_summary(folder / "map.h5", False)
    text = " ".join(capsys.readouterr().out.split())
    assert "asks for" not in text
    tried = data.provenance.solver_report["states_tried"]
    largest = max(found["flux_density_share"] for found in tried.values())
    assert f"largest error {100 * largest:.2g} % of B" in text
    printed = {"at random": "at random", "at extremes": "at extremes", "searched for": "found by a search"}
    for name, words in printed.items():
        assert f"{tried[name]['states']} {words}" in text
    bound = data.error_bounds["harmonic"]
    assert f"within {1e6 * bound.flux_density:.2g} uT" in text
    assert f"{data.provenance.solver_report['states_solved']} states in" in text


def test_images_of_states_are_states(solver):
    currents = np.array([1.7, 0.4])
    state = solver.solve(currents)
    images = {tuple(image.currents(currents)): image for image in solver.images}
    # Mirrors x = 0 and y = 0, each with the same and with reversed currents.
    assert set(images) == {(0.4, 1.7), (1.7, 0.4), (-0.4, -1.7), (-1.7, -0.4)}
    for values, image in images.items():
        direct = solver.solve(values).state.potential[:, 0]
        ours = image.potential(state.state.potential[:, 0])
        # Potentials of a connected piece are known up to a constant.
        difference = ours - direct
        assert np.ptp(difference) < 1e-5 * np.ptp(direct)


def test_tangents_are_the_derivatives_of_states(solver):
    """Taylor: the difference of states less the tangent falls with the square of the step."""
    currents, direction = np.array([1.4, 0.7]), np.array([1.0, -0.6])
    tangent = solver.sensitivities(currents, potential_at(solver, currents), direction[:, None], 1e-9)[:, 0]
    size = np.ptp(tangent)
    steps = np.array([0.08, 0.04, 0.02])
    left = []
    for step in steps:
        ahead, behind = (potential_at(solver, currents + s * direction) for s in (step, -step))
        # Central differences leave the third derivative; potentials of a connected piece are known up to a constant.
        left.append(np.ptp((ahead - behind) / (2.0 * step) - tangent) / size)
    slopes = np.log2(np.array(left[:-1]) / np.array(left[1:]))
    assert (slopes > 1.5).all()
    assert left[-1] < 2e-3
    both = solver.sensitivities(currents, potential_at(solver, currents), np.eye(2), 1e-9)
    assert np.ptp(both @ direction - tangent) < 1e-6 * size


def potential_at(solver, currents):
    return solver.solve(currents, 1e-7).state.potential[:, 0]


def snapshots(solver, images, *currents):
    """Solved states with their tangents, and with their images."""
    known = Snapshots(solver, lambda currents: images)
    for values in map(np.array, currents):
        potential = potential_at(solver, values)
        tangents = solver.sensitivities(values, potential, 0.2 * np.eye(2))
        known.add(values, Solved(potential, tangents, solver.air(np.column_stack([potential, tangents]))))
    return known


def test_modes_hold_the_states_and_their_tangents(solver):
    known = snapshots(solver, False, [1.0, 0.5], [1.6, 1.4])
    modes = SolvedModes(solver, known, 20, 0.0)
    assert modes.basis.shape[1] == 6
    energy = solver.energy_operator(known.currents[0], known.state(0).potential)
    np.testing.assert_allclose(modes.basis.T @ energy(modes.basis), np.eye(6), atol=1e-5)
    for state in known.states:
        vectors = np.column_stack([state.potential, state.tangents])
        left = vectors - modes.basis @ (modes.basis.T @ energy(vectors))
        assert np.einsum("ns,ns->s", left, energy(left)) == pytest.approx(
            np.zeros(3), abs=1e-9 * np.einsum("ns,ns->s", vectors, energy(vectors)).max()
        )
    # The model gives a state between them, up to the second derivative.
    between = np.array([1.3, 0.95])
    ours = modes.basis @ modes.amplitude(between)
    truth = potential_at(solver, between)
    assert np.ptp(ours - truth) < 0.02 * np.ptp(truth)


@pytest.mark.parametrize("limit", ["_AS_THEY_ARE", "_NUMBERS"])
def test_modes_of_many_columns_leave_no_more_than_the_best_there_are(solver, monkeypatch, limit):
    """Sought in ten combinations of eighteen columns and their images, they hold as much of the columns' energy as the
    best modes of this number (Eckart and Young)."""
    monkeypatch.setattr(modes_of, "_MORE", 4)
    monkeypatch.setattr(modes_of, limit, 1)
    blocks, block = [], modes_of._Columns.block

    def noted(columns, most):
        blocks.append(block(columns, most))
        return blocks[-1]

    monkeypatch.setattr(modes_of._Columns, "block", noted)
    known = snapshots(solver, True, [1.0, 0.5], [1.6, 1.4], [0.7, 1.9], [2.0, 0.2], [0.4, 1.0], [1.9, 1.7])
    energy = solver.energy_operator(known.currents[0], known.state(0).potential)
    columns = []
    for state in known.states:
        vectors = np.column_stack([state.potential, state.tangents])
        columns.append(vectors / np.sqrt(state.potential @ energy(vectors[:, :1])[:, 0]))
    columns = np.concatenate(columns, axis=1)
    assert columns.shape[1] > 2 * len(known.currents) > 20
    products = columns.T @ energy(columns)
    best = np.linalg.eigvalsh(0.5 * (products + products.T))[:-6].sum()
    modes = SolvedModes(solver, known, 6, 0.0)
    assert [found.shape[1] for found, _ in blocks] == [10]
    left = columns - modes.basis @ (modes.basis.T @ energy(columns))
    of_each = np.einsum("ns,ns->s", left, energy(left))
    assert best * (1 - 1e-6) < of_each.sum() < 1.01 * best
    assert modes.left == pytest.approx(np.sqrt(of_each.max()), rel=1e-6)
    assert modes.amplitudes == pytest.approx(known.potentials.T @ energy(modes.basis), rel=1e-6, abs=1e-9)


def test_a_part_of_the_points_tells_the_energy(solver, monkeypatch):
    """The sizes of the residuals equal those from all points."""
    currents = np.array([1.6, 1.4])
    modes = SolvedModes(solver, snapshots(solver, False, currents), 20, 0.0)
    amplitude = modes.amplitude(currents)
    fields = np.zeros((modes.model.modes, 1))

    def contributions(model):
        combine = model.conditions(currents, amplitude, fields, reduced.Weights(1.0, 0.0)).combine
        return model.contributions(model.moments(currents, amplitude), combine)

    exact = contributions(modes.model)
    few = len(modes.model.weights) // 3
    monkeypatch.setattr(reduced, "_FEW", few)
    rough = contributions(replace(modes.model))
    assert not np.array_equal(rough, exact)
    assert np.linalg.norm(rough) == pytest.approx(np.linalg.norm(exact), rel=0.15)
    # No direction is favoured: the products of the points are the same up to the sampling error.
    products = exact @ exact.T
    assert np.linalg.norm(rough @ rough.T - products) < 0.2 * np.linalg.norm(products)


def test_the_total_of_the_file_is_the_field_at_the_reference_currents(data, folder):
    flux, _ = field_of(data, data.reference_current)
    with h5py.File(folder / "map.h5") as file:
        total = np.stack([file[f"/data/0/meshes/B/{c}"][()] for c in "xyz"], axis=-1)
    # Lookups solve the model to 1e-6, the file's total is solved to 1e-8.
    np.testing.assert_allclose(total, flux, rtol=0, atol=1e-7 * np.abs(flux).max())


def test_other_programs_can_read_it(data, folder, monkeypatch, capsys):
    assert data.field_names[:3] == ("left", "right", "iron mode 1")
    assert validated(folder / "map.h5", monkeypatch, capsys)[1] == ("0", "0")


def test_a_stopped_run_goes_on_to_the_same_bits(data, folder, monkeypatch):
    # Nothing of the certificate is kept, so it is left out.
    monkeypatch.setattr(generation, "certified_bounds", lambda *_: {})

    def stop_at(message):
        def progress(text, fraction):
            if message in text:
                raise KeyboardInterrupt

        return progress

    other = folder / "stopped.h5"
    for message in (
        "state 6 of",
        "at extremes",
        "at random",
        "of the largest residual",
        "field at the nodes",
    ):
        with pytest.raises(KeyboardInterrupt):
            fm.generate(folder / "recipe.toml", other, progress=stop_at(message))
        assert not other.exists()
    assert checkpoint_path(other).exists()
    resumed = read_map(fm.generate(folder / "recipe.toml", other))
    assert (resumed.flux_density == data.flux_density).all()
    assert (resumed.gradient == data.gradient).all()
    for name in ("gradients", "weights", "air", "output", "known_amplitudes"):
        assert (getattr(resumed.reduced_model, name) == getattr(data.reduced_model, name)).all()
    assert not checkpoint_path(other).exists()


def test_states_come_back_with_their_costs(tmp_path):
    """Unless the currents differ; a failed state comes back with its reason."""

    def solve_potential(currents, tolerance, start):
        if currents[0] == 2.0:
            raise NotConverged(Problem("solver", "must converge", "no", "refine"))
        return np.arange(3.0), np.zeros(3)

    solver = Common.of(SimpleNamespace(solve_potential=solve_potential))
    wanted = [Wanted(0, np.array([1.0])), Wanted(1, np.array([2.0]))]
    with Checkpoint(tmp_path / "a.partial", "one") as checkpoint, Workers() as workers:
        first = SolvedStates(checkpoint, solver, workers)
        solved = first.solve(wanted, 1e-3, lambda done: None)
        np.testing.assert_array_equal(solved[0].potential, np.arange(3.0))
        assert solved[0].tangents.shape == (3, 0)
        assert solved[1] is None
    with Checkpoint(tmp_path / "a.partial", "one") as checkpoint, Workers() as workers:
        again = SolvedStates(checkpoint, solver, workers)
        assert again.known(0, np.array([1.5])) is None
        back = again.solve(wanted, 1e-3, lambda done: None)
        np.testing.assert_array_equal(back[0].potential, solved[0].potential)
        assert (again.count, again.failed) == (first.count, first.failed)
        one, other = again.known(0, np.array([1.0])), again.known(1, np.array([2.0]))
        assert again.failed == {1: other.state}
        assert again.earlier_seconds == one.seconds + other.seconds
        assert again.earlier_processor_seconds == one.processor_seconds + other.processor_seconds
        assert all(0.0 <= spent < 60.0 for of in (one, other) for spent in (of.seconds, of.processor_seconds))


def test_currents_beyond_the_domain_are_refused_flagged_or_evaluated(data):
    beyond = np.array([2.5, 0.0])
    with pytest.raises(OutsideMapError, match=r"coil left.*0\.5 to 2 A.*2\.5 A"):
        CurrentModel(data.reduced_model, data.coil_names).weights(beyond)
    flagged = CurrentModel(data.reduced_model, data.coil_names, "nan").weights(np.stack([beyond, [1.0, 0.0]]))
    assert np.isnan(flagged[0, 2:]).all()
    assert np.isfinite(flagged[1]).all()
    assert np.isfinite(CurrentModel(data.reduced_model, data.coil_names, "evaluate").weights(beyond)).all()


def test_contributions_are_counted_by_the_error_that_they_cause(solver):
    known = np.array([[1.0, 0.5], [2.0, 0.5], [1.5, 1.5], [1.2, -0.5]])
    states = np.array([solver.solve(currents).state.potential[:, 0] for currents in known]).T
    basis = states @ proper_modes(states, solver.energy_operator(known[0], states[:, 0])(states), 4)
    model = solver.project(basis)
    fields = np.random.default_rng(2).standard_normal((4, 3))
    for currents in known:
        amplitude = model.solve(currents, np.zeros(4))[0]
        # Each point's weight is off by its own ten-thousandth.
        share = 1e-4 * np.random.default_rng(1).standard_normal(len(model.weights))
        others = replace(model, weights=model.weights * (1 + share))
        off = others.solve(currents, amplitude)[0] - amplitude
        tangent = basis.T @ solver.energy_operator(currents, basis @ amplitude)(basis)
        moments = model.moments(currents, amplitude)
        # By the energy alone, by three numbers linear in the modes alone, and by both.
        caused = np.sqrt(off @ tangent @ off / (amplitude @ tangent @ amplitude))
        of_fields = np.linalg.norm(off @ fields) / np.linalg.norm(amplitude @ fields)
        for parts, energy, expected in (
            (0.0 * fields, 1.0, caused),
            (fields, 1e-9, of_fields),
            (fields, 0.5, np.hypot(of_fields, 0.5 * caused)),
        ):
            factor = model.tangent_factor(currents, amplitude)
            combine = reduced.error_coordinates(factor, amplitude, parts, energy)
            predicted = np.linalg.norm(share @ model.contributions(moments, combine))
            assert predicted == pytest.approx(expected, rel=0.02)
        np.testing.assert_allclose(
            model.sums(moments)[:4], model.contributions(moments, np.eye(4)).sum(axis=0), rtol=1e-9
        )


def test_a_model_that_follows_the_currents_gives_the_same(data):
    ours = CurrentModel(data.reduced_model, data.coil_names, follow=True)
    afresh = CurrentModel(data.reduced_model, data.coil_names)
    angle = np.linspace(0, 6, 40)
    path = np.stack([1.2 + 0.7 * np.cos(angle), 0.5 + 1.4 * np.sin(angle)], axis=1)
    for currents in (*path, path[-1], path[0], path[20]):
        weights, others = afresh.weights(currents), ours.weights(currents)
        for values in (data.flux_density, data.gradient):
            difference = np.abs(np.tensordot(others - weights, values, 1)).max()
            assert difference < 1e-6 * np.abs(np.tensordot(weights, values, 1)).max()


def test_a_map_of_a_division_knows_its_currents(data):
    six = {"source": np.zeros((data.reduced_model.source.shape[0], 6)), "known_currents": np.ones((1, 6))}
    known = {
        "known_amplitudes": data.reduced_model.known_amplitudes[:1],
        "parametrisation": LiftAndDirections(1.25),
    }
    bounds = {"lower": np.array([1.0, -0.4, -0.3]), "upper": np.array([2.2, 0.4, 0.3])}
    model = CurrentModel(replace(data.reduced_model, **six, **known, **bounds), tuple("123456"))
    inside = divide_currents(1.6, -0.3, 0.2, 1.25)
    assert model.weights(inside)[:6] == pytest.approx(inside)
    with pytest.raises(OutsideMapError) as caught:
        model.weights(divide_currents(1.6, 0.5, 0.2, 1.25))
    assert (caught.value.problems[0].where, caught.value.problems[0].received) == ("currents, their x", "0.5")
    with pytest.raises(OutsideMapError, match=r"n = 1.25"):
        model.weights(divide_currents(1.6, 0.3, 0.2, 1.0))
    with pytest.raises(OutsideMapError):
        model.weights(np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))


def test_a_map_of_groups_knows_its_currents(data):
    bounds = {"lower": np.array([0.5]), "upper": np.array([2.0]), "parametrisation": CoilGroups(((0, 1),))}
    model = CurrentModel(replace(data.reduced_model, **bounds), data.coil_names)
    free = CurrentModel(data.reduced_model, data.coil_names)
    equal = np.array([1.5, 1.5])
    weights, others = model.weights(equal), free.weights(equal)
    for values in (data.flux_density, data.gradient):
        difference = np.abs(np.tensordot(others - weights, values, 1)).max()
        assert difference < 1e-6 * np.abs(np.tensordot(weights, values, 1)).max()
    for beyond in ([1.5, 1.4], [2.5, 2.5]):
        with pytest.raises(OutsideMapError):
            model.weights(np.array(beyond))


@pytest.mark.parametrize("kind", ["hermite", "harmonic", "global"])
def test_every_form_of_the_opened_map_gives_the_field_of_the_solver(data, folder, solver, kind):
    opened = fm.open_map(folder / "map.h5", kind=kind)
    points = np.array([[0.001, 0.002, -0.011], [-0.004, 0.003, -0.008], [0.005, -0.006, -0.0151]])
    currents = np.array([1.7, -0.4])
    state = solver.solve(currents)
    flux, gradient = state.field(points), state.gradient(points)
    scale = np.abs(flux).max(), np.abs(gradient).max()
    for ours in (opened.field(points, currents), opened.at(currents).field(points)):
        assert np.abs(ours - flux).max() < 5e-3 * scale[0]
    assert np.abs(opened.gradient(points, currents) - gradient).max() < 1e-2 * scale[1]
    rows = np.stack([currents, [1.0, 1.0], currents])
    by_row = opened.field(points, rows)
    np.testing.assert_array_equal(by_row[0], opened.field(points[0], currents))
    assert np.abs(by_row[1] - solver.solve(rows[1]).field(points[1])).max() < 5e-3 * scale[0]
    one = opened.field_and_gradient(points[0], currents)
    np.testing.assert_array_equal(one[0], by_row[0])


def test_the_opened_map_says_what_it_cannot_do(data, folder):
    opened = fm.open_map(folder / "map.h5")
    assert opened.current_error.flux_density > 0
    with pytest.raises(InputError, match="superpose"):
        opened.unit_field(np.zeros(3))
    for rule in ("raise", "guess"):
        with pytest.raises(InputError):
            fm.open_map(folder / "map.h5", outside_currents=rule).field([0, 0, -0.01], [3.0, 0.0])
    flagged = fm.open_map(folder / "map.h5", outside_currents="nan")
    assert np.isnan(flagged.field([0, 0, -0.01], [3.0, 0.0])).all()


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("[currents]", "[current]", "current"),
        ("upper_A = 2.0", "upper_A = 0.4", "lower_A below upper_A"),
        ("upper_A = 2.0", "upper_A = [2.0, 2.0, 2.0]", "must name the same coils"),
        ("lower_A = [0.5, -1.0]\nupper_A = 2.0", "lower_A = 0.5\nupper_A = [2.0, 2.0, 2.0]", "2 coils"),
        ("upper_A = 2.0\n", "", "lower_A and upper_A, or lift_and_directions; received lower_A"),
        (
            "lower_A = [0.5, -1.0]\nupper_A = 2.0",
            "lift_and_directions = { u_A = [1, 2], x = [-0.4, 0.4], y = [0, 0.3] }",
            "lift_and_directions is for six coils",
        ),
        ("states = 40", "states = 0", "states"),
        ('model = "saturating"', 'model = "linear"', "belongs to saturating iron"),
        ("upper_A = 2.0", 'upper_A = 2.0\ngroups = [["left", "middle"]]', "currents.groups"),
        ("upper_A = 2.0", 'upper_A = 2.0\ngroups = [["left"]]', "currents.groups"),
        ("upper_A = 2.0", 'upper_A = 2.0\ngroups = [["left", "right"]]', "currents.lower_A"),
        ("held_out = 4", "held_out = 4\n[output]\nreference_current_A = 7.0", "within .currents."),
    ],
)
def test_recipes_that_make_no_sense_are_refused(folder, tmp_path, two_cores, old, new, text):
    (tmp_path / "two_cores.toml").write_text(two_cores)
    assert old in RECIPE
    (tmp_path / "recipe.toml").write_text(RECIPE.replace(old, new))
    with pytest.raises(RecipeError, match=text):
        fm.generate(tmp_path / "recipe.toml", tmp_path / "map.h5")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["recipe.toml", "two_cores.toml"]


def test_what_newtons_method_leaves_is_far_below_what_the_model_is_off(data):
    """A lookup against the same equations solved to 1e-10, in the fields of the sum."""
    model = CurrentModel(data.reduced_model, data.coil_names)
    reduced = data.reduced_model
    shares = np.random.default_rng(3).random((12, 2))
    for currents in reduced.lower + shares * (reduced.upper - reduced.lower):
        exact = model.search().weights_and_slopes(currents)[0][2:]
        left = model.weights(currents)[2:] - exact
        for values, own in (
            (data.flux_density, data.current_error.flux_density),
            (data.gradient, data.current_error.gradient),
        ):
            assert np.abs(np.tensordot(left, values[2:], 1)).max() < 0.01 * own


def test_some_states_to_train_on_are_their_own_images(solver):
    box = CurrentDomain(IndependentCurrents(2), np.array([0.5, 0.5]), np.array([2.0, 2.0]))
    plain, signals = sequence(box, 16), training_signals(box, 16, solver.images)
    changed = (signals != plain).any(axis=1)
    assert np.flatnonzero(changed).tolist() == [3, 7, 11, 15]
    mirrors = [image for image in solver.images if box.holds(image.currents(np.array([1.0, 1.5])))]
    assert mirrors
    for currents, before in zip(signals[changed], plain[changed], strict=True):
        assert box.holds(currents)
        # The mirror exchanges the two coils: half way, both have the same current.
        assert currents == pytest.approx(before.mean(), rel=1e-12)
        assert any(image.currents(currents) == pytest.approx(currents, rel=1e-12) for image in mirrors)
    # Without an image in the domain nothing changes.
    one_sided = CurrentDomain(IndependentCurrents(2), np.array([0.5, 2.1]), np.array([2.0, 3.0]))
    np.testing.assert_array_equal(training_signals(one_sided, 16, solver.images), sequence(one_sided, 16))
