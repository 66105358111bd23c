"""A fingerprint covers everything that determines numbers, each text separately."""

import numpy as np
import pytest

from fieldmap import provenance
from fieldmap.device import read_device
from fieldmap.maps.generation import _describe
from fieldmap.store import Grid
from fieldmap.studies import read_design_problem, read_study
from fieldmap.studies.search import problem_fingerprint


def test_every_setting_counts_and_so_does_where_it_ends():
    settings = ["one", "two", "three"]
    marks = [provenance.fingerprint(settings, ["records"])]
    for k in range(3):
        marks.append(provenance.fingerprint([*settings[:k], "other", *settings[k + 1 :]], ["records"]))
    marks.append(provenance.fingerprint(["onet", "wo", "three"], ["records"]))
    marks.append(provenance.fingerprint(["two", "one", "three"], ["records"]))
    marks.append(provenance.fingerprint(settings[:2], ["records"]))
    marks.append(provenance.fingerprint(settings, ["records", "plain"]))
    assert len(set(marks)) == len(marks)
    assert provenance.fingerprint(iter(settings), iter(["records"])) == marks[0]
    assert all(len(mark) == 64 for mark in marks)


@pytest.mark.parametrize("name", ["fieldmap", "python", *provenance.LIBRARIES])
def test_every_library_counts(name, monkeypatch):
    before = provenance.fingerprint((), ())
    monkeypatch.setattr(provenance, "library_versions", lambda: VERSIONS | {name: "0.0.1"})
    assert provenance.fingerprint((), ()) != before


VERSIONS = provenance.library_versions()


@pytest.mark.parametrize("changed", ["package/one.py", "package/two.py", "module.py"])
def test_every_file_of_code_counts(changed, tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "PACKAGE", tmp_path)
    (tmp_path / "package").mkdir()
    for name in ("package/one.py", "package/two.py", "module.py"):
        (tmp_path / name).write_text("x = 1\n")

    def mark():
        provenance._code.cache_clear()
        return provenance.fingerprint(("text",), ("package", "module"))

    before = mark()
    assert mark() == before
    (tmp_path / changed).write_text("x = 2\n")
    after = mark()
    provenance._code.cache_clear()
    assert after != before


# For each kind of resumable run its inputs, as (file, text, other text), each changed separately.
OUTER = """
format = 1
name = "pair"
title = "A pair"
include = ["part.toml"]

[material.steel]
kind = "bh_table"
file = "steel.toml"
below = "straight line to the origin"
above = "slope mu0"

[[coil]]
name = "upper"
kind = "circular"
inner_radius_mm = 30.0
outer_radius_mm = 31.0
height_mm = 1.0
turns = 50
"""
INCLUDED = """
[[coil]]
name = "lower"
kind = "circular"
inner_radius_mm = 30.0
outer_radius_mm = 31.0
height_mm = 1.0
position_mm = [0.0, 0.0, -20.0]
turns = 100
"""
STUDY = """
format = 1
title = "Turns"
device = "pair.toml"
currents = [{ name = "one", amperes_A = 1.0 }]
record = { quantities = ["field"], points_mm = [[0.0, 0.0, -60.0]] }
iron = { refinement = 1.0 }
vary = [{ name = "turns", key = "coil.upper.turns", values = [10.0, 20.0] }]
"""
DESIGN = (
    STUDY.split("vary")[0].replace('quantities = ["field"], ', "")
    + """
[optimise]
maximise = { number = "gradient 1 z z" }
variable = [{ key = "coil.upper.turns", lower = 10.0, upper = 90.0, start = 40.0 }]
"""
)
STEEL = read_device("drive_unit").included["materials/steel_a3.toml"]
DEVICE_CHANGES = [
    ("pair.toml", "turns = 50", "turns = 51"),
    ("part.toml", "turns = 100", "turns = 101"),
    ("steel.toml", STEEL, STEEL + "# another text\n"),
]
STUDY_CHANGES = [
    *DEVICE_CHANGES,
    ("study.toml", "amperes_A = 1.0", "amperes_A = 2.0"),
    ("study.toml", "-60.0", "-61.0"),
    ("study.toml", "refinement = 1.0", "refinement = 1.2"),
]


def marks_of(folder, texts, changes, mark):
    """The fingerprint of the unchanged files, and after each of the changes alone."""
    found = []
    for file, old, new in [("study.toml", "", ""), *changes]:
        for name, text in texts.items():
            changed = text if name != file or not old else text.replace(old, new)
            assert name != file or not old or changed != text
            (folder / name).write_text(changed)
        found.append(mark(folder))
    return found


def test_a_study_is_another_when_it_or_its_device_changes(tmp_path):
    texts = {"pair.toml": OUTER, "part.toml": INCLUDED, "steel.toml": STEEL, "study.toml": STUDY}
    changes = [*STUDY_CHANGES, ("study.toml", "[10.0, 20.0]", "[10.0, 30.0]")]
    marks = marks_of(tmp_path, texts, changes, lambda folder: read_study(folder / "study.toml").fingerprint)
    assert len(set(marks)) == len(marks) == 8
    assert marks[:1] == marks_of(
        tmp_path, texts, [], lambda folder: read_study(folder / "study.toml").fingerprint
    )


def test_designs_are_kept_for_another_search_of_the_same_device_alone(tmp_path):
    """Bounds, start and refinement of the search do not belong to a design; each design records its refinement."""

    def mark(folder):
        return problem_fingerprint(read_design_problem(folder / "study.toml"))

    texts = {"pair.toml": OUTER, "part.toml": INCLUDED, "steel.toml": STEEL, "study.toml": DESIGN}
    key = ("study.toml", 'key = "coil.upper.turns"', 'key = "coil.lower.turns"')
    number = ("study.toml", "gradient 1 z z", "gradient 1 x z")
    marks = marks_of(tmp_path, texts, [*STUDY_CHANGES[:-1], key, number], mark)
    assert len(set(marks)) == len(marks) == 8
    same = [("study.toml", "upper = 90.0", "upper = 95.0"), ("study.toml", "start = 40.0", "start = 45.0")]
    assert set(marks_of(tmp_path, texts, same, mark)) == {marks[0]}


def test_a_map_is_another_when_recipe_or_device_changes(tmp_path):
    grid = Grid([0.0, 0.0, 0.0], [0.01] * 3, (2, 2, 2))
    recipe = ["spacing_mm = 4.0"]

    def mark(folder):
        device = read_device(folder / "pair.toml")
        info = _describe(device, grid, np.ones(2), "", recipe[0], False)
        return info.provenance.fingerprint

    texts = {"pair.toml": OUTER, "part.toml": INCLUDED, "steel.toml": STEEL, "study.toml": ""}
    marks = marks_of(tmp_path, texts, DEVICE_CHANGES, mark)
    recipe[0] = "spacing_mm = 5.0"
    marks += marks_of(tmp_path, texts, [], mark)
    assert len(set(marks)) == len(marks) == 5
