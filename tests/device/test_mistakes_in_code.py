"""Every mistake of a device file made in Python as well: the same rules, told at the attribute."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from tests.device.made_in_code import attribute, made_in_code

CASES = tomllib.loads((Path(__file__).parent / "mistakes.toml").read_text())["case"]

# What Python itself makes impossible or harmless: a file's format, a key in a wrong unit, a value of another quantity.
NO_MISTAKE = {
    "format of the future",
    "no format",
    "unit left out of the key",
    "value of the other quantity",
}
# (attribute, what must hold, received, remedy) where a constructor, not the device, has found it, or a class stands for
# a word.
OTHERWISE = {
    "missing key": ("radius", "required", "nothing", "add radius"),
    "misspelt key": ("mesh_sise", "known keys here are", "mesh_sise", "remove it"),
    "key of another shape": ("inner_radius", "known keys", "inner_radius", "did you mean radius?"),
    "shape beside parts": ("shape", "parts", '"shape"', "remove it"),
    "unknown table": ("drivers", "known keys", "drivers", "did you mean driver?"),
    "unknown shape": ("shape", "one of Box, Cylinder", "cilin", "help"),
    "no shape": ("shape", "one of Box, Cylinder", "None", "help"),
    "unknown coil kind": ("coils[0]", "PathCoil", "round", "help"),
    "unknown material kind": ("materials['iron']", "FluxBarrier", "liner", "help"),
    "four angles": ("placed, rotation_deg", "3 finite numbers", "[90, 0, 9, 0]", "degrees"),
    "angles in words": ("placed, rotation_deg", "3 finite numbers", "90 about", "degrees"),
    "STEP file missing": ("path", "must exist", "hole.step", "correct the path"),
    "coil as one table": ("driver", "one of Driver", "list", "help"),
    "no law below": ("below", "required", "nothing", "add below"),
    "moment and magnet": ("moment", "that of the magnet", "0.8", "leave the moment out"),
    "no gain": ("gain", "required", "nothing", "add gain"),
    "unknown law": ("materials['powder']", "Marrocco", "froelich", "help"),
    "law without saturation": ("saturation", "required", "nothing", "add saturation"),
}
OTHER_WAY = {"material file missing"}
KEY = re.compile(r"\b([a-z_]+?)_mm\b")


def twin(case, valid_text):
    return made_in_code(tomllib.loads(valid_text.replace(case["old"], case["new"], 1)))


def test_the_twin_of_the_unbroken_file_is_the_device(valid_text):
    device = made_in_code(tomllib.loads(valid_text))
    assert tomllib.loads(device.to_toml()) == tomllib.loads(device.text)
    assert device.coil_names == ("round", "race", "path")


@pytest.mark.parametrize(
    "case", [c for c in CASES if c["id"] not in NO_MISTAKE | OTHER_WAY], ids=lambda c: c["id"]
)
def test_one_mistake_gives_one_problem_at_the_attribute(case, valid_text):
    with pytest.raises(InputError) as caught:
        twin(case, valid_text)
    (problem,) = caught.value.problems
    if case["id"] in OTHERWISE:
        path, must_hold, received, remedy = OTHERWISE[case["id"]]
    else:
        steps = case["path"].split(".")
        path = attribute(next(step for step in reversed(steps) if not step.isdigit()))
        path = path if steps[0] != "provenance" else case["path"].partition(".")[2]
        path = {"rotation": "rotation", "part": "parts"}.get(path, path)
        keys = re.compile("($^)") if steps[0] == "provenance" else KEY
        must_hold, received, remedy = (
            keys.sub(r"\1", case[key]) for key in ("must_hold", "received", "remedy")
        )
    assert path in problem.where
    assert must_hold in problem.must_hold
    assert received in problem.received
    assert remedy in problem.remedy


@pytest.mark.parametrize("name", sorted(NO_MISTAKE))
def test_what_is_no_mistake_in_python(name, valid_text):
    (case,) = (case for case in CASES if case["id"] == name)
    try:
        twin(case, valid_text)
    except InputError as error:
        assert "known keys" in error.problems[0].must_hold  # noqa: PT017 - one of them is a wrong argument


def test_a_material_that_is_not_there():
    with pytest.raises(InputError) as caught:
        fm.material("steal")
    assert "steel_a3" in caught.value.problems[0].remedy


BALL, BEAD = fm.MagnetSphere(4e-3, 1.2), fm.SoftSphere(4e-3, mu_r=1e3)
COIL = fm.CircularCoil("a", 0.02, 0.03, 0.01, 100)
IRON = fm.LinearMaterial("iron", 1000.0)


def paths(**values):
    with pytest.raises(InputError) as caught:
        fm.Device("d", **{"title": "", "coils": [COIL], **values})
    return [problem.where.rpartition(": ")[2] for problem in caught.value.problems]


def test_all_mistakes_at_once_at_paths_that_python_understands():
    rod = fm.Body("rod", "steal", fm.Cylinder(-1.0, 11.0), mesh_size=np.nan)
    far = fm.CircularCoil("a", 0.02, 11000.0, 0.01, 100, placement=fm.Placement(np.array([0, 0, 1e9])))
    found = paths(coils=[COIL, far], bodies=[rod])
    assert set(found) == {
        "coils[1].name",
        "coils[1].outer_radius",
        "coils[1].placement.position[2]",
        "bodies[0].material",
        "bodies[0].mesh_size",
        "bodies[0].parts[0].shape.radius",
    }
    values = {"coils": [COIL, far], "bodies": [rod]}
    for path in found:
        eval(path, {}, values)


@pytest.mark.parametrize(
    ("values", "path"),
    [
        ({"coils": "abc"}, "Device.coils"),
        ({"coils": [COIL, None]}, "coils[1]"),
        ({"bodies": [COIL]}, "bodies[0]"),
        ({"materials": [1]}, "Device.materials"),
        ({"payload": 3}, "payload"),
        ({"workspace": ((0, 0, 0), (1, 1, 1))}, "workspace"),
        (
            {
                "coils": [
                    fm.CircularCoil("a", 1, 2, 3, 4, placement=fm.Placement(np.zeros(3), np.ones((3, 3))))
                ]
            },
            "coils[0].placement.rotation",
        ),
        ({"coils": [fm.CircularCoil("a", 0.1, 0.2, 0.3, 4, placement=3)]}, "coils[0].placement"),
        ({"coils": []}, 'Device "d"'),
        ({"coils": [COIL], "title": np.zeros(3)}, "title"),
        ({"coils": [COIL], "payload": fm.Payload(1e-3, moment=0.1, pieces=[BALL])}, "payload.moment"),
        ({"coils": [COIL], "payload": fm.Payload(1e-3, moment=0.1, pieces=[BEAD])}, "payload.moment"),
        (
            {"bodies": [fm.Body("rod", "iron", fm.Box(3.0), mesh_size=0.01)], "materials": {"iron": IRON}},
            "bodies[0].parts[0].shape.size",
        ),
        (
            {
                "bodies": [fm.Body("rod", "iron", fm.Box(np.ones((1, 3))), mesh_size=0.01)],
                "materials": {"iron": IRON},
            },
            "bodies[0].parts[0].shape.size[0]",
        ),
    ],
)
def test_things_in_the_wrong_place(values, path):
    assert paths(**values) == [path]


def test_the_moment_of_the_pieces_may_be_repeated():
    once = fm.Payload(1e-3, pieces=[BALL, BEAD])
    twice = fm.Payload(1e-3, moment=once.moment, pieces=[BALL, BEAD])
    assert fm.Device("d", "", coils=[COIL], payload=twice).payload.moment == once.moment > 0


def test_an_array_is_a_size():
    assert fm.Box(np.array([1.0, 2.0, 3.0])) == fm.Box((1.0, 2.0, 3.0))


@pytest.mark.parametrize("changes", [np.zeros(3), np.zeros(0), ["parameters.gap"]])
def test_changes_that_are_no_mapping(changes):
    with pytest.raises(InputError) as caught:
        fm.read_device("drive_unit", changes)
    assert [problem.where for problem in caught.value.problems] == ["changes"]
