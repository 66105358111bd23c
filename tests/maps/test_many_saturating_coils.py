"""Sixteen independent currents over saturating iron: a quick case of `scripts/validate.py --only many_coils`."""

import importlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.currents import CoilGroups, CurrentDomain, IndependentCurrents
from fieldmap.errors import InputError
from fieldmap.iron import NonlinearSolver
from fieldmap.maps.training import room
from fieldmap.maps.training.currents import MOST_CORNERS, extreme_signals
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.room import coupled_groups, needs, require_room
from fieldmap.maps.training.training import _fields_of_map

SCRIPTS = Path(__file__).parents[2] / "scripts"
COILS, MODES, ACCURACY = 16, 12, 2e-2
ENOUGH = 10**15


@pytest.fixture(scope="module")
def study():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        yield importlib.import_module("validation.many_coils")


@pytest.fixture(scope="module")
def device(study):
    return study.disk_with_cores(COILS)


@pytest.fixture(scope="module")
def data(study, device, tmp_path_factory):
    """A recipe that allows fewer modes than there are coils."""
    target = tmp_path_factory.mktemp("sixteen") / "map.h5"
    return study.made(device, target, accuracy=ACCURACY, modes=MODES, held_out=4, states=40)


def test_the_stated_error_holds_at_random_states_and_at_extremes(study, device, data):
    stated, errors = study.stated_errors(data), study.true_errors(device, data, 6, seed=5)
    for true in errors.values():
        assert (true <= 1.5 * np.array(stated)).all()
        assert (true <= np.array([2.0, 4.0]) * ACCURACY).all()
    assert stated[0] <= 2.0 * ACCURACY


def test_each_coil_has_modes_and_few_states_are_enough(data, device):
    """The tangents of a state hold the field of each coil: the number of states does not grow with the coils."""
    report = data.provenance.solver_report
    assert report["condensed_from"]["modes"] > COILS > MODES
    assert report["states_trained_on_solved"] < 20


def test_the_iron_saturates(study, device):
    """At random currents the field is far from proportional to them."""
    solver = NonlinearSolver(device)
    shares = np.random.default_rng(3).random((2, COILS))
    box = device.workspace
    points = np.random.default_rng(4).uniform(box.lower, box.upper, (100, 3))
    for currents in study.LOWER_A + shares * (study.UPPER_A - study.LOWER_A):
        field = solver.solve(currents, 1e-3).field(points)
        in_proportion = 1e3 * solver.solve(1e-3 * currents, 1e-3).field(points)
        off = np.linalg.norm(field - in_proportion, axis=1).max()
        assert off > 0.2 * np.linalg.norm(field, axis=1).max()


def test_extremes_of_two_hundred_coils_are_as_many_as_are_solved():
    count = 200
    domain = CurrentDomain(IndependentCurrents(count), np.full(count, -1.0), np.full(count, 2.0))
    signals = extreme_signals(domain)
    assert len(signals) <= 6 * count + 3 + 128 + MOST_CORNERS
    assert (signals >= -1.0).all()
    assert (signals <= 2.0).all()


def test_each_current_may_have_a_field_of_its_own():
    count = 130
    domain = CurrentDomain(IndependentCurrents(count), np.full(count, -1.0), np.full(count, 2.0))
    modes = SimpleNamespace(amplitudes=np.eye(count))
    fields = SimpleNamespace(rows=np.eye(count))
    trained = SimpleNamespace(modes=modes, fields=fields, amplitudes=lambda currents: currents)
    combination, weights = _fields_of_map(trained, domain, Plan())
    np.testing.assert_allclose(weights.T @ combination, np.eye(count), atol=1e-9)


def test_groups_are_those_that_couple_most():
    """Three clusters of coils in any order; two clusters couple more with each other. Signs do not matter."""
    of = np.array([0, 1, 2, 0, 1, 2, 0, 1])
    coupling = np.where(of[:, None] == of, 0.8, 0.1)
    coupling[np.ix_(of == 1, of == 2)] = coupling[np.ix_(of == 2, of == 1)] = -0.4
    np.fill_diagonal(coupling, 1.0)
    size = np.linspace(1.0, 9.0, len(of))
    inductance = 1e-3 * coupling * np.sqrt(np.outer(size, size))
    clusters = {tuple(np.flatnonzero(of == k).tolist()) for k in range(3)}
    assert set(coupled_groups(inductance, 3)) == clusters
    first, *others = sorted(clusters)
    assert set(coupled_groups(inductance, 2)) == {first, tuple(sorted(sum(others, ())))}
    assert coupled_groups(inductance, 8) == tuple((k,) for k in range(8))
    assert coupled_groups(inductance, 1) == (tuple(range(8)),)
    assert coupled_groups(inductance[:1, :1], 1) == ((0,),)


def test_what_a_training_needs_grows_with_coils_and_is_that_of_its_tangents_on_the_disk():
    few, many = (needs(50_000, count, count, 5 * count, Plan()) for count in (64, 200))
    # Tangents and their air operator of one state of 200 coils: 167 MB for 52 000 nodes.
    assert many.disk / (45 + Plan().held_out) == pytest.approx(167e6, rel=0.05)
    assert few.disk == pytest.approx(many.disk * 65 / 201)
    assert few.memory < many.memory
    grouped = needs(50_000, 200, 10, 60, Plan())
    assert grouped.disk == pytest.approx(many.disk * 11 / 201)
    assert needs(50_000, 200, 10, 60, Plan(inductance=True)).disk > many.disk
    assert few.within(few.memory, few.disk)
    assert not few.within(0.99 * few.memory, few.disk)
    assert not few.within(few.memory, 0.99 * few.disk)


def test_more_coils_than_a_lookup_takes_are_refused():
    count = 257
    domain = CurrentDomain(IndependentCurrents(count), np.full(count, -1.0), np.full(count, 2.0))
    with pytest.raises(InputError) as raised:
        require_room(None, domain, Plan(), lambda signals: 60, ENOUGH)
    assert (raised.value.problems[0].where, raised.value.problems[0].received) == ("currents", "257")


def test_a_domain_without_room_is_refused_before_a_state_is_solved_with_groups_that_have_room(
    device, tmp_path, monkeypatch
):
    """The groups of the message make a map's domain, and with them the same machine has room."""
    solver = NonlinearSolver(device)
    memory = needs(solver.unknowns, COILS, 5, 60, Plan()).memory
    monkeypatch.setattr(room, "memory_bytes", lambda: 1.0001 * memory)
    solves = []
    monkeypatch.setattr(NonlinearSolver, "solve", lambda *_, **__: solves.append(1))
    # Each signal has so many modes that five signals fit and six do not.
    modes_of = {count: 60 if count <= 5 else 60 + count for count in range(COILS + 1)}.__getitem__
    bounds = np.full(COILS, -1.0), np.full(COILS, 2.0)
    with pytest.raises(InputError) as raised:
        require_room(solver, CurrentDomain(IndependentCurrents(COILS), *bounds), Plan(), modes_of, ENOUGH)
    assert not solves
    problem = raised.value.problems[0]
    assert problem.where == "currents.groups"
    lists = problem.remedy.split("groups = ")[1].split("; or")[0]
    groups = [[int(name) - 1 for name in group] for group in json.loads(lists)]
    assert len(groups) == 5
    grouped = CurrentDomain(CoilGroups(groups), bounds[0][:5], bounds[1][:5])
    require_room(solver, grouped, Plan(), modes_of, ENOUGH)
    # Coils of a group are nearer to each other than coils of other groups are to them.
    places = np.array([coil.placement.position for coil in device.coils])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    within = [apart[a, b] for group in groups for a in group for b in group if a < b]
    between = [apart[a, b] for one in groups for other in groups if one != other for a in one for b in other]
    assert np.mean(within) < 0.6 * np.mean(between)
    with pytest.raises(InputError):
        require_room(solver, grouped, Plan(), modes_of, 1000)


def test_the_map_command_refuses_it_at_its_key(device, tmp_path, monkeypatch):
    monkeypatch.setattr(room, "memory_bytes", lambda: 1e6)
    currents = {"lower_A": -1.0, "upper_A": 2.0}
    with pytest.raises(InputError, match=r"currents\.groups"):
        fm.generate(device, tmp_path / "map.h5", spacing=2.5e-3, currents=currents, iron={"reaction": False})
    assert list(tmp_path.iterdir()) == []
