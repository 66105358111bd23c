"""Boxes of maps that come near to iron, and boxes in which the field is singular: refused, and nothing is written."""

import magpylib
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import MapFileError, RecipeError
from fieldmap.maps.error_bound import interpolation_error
from fieldmap.maps.near_sources import largest_field, least_distance, require_use
from fieldmap.maps.recipe import choose_grid
from fieldmap.store import FieldError, Grid
from fieldmap.store.map_data import MapData
from tests.iron.shared import at


@pytest.fixture(scope="module")
def pole():
    """A square pole of 20 mm whose face is the plane z = 0, in a coil, and a ball far to the side of it."""
    bodies = (
        fm.Body("pole", "iron", fm.Box((0.02, 0.02, 0.03)), 0.006),
        fm.Body("ball", "iron", (fm.Part(fm.Sphere(0.004), at(0.03, 0, -0.01)),), 0.004),
    )
    coil = fm.CircularCoil("coil", 0.018, 0.025, 0.02, 100.0, placement=at(0, 0, 0.015))
    return fm.Device("pole", "", (coil,), bodies, {"iron": fm.LinearMaterial("iron", 1000.0)})


def refused(tmp_path, device, box, spacing=2e-3, **more):
    with pytest.raises((RecipeError, MapFileError)) as caught:
        fm.generate(device, tmp_path / "map.h5", spacing=spacing, box=box, progress=False, **more)
    assert caught.value.exit_code == 2
    assert list(tmp_path.iterdir()) == []
    assert all(problem.where.endswith((": box", "x-planes 0 to 5")) for problem in caught.value.problems)
    return caught.value.problems


@pytest.mark.parametrize(
    ("top", "received", "finer"), [(0.0, "0 mm", ""), (-1e-4, "0.1 mm", "0.1"), (-1.8e-3, "1.8 mm", "1.8")]
)
def test_a_box_at_a_pole_is_refused_before_any_work(tmp_path, monkeypatch, pole, top, received, finer):
    monkeypatch.setattr("fieldmap.maps.generation.solve_linear_and_reaction", None)
    (problem,) = refused(tmp_path, pole, ([-0.01, -0.01, top - 0.01], [0.01, 0.01, top]))
    assert problem.received == f"{received} from body 'pole'"
    # 2 mm (1e-2 / 1e-2)^(1/3)
    assert "must keep 2 mm" in problem.must_hold
    assert (f"spacing_mm = {finer}," in problem.remedy) == bool(finer)


def test_an_error_may_be_accepted_at_any_distance_but_none(tmp_path, pole):
    near = [-0.01, -0.01, -0.012], [0.01, 0.01, -1.5e-3]
    fm.generate(pole, tmp_path / "near.h5", spacing=2.5e-3, box=near, progress=False, accept_error=True)
    assert fm.open_map(tmp_path / "near.h5").interpolation_error.flux_density > 0.0
    (tmp_path / "near.h5").unlink()
    refused(tmp_path, pole, ([-0.01, -0.01, -0.01], [0.01, 0.01, 0.0]), accept_error=True)


def test_every_body_that_is_too_near_is_told(tmp_path, pole):
    problems = refused(tmp_path, pole, ([-0.01, -0.01, -0.02], [0.025, 0.01, -0.0015]))
    assert [problem.received for problem in problems] == ["1.5 mm from body 'pole'", "1 mm from body 'ball'"]


def test_the_accuracy_of_saturating_iron_counts(tmp_path, pole):
    """4 mm (1e-2 / 1.6e-2)^(1/3): the pole is at 3 mm, the ball at 5 mm."""
    box = [-0.01, -0.01, -0.02], [0.021, 0.01, -0.003]
    (problem,) = refused(
        tmp_path, pole, box, 4e-3, currents={"lower_A": 0.0, "upper_A": 1.0, "accuracy": 8e-3}
    )
    assert "3.42 mm" in problem.must_hold
    assert "currents.accuracy" in problem.must_hold


@pytest.mark.parametrize(("spacing", "wanted"), [(4e-3, 1e-3), (4e-3, 1e-2), (2e-3, 1e-3), (1e-3, 1e-3)])
def test_lookups_at_the_least_distance_are_as_good_as_wanted(pole, spacing, wanted):
    """Against the solver at random points and at the outer cells' centres, below a pole with sharp edges; at a third of
    the distance the errors are larger than wanted."""
    solution = fm.solve_linear(pole)

    def error_at(distance):
        lower, upper = np.array([-0.016, -0.016, -0.016 - distance]), np.array([0.016, 0.016, -distance])
        grid = choose_grid((lower, upper), np.full(3, spacing))
        flux, gradient = solution.source_fields(grid.points(0, grid.shape[0]))
        values = {
            "flux_density": flux.reshape(1, *grid.shape, 3),
            "gradient": gradient.reshape(1, *grid.shape, 3, 3),
        }
        data = MapData(grid=grid, coil_names=("coil",), reference_current=np.ones(1), **values)
        found = interpolation_error(data, solution.source_fields).flux_density
        return found / np.linalg.norm(flux, axis=-1).max()

    distance = least_distance(spacing, wanted)
    assert error_at(distance) < wanted < error_at(distance / 3)


def test_what_is_asked_of_a_distance_is_told_in_numbers(tmp_path, pole):
    """1 % of B; with an accuracy, twice it, which takes 4.31 mm at nodes 2 mm apart, or nodes 0.93 mm apart."""
    near = [-0.01, -0.01, -0.012], [0.01, 0.01, -2e-3]
    (problem,) = refused(tmp_path, pole, near, 2.5e-3)
    assert problem.must_hold == (
        "must keep 2.5 mm from iron and magnets, for lookups within 1 % of B between nodes 2 mm apart"
    ).replace("2 mm apart", "2.5 mm apart")
    currents = {"lower_A": 0.0, "upper_A": 1.0, "accuracy": 5e-4}
    (problem,) = refused(tmp_path, pole, near, currents=currents)
    assert (
        "4.31 mm from iron and magnets, for lookups within 0.1 % of B (twice currents.accuracy)"
        in problem.must_hold
    )
    assert "between nodes 2 mm apart" in problem.must_hold
    assert "take spacing_mm = 0.93," in problem.remedy


def test_errors_below_what_was_measured_ask_for_no_more_distance():
    assert (
        least_distance(1e-3, 1e-9)
        == least_distance(1e-3, 3e-4)
        == pytest.approx(1e-3 * (1e-2 / 3e-4) ** (1 / 3))
    )
    assert least_distance(1e-3, 2e-2) == pytest.approx(1e-3 * 0.5 ** (1 / 3))


@pytest.mark.parametrize(
    ("flux", "gradient", "bound", "useful"),
    [
        (0.6999, 9.0, 9.0, True),
        (0.7001, 0.0, 0.0, False),
        (np.nan, 0.0, 0.0, False),
        (0.1, np.inf, 0.0, False),
        (0.1, 0.0, np.nan, False),
        (0.1, 0.0, np.inf, False),
    ],
)
def test_a_map_that_is_off_by_more_than_a_tenth_of_its_field_is_of_no_use(flux, gradient, bound, useful):
    """Two coils of 2 T and 0.5 T per ampere at one node, at 3 A and 2 A: 7 T."""
    of = np.zeros((2, 3, 3, 3, 3))
    of[:, 1, 2, 0] = [[0.0, -2.0, 0.0], [0.3, 0.0, 0.4]]
    of[1, 0, 0, 0] = [0.0, 0.0, 3.0]
    data = MapData(
        Grid(np.zeros(3), np.ones(3), (3, 3, 3)),
        ("a", "b"),
        [3.0, 2.0],
        flux_density=of,
        gradient=np.zeros((*of.shape, 3)),
    )
    error, bounds = FieldError(flux, gradient), {"global": FieldError(0.0, bound)}
    if useful:
        require_use(largest_field(data), error, bounds)
        return
    with pytest.raises(RecipeError) as caught:
        require_use(largest_field(data), error, bounds)
    (problem,) = caught.value.problems
    assert (problem.where, problem.must_hold) == ("box", "lookups must be within 10 % of the largest B, 7 T")
    assert problem.received == f"{flux:.3g} T and {gradient:.3g} T/m off at the points tried"


@pytest.mark.parametrize(
    ("at", "where"), [((0.0, 0.0, 0.0), "x-planes 0 to 5"), ((1e-3, 7e-4, 0.0), ": box")]
)
def test_a_singular_field_of_unknown_place_is_refused(tmp_path, at, where):
    """The field of a charged line through nodes or between them, in a source without a known place: the nodes show the
    singularity, or the error of the lookups does."""

    def field(field, observers):
        away = (np.array(observers) - at) * [1.0, 1.0, 0.0]
        return 1e7 * away / (np.sum(away**2, axis=-1, keepdims=True) + 1e-30)

    device = fm.Device.from_magpylib(magpylib.misc.CustomSource(field_func=field))
    corner = np.full(3, 1e-2)
    (problem,) = refused(tmp_path, device, (-corner, corner))
    assert problem.where.endswith(where)
