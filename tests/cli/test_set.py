"""`--set KEY=VALUE` of the commands that take a device: one mechanism, what it changes and what it refuses."""

import json

import pytest

from fieldmap.device import read_device
from fieldmap.store import read_info

POINT = ("--at", "0", "0", "-0.014")


def test_the_machine_that_comes_out(command):
    _, before, _ = command("check", "drive_unit", "--json")
    code, out, _ = command(
        "check", "drive_unit", "--set", "coil.*.turns=900", "--set", "payload.mass_g=5", "--json"
    )
    assert code == 0
    assert {coil["turns"] for coil in json.loads(before)["coils"]} == {840}
    assert {coil["turns"] for coil in json.loads(out)["coils"]} == {900}
    code, text, _ = command("check", "drive_unit", "--set", "parameters.gap=300", "--toml")
    assert read_device(text).bodies[-1].parts[0].placement.position[2] == pytest.approx(-0.306)


@pytest.mark.parametrize("words", [("solve",), ("probe", "--currents", "1")], ids=lambda words: words[0])
def test_fields_follow_the_turns(command, words):
    fields = []
    for turns in (100, 250):
        what = (
            words[0],
            "loop_and_sphere",
            *words[1:],
            *POINT,
            "--set",
            f"coil.loop.turns={turns}",
            "--json",
        )
        code, out, _ = command(*what)
        answer = json.loads(out)
        assert code == 0
        fields.append((answer["points"][0] if words[0] == "solve" else answer)["B"][2])
    assert fields[1] == pytest.approx(2.5 * fields[0], rel=1e-12)


def test_a_map_records_the_changed_device(command, six_coils, tmp_path):
    """A map of coils alone, made of a recipe: the current that gives a field follows the turns."""
    device = tmp_path / "loop.toml"
    device.write_text(
        'format = 1\nname = "loop"\ntitle = "A loop"\n[parameters]\nturns = 100\n[[coil]]\nname = "1"\n'
        'kind = "circular"\ninner_radius_mm = 29\nouter_radius_mm = 31\nheight_mm = 2\nturns = "= turns"\n[workspace]\n'
        'shape = "box"\n'
        "lower_mm = [-4, -4, -24]\nupper_mm = [4, 4, -16]\n"
    )
    recipe = tmp_path / "loop_map.toml"
    recipe.write_text('format = 1\ntitle = "A loop"\ndevice = "loop.toml"\nspacing_mm = 2.0\n')
    fields = []
    for turns in (100, 250):
        path = tmp_path / f"{turns}.h5"
        code, _, _ = command("map", str(recipe), "-o", str(path), "--set", f"parameters.turns={turns}")
        assert code == 0
        assert read_device(read_info(path).provenance.device_text).coils[0].turns == turns
        _, out, _ = command("probe", str(path), "--at", "0", "0", "-0.02", "--currents", "1", "--json")
        fields.append(json.loads(out)["B"][2])
    assert fields[1] == pytest.approx(2.5 * fields[0], rel=1e-12)
    fingerprints = {read_info(tmp_path / f"{turns}.h5").provenance.fingerprint for turns in (100, 250)}
    assert len(fingerprints) == 2
