"""Training of a bar whose states take a millisecond: what it reports, against states that are solved anew."""

import re
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import CurrentDomain, IndependentCurrents
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.maps import forecast as expected_work
from fieldmap.maps.forecast import STAGES, states_expected
from fieldmap.maps.training import condensation, search, training
from fieldmap.maps.training.currents import extreme_signals, held_out, sequence, training_signals
from fieldmap.maps.training.model_error import larger
from fieldmap.maps.training.modes import SolvedModes
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.search import ExtremesTried
from fieldmap.maps.training.sequence import Training
from fieldmap.maps.training.states import Snapshots, Solved, SolvedStates
from fieldmap.maps.training.training import train
from fieldmap.parallel import Common, Workers
from fieldmap.progress import Forecast
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.store import Checkpoint
from tests.maps.whole_bar import COILS, POINTS, WholeBar

REFERENCE = np.array([0.7, 1.3, 0.2])
# Ranges of the currents, and the plan: a case that needs few states; a case with more extremes than are all solved,
# chosen by the residual; and a case with too few states, in a domain that holds the reversal of its middle.
CASES = {
    "few": (
        [(-1.5, 1.0), (-0.5, 2.0)],
        Plan(states=30, accuracy=2e-3, modes=25, points=120, fields=6, held_out=5, inductance=True),
    ),
    "many extremes": (
        [(-1.5, 1.0), (-0.5, 2.0), (-1.0, 1.2)],
        Plan(states=40, accuracy=5e-3, modes=40, points=120, fields=6, held_out=4),
    ),
    "used up": (
        [(-2.0, 1.0), (-1.5, 2.0)],
        Plan(states=5, accuracy=2e-5, modes=25, points=60, fields=6, held_out=3),
    ),
}


class Noting(Forecast):
    """A forecast that records the pieces of stages."""

    def __init__(self, *given):
        super().__init__(*given)
        self.pieces, self.seconds = [], []

    def at(self, stage, message, done=0.0, count=1.0):
        self.pieces.append((stage, message, done, count))
        super().at(stage, message, done, count)

    def expect(self, stage, seconds):
        self.seconds.append((stage, seconds))
        super().expect(stage, seconds)


@pytest.fixture(scope="module", params=CASES)
def trained(request, tmp_path_factory):
    """Result of a training, the solver with its solves, and the progress texts."""
    (ranges, plan), told = CASES[request.param], []
    coils, domain = len(ranges), CurrentDomain(IndependentCurrents(len(ranges)), *np.array(ranges).T)
    solver, path = WholeBar(coils), tmp_path_factory.mktemp("bar") / "map.partial"
    forecast = Noting(lambda text, share: told.append((text, share)), dict.fromkeys(STAGES, 1.0))
    with pytest.MonkeyPatch.context() as patch, Checkpoint(path, "one") as checkpoint, Workers() as workers:
        patch.setattr(condensation, "_STATES", 40)
        patch.setattr(condensation, "_TRIED", 30)
        states = SolvedStates(checkpoint, Common.of(solver), workers)
        found = train(solver, domain, plan, POINTS, REFERENCE[:coils], states, forecast)
    # The last solve is the middle, from the nearest state, for the report.
    currents, _, start = solver.solves.pop()
    assert found.about["report"] == {"currents": currents}
    np.testing.assert_array_equal(currents, domain.middle)
    assert start is not None
    return SimpleNamespace(
        found=found, about=found.about, solver=solver, states=states, told=told, domain=domain, plan=plan, coils=coils,
        unit=[unit_flux_density_and_gradient(coil, POINTS) for coil in COILS[:coils]], forecast=forecast,
        largest=np.abs(ranges).max(axis=1),
    )  # fmt: skip


def norms(values):
    return np.linalg.norm(values.reshape(len(values), len(POINTS), -1), axis=2).max(axis=1)


def weights(trained, currents):
    """Weights of the iron's fields, by Newton's method in numpy."""
    m = trained.found.model
    few = GalerkinModel(
        m.gradients,
        m.source,
        m.weights,
        m.law.astype(np.int64),
        trained.solver.model.tables,
        m.air,
        m.constant,
    )
    return np.array([few.solve(row, np.zeros(few.modes), 1e-9)[0] for row in currents]) @ m.output.T


def errors_at(trained, currents):
    """Largest difference, largest field, and largest relative error, of flux density and gradient."""
    charge = trained.solver.charge_density(np.array([trained.solver.potential(i) for i in currents]).T)
    ours = weights(trained, currents) @ trained.found.charge
    rows = []
    for j in range(2):
        bare = np.array([pair[j] for pair in trained.unit])
        truth = np.tensordot(currents, bare, 1) + trained.solver._fields(POINTS, charge)[j]
        off, size = norms(trained.solver._fields(POINTS, ours - charge)[j]), norms(truth)
        least = 1e-3 * max(most * one for most, one in zip(trained.largest, norms(bare), strict=True))
        rows.append([off.max(), size.max(), (off / np.maximum(size, least)).max()])
    return np.array(rows)


def test_stated_errors_are_those_of_states_solved_anew(trained):
    """At the random states, at the training states, and within the promised errors anywhere else."""
    tried, solved = trained.about["states_tried"], {currents for currents, *_ in trained.solver.solves}
    kinds = {
        "at random": held_out(trained.domain, trained.plan.held_out),
        "trained on": np.array([i for i in trained.found.model.known_currents if tuple(i) in solved]),
    }
    for kind, currents in kinds.items():
        flux, gradient = errors_at(trained, currents)
        found = tried[kind]
        assert found["states"] == found["solved"] == len(currents)
        assert [found["flux_density"], found["gradient"]] == pytest.approx([flux[0], gradient[0]], rel=0.03)
        assert [found["largest_flux_density"], found["largest_gradient"]] == pytest.approx(
            [flux[1], gradient[1]], rel=1e-6
        )
        assert [found["flux_density_share"], found["gradient_share"]] == pytest.approx(
            [flux[2], gradient[2]], rel=0.03
        )
    largest = [
        max(found[name] for found in tried.values()) for name in ("flux_density_share", "gradient_share")
    ]
    if trained.plan.states > 5:
        assert largest[0] <= 2.0 * trained.plan.accuracy
        assert largest[1] <= 4.0 * trained.plan.accuracy
    anywhere = errors_at(trained, trained.domain.at(np.random.default_rng(5).random((40, trained.coils))))
    assert (anywhere[:, 2] <= 1.5 * np.array(largest)).all()


def test_stated_errors_of_linkages_are_those_of_states_solved_anew(trained):
    """The model as the C core solves it, against the bar's own linkages and their differences."""
    stated, currents = trained.about["linkage_error"], held_out(trained.domain, trained.plan.held_out)
    names = tuple("abc"[: trained.coils])
    model, off = CurrentModel(trained.found.model, names, outside="evaluate"), []
    for row in currents:
        state = trained.solver.potential(row)
        theirs = trained.solver.iron_linkage(row, state), trained.solver.iron_inductance(row, state)
        both = zip(model.linkages(row, inductance=True), theirs, strict=True)
        off.append([np.abs(ours - whole).max() / np.abs(whole).max() for ours, whole in both])
    shares = np.array(off)
    assert stated["states"] == len(currents)
    assert stated["share"] == pytest.approx(shares[:, 0].max(), rel=0.03)
    compared = stated["inductance_states"]
    assert compared == (len(currents) if trained.plan.inductance else min(4, len(currents)))
    assert stated["inductance_share"] == pytest.approx(shares[:compared, 1].max(), rel=0.03)
    assert stated["share"] < 0.05
    assert stated["inductance_share"] < 0.3


def test_what_was_solved_is_counted_by_its_kind(trained):
    about, solves = trained.about, trained.solver.solves
    extremes, tried, rounds = about["extremes"], about["states_tried"], about["rounds"]
    assert len({currents for currents, *_ in solves}) == len(solves) == trained.states.count
    assert {tolerance for _, tolerance, _ in solves} == {max(1e-3, 10.0 * trained.plan.accuracy)}
    # Three states, then rounds of four until one is predicted well enough; images in the domain come with them.
    taken = min(3 + 4 * len(rounds), trained.plan.states)
    assert [one["solved"] for one in rounds] == [3 + 4 * k for k in range(len(rounds))]
    shares = [
        max(one["errors"]["flux_density_share"], one["errors"]["gradient_share"] / 2.0) for one in rounds
    ]
    enough = [share <= trained.plan.accuracy for share in shares]
    assert not any(enough[:-1])
    assert enough[-1] or taken == trained.plan.states
    first = trained.domain.parametrisation.currents(
        training_signals(trained.domain, taken, trained.solver.images)
    )
    assert [currents for currents, *_ in solves[:taken]] == [tuple(row) for row in first]
    known = trained.found.model.known_currents
    assert about["states_trained_on"] == len(known)
    reversed_ones = [row for row in known if (known == -row).all(axis=1).any()]
    assert about["states_trained_on_solved"] == len(known) - len(reversed_ones) // 2
    assert {tuple(row) for row in first} <= {tuple(row) for row in known}
    assert about["corners_trained_on"] == extremes["trained_on"]
    solved = sum(one["solved"] for kind, one in tried.items() if kind != "trained on")
    again = trained.about["extremes"]["searched"] > 300
    # After a second training, states that measured the error of the first model are not reported.
    assert (trained.states.count > about["states_trained_on_solved"] + solved) == again
    assert trained.states.count >= about["states_trained_on_solved"] + solved
    assert tried["at extremes"]["solved"] + extremes["trained_on"] == extremes["solved"]
    assert about["error_parts"]["taken"]["states"] == taken
    assert about["error_parts"]["limits"] == (("states",) if taken == trained.plan.states else ())


def test_extremes_are_those_of_the_domain(trained):
    extremes, signals = trained.about["extremes"], extreme_signals(trained.domain)
    assert extremes["corners"] == 2**trained.coils
    assert extremes["looked_at"] == len(signals)
    reversed_ones = sum((np.abs(signals + row).max(axis=1) < 1e-9).any() for row in signals)
    assert extremes["different"] == len(signals) - reversed_ones // 2
    assert extremes["by_residual"] == (extremes["different"] > 32)
    # From many extremes first the eight of the largest indicators and four others, and never more than 64.
    assert (12 if extremes["by_residual"] else extremes["different"] - 8) <= extremes["solved"] <= 64
    # The search begins at the extremes, 32 at most, 32 at random and as many on edges; ten places have three
    # neighbours in each of two rounds.
    searches, rest = divmod(extremes["searched"], min(32, len(signals)) + 64 + 60)
    assert rest == 0
    assert searches >= 1
    # First solved of each kind: the worst and others; and of the searches the best ends.
    texts, known = [text for text, _ in trained.told], len(trained.found.model.known_currents)
    first = next(int(text.split()[3]) for text in texts if text.endswith("at extremes"))
    assert first == 12 if extremes["by_residual"] else first >= extremes["different"] - known
    assert "state 1 of 4 of the largest residual" in texts
    assert "state 1 of 8 that fewer modes change most" in texts


@pytest.mark.parametrize(
    ("errors", "looks", "worse"),
    [
        # The largest ratio of error and indicator is 0.2, the largest error 0.02: indicators above 0.1.
        ({1: 0.02, 2: 0.01}, {1: 0.1, 2: 0.2, 3: 0.3, 4: 0.05, 5: 0.11, 6: 0.1}, [3, 5]),
        ({1: 0.02, 2: 0.01}, {1: 0.1, 2: 0.0, 3: 0.0, 4: 0.05, 5: 0.2, 6: 0.0}, [5]),
        ({1: 0.5}, {1: 0.0, 2: 0.0, 3: 7.0, 4: 1.0, 5: 1.0, 6: 1.0}, []),
        ({}, dict.fromkeys(range(1, 7), 1.0), []),
    ],
)
def test_extremes_that_may_be_worse_are_those_of_larger_indicators(errors, looks, worse):
    assert search._perhaps_worse(errors, [3, 4, 5, 6], looks) == worse


@pytest.mark.parametrize(("modes", "raised"), [(11, 0), (12, 1), (13, 1)])
def test_the_limit_of_modes_is_raised_where_all_are_taken(modes, raised):
    calls, added = [], []
    known = SimpleNamespace(add=lambda *given: added.append(given))
    made = SimpleNamespace(most_modes=12, more_modes=lambda: calls.append(1), known=known)
    training._train_on(made, SimpleNamespace(sampled=SimpleNamespace(modes=modes)), [(1, 2), (3, 4)])
    assert (len(calls), added) == (raised, [(1, 2), (3, 4)])


def test_two_tries_are_added_up():
    one, later = ExtremesTried(4, 19, 18, 12, 3, True, 100), ExtremesTried(8, 41, 40, 9, 2, False, 55)
    assert one.and_again(later) == ExtremesTried(8, 41, 40, 12, 5, False, 155)
    assert later.and_again(one).solved == 12
    assert search.allowed(SimpleNamespace(plan=SimpleNamespace(accuracy=1.5e-3))) == 3e-3


def test_solves_begin_near_their_ends(trained):
    """The first two after the middle start at its tangent, by the change of their signals; later solves start at the
    model's prediction."""
    potential, solves = trained.solver.potential, trained.solver.solves
    assert solves[0][2] is None
    middle, step = np.array(solves[0][0]), 1e-3
    slopes = [
        (potential(middle + d) - potential(middle - d)) / (2.0 * step) for d in step * np.eye(trained.coils)
    ]
    for currents, _, start in solves[1:3]:
        expected = potential(middle) + (np.array(currents) - middle) @ slopes
        np.testing.assert_allclose(start, expected, atol=1e-4 * np.abs(expected).max())
    field = trained.solver.charge_density
    for currents, _, start in solves[3:]:
        end = field(potential(currents))
        assert np.abs(field(start) - end).max() < 0.08 * np.abs(end).max() + 1e-5


def test_weights_at_the_ends_of_the_domain_and_at_the_reference(trained):
    found, model = trained.found, trained.found.model
    np.testing.assert_array_equal(found.largest_weights[: trained.coils], trained.largest)
    np.testing.assert_allclose(
        model.reference_weights, weights(trained, REFERENCE[None, : trained.coils])[0], rtol=1e-4
    )
    # A tenth more than the largest at extremes, at states that fill the domain, and at training states.
    signals = np.concatenate([extreme_signals(trained.domain), sequence(trained.domain, 128)])
    currents = np.concatenate([trained.domain.parametrisation.currents(signals), model.known_currents])
    largest = 1.1 * np.abs(weights(trained, currents)).max(axis=0)
    np.testing.assert_allclose(found.largest_weights[trained.coils :], largest, rtol=1e-4)


def test_fewer_modes_and_points_are_told_with_what_they_change(trained):
    about = trained.about
    before, parts = about["condensed_from"], about["error_parts"]
    assert about["modes"] == len(trained.found.model.constant) <= before["modes"] == parts["taken"]["modes"]
    assert (
        about["sample_points"]
        == len(trained.found.model.weights)
        <= before["points"]
        == parts["taken"]["points"]
    )
    assert about["modes"] % 8 == 0 or about["modes"] == before["modes"]
    assert parts["taken"]["fields"] == len(trained.found.charge)
    changed = [share * trained.plan.accuracy * before["changed"] for share in (1.0, 0.5, 0.2)]
    assert parts["condensation"] in [pytest.approx(one) for one in changed]
    assert before["changed"] <= 1.1
    # No part is larger than the total error, and the projection error is relative to a state.
    largest = max(one["flux_density_share"] for one in about["states_tried"].values())
    assert parts["states"] <= 2.0 * largest
    assert parts["modes_leave"] <= max(0.2 * trained.plan.accuracy, 1e-5) * 1.01


RATE = re.compile(r", [\d.]+ (s a \w+|\w+s/s)$")


def test_the_progress_counts_the_states_of_each_stage(trained):
    texts = [RATE.sub("", text) for text, _ in trained.told]
    shares = [share for _, share in trained.told]
    assert 0.0 == shares[0] < shares[-1] < 1.0
    # A rate follows every state except the first of a kind.
    assert sum(RATE.search(text) is not None for text, _ in trained.told) > len(texts) / 4
    stages = {}
    for text in texts:
        if found := re.match(r"state (\d+) of (?:at most )?(\d+) ?(.*)", text):
            stages.setdefault((found[3], int(found[2])), []).append(int(found[1]))
    taken = trained.about["error_parts"]["taken"]["states"]
    assert stages["", trained.plan.states] == list(range(1, taken + 1))
    assert stages["at random", trained.plan.held_out] == list(range(1, trained.plan.held_out + 1))
    for (_, most), numbers in stages.items():
        # States that exist already are counted, but not reported.
        assert set(numbers) == set(range(min(numbers), max(numbers) + 1))
        assert max(numbers) <= most
    known = [text for text in texts if text.startswith("sample points, from state")]
    last = trained.about["states_trained_on"]
    assert known[0].startswith("sample points, from state 1 of ")
    assert known[-last:] == [f"sample points, from state {k + 1} of {last}" for k in range(last)]
    assert "sample points, choice 1" in texts


def test_pieces_of_each_stage_are_counted(trained):
    """States of the sequence count to the expected end, one round beyond the last; others to their own number."""
    pieces, plan, rounds = trained.forecast.pieces, trained.plan, trained.about["rounds"]
    shares = [
        max(one["errors"]["flux_density_share"], one["errors"]["gradient_share"] / 2.0) for one in rounds
    ]
    expected, images = [], len(trained.solver.images)
    for number, begin in enumerate([0, 1, *range(3, 3 + 4 * len(rounds), 4)]):
        end = (1, min(3, plan.states), min(begin + 4, plan.states))[min(number, 2)]
        known = max(number - 2, 0)
        needed = states_expected(
            shares[:known], [3 + 4 * k for k in range(known)], plan.states, plan.accuracy, images
        )
        needed = min(max(needed, begin) + 4, plan.states) if known else needed
        for done in range(begin, end):
            left = max(needed - done, end - done)
            expected.append(expected_work.training(done, known, left, images))
    told = [(done, count) for stage, _, done, count in pieces if stage == "training"]
    assert told[: len(expected)] == expected
    at_random = [(done, count) for stage, _, done, count in pieces if stage == "random"]
    assert at_random[: plan.held_out] == [(k, plan.held_out) for k in range(plan.held_out)]
    extremes = [(message, done) for stage, message, done, _ in pieces if stage == "extremes"]
    assert all(
        done == pytest.approx(expected_work.EXTREME * (int(message.split()[1]) - 1))
        for message, done in extremes[:4]
    )
    assert [done for stage, _, done, _ in pieces if stage == "search"][:4] == pytest.approx(
        [0.0, 0.2, 0.4, 0.6]
    )
    points = [(message, done) for stage, message, done, _ in pieces if stage == "points"]
    choices = [
        (message[-1], done) for message, done in points if "choice 1" in message or "choice 2" in message
    ]
    # A tenth for the conditions, then 40 % of the rest in each choice.
    assert all(done == pytest.approx(1.0 - 0.9 * 0.6 ** int(number)) for number, done in choices)
    assert all(0.0 <= done < 0.1 for message, done in points if "state" in message)
    assert {done for message, done in points if "conditions" in message} == {0.1}


@contextmanager
def training_of(bar, folder, ranges, **plan):
    """A training of a bar after its first states, and the seconds that it expects of its stages."""
    domain, seconds = CurrentDomain(IndependentCurrents(len(ranges)), *np.array(ranges).T), []

    class OfTheTest(Forecast):
        def expect(self, stage, work):
            seconds.append((stage, work))
            super().expect(stage, work)

    told = []
    forecast = OfTheTest(lambda text, share: told.append(text), dict.fromkeys(STAGES, 1.0))
    with Checkpoint(folder / "a.partial", str(ranges)) as checkpoint, Workers() as workers:
        states = SolvedStates(checkpoint, Common.of(bar), workers)
        made = Training(bar, domain, Plan(**plan), POINTS, states, forecast)
        made.told, made.seconds = told, seconds
        yield made


def test_a_training_whose_first_state_fails_goes_on_without_a_start(tmp_path):
    """A middle without currents gives no start either."""
    for ranges, fails in (([(-1.0, 1.5), (0.0, 1.0)], ((0.25, 0.5),)), ([(-1.0, 1.0), (-0.5, 0.5)], ())):
        bar = WholeBar()
        bar.fails = fails
        with training_of(bar, tmp_path, ranges, states=6) as training:
            assert [start is None for *_, start in bar.solves] == [True] * 3
            assert list(training.states.failed) == [0] * len(fails)
            assert training.states.count == 3 - len(fails)
            assert not training.at_its_end


def test_states_at_random_take_half_of_those_to_train_on(tmp_path):
    bar = WholeBar(images=False)
    with training_of(bar, tmp_path, [(-1.0, 1.5), (0.0, 1.0)], states=6, held_out=7) as training:
        found = [value for stage, value in training.seconds if stage == "random"]
        # The forecast was told after three states.
        assert found == pytest.approx([0.5 * 7 * training.seconds_of_state] * 3)
        assert [training.too_few(SimpleNamespace(left=left)) for left in (3.99e-3, 4.01e-3)] == [False, True]
        training.most_modes = 12
        assert [(training.more_modes(), training.most_modes) for _ in range(2)] == [(True, 200), (False, 200)]


def test_an_image_of_a_state_that_failed_is_solved_itself(tmp_path):
    bar, currents = WholeBar(), np.array([[1.0, 0.5], [-1.0, -0.5], [0.25, 0.75], [-0.25, -0.75]])
    bar.fails = ((1.0, 0.5),)
    with training_of(bar, tmp_path, [(-1.0, 1.0), (-1.0, 1.0)], states=4) as training:
        before = len(bar.solves)
        found = training.solve_tried(bar.potential, currents, 50, "to try", None)
        assert [row for row, *_ in bar.solves[before:]] == [(1.0, 0.5), (0.25, 0.75), (-1.0, -0.5)]
        assert (found.solved, len(found.currents)) == (2, 4)
        assert sorted(found.currents.tolist()) == sorted(currents.tolist())
        assert [RATE.sub("", text) for text in training.told if "to try" in text] == [
            f"state {k} of 4 to try" for k in (1, 2, 4)
        ]
        assert list(training.states.failed) == [50]
        # Existing states are not solved again, and need no start.
        training.solve_tried(lambda values: 1 / 0, currents[1:3], 51, "again", None)
        assert len(bar.solves) == before + 3


def states_of(bar, *currents):
    """Solved states with tangents of an eighth of the ranges, which are -1 to 1."""
    known = Snapshots(bar)
    for values in map(np.array, currents):
        potential = bar.potential(values)
        tangents = bar.sensitivities(values, potential, 0.25 * np.eye(len(values)))
        known.add(values, Solved(potential, tangents, bar.air(np.column_stack([potential, tangents]))))
    return known


@pytest.mark.parametrize("most", [4, 50])
def test_modes_are_those_of_states_and_tangents_each_state_of_the_same_energy(most):
    """A state without currents counts by its largest tangent. Against the energy operator and all singular values."""
    bar = WholeBar(images=False)
    known = states_of(bar, [0.9, 0.4], [0.0, 0.0], [-0.7, 1.2])
    energy = np.array(bar.energy_operator(known.currents[0], known.state(0).potential)(np.eye(30)))
    columns = []
    for state in known.states:
        own = np.column_stack([state.potential, state.tangents])
        energies = np.einsum("nk,nm,mk->k", own, energy, own)
        columns.append(own / np.sqrt(energies[0] if state.potential.any() else energies.max()))
    columns = np.concatenate(columns, axis=1)
    modes = SolvedModes(bar, known, most, 0.0)
    size = min(most, 8)
    assert modes.basis.shape == modes.air.shape == (30, size)
    np.testing.assert_allclose(modes.basis.T @ energy @ modes.basis, np.eye(size), atol=1e-6)
    np.testing.assert_allclose(modes.air, bar.air(modes.basis), atol=1e-9 * np.abs(modes.air).max())
    left = columns - modes.basis @ (modes.basis.T @ energy @ columns)
    of_each = np.einsum("nk,nm,mk->k", left, energy, left)
    root = np.linalg.cholesky(energy)
    assert of_each.sum() == pytest.approx(
        (np.linalg.svd(root.T @ columns)[1][most:] ** 2).sum(), rel=1e-6, abs=1e-9
    )
    assert modes.left == pytest.approx(np.sqrt(of_each.max()), rel=1e-6, abs=1e-6)
    np.testing.assert_allclose(modes.amplitudes, known.potentials.T @ energy @ modes.basis, atol=1e-7)
    # A tolerance between the errors with fewer and with more modes.
    fewer = SolvedModes(bar, known, 3, 0.0).left
    assert SolvedModes(bar, known, most, 1.01 * fewer).basis.shape[1] == 3
    assert modes.amplitude(np.array([0.9, 0.4])) == pytest.approx(
        modes.amplitudes[0], abs=1e-3 * abs(modes.amplitudes).max()
    )


def test_states_that_modes_lack_are_found_one_after_the_other():
    bar = WholeBar(images=False)
    known = states_of(bar, [0.9, 0.4], [-0.7, 1.2])
    modes = SolvedModes(bar, known, 50, 0.0)
    tried = states_of(bar, [0.9, 0.4], [0.2, 1.9], [0.21, 1.89], [1.9, -1.8], [0.91, 0.41])
    energy = np.array(bar.energy_operator(known.currents[0], known.state(0).potential)(np.eye(30)))
    root = np.linalg.cholesky(energy).T
    states = root @ tried.potentials / np.linalg.norm(root @ tried.potentials, axis=0)
    basis = root @ modes.basis
    for accuracy in (1e-1, 1e-2, 1e-3):
        span, expected = basis, []
        while True:
            left = np.linalg.norm(states - span @ np.linalg.lstsq(span, states, rcond=None)[0], axis=0)
            if left.max() <= accuracy:
                break
            expected.append(int(left.argmax()))
            span = np.column_stack([span, states[:, expected[-1]]])
        assert modes.missing(tried, accuracy).tolist() == expected
    assert len(expected) >= 2


def test_errors_and_indicators_of_a_reduced_model(tmp_path):
    """Errors of the model at sample points: at solved states, by the residual of one step, and of the modes alone."""
    bar, domain = (
        WholeBar(images=False),
        CurrentDomain(IndependentCurrents(2), np.full(2, -1.0), np.full(2, 1.5)),
    )
    forecast = Forecast(lambda text, share: None, dict.fromkeys(STAGES, 1.0))
    with Checkpoint(tmp_path / "a.partial", "one") as checkpoint, Workers() as workers:
        states = SolvedStates(checkpoint, Common.of(bar), workers)
        training = Training(bar, domain, Plan(states=5, accuracy=1e-2, modes=12), POINTS, states, forecast)
        training.go_on()
        modes = training.modes()
        reduction = training.reduce(modes, domain.at(np.array([[1.0, 0.2], [0.3, 0.9]])))
    currents = domain.at(np.random.default_rng(6).random((70, 2)))
    tried = Snapshots(bar)
    for values in currents:
        tried.add(values, Solved(bar.potential(values), np.zeros((30, 0)), np.zeros((30, 0))))
    amplitudes = np.array(
        [reduction.sampled.solve(i, np.zeros(reduction.sampled.modes), 1e-9)[0] for i in currents]
    )
    potentials = modes.basis @ amplitudes.T
    np.testing.assert_allclose(
        reduction.potential(currents[3]), potentials[:, 3], atol=1e-5 * np.abs(potentials).max()
    )

    def shares(charge, change):
        return larger(training.trial.shares(currents, charge, change))

    ours, truth = bar.charge_density(potentials), bar.charge_density(tried.potentials)
    np.testing.assert_allclose(reduction.off(tried), shares(truth, truth - ours), rtol=1e-3, atol=1e-8)
    step = bar.charge_density(bar.corrections(currents, potentials, None))
    np.testing.assert_allclose(reduction.shortfall(currents), shares(ours, step), rtol=1e-3, atol=1e-8)
    assert reduction.off(Snapshots(bar)).shape == (0,)
    full = modes.basis @ modes.model.solve(currents[5], amplitudes[5], 1e-9)[0]
    own = bar.charge_density(full[:, None])
    found = training.off_of_modes(modes, tried, 5)
    assert found == pytest.approx(
        larger(training.trial.shares(currents[5:6], truth[5:6], truth[5:6] - own))[0], rel=0.02
    )
    assert training.too_few(modes) == (modes.left > 4e-2)
    assert training.different(np.array([[1.0, 2.0], [-1.0, -2.0], [1.0, 2.0], [0.5, 0.0]]), [0, 1, 2, 3]) == [
        0,
        1,
        2,
        3,
    ]
    bar.images = WholeBar().images
    assert training.different(
        np.array([[1.0, 2.0], [-1.0, -2.0], [0.5, 0.0], [-1.0, -2.0]]), [1, 0, 2, 3]
    ) == [1, 2, 3]
    assert training.unknown(np.array([training.currents[0], [0.123, 0.456]]), [0, 1]) == [1]
