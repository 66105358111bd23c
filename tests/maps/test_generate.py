"""From recipe to map: against closed forms and the solver, finished maps left alone, bad input leaving nothing."""

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import DeviceFileError, GeometryError, InputError, NotConverged, Problem, RecipeError
from fieldmap.iron import solve_linear
from fieldmap.lookup import open_map
from fieldmap.maps import generate, generation
from fieldmap.store import checkpoint_path, read_info

MU0 = 4e-7 * np.pi


def on_axis(z, centre, turns):
    """Bz per ampere on the axis of the rig's coils (radii 20 and 30 mm, height 12 mm).

    A stack of discs of current integrated in closed form; Montgomery, Solenoid Magnet Design, 1969, eq. (2.3).
    """
    a, b, length = 0.020, 0.030, 0.012

    def end(s):
        return s * np.log((b + np.hypot(b, s)) / (a + np.hypot(a, s)))

    s = z - centre
    return MU0 * turns / (2 * length * (b - a)) * (end(s + length / 2) - end(s - length / 2))


@pytest.fixture
def path(rig, rig_map):
    """A copy of the finished map, beside its recipe."""
    (rig / "out").mkdir()
    return Path(shutil.copy(rig_map, rig / "out" / "map.h5"))


def test_field_on_the_axis_is_the_closed_form(path):
    opened = open_map(path)
    currents = np.array([2.0, -0.5])
    z = np.linspace(-0.012, 0.012, 41)
    points = np.stack([0 * z, 0 * z, z], axis=1)

    def exact(z):
        return 2.0 * on_axis(z, 0.04, 100) - 0.5 * on_axis(z, -0.04, 200)

    flux, slope = opened.field_and_gradient(points, currents)
    scale = np.abs(exact(z)).max()
    np.testing.assert_allclose(flux[:, 2], exact(z), rtol=0, atol=2e-6 * scale)
    # A cell's polynomial does not know the axis: zero to the interpolation error only.
    np.testing.assert_allclose(flux[:, :2], 0, atol=5e-7 * scale)
    np.testing.assert_allclose(open_map(path, "hermite").field(points, currents)[:, :2], 0, atol=1e-9 * scale)
    derivative = (exact(z + 1e-6) - exact(z - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope[:, 2, 2], derivative, rtol=0, atol=1e-4 * np.abs(derivative).max())


def test_iron_and_coil_against_the_closed_form_of_a_sphere(rig, recipe_text):
    (rig / "sphere.toml").write_text(recipe_text.replace("pair.toml", "loop_and_sphere"))
    opened = open_map(generate(rig / "sphere.toml", rig / "sphere.h5"))
    compared = 0
    for known in read_device("loop_and_sphere").references:
        flux, slope = opened.field_and_gradient(known.at, known.currents)
        if known.quantity.startswith("B"):
            ours = flux["xyz".index(known.quantity[1])]
        else:
            ours = slope["xyz".index(known.quantity[2]), "xyz".index(known.quantity[-1])]
        assert ours == pytest.approx(known.value, rel=2e-3), known
        compared += 1
    assert compared >= 8
    assert "mu_r = 1000" in opened.info.provenance.assumptions[0]
    assert opened.info.provenance.solver_report["surface_faces"] > 100


def test_refinement_reaches_the_mesher(rig, recipe_text):
    faces = []
    for refinement in ("0.5", "1.0"):
        recipe = recipe_text.replace("pair.toml", "loop_and_sphere").replace("2.0", "3.0")
        lines = recipe + f"[iron]\nrefinement = {refinement}\n"
        (rig / "sphere.toml").write_text(lines)
        info = read_info(generate(rig / "sphere.toml", rig / "sphere.h5", accept_error=True))
        faces.append(info.provenance.solver_report["surface_faces"])
    assert faces[1] > 2 * faces[0]


def test_recorded_interpolation_error_is_what_other_points_show(path, rig):
    opened = open_map(path, "hermite")
    solution = solve_linear(read_device(rig / "pair.toml"))
    points = opened.lower + np.random.default_rng(99).random((2000, 3)) * (opened.upper - opened.lower)
    flux, slope = solution.unit_fields(points)
    of_flux = np.linalg.norm(opened.unit_field(points).swapaxes(0, 1) - flux, axis=2).sum(axis=0).max()
    of_slope = (
        np.linalg.norm(opened.unit_gradient(points).swapaxes(0, 1) - slope, axis=(2, 3)).sum(axis=0).max()
    )
    recorded = opened.interpolation_error
    assert of_flux == pytest.approx(recorded.flux_density, rel=0.5)
    assert of_slope == pytest.approx(recorded.gradient, rel=0.5)
    assert opened.error_bound is None  # of this form


def test_half_the_spacing_gives_a_sixteenth_of_the_error(rig, recipe_text, monkeypatch):
    monkeypatch.setattr(generation, "certified_bounds", lambda *_: {})  # another error, and most of the time
    errors = []
    for spacing in ("3.0", "1.5"):
        (rig / "recipe.toml").write_text(recipe_text.replace("2.0", spacing))
        error = read_info(generate(rig / "recipe.toml", rig / "map.h5")).interpolation_error
        errors.append([error.flux_density, error.gradient])
    orders = -np.diff(np.log2(errors), axis=0).mean(axis=0)
    assert 3.6 < orders[0] < 4.5
    assert 2.6 < orders[1] < 3.5


def test_record_of_what_made_it(path, rig):
    info = read_info(path)
    record = info.provenance
    assert record.recipe_text == (rig / "recipe.toml").read_text()
    assert record.device_text == (rig / "pair.toml").read_text()
    assert f'title = "{record.title}"' in record.recipe_text
    assert record.device_name == "pair"
    assert {"fieldmap", "numpy", "netgen-mesher"} <= set(record.versions)
    assert len(record.fingerprint) == 64
    (assumption,) = record.assumptions
    assert "no iron" in assumption
    assert info.coil_names == ("upper", "lower")


def test_record_of_what_the_device_takes_from_other_files(coarse):
    curve = read_device("drive_unit").included["materials/steel_a3.toml"]
    (coarse / "steel.toml").write_text(curve)
    keys = [
        'kind = "bh_table"',
        'file = "steel.toml"',
        'below = "straight line to the origin"',
        'above = "slope mu0"',
    ]
    material = "\n".join(["[material.steel]", *keys, ""])
    device = coarse / "pair.toml"
    device.write_text(f"{device.read_text()}\n{material}")
    record = read_info(generate(coarse / "recipe.toml", coarse / "map.h5")).provenance
    assert record.included == {"steel.toml": curve}
    assert record.solver_report["workers"] == "one process"


def test_progress_runs_from_nothing_to_all(coarse):
    told = []
    generate(
        coarse / "recipe.toml", coarse / "map.h5", progress=lambda text, share: told.append((text, share))
    )
    shares = [share for _, share in told]
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert all(0.0 <= share < 1.0 for share in shares[:-1])
    assert all(isinstance(text, str) and text for text, _ in told)


def test_progress_on_a_terminal_without_the_extra_of_the_program_is_in_lines(coarse, monkeypatch, capsys):
    """The extra `make` does not install rich."""
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    generate(coarse / "recipe.toml", coarse / "map.h5")
    assert "100 %" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("asked", "terminal", "told"),
    [
        ({}, True, "bar"),
        ({}, False, ""),
        ({"progress": True}, False, "lines"),
        ({"progress": False}, True, ""),
    ],
)
def test_progress_is_shown_on_a_terminal_or_where_it_is_asked_for(
    coarse, capsys, monkeypatch, asked, terminal, told
):
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
    bars = []
    monkeypatch.setattr(
        "fieldmap.progress._bar",
        lambda: SimpleNamespace(
            start=lambda: None,
            stop=lambda: bars.append("stopped"),
            add_task=lambda *_, **__: 1,
            update=lambda *_, completed, **__: bars.append(completed),
        ),
    )
    generate(coarse / "recipe.toml", coarse / "shown.h5", **asked)
    lines = capsys.readouterr().err.splitlines()
    assert any(" map: 100 %" in line for line in lines) == (told == "lines")
    assert bars[-2:] == ([1.0, "stopped"] if told == "bar" else [])
    assert told or not lines


def test_a_finished_map_is_left_alone_until_something_changes(coarse):
    rig, path = coarse, generate(coarse / "recipe.toml", coarse / "map.h5")
    stamp = path.stat().st_mtime_ns
    told = []
    generate(rig / "recipe.toml", path, progress=lambda text, share: told.append(text))
    assert path.stat().st_mtime_ns == stamp
    assert told[-1] == "complete already"
    generate(rig / "recipe.toml", path, resume=False)
    again = path.stat().st_mtime_ns
    assert again != stamp
    device = rig / "pair.toml"
    device.write_text(device.read_text().replace("turns = 100", "turns = 101"))
    generate(rig / "recipe.toml", path)
    assert path.stat().st_mtime_ns != again
    assert open_map(path).field([0, 0, 0], [1, 0])[2] == pytest.approx(on_axis(0, 0.04, 101), rel=1e-5)


def test_a_ruined_map_is_made_again(path, coarse):
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    generate(coarse / "recipe.toml", path)
    assert open_map(path).coil_names == ("upper", "lower")


def test_default_place_is_maps_out_below_the_current_folder(coarse, monkeypatch):
    monkeypatch.chdir(coarse)
    path = generate("recipe.toml")
    assert path.resolve() == coarse / "maps" / "out" / "recipe.h5"


WINDING = "[box]\nlower_mm = [-25, -25, 0]\nupper_mm = [25, 25, 36]\n"
SPHERE = "[box]\nlower_mm = [-8, -8, -20]\nupper_mm = [8, 8, -5]\n"


@pytest.mark.parametrize(
    ("box", "device", "turns", "output", "error", "words"),
    [
        (WINDING, "pair.toml", "100", "map.h5", GeometryError, "'upper'"),
        (SPHERE, "loop_and_sphere", "100", "map.h5", GeometryError, "'sphere'"),
        ("", "pair.toml", '"many"', "map.h5", DeviceFileError, "coil.upper.turns"),
        ("", "pair.toml", "100", "map.csv", RecipeError, "must end in .h5 or .hdf5"),
        ("", "pair.toml", "100", ".", RecipeError, "must end in .h5 or .hdf5"),
        ("", "pair.toml", "100", "pair.toml/map.h5", InputError, "pair.toml is a file"),
    ],
)
def test_what_is_wrong_leaves_no_file(rig, recipe_text, box, device, turns, output, error, words):
    (rig / "recipe.toml").write_text(recipe_text.replace("pair.toml", device) + box)
    pair = rig / "pair.toml"
    pair.write_text(pair.read_text().replace("turns = 100", f"turns = {turns}"))
    before = sorted(rig.rglob("*"))
    with pytest.raises(error, match=words) as caught:
        generate(rig / "recipe.toml", rig / output)
    assert caught.value.exit_code == 2
    assert sorted(rig.rglob("*")) == before


def test_a_solver_that_fails_leaves_nothing(rig, monkeypatch):
    def fail(*_, **__):
        raise NotConverged(Problem("solve", "residual below 1e-7", "1e-3", "refine"), residuals=(1.0, 1e-3))

    monkeypatch.setattr(generation, "solve_linear_and_reaction", fail)
    before = sorted(rig.rglob("*"))
    with pytest.raises(NotConverged):
        generate(rig / "recipe.toml", rig / "map.h5")
    assert sorted(rig.rglob("*")) == before
    assert not checkpoint_path(rig / "map.h5").exists()
