"""Reading recipes: the shipped ones, and the message of each mistake."""

import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.errors import RecipeError
from fieldmap.maps import generate, read_recipe
from fieldmap.maps.recipe import choose_grid, read_recipe_device, recipe_for
from fieldmap.shipped import shipped_names


@pytest.mark.parametrize("name", shipped_names("maps"))
def test_shipped_recipes_are_sound(name):
    recipe = read_recipe(name)
    device = read_recipe_device(recipe)
    grid = choose_grid(recipe.box(device), recipe.spacing)
    assert recipe.file_name == f"{name}.h5"
    if name == "sample":  # a small box, for a small file
        assert (grid.lower > device.workspace.lower).all()
        assert (grid.upper < device.workspace.upper).all()
        return
    np.testing.assert_allclose(grid.lower, device.workspace.lower)
    np.testing.assert_allclose(grid.upper, device.workspace.upper, atol=1e-15)


def test_everything_a_recipe_can_say(rig):
    text = """
    format = 1
    title = "All keys"
    device = "pair.toml"
    spacing_mm = [2, 2.5, 1.0]
    [box]
    lower_mm = [-1, -2, -3]
    upper_mm = [9, 8, 7]
    [iron]
    model = "linear"
    mu_r = 4000
    tolerance = 1e-4
    refinement = 1.5
    [output]
    file = "other.h5"
    reference_current_A = 1.5
    """
    (rig / "recipe.toml").write_text(text)
    recipe = read_recipe(rig / "recipe.toml")
    assert (recipe.title, recipe.device, recipe.file_name) == ("All keys", "pair.toml", "other.h5")
    assert (recipe.mu_r, recipe.tolerance, recipe.reference_current) == (4000.0, 1e-4, 1.5)
    assert recipe.refinement == 1.5
    np.testing.assert_allclose(recipe.spacing, [2e-3, 2.5e-3, 1e-3])
    np.testing.assert_allclose(recipe.lower, [-1e-3, -2e-3, -3e-3])
    np.testing.assert_allclose(recipe.upper, [9e-3, 8e-3, 7e-3])


SATURATING = """
    format = 1
    title = "Currents"
    device = "pair.toml"
    spacing_mm = 2.0
    [iron]
    model = "saturating"
    tolerance = 2e-3
    [currents]
    {}
"""
ONE_RANGE = "lower_A = 0.5\nupper_A = 2.0\n"


def saturating(rig, lines):
    (rig / "recipe.toml").write_text(SATURATING.format(lines))
    return read_recipe(rig / "recipe.toml").currents


def test_everything_that_it_says_of_currents(rig):
    given = {"states": 41, "accuracy": 0.002, "modes": 33, "points": 444, "fields": 11, "held_out": 7}
    lines = "\n".join(f"{key} = {value}" for key, value in given.items())
    plan = saturating(rig, f"lower_A = [0.5, -1.0]\nupper_A = 2.0\n{lines}")
    assert {key: getattr(plan, key) for key in given} == given
    assert plan.tolerance == 2e-3
    domain = plan.domain(("upper", "lower"))
    assert (domain.lower.tolist(), domain.upper.tolist()) == ([0.5, -1.0], [2.0, 2.0])
    assert saturating(rig, ONE_RANGE).domain(("a", "b", "c")).lower.tolist() == [0.5, 0.5, 0.5]
    # The values in docs/recipes.md.
    plan = saturating(rig, ONE_RANGE)
    usual = {"states": 64, "accuracy": 1e-3, "modes": 60, "points": 800, "fields": 20, "held_out": 12}
    assert {key: getattr(plan, key) for key in given} == usual


def test_currents_of_groups_and_of_a_division(rig):
    plan = saturating(rig, 'lower_A = [0.5, -1.0]\nupper_A = [2.0, 3.0]\ngroups = [["c", "a"], ["b"]]')
    domain = plan.domain(("a", "b", "c"))
    assert domain.parametrisation.currents([4.0, 5.0]).tolist() == [4.0, 5.0, 4.0]
    assert (domain.lower.tolist(), domain.upper.tolist()) == ([0.5, -1.0], [2.0, 3.0])
    signals = "u_A = [1.0, 2.5], x = [-0.3, 0.2], y = [-0.1, 0.3]"
    domain = saturating(rig, f"lift_and_directions = {{ {signals}, n = 1.25, limit_A = 3.5 }}").domain(
        "123456"
    )
    assert (domain.lower.tolist(), domain.upper.tolist()) == ([1.0, -0.3, -0.1], [2.5, 0.2, 0.3])
    assert (domain.parametrisation.n, domain.parametrisation.limit) == (1.25, 3.5)
    domain = saturating(rig, f"lift_and_directions = {{ {signals} }}").domain("123456")
    assert (domain.parametrisation.n, domain.parametrisation.limit) == (1.0, None)


@pytest.mark.parametrize(("limit", "taken"), [(1.69, False), (1.7, True)])
def test_the_smallest_lift_leaves_every_coil_below_its_limit(rig, limit, taken):
    """The coil with both directions at 0.3 has the largest current: 1.3 times 1.3 A."""
    line = f"lift_and_directions = {{ u_A = [1, 2], x = [-0.2, 0.3], y = [-0.3, 0.1], n = 1.0, limit_A = {limit} }}"
    if taken:
        assert saturating(rig, line) is not None
        return
    with pytest.raises(RecipeError, match=r"received a coil at 1\.69 A with limit_A = 1\.69"):
        saturating(rig, line)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("upper_A = 1.0", "lower_A and upper_A, or lift_and_directions; received upper_A"),
        ("states = 9", "received none of them"),
        (
            ONE_RANGE + "lift_and_directions = { u_A = [1, 2], x = [0, 0.3], y = [0, 0.3] }",
            "received lower_A and upper_A and lift_and_directions",
        ),
        (
            'groups = [["a"]]\nlift_and_directions = { u_A = [1, 2], x = [0, 0.3], y = [0, 0.3] }',
            "groups or lift_and_directions.*received both",
        ),
        ("lower_A = [0, 1]\nupper_A = [2, 3, 4]", "received 2 and 3 numbers"),
        ("lower_A = [0, 1]\nupper_A = 1", r"received lower_A = \[0(\.0)?, 1(\.0)?\] with upper_A = 1"),
        (
            "lift_and_directions = { u_A = [1, 2, 3], x = [0, 0.3], y = [0, 0.3] }",
            "range .smallest, largest. of at most 1e.06",
        ),
        ("groups = []\n" + ONE_RANGE, "groups"),
        ('groups = [[], ["a"]]\n' + ONE_RANGE, "groups"),
    ],
)
def test_currents_that_make_no_sense(rig, lines, words):
    with pytest.raises(RecipeError, match=words):
        saturating(rig, lines)


@pytest.mark.parametrize(
    ("where", "key", "inside", "beyond"),
    [
        (
            "",
            "spacing_mm",
            ["1e-6", "100000", "[1, 1, 100000]"],
            ["0", "100001", "[1, 1, 0]", "[1, 1, 1, 1]", "[1]"],
        ),
        ("[iron]", "mu_r", ["1e-9", "4000", '"initial"'], ["0", "-1e-9", "true", '"Initial"']),
        ("[iron]", "tolerance", ["1e-12", "0.1"], ["0", "0.101"]),
        ("[iron]", "refinement", ["0.1", "10"], ["0.099", "10.01"]),
        (
            "[output]",
            "file",
            ['"a.h5"', '"a b.c.h5"'],
            ['".h5"', '"h5"', '"a.h"', '"a\\\\b.h5"', '"a:b.h5"', "5"],
        ),
        ("[output]", "reference_current_A", ["1e-9", "7"], ["0", "-1"]),
        ("[currents]", "lower_A", ["-1e6", "1.9"], ["-1000001", "2.0", '"no"']),
        ("[currents]", "states", ["4", "4096"], ["3", "4097", "4.5"]),
        ("[currents]", "accuracy", ["1e-9", "0.999"], ["0", "1"]),
        ("[currents]", "modes", ["2", "200"], ["1", "201"]),
        ("[currents]", "points", ["20", "5000"], ["19", "5001"]),
        ("[currents]", "fields", ["1", "100"], ["0", "101"]),
        ("[currents]", "held_out", ["1", "1000"], ["0", "1001"]),
    ],
)
def test_the_last_number_of_each_key_is_taken_and_the_next_is_not(
    rig, recipe_text, where, key, inside, beyond
):
    for values, taken in ((inside, True), (beyond, False)):
        for value in values:
            line = f"{key} = {value}"
            if where == "[currents]":
                others = "" if key == "lower_A" else "lower_A = 0.5\n"
                text = SATURATING.format(f"{others}upper_A = 2.0\n{line}")
            else:
                text = (
                    recipe_text.replace("spacing_mm = 2.0", line)
                    if not where
                    else f"{recipe_text}{where}\n{line}"
                )
            (rig / "recipe.toml").write_text(text)
            if taken:
                read_recipe(rig / "recipe.toml")
                continue
            with pytest.raises(RecipeError) as caught:
                read_recipe(rig / "recipe.toml")
            told = [f"{problem.where} {problem.must_hold}" for problem in caught.value.problems]
            assert all(key in text for text in told), value


def test_a_recipe_of_a_device_in_python_says_in_units_of_keys_what_was_given_in_those_of_python():
    device = SimpleNamespace(name="rig", title="", bounds=None)
    box, iron = ([-1e-3, -2e-3, -3e-3], np.array([4e-3, 5e-3, 6e-3])), {"refinement": 0.7}
    recipe = recipe_for(device, np.array([1e-3, 2e-3, 38.10512e-3]), box, ([0.5, -1.0], 2.0), iron, 1.25)
    assert (recipe.title, recipe.device, recipe.file_name) == ("rig", "rig", "rig.h5")
    assert (recipe.refinement, recipe.reference_current) == (0.7, 1.25)
    assert recipe.spacing.tolist() == [1e-3, 2e-3, 38.10512e-3]
    assert [corner.tolist() for corner in recipe.box(device)] == [[-1e-3, -2e-3, -3e-3], [4e-3, 5e-3, 6e-3]]
    assert (recipe.currents.lower.tolist(), recipe.currents.upper.tolist()) == ([0.5, -1.0], [2.0])
    said = tomllib.loads(recipe.text)
    assert said == {
        "format": 1,
        "title": "rig",
        "device": "rig",
        "spacing_mm": [1.0, 2.0, 38.10512],
        "box": {"lower_mm": [-1.0, -2.0, -3.0], "upper_mm": [4.0, 5.0, 6.0]},
        "iron": {"model": "saturating", "refinement": 0.7},
        "currents": {"lower_A": [0.5, -1.0], "upper_A": 2.0},
        "output": {"reference_current_A": 1.25},
    }
    plain = recipe_for(SimpleNamespace(name="rig", title="A rig", bounds=7), 4e-3)
    assert (plain.title, plain.currents, plain.reference_current, plain.spacing.tolist()) == (
        "A rig",
        None,
        None,
        [4e-3] * 3,
    )
    assert plain.box(SimpleNamespace(bounds=7)) == 7
    assert set(tomllib.loads(plain.text)) == {"format", "title", "device", "spacing_mm", "iron"}


def test_what_is_left_out(rig):
    recipe = read_recipe(rig / "recipe.toml")
    assert (recipe.mu_r, recipe.tolerance, recipe.reference_current) == (None, 1e-3, None)
    assert (recipe.lower, recipe.upper, recipe.file_name) == (None, None, "recipe.h5")
    np.testing.assert_allclose(recipe.spacing, 2e-3)


# Replacement of the recipe's last line, and a pattern of the message: key, condition, received, remedy.
MISTAKES = {
    "wrong type": ('spacing_mm = "2"', r'toml:5: spacing_mm: one positive number.*received "2"'),
    "negative": ("spacing_mm = -2.0", "spacing_mm: one positive number, or three.*received -2.0; write for"),
    "zero": ("spacing_mm = 0", "spacing_mm: one positive number.*received 0"),
    "nan": ("spacing_mm = nan", "spacing_mm: one positive number.*received nan"),
    "one of three": ("spacing_mm = [1, 2, -3]", r"spacing_mm: one positive number.*\[1, 2, -3\]"),
    "two of three": ("spacing_mm = [1, 2]", r"spacing_mm: one positive number, or three.*\[1, 2\]"),
    "true": ("spacing_mm = true", "spacing_mm: one positive number.*received true"),
    "missing": ("", "spacing_mm: this key is required.*add spacing_mm"),
    "unknown key": ("spacing_mm = 2\nspacings_mm = 3", 'unknown key "spacings_mm"; did you mean spacing_mm'),
    "unknown table": ("spacing_mm = 2\n[grid]\nn = 3", 'toml:6: grid: known keys.*unknown key "grid"'),
    "not TOML": ("spacing_mm = = 2", "toml:5:14: the file must be valid TOML.*correct the line"),
    "empty box": (
        "spacing_mm = 2\n[box]\nlower_mm = [0, 0, 0]\nupper_mm = [9, 9, -9]",
        r"box.upper_mm: the box must not be empty.*\(along z\); swap the two corners",
    ),
    "half a box": ("spacing_mm = 2\n[box]\nlower_mm = [0, 0, 0]", "box.upper_mm: this key is required"),
    "flat corner": (
        "spacing_mm = 2\n[box]\nlower_mm = [0, 0]\nupper_mm = [9, 9, 9]",
        "box.lower_mm: needs at least 3 entries; received 2 entries",
    ),
    "unknown model": (
        'spacing_mm = 2\n[iron]\nmodel = "magic"',
        "iron.model: must be 'linear', 'saturating' or 'hysteresis'; received \"magic\"",
    ),
    "negative permeability": ("spacing_mm = 2\n[iron]\nmu_r = -5", 'iron.mu_r: "initial".*received -5'),
    "unknown word": ('spacing_mm = 2\n[iron]\nmu_r = "high"', 'iron.mu_r: "initial".*received "high"'),
    "loose tolerance": (
        "spacing_mm = 2\n[iron]\ntolerance = 2.0",
        "iron.tolerance: must be at most 0.1; received 2.0",
    ),
    "no mesh": ("spacing_mm = 2\n[iron]\nrefinement = 0.0", "iron.refinement: must be at least 0.1"),
    "no tolerance": ("spacing_mm = 2\n[iron]\ntolerance = 0.0", "iron.tolerance: must be greater than 0"),
    "no current": (
        "spacing_mm = 2\n[output]\nreference_current_A = 0.0",
        "output.reference_current_A: must be greater than 0; received 0.0",
    ),
    "folder": ('spacing_mm = 2\n[output]\nfile = "a/b.h5"', "output.file: a file name that ends in .h5"),
    "suffix": ('spacing_mm = 2\n[output]\nfile = "map.csv"', 'output.file: .*received "map.csv"'),
    "coarse": (
        "spacing_mm = 7.0",
        "spacing_mm: at least 5 nodes along each axis; received a box of 20 x 20 x 24",
    ),
    "too fine": (
        "spacing_mm = 0.001",
        "spacing_mm: must make a map for which its disk has room: .* GB for 9601",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_every_mistake_has_its_message_and_leaves_no_file(rig, recipe_text, mistake):
    line, words = MISTAKES[mistake]
    path = rig / "recipe.toml"
    path.write_text(recipe_text.replace("spacing_mm = 2.0\n", line + "\n"))
    with pytest.raises(RecipeError, match=words) as caught:
        generate(path, rig / "out" / "map.h5")
    assert caught.value.exit_code == 2
    assert all(str(path) in problem.where for problem in caught.value.problems)
    assert not (rig / "out").exists()


def test_all_mistakes_at_once_in_the_order_of_lines(rig):
    path = rig / "recipe.toml"
    path.write_text(
        'format = 2\ntitle = ""\ndevice = 5\nspacing_mm = -1\n[iron]\ntolerance = "low"\nmur = 3\n'
    )
    with pytest.raises(RecipeError) as caught:
        read_recipe(path)
    keys = [problem.where.rpartition(": ")[2] for problem in caught.value.problems]
    assert keys == ["format", "title", "device", "spacing_mm", "iron.tolerance", "iron.mur"]


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("drive_unti", 'a shipped device; received "drive_unti"; did you mean "drive_unit"?'),
        (
            "somewhere/rig.toml",
            'received "somewhere/rig.toml"; give a path relative to the recipe, or one of',
        ),
    ],
)
def test_unknown_device(rig, recipe_text, device, words):
    path = rig / "recipe.toml"
    path.write_text(recipe_text.replace("pair.toml", device))
    with pytest.raises(RecipeError, match=words.replace("?", r"\?")) as caught:
        generate(path, rig / "map.h5")
    assert f"{path}:4: device" in str(caught.value)


def test_unknown_recipe():
    for name, offered in (("quikc", {"quick"}), ("somewhere/else.toml", {"division", "quick"})):
        with pytest.raises(RecipeError) as error:
            read_recipe(name)
        (problem,) = error.value.problems
        assert problem.where == name
        assert offered <= set(re.findall(r'"(\w+)"', problem.remedy))


def test_a_recipe_that_is_no_text(rig):
    (rig / "recipe.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecipeError, match="UTF-8"):
        read_recipe(rig / "recipe.toml")
