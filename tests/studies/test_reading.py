"""Study files: every mistake at once, by line and key; recipes as the source of device and iron."""

import itertools
import json
from dataclasses import replace

import pytest

from fieldmap.errors import StudyError
from fieldmap.studies import Linked, read_study, reading
from fieldmap.studies.quantities import GROUPS
from fieldmap.studies.study import Axis, StudyIron, settings_with
from tests.studies.conftest import LOOP

MISTAKES = """format = 1
title = "Everything wrong with the keys"
device = "thin_loop.toml"
colour = "red"

[iron]
model = "saturated"
accuracy = 2.0

[[vary]]
name = "turns"
key = "coil.loop.turns"
values = [100, "many"]

[[vary]]
name = "point"
key = "coil.loop.height_mm"
values = []

[[currents]]
name = "none"

[[currents]]
name = "both"
amperes_A = 1.0
carries_at_mm = [0, 0, -90]

[record]
quantities = ["lift"]
force_share = 0
"""
FOUND = [
    (4, "colour", "unknown key"),
    (7, "iron.model", "'linear' or 'saturating'"),
    (8, "iron.accuracy", "less than 1"),
    (10, "vary.turns", "all numbers or all texts"),
    (18, "vary.point.values", "at least 1 entries"),
    (20, "currents.none", "amperes_A or lift_and_directions with u_A, or carries_at_mm"),
    (23, "currents.both", "only their shares"),
    (29, "record.quantities.1", '"equilibrium_area"'),
    (30, "record.force_share", "greater than 0"),
]


def problems(devices, text, name="wrong.toml"):
    path = devices.study(name, text)
    with pytest.raises(StudyError) as caught:
        read_study(path)
    return path, caught.value.problems


def test_a_parameter_is_varied_and_what_follows_from_it(devices):
    text = 'format = 1\ntitle = "Gaps"\ndevice = "drive_unit"\n'
    text += '[[vary]]\nname = "gap"\nkey = "parameters.gap"\nvalues = [120.0, 283.0]\n'
    text += '[[vary]]\nname = "plate"\nkey = "body.lower plate.radius_mm"\nvalues = [66.0, 80.0]\n'
    study = read_study(devices.study("gaps.toml", text + "[[currents]]\nname = 'all'\namperes_A = 1.0\n"))
    plates = [
        next(body for body in variant.document.data["body"] if body["name"] == "lower plate")
        for variant in study.variants
    ]
    assert [plate["position_mm"][2] for plate in plates] == [-126.0, -126.0, -289.0, -289.0]
    assert [plate["radius_mm"] for plate in plates] == [66.0, 80.0, 66.0, 80.0]


def test_every_mistake_is_named_with_its_line(devices):
    path, found = problems(devices, MISTAKES)
    for (line, key, words), problem in zip(FOUND, found, strict=True):
        assert problem.where == f"{path}:{line}: {key}"
        assert words in str(problem)
        assert problem.received
        assert problem.remedy


GOOD = """format = 1
title = "Good"
device = "thin_loop.toml"
[[vary]]
name = "turns"
key = "coil.loop.turns"
values = [500, 1000]
[[currents]]
name = "one"
amperes_A = 1.0
[record]
points_mm = [[0, 0, -90]]
"""


KEY, VALUES, AMPERES = '"coil.loop.turns"', "[500, 1000]", "amperes_A = 1.0"
POINTS, DEVICE, LINKED = (
    "points_mm = [[0, 0, -90]]",
    'device = "thin_loop.toml"',
    "vary.turns.linked.1.keys.1",
)
DIVIDED, BY_SIGNALS = "lift_and_directions = {{ u_A = 1.0{} }}", "currents.one.lift_and_directions"


@pytest.mark.parametrize(
    ("there", "wrong", "line", "key", "words"),
    [
        (KEY, '"coil.loop.turn"', 6, "vary.turns.key", 'did you mean "coil.loop.turns"'),
        (KEY, '"coil.loop.position_mm"', 6, "vary.turns.key", "an array or a table"),
        (VALUES, "[500, -1]", 7, "vary.turns.values", "coil.loop.turns of the device must be greater than 0"),
        (VALUES, "[500, 500]", 4, "vary.turns", "every value must be listed once"),
        (VALUES, '[500, ""]', 7, "vary.turns.values.2", "finite number or a text"),
        (VALUES, "[true]", 7, "vary.turns.values.1", "finite number or a text"),
        (VALUES, "[500, nan]", 7, "vary.turns.values.2", "finite number or a text"),
        ('name = "turns"', 'name = "coil"', None, "", "own axes and variables are taken"),
        ('name = "turns"', 'name = "reach_height"', None, "", "own axes and variables are taken"),
        (
            VALUES,
            f'{VALUES}\n[[vary.linked]]\nkeys = ["coil.*.turns"]',
            9,
            LINKED,
            "coil.loop.turns, set before",
        ),
        (AMPERES, "amperes_A = [1.0, 2.0]", 10, "currents.one.amperes_A", "each of the 1 coils"),
        (AMPERES, "amperes_A = 0.0", 10, "currents.one.amperes_A", "not all of them 0"),
        (AMPERES, DIVIDED.format(""), 10, BY_SIGNALS, "six coils"),
        (AMPERES, DIVIDED.format(", x = 1e308, n = 3.0"), 10, BY_SIGNALS, "1e+09 A"),
        ("[record]", '[iron]\nmodel = "saturating"\n[record]', 12, "iron.model", "iron to saturate"),
        (POINTS, 'quantities = ["field"]', 12, "record.quantities.1", "record.points_mm"),
        (POINTS, 'quantities = ["error"]', 12, "record.quantities.1", "needs iron"),
        (DEVICE, 'device = "thin_lop.toml"', 3, "device", "no such file"),
        (DEVICE, f'{DEVICE}\nrecipe = "quick"', None, "", "device and recipe"),
        (DEVICE, 'recipe = "quik"', 3, "recipe", 'did you mean "quick"'),
    ],
)
def test_what_the_device_does_not_allow(devices, there, wrong, line, key, words):
    assert there in GOOD
    path, found = problems(devices, GOOD.replace(there, wrong))
    place = f"{path}:{line}" if line else str(path)
    assert found[0].where == (f"{place}: {key}" if key else place)
    assert words in str(found[0])


def test_a_device_without_payload_or_limit(devices):
    text = GOOD.replace("thin_loop", "sphere").replace("coil.loop.turns", "body.sphere.radius_mm")
    text = text.replace("[500, 1000]", "[8.0, 9.0]")
    wanted = 'quantities = ["reach", "equilibrium"]\npoints_mm = [[0, 0, -14]]'
    _, found = problems(devices, text.replace(POINTS, wanted))
    for words, problem in zip(("[payload]", "limit", "[payload]"), found, strict=False):
        assert words in str(problem)
    # By default a study records the groups that the device allows.
    study = read_study(devices.study("allowed.toml", text))
    assert study.record.groups == ("currents", "field", "iron", "error")


def test_no_such_study_and_no_toml(devices):
    with pytest.raises(StudyError, match="pole_disk"):
        read_study("pole_dis")
    _, found = problems(devices, "format = = 1")
    assert "valid TOML" in str(found[0])


def test_a_recipe_gives_device_and_iron(devices):
    text = """format = 1
title = "By a recipe"
recipe = "saturating"
vary = [{ name = "radius", key = "body.disk.radius_mm", values = [60, 66] }]
currents = [{ name = "equal", shares = 1.0, carries_at_mm = [0, 0, -102] }]
"""
    study = read_study(devices.study("by_recipe.toml", text))
    assert (study.iron.saturating, study.iron.tolerance) == (True, 1e-3)
    assert (study.device_document.data["name"], study.current_sets[0].common) == ("drive_unit", None)
    assert "reachable_share" not in study.record.groups
    assert study.record.current_limit == 3.55
    linear = read_study(devices.study("linear.toml", text.replace('"saturating"', '"quick"')))
    assert (linear.iron.saturating, linear.iron.refinement) == (False, 0.7)


def test_divided_currents_have_the_mean_of_their_signal(devices):
    text = """format = 1
title = "Divided"
device = "drive_unit"
vary = [{ name = "radius", key = "body.disk.radius_mm", values = [66] }]
currents = [{ name = "given", lift_and_directions = { u_A = 1.5, x = 0.2, n = 1.25 } }]
"""
    entry = read_study(devices.study("divided.toml", text)).current_sets[0]
    assert entry.common == pytest.approx(1.5)
    # Thesis (6-3) with n = 1.25: coil 5 gets 1 + 1.25 x, coil 2 gets 1 - 1.25 x, the others 1 +- x.
    assert entry.shares.tolist() == pytest.approx([0.8, 0.75, 0.8, 1.2, 1.25, 1.2])


def test_units_come_from_keys():
    units = {"a.gain_A_per_V": "A/V", "b.1.moment_A_m2": "A m2", "c.position_mm.3": "mm", "d.turns": "1"}
    assert {key: Axis("n", key, (1.0,)).unit for key in units} == units
    assert Axis("n", "body.disk.material", ("steel",)).unit == ""


def test_a_name_that_cannot_be_is_told_in_words(devices):
    """The message does not contain the pattern that checks the name."""
    text = 'format = 1\ntitle = "Gaps"\ndevice = "drive_unit"\n'
    text += '[[vary]]\nname = "gap of it"\nkey = "parameters.gap"\nvalues = [120.0, 283.0]\n'
    _, (problem,) = problems(devices, text + "[[currents]]\nname = 'all'\namperes_A = 1.0\n")
    assert ":5: " in problem.where
    assert "letters, digits and _" in problem.must_hold
    assert problem.received == '"gap of it"'
    assert "^" not in str(problem)


def read(devices, text, name="changed.toml"):
    return read_study(devices.study(name, text))


def refusals(devices, text):
    """Line and key of each refusal; none if the file is read."""
    path = devices.study("changed.toml", text)
    try:
        read_study(path)
    except StudyError as error:
        return [problem.where.removeprefix(f"{path}") for problem in error.problems]
    return []


@pytest.fixture(scope="module")
def six(devices):
    """A study of six loops on a circle, without its currents."""
    loops = LOOP.replace('name = "loop"', 'name = "{k}"\nrepeat = { count = 6, about = "z" }')
    (devices.folder / "six.toml").write_text(loops.replace("position_mm = [0.0,", "position_mm = [100.0,"))
    return GOOD.replace("thin_loop", "six").replace("coil.loop", "coil.1").replace("amperes_A = 1.0\n", "")


CURRENTS = {
    "amperes_A": "amperes_A = 1.0",
    "u_A": "lift_and_directions = { u_A = 1.0 }",
    "x": "lift_and_directions = { x = 0.1 }",
    "shares": "shares = 1.0",
    "carries": "carries_at_mm = [0, 0, -90]",
}
COMPLETE = [{"amperes_A"}, {"u_A"}, {"carries"}, {"carries", "shares"}, {"carries", "x"}]
SETS = [
    set(keys)
    for count in range(5)
    for keys in itertools.combinations(CURRENTS, count)
    if not {"u_A", "x"} <= set(keys)
]


@pytest.mark.parametrize("keys", SETS, ids=lambda keys: " ".join(sorted(keys)) or "none")
def test_a_set_of_currents_is_given_or_looked_for(devices, six, keys):
    """Every combination of its keys."""
    lines = "\n".join(CURRENTS[key] for key in keys)
    text = six.replace('name = "one"\n', f'name = "one"\n{lines}\n')
    assert refusals(devices, text) == ([] if keys in COMPLETE else [":8: currents.one"])
    if keys == {"carries", "x"}:
        (entry,) = read(devices, text).current_sets
        assert (entry.common, entry.carried_at.tolist()) == (None, [0.0, 0.0, -0.09])
        # Thesis (6-3): shares of 1 -+ x, three of each sign, with mean 1.
        assert sorted(entry.shares.tolist()) == pytest.approx([0.9] * 3 + [1.1] * 3)


@pytest.mark.parametrize(
    ("line", "fits"),
    [
        ("lift_and_directions = { u_A = 1e9 }", True),
        ("lift_and_directions = { u_A = 1.001e9 }", False),
        ("lift_and_directions = { u_A = 9e8, x = 0.12 }", False),
        ("lift_and_directions = { u_A = 9e8, x = 0.11 }", True),
        ("lift_and_directions = { u_A = 9e8, x = 0.11, n = 1.1 }", False),
        ("lift_and_directions = { u_A = 9e8, y = -0.12 }", False),
        ("amperes_A = [1, 2, 3, 4, 5, 6]", True),
        ("amperes_A = [1, 2, 3, 4, 5]", False),
        ("amperes_A = [0, 0, 0, 0, 0, 1]", True),
        ("amperes_A = [0, 0, 0, 0, 0, 0]", False),
        ("carries_at_mm = [0, 0, -90]\nshares = [1, 2, 3, 4, 5]", False),
        ("carries_at_mm = [0, 0, -90]\nshares = [1, 2, 3, 4, 5, 9]", True),
    ],
)
def test_numbers_of_currents(devices, six, line, fits):
    text = six.replace('name = "one"\n', f'name = "one"\n{line}\n')
    assert (refusals(devices, text) == []) == fits
    if line.endswith("9]"):
        assert read(devices, text).current_sets[0].shares.tolist() == pytest.approx(
            [k / 4 for k in (1, 2, 3, 4, 5, 9)]
        )


IRON = (
    GOOD.replace("thin_loop", "sphere")
    .replace("coil.loop.turns", "coil.loop.turns")
    .replace("[record]\npoints_mm = [[0, 0, -90]]", "record = { points_mm = [[0, 0, -14]] }")
)


@pytest.mark.parametrize(
    ("iron", "fits"),
    [
        ('model = "saturating"', True),
        ('model = "saturating", mu_r = 1000', False),
        ('model = "linear", mu_r = 1000', True),
        ('model = "linear", accuracy = 0.01', True),
        ('model = "linear", accuracy = 0.01, refinement = 1.0', False),
        ('model = "saturating", accuracy = 0.01, refinement = 1.0', True),
        ('model = "linear", refinement = 1.0', True),
    ],
)
def test_how_iron_is_solved(devices, iron, fits):
    text = IRON.replace("[[vary]]", f"iron = {{ {iron} }}\n[[vary]]")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("record"))
    assert refusals(devices, text) == ([] if fits else [":4: iron"])
    if fits:
        groups = read(devices, text).record.groups
        assert "error" in groups
        wanted = text.replace("[[vary]]", 'record = { quantities = ["currents"] }\n[[vary]]', 1)
        assert read(devices, wanted).record.groups == (
            ("currents", "error") if "accuracy" in iron else ("currents",)
        )


def test_an_accuracy_needs_a_workspace(devices):
    text = (devices.folder / "sphere.toml").read_text().split("[workspace]")[0]
    (devices.folder / "bare.toml").write_text(text)
    wanted = IRON.replace("sphere", "bare").replace("[[vary]]", "iron = { accuracy = 0.01 }\n[[vary]]")
    wanted = "\n".join(line for line in wanted.splitlines() if not line.startswith("record"))
    assert refusals(devices, wanted) == [":4: iron.accuracy"]


@pytest.mark.parametrize(
    ("line", "fits"),
    [
        ("force_share = 1.0", True),
        ("force_share = 1.001", False),
        ("force_share = 1e-6", True),
        ("box_mm = [[-1, -2, -90], [1, 2, -80]]", True),
        ("box_mm = [[1, -2, -90], [1, 2, -80]]", False),
        ("box_mm = [[-1, 2, -90], [1, 2, -80]]", False),
        ("box_mm = [[-1, -2, -80], [1, 2, -80]]", False),
        ("box_mm = [[-1, -2, -90]]", False),
        ("current_limit_A = 0.5", True),
        ("current_limit_A = 0.0", False),
    ],
)
def test_what_is_recorded_has_bounds(devices, line, fits):
    text = GOOD + line + "\n"
    key = line.split()[0]
    assert refusals(devices, text) == ([] if fits else [f":13: record.{key}"])
    if fits:
        record = read(devices, text).record
        assert record.force_share == (float(line.split()[-1]) if key == "force_share" else 0.01)
        # The driver's limit unless given.
        assert record.current_limit == (0.5 if key == "current_limit_A" else 3.0)
        if key == "box_mm":
            assert [corner.tolist() for corner in record.box] == [
                [-0.001, -0.002, -0.09],
                [0.001, 0.002, -0.08],
            ]


CARRIED = {"force_per_ampere", "equilibrium", "equilibrium_area", "reach", "reachable_share"}
LOOPS = set(GROUPS) - {"iron", "error", "inductance", "power"}
PAYLOAD = "[payload]\nmass_g = 1.0\nmoment_A_m2 = 0.1\n"


@pytest.mark.parametrize(
    ("device", "change", "record", "groups"),
    [
        ("loop", "", "points_mm = [[0, 0, -90]]\nbox_mm = [[-1, -1, -90], [1, 1, -80]]", LOOPS),
        ("loop", "", "points_mm = [[0, 0, -90]]", LOOPS - {"homogeneity"}),
        ("loop", "", "", LOOPS - {"homogeneity", "field", "force_per_ampere"}),
        (
            "loop",
            "[driver]",
            "points_mm = [[0, 0, -90]]",
            LOOPS - {"homogeneity", "reach", "reachable_share"},
        ),
        ("loop", "[payload]", "points_mm = [[0, 0, -90]]", LOOPS - {"homogeneity"} - CARRIED),
        ("loop", "[workspace]", "points_mm = [[0, 0, -90]]", LOOPS - {"homogeneity"} - CARRIED),
        ("sphere", "", "", {"currents", "iron", "error"}),
        ("sphere", "[workspace]", "", {"currents", "iron"}),
        (
            "sphere",
            PAYLOAD,
            "current_limit_A = 1.0",
            {"currents", "iron", "error"} | CARRIED - {"force_per_ampere"},
        ),
        (
            "sphere",
            PAYLOAD,
            'current_limit_A = 1.0\n[iron]\nmodel = "saturating"',
            {"currents", "iron", "error"} | CARRIED - {"force_per_ampere", "reachable_share"},
        ),
    ],
)
def test_what_a_device_allows_is_recorded(devices, device, change, record, groups):
    """By default; asking for any other group is refused."""
    text = getattr(devices, device).read_text()
    if change.startswith("[payload]\n"):
        text += change
    else:
        text = "\n\n".join(part for part in text.split("\n\n") if not change or change not in part)
    (devices.folder / "allowing.toml").write_text(text)
    wanted = GOOD.replace("thin_loop", "allowing").split("[record]")[0] + "[record]\n" + record + "\n"
    found = read(devices, wanted).record.groups
    assert set(found) == groups
    assert found == tuple(group for group in GROUPS if group in groups)
    asked = [group for group in GROUPS if group not in {"power", "inductance"}]
    listed = wanted.replace("[record]\n", f"[record]\nquantities = {json.dumps(asked)}\n")
    told = {text.split("quantities.")[1] for text in refusals(devices, listed)}
    assert told == {str(k + 1) for k, group in enumerate(asked) if group not in groups}


VARIANTS = """format = 1
title = "Good"
device = "thin_loop.toml"
variant = [{ name = "few", set = { "coil.loop.turns" = 500 } }, { name = "many", set = { "coil.loop.turns" = 1000 } }]
currents = [{ name = "one", amperes_A = 1.0 }, { name = "two", amperes_A = 2.0 }]
"""


def test_variants_one_by_one(devices):
    study = read(devices, VARIANTS)
    assert (study.shape, study.axes) == ((2,), ())
    assert [study.settings(k) for k in (0, 1)] == [{"variant": "few"}, {"variant": "many"}]
    assert [one.place for one in study.variants] == [(0,), (1,)]
    assert [one.document.data["coil"][0]["turns"] for one in study.variants] == [500, 1000]
    grid = read(devices, GOOD.replace("[[currents]]", LENGTHS + "[[currents]]"))
    assert grid.shape == (2, 3)
    assert grid.settings(4) == {"turns": 1000, "length": 2.0}
    assert [one.place for one in grid.variants] == list(itertools.product(range(2), range(3)))


LENGTHS = '[[vary]]\nname = "length"\nkey = "coil.loop.height_mm"\nvalues = [1.0, 2.0, 3.0]\n'


@pytest.mark.parametrize(
    ("text", "before", "after", "where"),
    [
        (VARIANTS, '"many"', '"few"', [""]),
        (VARIANTS, '"two"', '"one"', [""]),
        (VARIANTS, "= 1000", "= -1", [":4: variant.many"]),
        (
            VARIANTS,
            'coil.loop.turns" = 1000',
            'coil.loop.turn" = 1000',
            [":4: variant.many.set.coil.loop.turn"],
        ),
        (
            VARIANTS,
            "variant = [",
            "vary = [{ name = 'n', key = 'coil.loop.turns', values = [1] }]\nvariant = [",
            [""],
        ),
        (VARIANTS, 'device = "thin_loop.toml"\n', "", [""]),
        (GOOD, "[[currents]]", LENGTHS.replace('"length"', '"turns"') + "[[currents]]", [""]),
        (GOOD, 'device = "thin_loop.toml"', 'recipe = "quick"\niron = { refinement = 0.9 }', [""]),
        (
            GOOD,
            'key = "coil.loop.turns"\nvalues = [500, 1000]',
            'key = "coil.loop.kind"\nvalues = ["circular"]',
            [],
        ),
        (
            GOOD,
            'key = "coil.loop.turns"\nvalues = [500, 1000]',
            'key = "coil.loop.kind"\nvalues = ["circular"]\nlinked = [{ keys = ["coil.loop.turns"] }]',
            [":4: vary.turns"],
        ),
        (
            GOOD,
            "values = [500, 1000]",
            'values = [500, 1000]\nlinked = [{ keys = ["coil.loop.height_mm"], factor = -1.0, offset = 600.0 }]',
            [":8: vary.turns.linked"],
        ),
    ],
)
def test_mistakes_of_variants(devices, text, before, after, where):
    assert text.count(before) == 1
    found = refusals(devices, text.replace(before, after))
    assert found == where


def test_a_mistake_in_several_variants_is_told_once(devices):
    text = GOOD.replace("[500, 1000]", "[-1, 1000]").replace("[[currents]]", LENGTHS + "[[currents]]")
    path, (problem,) = problems(devices, text)
    assert problem.where == f"{path}:7: vary.turns.values"
    assert problem.received == "-1 in the variant turns = -1, length = 1"


@pytest.mark.parametrize(("most", "fits"), [(2, True), (1, False)])
@pytest.mark.parametrize("text", [GOOD, VARIANTS])
def test_a_study_of_too_many_variants(devices, monkeypatch, most, fits, text):
    assert reading.LARGEST_STUDY == 10_000
    monkeypatch.setattr(reading, "LARGEST_STUDY", most)
    assert (refusals(devices, text) == []) == fits


def test_keys_that_follow_a_value():
    linked = (Linked(("a", "b")), Linked(("c",), 2.0, 0.5), Linked(("d",), offset=-1.0))
    found = settings_with("x", 3.0, linked)
    assert found == (("x", 3.0), ("a", 3.0), ("b", 3.0), ("c", 6.5), ("d", 2.0))


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [("study", "-90", "-91"), ("study", "Good", "Better"), ("device", "height_mm = 1.0", "height_mm = 1.5")],
)
def test_a_run_goes_on_where_its_files_are_the_same(devices, file, before, after):
    first = read(devices, GOOD).fingerprint
    assert read(devices, GOOD).fingerprint == first
    text = GOOD.replace(before, after) if file == "study" else GOOD
    if file == "device":
        (devices.folder / "other.toml").write_text(LOOP.replace(before, after))
        other = read(devices, GOOD.replace("thin_loop", "other")).device_document
        assert replace(read(devices, GOOD), device_document=other).fingerprint != first
        return
    assert read(devices, text).fingerprint != first
    saturating = replace(read(devices, GOOD), iron=StudyIron("saturating"))
    assert saturating.fingerprint != first
