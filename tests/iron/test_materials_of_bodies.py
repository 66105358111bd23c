"""Material properties that the solvers use, notes on them, and reports in numbers and words."""

import json
import re
from dataclasses import asdict, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.materials.flux_barrier import FluxBarrier
from fieldmap.device.model import Background, Body, Box, Device, Part, placed
from fieldmap.errors import InputError
from fieldmap.iron import notes, report
from fieldmap.iron.materials import (
    BARRIER_MU_R,
    body_properties,
    material_assumptions,
    materials_on,
    require_soft_bodies,
)
from fieldmap.iron.mesh.mesher import LocalSizes, MesherCells
from fieldmap.iron.notes import BodyBeyondSaturation
from fieldmap.iron.report import SolverReport, Stages

LAWS = {
    "plain": fm.LinearMaterial("plain", 100.0),
    "steel": fm.Froehlich("steel", 500.0, 2.1),
    "magnet": fm.PermanentMagnet("magnet", np.array([0.1, 0.0, -1.2]), 1.05),
    "barrier": FluxBarrier("barrier"),
    "weak": fm.LinearMaterial("weak", 0.5),
}


def device(*materials, **more):
    bodies = [
        Body(f"{name} {k}", name, (Part(Box((0.01,) * 3), placed((0.02 * k, 0, 0))),), 0.005)
        for k, name in enumerate(materials)
    ]
    return Device.unchecked(name="d", bodies=tuple(bodies), materials=LAWS, **more)


def test_permeability_and_remanence_of_every_body():
    every = device("plain", "steel", "magnet", "barrier", "plain")
    own, asked = body_properties(every, None), body_properties(every, 7.0)
    assert own.mu_r.tolist() == [100.0, 500.0, 1.05, BARRIER_MU_R, 100.0]
    # Only soft iron takes the requested permeability.
    assert asked.mu_r.tolist() == [7.0, 7.0, 1.05, BARRIER_MU_R, 7.0]
    for found in (own, asked):
        assert found.remanence.tolist() == [[0, 0, 0], [0, 0, 0], [0.1, 0, -1.2], [0, 0, 0], [0, 0, 0]]
        assert found.weakest == BARRIER_MU_R
        # Each material has one note.
        assert len(found.assumptions) == 4
    assert "mu_r = 500" in own.assumptions[1]
    assert "mu_r = 7 as requested" in asked.assumptions[1]
    assert body_properties(device("plain", "steel"), None).weakest == 100.0
    joint = fm.Joint(1e-4, ("plain 0", "steel 1"), 0.25)
    joined = body_properties(device("plain", "steel", joints=(joint,)), None)
    assert joined.weakest == 0.25
    assert joined.assumptions[-1] == joint.description
    assert body_properties(device(), None).weakest == np.inf


@pytest.mark.parametrize("mu_r", [0.0, -1.0, np.nan, np.inf, "3", True, 1j])
def test_permeabilities_that_nothing_has_are_refused(mu_r):
    with pytest.raises(InputError) as caught:
        body_properties(device("plain"), mu_r)
    assert caught.value.problems[0].where == "solve_linear, mu_r"


def test_sheets_come_behind_the_bodies():
    both = device("plain", "magnet")
    sheets = [SimpleNamespace(name="s", mu_r=2.0), SimpleNamespace(name="t", mu_r=3.0)]
    mesh = SimpleNamespace(body_names=("plain 0", "magnet 1", "s", "t"), sheets=sheets)
    found = body_properties(both, None).on(mesh)
    assert found.mu_r.tolist() == [100.0, 1.05, 2.0, 3.0]
    assert found.remanence.tolist() == [[0, 0, 0], [0.1, 0, -1.2], [0, 0, 0], [0, 0, 0]]
    assert [one.initial_mu_r for one in materials_on(both, mesh)] == [100.0, 1.05, 2.0, 3.0]
    alone = SimpleNamespace(body_names=("plain 0", "magnet 1"), sheets=())
    assert body_properties(both, None).on(alone).mu_r.tolist() == [100.0, 1.05]


def test_what_a_nonlinear_solve_cannot_have_is_named_at_once():
    joints = (fm.Joint(1e-4, ("plain 0", "steel 1"), 0.9), fm.Joint(1e-4, ("plain 0", "magnet 3"), 1.0))
    with pytest.raises(InputError) as caught:
        require_soft_bodies(device("plain", "steel", "barrier", "magnet", "weak", joints=joints))
    assert [one.where.split(", ", 1)[1] for one in caught.value.problems] == [
        "body 'barrier 2'",
        "body 'weak 4'",
        joints[0].description,
    ]
    assert [one.received for one in caught.value.problems][1:] == ["mu_r = 0.5", "mu_r = 0.9"]
    with pytest.raises(InputError) as caught:
        require_soft_bodies(device())
    assert caught.value.problems[0].received == "no bodies"
    require_soft_bodies(device("plain", "steel", "magnet"))


def test_assumptions_name_each_material_joint_and_background():
    background = Background(np.array([0.0, 1e-3, 0.0125]))
    joint = fm.Joint(1e-4, ("steel 0", "magnet 1"))
    found = material_assumptions(device("steel", "magnet", "steel", joints=(joint,), background=background))
    assert [one.split(":")[0] for one in found[:2]] == ["iron 'steel'", "magnet 'magnet'"]
    assert found[2] == joint.description
    assert "(0, 1, 12.5) mT" in found[3]
    assert len(found) == 4
    assert "gradient" not in found[3]


def test_warnings_of_saturation_name_the_worst_first(monkeypatch):
    found = [
        BodyBeyondSaturation("a", "steel", 2.1, 2.5, 0.02),
        BodyBeyondSaturation("b", "plain", 2.45, 9.0, 0.5),
        BodyBeyondSaturation("c", "steel", 2.1, 3.25, 0.125),
    ]
    monkeypatch.setattr(notes, "bodies_beyond_saturation", lambda *_: found)
    first, second = notes.saturation_warnings(None, None, None)
    assert [float(share) for share in re.findall(r"([\d.]+) %", first)] == [50.0]
    assert [float(share) for share in re.findall(r"([\d.]+) %", second)] == [12.5, 2.0]
    assert ("9 T" in first, "3.25 T" in second, "2.5 T" in second) == (True, True, False)
    monkeypatch.setattr(notes, "bodies_beyond_saturation", lambda *_: [])
    assert notes.saturation_warnings(None, None, None) == ()


TOOK, ASSUMED = {"mesh": 1.25, "solve": 2.5}, ("one", "two")
MADE = SolverReport("potential", 2000, 300, 280, 4500, 2, 7, 2.5e-5, 3_400_000, TOOK, ASSUMED)


def test_a_report_in_words_and_back_from_json():
    assert MADE.total_seconds == 3.75
    assert list(MADE.card_rows().values()) == [
        "2 magnetic bodies, symmetry: none",
        "2000 tetrahedra, 4500 unknowns, 3 MB",
        "not estimated",
        "2.5e-05 after 7 iterations",
        "3.8 s",
        "one; two",
    ]
    harder = replace(
        MADE, continuation=(0.25, 0.625), beyond_table=50, below_table=10, refinement=((30, 0.1),)
    )
    assert (MADE.steps_text, "25, 62.5 %" in harder.steps_text) == ("", True)
    assert re.findall(r"([\d.]+) % of the elements", str(harder)) == ["0.5", "2.5"]
    assert "of the elements" not in str(MADE)
    assert SolverReport.from_dict(json.loads(json.dumps(asdict(harder)))) == harder
    assert replace(MADE, tetrahedra=0).card_rows()["size"] == "4500 unknowns, 3 MB"


def test_notes_of_a_state_are_those_of_its_kind():
    """A linear state lists its assumptions, a saturating state also how far iron is driven, another field its own."""
    machine = device("plain", coils=(fm.CircularCoil("c", 0.05, 0.06, 0.01, 100),))
    linear = fm.solve_linear(machine, refinement=0.5)
    told = notes.state_notes(machine, linear.at([1e5]))
    assert told[: len(linear.assumptions)] == linear.assumptions
    assert told[-1].startswith("warning: linear iron does not saturate")
    assert notes.state_notes(machine, linear.at([1e-3])) == linear.assumptions
    steel = device("steel", coils=machine.coils)
    state = fm.iron.NonlinearSolver(steel, 0.5).at([1.0])
    told = notes.state_notes(steel, state)
    assert told[:-1] == state.assumptions
    assert f"iron up to {state.report.largest_flux_density:.2f} T" in told[-1]
    assert notes.state_notes(steel, SimpleNamespace(assumptions=["a"])) == ("a",)
    assert notes.state_notes(steel, None) == ()
    assert notes.saturates(steel)
    assert not notes.saturates(machine)
    outside = replace(MADE, below_table=10, beyond_table=1000)
    for one, counts in ((outside, ["10", "1,000"]), (replace(outside, beyond_table=0), ["10"]), (MADE, [])):
        assert re.findall(r"([\d,]+) elements", notes.law_range(one, steel)) == counts
    assert "linear" in notes.law_range(outside, machine)


def test_stages_tell_and_time_each_step(monkeypatch):
    clock = iter([1.0, 3.0, 3.5, 10.5, 11.0])
    monkeypatch.setattr(report.time, "perf_counter", lambda: next(clock))
    told = []
    stages = Stages(lambda *what: told.append(what))
    stages.next("mesh", 0.0)
    stages.next("solve", 0.5)
    stages.done()
    assert stages.seconds == {"mesh": 0.5, "solve": 7.0}
    assert told == [("mesh", 0.0), ("solve", 0.5), ("solved", 1.0)]
    stages.done("again")
    assert stages.seconds == {"mesh": 0.5, "solve": 7.0}


def test_sizes_grow_with_the_distance_from_where_they_are_asked():
    """Sizes grow by 0.3 of the distance from the nearest places; without places there is no limit."""
    places = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 10.0, 0]])
    sizes = LocalSizes(places, np.array([0.5, 0.1, 0.01]), places[:2], np.array([0.2, 0.3]))
    at = np.array([[0.0, 0, 0], [1.0, 0, 0.2], [0.2, 0, 0], [0.0, 9.0, 0.0]])
    expected = [
        min(s + 0.3 * np.linalg.norm(x - p) for p, s in zip(places, sizes.sizes, strict=True)) for x in at
    ]
    assert sizes.asked_at(at) == pytest.approx(expected)
    assert sizes.asked_at(at)[0] == pytest.approx(0.4)
    assert sizes.first_layer(at).tolist() == [0.2, 0.3, 0.2, 0.2]
    nothing = LocalSizes(places[:0], np.zeros(0), places[:0], np.zeros(0))
    assert nothing.asked_at(at).tolist() == [np.inf] * 4
    assert nothing.first_layer(at).tolist() == [np.inf] * 4


def test_sizes_of_cells_are_their_mean_edges_up_to_what_was_asked():
    corners = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 1.0]])
    points, tets = np.vstack([corners, 2 * corners + 100]), np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    mean = (3 + 4 + 1 + 5 + np.sqrt(10) + np.sqrt(17)) / 6 / 1.14
    of = partial(MesherCells.of, points, tets, np.arange(2))
    free = of(np.full(2, 9.0))
    assert free.sizes == pytest.approx([mean, 2 * mean])
    assert free.centres == pytest.approx(np.array([corners.mean(axis=0), 2 * corners.mean(axis=0) + 100]))
    assert of(np.array([9.0, 3.0])).sizes == pytest.approx([mean, 3.0])
    local = LocalSizes(free.centres[:1], np.array([1.5]), points[:0], np.zeros(0))
    assert of(np.full(2, 9.0), local).sizes == pytest.approx([1.5, 2 * mean])
