"""Faults found by mutating files: each was a traceback, an endless run or gigabytes requested by a few letters."""

import pytest

from fieldmap.cli.arguments import parse_settings
from fieldmap.device import read_device
from fieldmap.dynamics import read_scenario
from fieldmap.errors import DeviceFileError, RecipeError, ScenarioError, StudyError
from fieldmap.maps.recipe import read_recipe, read_recipe_device
from fieldmap.shipped import shipped_file
from fieldmap.studies.reading import read_study

LONG = "x" * 5000
HEAD = 'format = 1\nname = "a"\ntitle = "a"\n'
COIL = '[[coil]]\nname = "c"\nkind = "circular"\ninner_radius_mm = 1\nouter_radius_mm = 2\nheight_mm = 1\nturns = 1\n'
BODY = '[[body]]\nname = "b"\nmaterial = "m"\nmesh_size_mm = 1\nshape = "step_file"\nunit_mm = 1\n'
CURVE = 'kind = "bh_table"\nbelow = "straight line to the origin"\nabove = "slope mu0"\n'


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (f'include = "{LONG}"\n{HEAD}{COIL}', "include"),
        (f'{HEAD}{COIL}[material.m]\n{CURVE}file = "{LONG}"\n', "file"),
        (f'{HEAD}{COIL}{BODY}file = "{LONG}"\n', "file"),
    ],
)
def test_a_name_that_no_file_can_have(tmp_path, text, key):
    path = tmp_path / "device.toml"
    path.write_text(text)
    with pytest.raises(DeviceFileError) as caught:
        read_device(path)
    assert any(problem.where.endswith(key) for problem in caught.value.problems)


def test_a_whole_number_that_python_does_not_read(tmp_path):
    path = tmp_path / "device.toml"
    path.write_text(HEAD + COIL.replace("turns = 1", f"turns = {'9' * 5000}"))
    with pytest.raises(DeviceFileError) as caught:
        read_device(path)
    line = path.read_text().splitlines().index(f"turns = {'9' * 5000}") + 1
    assert [problem.where for problem in caught.value.problems] == [f"{path}:{line}"]
    assert parse_settings([f"coil.c.turns={'9' * 5000}"]) == {"coil.c.turns": "9" * 5000}


READERS = {
    read_device: DeviceFileError,
    read_recipe: RecipeError,
    read_study: StudyError,
    read_scenario: ScenarioError,
}


def test_such_a_name_for_any_file(tmp_path):
    for read, error in READERS.items():
        with pytest.raises(error):
            read(LONG)
    (tmp_path / "recipe.toml").write_text(RECIPE.replace("drive_unit", LONG))
    with pytest.raises(RecipeError):
        read_recipe_device(read_recipe(tmp_path / "recipe.toml"))


RECIPE = 'format = 1\ntitle = "a"\ndevice = "drive_unit"\nspacing_mm = 4\n'
DIVISION = f'{RECIPE}[iron]\nmodel = "saturating"\n[currents.lift_and_directions]\nlimit_A = 3.0\n'


@pytest.mark.parametrize(
    "text",
    [
        RECIPE.replace("spacing_mm = 4", f"spacing_mm = {10**400}"),
        f"{RECIPE}[iron]\nmu_r = {10**400}\n",
        f"{DIVISION}u_A = [1.0, 1e308]\nx = [-0.4, 0.4]\ny = [-0.4, 0.4]\n",
        f"{DIVISION}u_A = [1e307, 1e308]\nx = [-1e308, 0.4]\ny = [-0.4, 0.4]\n",
    ],
)
def test_numbers_that_no_float_holds(tmp_path, text):
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(RecipeError):
        read_recipe(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("duration_s = 4.0", "duration_s = 1e12"),
        ("step_ms = 0.1", "step_ms = 1e-12"),
        ("by_mm = 1.0", f"by_mm = 1.0\ntimes = {10**400}"),
        ("[start]", f"[record]\nevery = {10**30}\n\n[start]"),
    ],
)
def test_a_run_has_a_bounded_length(tmp_path, old, new):
    text = shipped_file("maps", "scenarios/vertical_step").read_text()
    assert old in text
    path = tmp_path / "run.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ScenarioError):
        read_scenario(path)
