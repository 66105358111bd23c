"""What the commands print, against the closed form of a thin loop."""

import json
import re
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from fieldmap.cli.check import kinds_of_file
from fieldmap.device import read_device
from fieldmap.io.json_schema import FILE_KINDS
from fieldmap.shipped import shipped_file
from tests.cli.thin_loop import MASS, MOMENT, bend, flux, gravity, lift_current, slope


@pytest.mark.parametrize("source", ["device", "map"])
def test_probe(answer, machine, source):
    found = answer("probe --at 0 0 -0.09 --currents 2 --payload", getattr(machine, source))
    assert found["at"] == [0, 0, -0.09]
    assert found["currents"] == [2.0]
    np.testing.assert_allclose(found["B"], [0, 0, 2 * flux(-0.09)], rtol=2e-4, atol=1e-9)
    expected = 2 * slope(-0.09) * np.diag([-0.5, -0.5, 1.0])
    np.testing.assert_allclose(found["gradient"], expected, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(found["force"], MOMENT * expected[2], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(found["torque"], 0.0, atol=1e-9)


def test_probe_with_a_moment_of_ones_own(answer, machine):
    found = answer("probe --at-mm 0,0,-90 --currents 1 --moment 0.5 0 0", machine.map)
    # T = m x B turns the dipole about -y; F_x = m dBx/dx.
    np.testing.assert_allclose(found["torque"], [0, -0.5 * flux(-0.09), 0], rtol=2e-4, atol=1e-9)
    np.testing.assert_allclose(found["force"], [-0.25 * slope(-0.09), 0, 0], rtol=1e-3, atol=1e-6)


def test_probe_with_the_payload_of_another_device(answer, machine, tmp_path):
    other = tmp_path / "other.toml"
    text = Path(machine.device).read_text()
    other.write_text(re.sub(r"(?m)^moment_A_m2 = .*$", f"moment_A_m2 = {3 * MOMENT}", text))
    found = answer("probe --at 0 0 -0.09 --currents 2 --payload-of", other, machine.map)
    assert found["moment"] == pytest.approx([0, 0, 3 * MOMENT])
    assert found["force"][2] == pytest.approx(3 * MOMENT * 2 * slope(-0.09), rel=1e-3)


@pytest.mark.parametrize("turning", ["", "fixed", "free"])
@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_all_questions_take_the_direction_that_the_payload_states(
    answer, machine, tmp_path, direction, sign, turning
):
    """At the equilibrium the force is the weight; the least current that carries the payload is the lift current."""
    other, words = tmp_path / "other.toml", f'direction = "{direction}"\n'
    words += f'turning = "{turning}"\n' if turning else ""
    other.write_text(Path(machine.device).read_text().replace("[payload]\n", f"[payload]\n{words}"))
    carries = sign * lift_current(-0.095)
    found = answer(f"equilibrium --currents={carries} --payload-of", other, machine.map)
    x, y, z = found["position"]
    assert [x, y, z] == pytest.approx([0, 0, -0.095], abs=2e-5)
    place = f"--at='{x} {y} {z}' --payload-of"
    probed = answer(f"probe --currents={carries} {place}", other, machine.map)
    assert probed["moment"] == pytest.approx([0, 0, sign * MOMENT], abs=1e-7)
    assert probed["force"] == pytest.approx([0, 0, MASS * gravity], rel=1e-4, abs=1e-7)
    state = "free to turn" if turning == "free" else "fixed"
    assert found["held"] == f"moment {direction}, {state}"
    assert probed["held"] == ("moment along the field, free to turn" if turning == "free" else found["held"])
    lifted = answer(f"equilibrium --height-mm={1e3 * z} --payload-of", other, machine.map)
    # A free magnet is attracted by currents of either sign.
    assert lifted["lift_current"] == pytest.approx(abs(carries) if turning == "free" else carries, rel=1e-4)
    least = answer(f"currents --lift {place}", other, machine.map)
    assert least["by_name"] == {"loop": pytest.approx(carries, rel=1e-4)}


def test_several_points_give_a_list(answer, machine):
    found = answer("probe --at-mm '0 0 -70' --at '0 0 -0.1' --currents 1", machine.map)
    assert [row["at"][2] for row in found] == pytest.approx([-0.1, -0.07])
    np.testing.assert_allclose([row["B"][2] for row in found], [flux(-0.1), flux(-0.07)], rtol=2e-4)


@pytest.mark.parametrize("source", ["device", "map"])
def test_lift_current_at_a_height(answer, machine, source):
    found = answer("equilibrium --height-mm -95", getattr(machine, source))
    assert found["lift_current"] == pytest.approx(lift_current(-0.095), rel=1e-3)
    # There is no measured sensor for this machine.
    assert found["sensor_mm"] is None


@pytest.mark.parametrize("source", ["device", "map"])
def test_equilibrium_at_given_currents(answer, machine, source):
    current = lift_current(-0.095)
    found = answer("equilibrium --currents", current, getattr(machine, source))
    np.testing.assert_allclose(found["position"], [0, 0, -0.095], atol=2e-5)
    stiffness = MOMENT * current * bend(-0.095) * np.diag([0.5, 0.5, -1.0])
    np.testing.assert_allclose(found["stiffness"], stiffness, rtol=0.02, atol=5e-3 * abs(stiffness[2, 2]))
    assert found["stable_axes"] == {"x": True, "y": True, "z": False}
    assert found["weight"] == pytest.approx(MASS * gravity)


def test_solve_prints_the_known_values_of_the_file(answer):
    """With the closed form next to the result, for the smallest device with iron."""
    found = answer("solve loop_and_sphere")
    assert len(found["references"]) == 8
    for row in found["references"]:
        assert abs(row["ours"] / row["reference"] - 1) == pytest.approx(abs(row["deviation"]))
        assert abs(row["deviation"]) < 2e-3


def test_known_values_for_another_permeability_are_not_compared(answer):
    found = answer("solve loop_and_sphere --mu-r 10")
    assert [row["ours"] for row in found["references"]] == [None] * 8


def test_check_lists_what_is_there(answer):
    found = answer("check drive_unit")
    assert [coil["name"] for coil in found["coils"]] == ["1", "2", "3", "4", "5", "6"]
    assert {coil["turns"] for coil in found["coils"]} == {840}
    volumes = {body["name"]: body["volume"] for body in found["bodies"]}
    assert volumes["disk"] == pytest.approx(np.pi * 0.066**2 * 0.006, rel=1e-9)
    assert any("magnet_offset" in text for text in found["assumptions"])


def test_info(answer, machine):
    found = answer("info", machine.map)
    assert found["coil_names"] == ["loop"]
    np.testing.assert_allclose(found["middle"]["at"], [0, 0, -0.092], atol=1e-12)
    np.testing.assert_allclose(found["middle"]["Bz"], [flux(-0.092)] * 2, rtol=2e-4)
    np.testing.assert_allclose(found["middle"]["dBz_dz"], [slope(-0.092)] * 2, rtol=1e-3)
    for row in found["lift"]:
        assert row["current"] == pytest.approx(lift_current(row["height"]), rel=1e-3)
        assert row["measured"] is None  # (7-18) was measured on another machine


def test_check_prints_the_machine_that_short_forms_make(command, tmp_path):
    code, text, _ = command("check disk_six_cores --toml")
    assert code == 0
    path = tmp_path / "whole.toml"
    path.write_text(text)
    data, whole = tomllib.loads(text), read_device(path)
    assert not {"include", "parameters", "defaults"} & set(data)
    assert [coil["resistance_ohm"] for coil in data["coil"]] == [4.27, 4.23, 4.25, 4.25, 4.29, 4.25]
    assert [one.name for one in whole.bodies] == [one.name for one in read_device("disk_six_cores").bodies]


def test_linear_iron_that_would_saturate_is_named(answer):
    """At 80 A the core with mu_r = 4000 carries about 4 T."""
    line = "probe single_electromagnet --refinement 0.5 --at-mm 0,0,-40 --currents"
    warned = [any("saturate" in text for text in answer(line, i)["assumptions"]) for i in (80, 1)]
    assert warned == [True, False]


@pytest.mark.parametrize(
    ("kind", "file", "wrong"),
    [
        ("device", "geometry/loop_and_sphere.toml", "name"),
        ("material", "geometry/materials/steel_a3.toml", "B_T"),
        ("planar-device", "geometry/planar_drive_unit.toml", "name"),
        ("recipe", "maps/quick.toml", "spacing_mm"),
        ("study", "maps/studies/pole_disk.toml", "device"),
        ("fit", "maps/fits/loop_and_sphere.toml", "unknown"),
        ("scenario", "maps/scenarios/hold.toml", "duration_s"),
    ],
)
def test_the_schema_of_a_kind_of_file_accepts_a_shipped_one(command, kind, file, wrong):
    """tests/device/test_json_schema.py checks the schema against the JSON meta-schema."""
    schema = json.loads(command("schema", kind)[1])
    validator = jsonschema.validators.validator_for(schema)(schema)
    data = tomllib.loads((Path(__file__).parents[2] / file).read_text())
    validator.validate(data)
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(data | {wrong: True})


def test_every_kind_of_file_has_a_schema(command):
    assert kinds_of_file() == [kind.name.replace(" ", "-") for kind in FILE_KINDS]
    assert command("schema")[1] == shipped_file("geometry", "device.schema.json").read_text()
