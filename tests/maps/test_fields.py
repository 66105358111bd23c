"""The fields of a map between the solver and the file: the kept parts, their order, and their expected time."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import CoilGroups, CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.errors import RecipeError
from fieldmap.iron import SolverReport
from fieldmap.maps import fields, generate, generation
from fieldmap.maps.fields import SaturatingFields, Stopwatch, box_surface, kept, trained_map
from fieldmap.progress import Forecast
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.store import Checkpoint, Grid, checkpoint_path, map_format, read_map
from fieldmap.store.reduced_model import ARRAYS
from tests.maps.test_resumed_training import COILS

RANDOM = np.random.default_rng(41)


def test_errors_are_looked_at_on_the_surface_of_the_box():
    """Seven by seven places of each face, ends included; places on edges and corners once."""
    points = box_surface(Grid([-1.0, 0.0, 2.0], [0.5, 1.0, 2.0], (5, 3, 4)))
    steps = (points - [-1.0, 0.0, 2.0]) / np.array([2.0, 2.0, 6.0]) * 6.0
    np.testing.assert_allclose(steps, steps.round(), atol=1e-12)
    cells = {tuple(row) for row in steps.round().astype(int).tolist()}
    assert len(cells) == len(points) == 7**3 - 5**3
    assert all(min(cell) == 0 or max(cell) == 6 for cell in cells)
    assert np.ptp(points, axis=0).tolist() == [2.0, 2.0, 6.0]


def test_fields_are_those_of_coils_then_iron_then_background():
    points, charge = 1e-3 * np.array([[1.0, 2.0, 30.0], [-8.0, 5.0, 25.0]]), np.ones((3, 4))
    iron, background = (
        (RANDOM.standard_normal((3, 2, 3)), RANDOM.standard_normal((3, 2, 3, 3))),
        (np.ones((2, 3)), np.ones((2, 3, 3))),
    )
    faces = SimpleNamespace(field_and_gradient=lambda at, of: iron if at is points and of is charge else None)
    for fixed in (None, SimpleNamespace(field_and_gradient=lambda at: background)):
        found = SaturatingFields(tuple(COILS), faces, charge, None, fixed).source_fields(points)
        for j, values in enumerate(found):
            coils = [unit_flux_density_and_gradient(coil, points)[j] for coil in COILS]
            expected = [*coils, *iron[j], *([] if fixed is None else [background[j]])]
            np.testing.assert_array_equal(values, expected)


@pytest.mark.parametrize("background", [None, "earth"])
def test_a_trained_model_is_read_back_with_its_largest_error(background):
    arrays = {name: RANDOM.standard_normal(2) for name in ARRAYS}
    face = {name: np.arange(3.0) for name in ("a", "b")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fields, "_FACES", list(face))
        patch.setattr(fields, "ChargedFaces", lambda **given: given)
        patch.setattr(fields, "ReducedModel", lambda **given: given)
        report = SolverReport(
            **dict.fromkeys(SolverReport.__dataclass_fields__, 0)
            | dict.fromkeys(("assumptions", "continuation", "refinement"), ())
        )
        tried = {"one": (1e-3, 7.0), "other": (2e-3, 5.0)}
        about = {
            "states_tried": {kind: {"flux_density": b, "gradient": g} for kind, (b, g) in tried.items()},
            "parametrisation": IndependentCurrents(2).to_json(),
            "report": json.loads(json.dumps(report.to_dict())),
            "largest_weights": [2.0, 3.0, 0.5, 0.25, 0.125],
            "modes": 2,
        }
        device = SimpleNamespace(coils=tuple(COILS), background=background)
        given = (
            arrays
            | {f"face_{name}": values for name, values in face.items()}
            | {"charge": np.eye(3), "remanent": np.ones(2)}
        )
        found = trained_map(device, given, about)
    assert (found.error.flux_density, found.error.gradient) == (2e-3, 7.0)
    assert found.largest_weights.tolist() == [2.0, 3.0, 0.5, 0.25, 0.125] + (
        [] if background is None else [1.0]
    )
    assert set(found.about) == {"states_tried", "largest_weights", "modes"}
    assert (found.fields.coils, found.fields.background) == (tuple(COILS), background)
    np.testing.assert_array_equal(found.fields.charge, np.eye(3))
    np.testing.assert_array_equal(found.remanent, np.ones(2))
    assert {name: values.tolist() for name, values in found.fields.faces.items()} == {
        name: [0.0, 1.0, 2.0] for name in face
    }
    assert found.model.pop("parametrisation") == IndependentCurrents(2)
    assert {name: values.tolist() for name, values in found.model.items()} == {
        name: arrays[name].tolist() for name in ARRAYS
    }


def test_what_is_kept_is_made_once(tmp_path):
    made = []

    def make(*given):
        made.append(given)
        return {"numbers": np.arange(3.0)}, {"text": "made"}

    with Checkpoint(tmp_path / "a.partial", "one") as checkpoint:
        for _ in range(2):
            arrays, about = kept(checkpoint, "piece", make, 1, 2)
            assert (arrays["numbers"].tolist(), about["text"]) == ([0.0, 1.0, 2.0], "made")
    assert made == [(1, 2)]


def test_a_stopwatch_counts_all_processors_and_what_was_spent_before(monkeypatch):
    clock = {"wall": 100.0, "own": 7.0}
    workers = SimpleNamespace(processor_seconds=3.0)
    monkeypatch.setattr(fields, "monotonic", lambda: clock["wall"])
    monkeypatch.setattr(fields, "process_time", lambda: clock["own"])
    watch = Stopwatch(workers, 20.0, 30.0)
    clock.update(wall=104.0, own=9.0)
    workers.processor_seconds = 8.0
    watch.add(0.5, 0.25)
    assert watch.read() == {"generation_seconds": 24.5, "generation_processor_seconds": 37.25}
    assert Stopwatch(workers).read() == {"generation_seconds": 0.0, "generation_processor_seconds": 0.0}


def box(lower, upper, of=None):
    return CurrentDomain(of or IndependentCurrents(2), np.array(lower), np.array(upper))


@pytest.mark.parametrize(
    ("given", "domain", "expected"),
    [
        (None, None, [1.0, 1.0]),
        (2.5, None, [2.5, 2.5]),
        # The middle of the domain; if that is not positive, the largest current of the corners.
        (None, box([1.0, 0.5], [2.0, 4.5]), [1.5, 2.5]),
        (None, box([-3.0, 0.5], [2.0, 1.5]), [3.0, 1.0]),
        (None, box([-2.0, -5.0], [2.0, 1.0]), [5.0, 5.0]),
        (1.75, box([1.0, 0.5], [2.0, 4.5]), [1.75, 1.75]),
        (1.25, box([1.0], [2.0], CoilGroups([[0, 1]])), [1.25, 1.25]),
        (9.0, box([1.0, -0.1, -0.1], [2.0, 0.1, 0.1], LiftAndDirections(1.0)), [9.0] * 6),
        (0.75, box([1.0, 0.5], [2.0, 4.5]), None),
    ],
)
def test_currents_at_which_a_map_states_its_fields(given, domain, expected):
    if expected is None:
        with pytest.raises(
            RecipeError, match=r"output\.reference_current_A.*within .currents.*received 0\.75"
        ):
            generation._reference_current(given, domain, 2)
        return
    assert generation._reference_current(given, domain, len(expected)).tolist() == expected


@pytest.fixture
def parts(coarse, monkeypatch):
    """The folder of a map of 8 planes of nodes, in parts of two; told(...) makes it and gives its progress texts."""
    text = (coarse / "recipe.toml").read_text()
    (coarse / "recipe.toml").write_text(text.replace("spacing_mm = 6.0", "spacing_mm = [3.0, 6.0, 6.0]"))
    monkeypatch.setattr(map_format, "NODES_PER_CHUNK", 55)

    def told(stop=None, **more):
        texts = []

        def tell(text, share):
            texts.append(re.sub(r", [\d.]+ (nodes/s|s a node)$", "", text))
            assert 0.0 <= share <= 1.0
            if stop and stop in text:
                raise KeyboardInterrupt

        target = coarse / "map.h5"
        try:
            generate(coarse / "recipe.toml", target, progress=tell, **more)
        except KeyboardInterrupt:
            assert checkpoint_path(target).exists()
        return texts

    return SimpleNamespace(told=told, folder=coarse)


def test_nodes_are_told_part_by_part_and_a_stopped_run_goes_on_with_those_it_lacks(parts):
    ends = ["certifying the lookup against the solver", "complete"]
    whole = [text for text in parts.told() if "part" in text or text in ends]
    assert whole == [f"field at the nodes, part {k} of 4" for k in range(1, 5)] + ends
    made = read_map(parts.folder / "map.h5")
    assert made.grid.shape == (8, 5, 5)
    assert parts.told()[-1] == "complete already"
    (parts.folder / "map.h5").unlink()
    parts.told(stop="part 3 of")
    texts = parts.told()
    assert texts.index("resumed with 2 of 4 parts") == texts.index("field at the nodes, part 3 of 4") - 1
    assert [text for text in texts if "at the nodes" in text] == [
        f"field at the nodes, part {k} of 4" for k in (3, 4)
    ]
    np.testing.assert_array_equal(read_map(parts.folder / "map.h5").flux_density, made.flux_density)
    # Kept parts of another recipe are reported and not used.
    (parts.folder / "map.h5").unlink()
    parts.told(stop="part 3 of")
    recipe = parts.folder / "recipe.toml"
    recipe.write_text(recipe.read_text().replace("[3.0, 6.0, 6.0]", "[3.0, 5.0, 6.0]"))
    texts = parts.told()
    assert sum(text.startswith(checkpoint_path(parts.folder / "map.h5").name) for text in texts) == 1
    assert not any("resumed" in text for text in texts)


def test_nodes_and_certificate_are_expected_by_their_amounts(parts, monkeypatch):
    """Without iron there are no faces: 0.07 ms for each field in each cell, for 7 x 4 x 4 cells and two coils."""
    noted = {}

    class Noting(Forecast):
        def expect(self, stage, work):
            noted.setdefault(stage, []).append(work)
            super().expect(stage, work)

    monkeypatch.setattr(generation, "Forecast", Noting)
    parts.told()
    # 200 nodes, 6 x 24 x 24 points of the certificate, and 5 us for each coil at each point.
    assert noted["nodes"][-1] == pytest.approx(200 * 2 * 5e-6)
    assert noted["certificate"][-1] == pytest.approx(3456 * 2 * 5e-6 + 7e-5 * 112 * 2)
