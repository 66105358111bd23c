"""Every mistake of a device file made in Python as well: the same rules, reported at the attribute."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from tests.device.made_in_code import attribute, made_in_code

CASES = tomllib.loads((Path(__file__).parent / "mistakes.toml").read_text())["case"]
KEY = re.compile(r"\b([a-z_]+?)_mm\b")
PARTS = ("must_hold", "received", "remedy")
pytestmark = pytest.mark.filterwarnings("ignore::fieldmap.errors.UnusualValueWarning")


def twin(case, valid_text):
    return made_in_code(tomllib.loads(valid_text.replace(case["old"], case["new"], 1)))


def test_the_twin_of_the_unbroken_file_is_the_device(valid_text):
    device = made_in_code(tomllib.loads(valid_text))
    assert tomllib.loads(device.to_toml()) == tomllib.loads(device.text)
    assert device.coil_names == ("round", "race", "path")


@pytest.mark.parametrize("case", [c for c in CASES if c.get("in_python") != []], ids=lambda c: c["id"])
def test_one_mistake_gives_one_problem_at_the_attribute(case, valid_text):
    with pytest.raises(InputError) as caught:
        twin(case, valid_text)
    (problem,) = caught.value.problems
    steps, of_source = case["path"].split("."), case["path"].startswith("provenance")
    path = attribute(next(step for step in reversed(steps) if not step.isdigit()))
    path = case["path"].partition(".")[2] if of_source else {"part": "parts"}.get(path, path)
    texts = [case[key] if of_source else KEY.sub(r"\1", case[key]) for key in PARTS]
    told = (problem.where, problem.must_hold, problem.received, problem.remedy)
    for word, text in zip(case.get("in_python", [path, *texts]), told, strict=True):
        assert word in text


@pytest.mark.parametrize("path", [3, 1.5, [], object, b"steel_a3", "steal"])
def test_a_material_that_is_not_there(path):
    with pytest.raises(InputError) as caught:
        fm.material(path)
    assert isinstance(path, str) == ("steel_a3" in caught.value.problems[0].remedy)


def test_names_of_materials():
    with pytest.raises(InputError):
        fm.material("steel_a3", name=np.ones((3, 3)))
    odd = fm.LinearMaterial(np.ones((3, 3)), 100.0)
    rod = fm.Body("b", "steel", fm.Cylinder(0.01, 0.02), mesh_size=0.005)
    assert fm.Device("d", "a", bodies=[rod], materials={"steel": odd}).materials["steel"].name == "steel"


@pytest.mark.parametrize("axis", [np.zeros(3), np.zeros(0), "xy", "", None, 1])
def test_an_axis(axis):
    for call in (lambda: COIL.turned(axis, 30.0), lambda: COIL.mirrored(axis), lambda: COIL.around(axis, 3)):
        with pytest.raises(InputError):
            call()


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


def test_a_class_of_ones_own_may_take_other_arguments():
    class Coin(fm.Cylinder):
        def __init__(self, size):
            super().__init__(size, 0.1 * size)

    assert Coin(0.01).height == pytest.approx(0.001)
