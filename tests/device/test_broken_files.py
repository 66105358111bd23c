"""Every kind of mistake in a device file: one edit of a valid file each, and the message for it."""

import tomllib
from pathlib import Path

import pytest

from fieldmap.device import read_device
from fieldmap.errors import DeviceFileError

CASES = tomllib.loads((Path(__file__).parent / "mistakes.toml").read_text())["case"]


def problems_of(text: str, tmp_path) -> tuple:
    path = tmp_path / "device.toml"
    path.write_text(text)
    with pytest.raises(DeviceFileError) as caught:
        read_device(path)
    return caught.value.problems


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_one_mistake_gives_one_message(case, valid_text, tmp_path):
    assert valid_text.count(case["old"]) >= 1, "the edit does not apply"
    text = valid_text.replace(case["old"], case["new"], 1)
    problems = problems_of(text, tmp_path)
    assert len(problems) == 1, "\n".join(map(str, problems))
    problem = problems[0]
    place, _, path = problem.where.rpartition(": ")
    assert path == case["path"]
    assert place.startswith(str(tmp_path / "device.toml"))
    assert case["must_hold"] in problem.must_hold
    assert case["received"] in problem.received
    assert case["remedy"] in problem.remedy


def test_all_mistakes_are_reported_at_once(valid_text, tmp_path):
    edits = [
        ("radius_mm = 66", "radius_mm = -66"),
        ('material = "iron"', 'material = "irn"'),
        ("0.80, 0.90]", "0.80, 0.75]"),
        ("corner_radius_mm = 15", "corner_radius_mm = 17"),
        ("turns = 840\npolarity", "turns = -840\npolarity"),
        ("upper_mm = [20, 20, -76]", "upper_mm = [20, 20, -140]"),
        ("currents_A = [1, 0, 0]\nvalue_T = ", "currents_A = [1, 0]\nvalue_T = "),
        ('"body.disk.radius_mm" =', '"body.disc.radius_mm" ='),
    ]
    for old, new in edits:
        assert old in valid_text
        valid_text = valid_text.replace(old, new, 1)
    problems = problems_of(valid_text, tmp_path)
    line = valid_text[: valid_text.index("radius_mm = -66")].count("\n") + 1
    assert problems[1].where == f"{tmp_path / 'device.toml'}:{line}: body.disk.radius_mm"
    assert [problem.where.rpartition(": ")[2] for problem in problems] == [  # in the order of the file
        "material.steel.B_T",
        "body.disk.radius_mm",
        "body.collar.material",
        "coil.race.corner_radius_mm",
        "coil.race.turns",
        "workspace.upper_mm",
        "reference.1.currents_A",
        "provenance.body.disc.radius_mm",
    ]


@pytest.mark.parametrize(
    ("broken_line", "where"), [("radius_mm = 6 6", ":28:15"), ("[[body", ":28:7"), ('name = "disk', ":28:13")]
)
def test_a_syntax_error_names_line_and_column(broken_line, where, valid_text, tmp_path):
    text = valid_text.replace("radius_mm = 66", broken_line)
    (problem,) = problems_of(text, tmp_path)
    assert problem.where == f"{tmp_path / 'device.toml'}{where}"
    assert "valid TOML" in problem.must_hold


def test_a_file_that_is_not_text(tmp_path):
    (tmp_path / "device.toml").write_bytes(b"\xff\xfe\x00format")
    with pytest.raises(DeviceFileError, match="UTF-8"):
        read_device(tmp_path / "device.toml")


def test_a_file_that_does_not_exist_names_the_shipped_ones():
    for name, remedy in (("drive_unti", '"drive_unit"'), ("xyzzy/nothing.toml", '"loop_and_sphere"')):
        with pytest.raises(DeviceFileError) as caught:
            read_device(name)
        (problem,) = caught.value.problems
        assert problem.where == name
        assert remedy in problem.remedy


def test_an_empty_file(tmp_path):
    problems = problems_of("", tmp_path)
    missing = [problem.where.rpartition(": ")[2] for problem in problems]
    assert {"format", "name", "title"} < set(missing)
    assert any("[[coil]]" in problem.must_hold for problem in problems)


def test_wrong_types_everywhere_are_told_without_a_crash(tmp_path):
    text = 'format = "1"\nname = 3\ntitle = []\nbody = 5\nmaterial = 5\ncoil = {name = 1}\npayload = [1]\n'
    text += 'driver = "x"\nworkspace = []\nreference = [[1], 2]\nprovenance = ["a"]\n'
    problems = problems_of(text, tmp_path)
    named = {problem.where.rpartition(": ")[2].split(".")[0] for problem in problems}
    assert {"format", "name", "title", "body", "material", "coil", "payload"} <= named
    assert {"driver", "workspace", "reference", "provenance"} <= named


def test_errors_of_a_material_file_come_with_those_of_the_device_file(valid_text, tmp_path):
    (tmp_path / "curve.toml").write_text(
        'format = 1\nname = "curve"\ntitle = "x"\nH_A_per_m = [1, 2]\nB_T = [0.2, 0.1]\n'
    )
    text = valid_text.replace("H_A_per_m = [355, 405, 470]\nB_T = [0.70, 0.80, 0.90]", 'file = "curve.toml"')
    text = text.replace("radius_mm = 66", "radius_mm = -66")
    where = [problem.where for problem in problems_of(text, tmp_path)]
    assert where[0].endswith("body.disk.radius_mm")
    assert where[1] == f"{tmp_path / 'curve.toml'}:5: B_T"


def test_a_curve_from_a_file_must_have_room_to_saturate(valid_text, tmp_path):
    (tmp_path / "curve.toml").write_text(
        'format = 1\nname = "curve"\ntitle = "Two points"\nH_A_per_m = [100, 1000]\nB_T = [1.0, 1.6]\n'
    )
    points = "H_A_per_m = [355, 405, 470]\nB_T = [0.70, 0.80, 0.90]"
    text = valid_text.replace(points, 'file = "curve.toml"').replace(
        'above = "slope mu0"', 'above = "towards saturation"\nsaturation_polarisation_T = 1.5'
    )
    (problem,) = problems_of(text, tmp_path)
    assert problem.where.endswith("material.steel.saturation_polarisation_T")
    assert "1.599 T" in problem.must_hold


def test_a_material_that_is_misspelt_once_is_reported_once(valid_text, tmp_path):
    """For any number of bodies of this material; another unknown name is another problem."""
    bodies = "".join(
        f'\n[[body]]\nname = "more {k}"\nmaterial = "{name}"\nshape = "sphere"\nradius_mm = 1\nmesh_size_mm = 1\n'
        f"position_mm = [{100 + 5 * k}, 0, 0]\n"
        for k, name in enumerate(("stele", "stele", "ion"))
    )
    text = valid_text.replace('= "steel"', '= "stele"', 1) + bodies
    told = [problem for problem in problems_of(text, tmp_path) if problem.where.endswith("material")]
    assert [problem.received.split('"')[1] for problem in told] == ["stele", "ion"]
    assert [problem.where.split(": ")[-1] for problem in told] == [
        "body.disk.material",
        "body.more 2.material",
    ]
