"""Keys of a device file set to other values: their effects, the recorded text, and refused changes."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device import read_device, recorded_device
from fieldmap.errors import DeviceFileError, InputError, RecipeError
from fieldmap.io import find_source, open_field
from fieldmap.iron.materials import device_notes
from tests.device.test_short_forms import SHORT


def problems(changes, device=SHORT):
    with pytest.raises(DeviceFileError) as caught:
        read_device(device, changes)
    assert all((p.where, p.must_hold, p.received, p.remedy) for p in caught.value.problems)
    return caught.value.problems


def test_what_follows_from_a_parameter_follows():
    device = read_device(
        SHORT, {"parameters.bore": 12.0, "parameters.heights.2": 50.0, "coil.row*.turns": 10}
    )
    assert {coil.inner_radius for coil in device.coils} == {0.012}
    assert {coil.outer_radius for coil in device.coils} == {0.022}
    assert [coil.height for coil in device.coils[:4]] == [0.030, 0.050, 0.032, 0.033]
    assert [coil.turns for coil in device.coils] == [840] * 4 + [10] * 4
    assert device.bodies[0].parts[0].shape.size[2] == 0.024


def test_a_change_stands_before_what_a_parameter_gives():
    device = read_device(SHORT, {"coil.c1.inner_radius_mm": 9.0, "parameters.bore": 12.0})
    assert [coil.inner_radius for coil in device.coils[:2]] == pytest.approx([0.009, 0.012])


def test_parameters_take_expressions_lists_and_arrays():
    device = read_device(SHORT, {"parameters.bore": "= radius/4", "parameters.heights": np.full(4, 20.0)})
    assert {coil.inner_radius for coil in device.coils} == {0.011}
    assert {coil.height for coil in device.coils[:4]} == {0.020}
    entry = SHORT.replace("[30.0,", '["= bore",')
    both = read_device(entry, {"parameters.heights.2": 50.0, "parameters.bore": 12.0})
    assert [coil.height for coil in both.coils[:3]] == [0.012, 0.050, 0.032]


def test_arrays_whole_numbers_and_texts():
    changes = {"workspace.lower_mm": (-5.0, -5.0, -100.0), "coil.*.turns": np.float64(900.0), "name": "mine"}
    device = read_device("disk_six_cores", changes)
    assert device.workspace.lower.tolist() == [-0.005, -0.005, -0.1]
    assert {coil.turns for coil in device.coils} == {900}
    assert device.name == "mine"


@pytest.mark.parametrize("name", ["drive_unit", "loop_and_sphere"])
def test_the_text_of_a_changed_device_is_that_device(name):
    """The text in a map, which also identifies a stopped run, contains the changes."""
    key = {"drive_unit": "parameters.gap", "loop_and_sphere": "coil.loop.turns"}[name]
    before, after = read_device(name), read_device(name, {key: 150.0})
    assert before.text != after.text
    again = read_device(after.text)
    for one, other in zip(again.bodies + again.coils, after.bodies + after.coils, strict=True):
        assert one.to_dict() == other.to_dict()
    assert recorded_device(after.text).coil_names == after.coil_names


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"parameters.bore": 12.0}, "parameters.bore = 12.0 (11.0 in the file)"),
        ({"parameters.bore": "= radius/4"}, 'parameters.bore = "= radius/4" (11.0 in the file)'),
        ({"coil.*.turns": 10}, "coil.*.turns = 10 (840 in the file)"),
        # What follows from a parameter is told as the file has it.
        (
            {"coil.c1.inner_radius_mm": 9.0, "parameters.bore": 12.0},
            "coil.c1.inner_radius_mm = 9.0 (11.0 in the file), parameters.bore = 12.0 (11.0 in the file)",
        ),
        (
            {"coil.*.height_mm": np.float64(20.0)},
            "coil.*.height_mm = 20.0 (30.0, 31.0, 32.0, 33.0, ... in the file)",
        ),
    ],
)
def test_a_device_tells_which_keys_were_changed_and_what_the_file_states(changes, words):
    device = read_device(SHORT, changes)
    assert device.changed == f"device text with {words}"
    assert read_device(device.text).changed == recorded_device(device.text).changed == device.changed
    assert device.replace(name="mine").changed == read_device(SHORT).changed == ""


def test_a_changed_device_in_a_background_tells_both():
    device = read_device("magnet_core", {"payload.mass_g": 6.0})
    assert device_notes(device)[1:] == ("magnet_core.toml with payload.mass_g = 6.0 (5.0 in the file)",)
    assert device_notes(read_device("magnet_core")) == device_notes(device)[:1]


@pytest.mark.parametrize(
    "key", ["parameters.boer", "coil.c9.turns", "coil", "coil.c1", "parameters", "", "..", "*"]
)
def test_keys_that_the_file_lacks(key):
    (problem,) = problems({key: 1.0})
    assert problem.where == f"device text: {key}".removesuffix(": ")
    assert f'"{key}"' in problem.received


def test_a_wrong_value_is_told_where_it_was_set():
    (problem,) = problems({"coil.c2.turns": -5})
    assert problem.where == "device text, as changed: coil.c2.turns"
    assert problem.received == "-5"


def test_a_parameter_that_spoils_an_expression_is_told_there():
    found = problems({"parameters.bore": 0.0})
    line = SHORT[: SHORT.index("inner_radius_mm")].count("\n") + 1
    assert f"device text:{line}: coil.c1.inner_radius_mm" in [problem.where for problem in found]


@pytest.mark.parametrize(
    "changes", ["parameters.gap=3", {3: 4}, [("a", 1)], np.zeros(3), np.zeros(0), ["parameters.gap"]]
)
def test_changes_are_a_mapping(changes):
    assert problems(changes)[0].where == "changes"


@pytest.mark.parametrize(
    "value", [float("nan"), 1e308, {}, None, object(), [[1.0], 2.0], "= 9**9**9", 10**400]
)
@pytest.mark.parametrize(
    "key", ["parameters.bore", "coil.*.turns", "body.post.size_mm", "material.steel.mu_r"]
)
def test_any_value_at_any_key(key, value):
    problems({key: value})


def test_what_is_no_file_takes_no_changes(tmp_path):
    device = read_device("loop_and_sphere")
    with pytest.raises(InputError):
        read_device(device, {"coil.loop.turns": 5})
    with pytest.raises(RecipeError):
        fm.generate(device, tmp_path / "a.h5", spacing=4e-3, changes={"coil.loop.turns": 5})
    assert not list(tmp_path.iterdir())


def test_fields_and_sources_of_changed_devices():
    """Twice the turns give twice the field of linear iron."""
    point = [0.0, 0.0, -0.014]
    once = open_field("loop_and_sphere").at(1.0).field(point)
    twice = open_field("loop_and_sphere", changes={"coil.loop.turns": 200}).at(1.0).field(point)
    assert twice == pytest.approx(2 * once, rel=1e-12)
    assert find_source("drive_unit", changes={"parameters.gap": 300.0}).device.text.count("300.0")
