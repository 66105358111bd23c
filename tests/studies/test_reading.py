"""Study files with every mistake named at once, by line and key; recipes as the source of device and iron."""

import pytest

from fieldmap.errors import StudyError
from fieldmap.studies import read_study
from fieldmap.studies.study import Axis

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
    # Left to the study, only what the device allows is recorded.
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
    """The rule of the name is not told as the pattern that checks it."""
    text = 'format = 1\ntitle = "Gaps"\ndevice = "drive_unit"\n'
    text += '[[vary]]\nname = "gap of it"\nkey = "parameters.gap"\nvalues = [120.0, 283.0]\n'
    _, (problem,) = problems(devices, text + "[[currents]]\nname = 'all'\namperes_A = 1.0\n")
    assert ":5: " in problem.where
    assert "letters, digits and _" in problem.must_hold
    assert problem.received == '"gap of it"'
    assert "^" not in str(problem)
