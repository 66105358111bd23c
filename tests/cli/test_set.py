"""`--set KEY=VALUE` of the commands that take a device: one mechanism, and its effects."""

import pytest

from fieldmap.device import read_device
from fieldmap.store import read_info

LOOP = """format = 1
name = "loop"
title = "A loop"
parameters = { turns = 100 }
coil = [{ name = "1", kind = "circular", inner_radius_mm = 29, outer_radius_mm = 31, height_mm = 2, turns = "= turns" }]
workspace = { shape = "box", lower_mm = [-4, -4, -24], upper_mm = [4, 4, -16] }
"""


def test_the_machine_that_comes_out(command, answer):
    assert {coil["turns"] for coil in answer("check drive_unit")["coils"]} == {840}
    changed = answer("check drive_unit --set coil.*.turns=900 --set payload.mass_g=5")
    assert {coil["turns"] for coil in changed["coils"]} == {900}
    _, text, _ = command("check drive_unit --set parameters.gap=300 --toml")
    assert read_device(text).bodies[-1].parts[0].placement.position[2] == pytest.approx(-0.306)


@pytest.mark.parametrize("line", ["solve", "probe --currents 1"])
def test_fields_follow_the_turns(answer, line):
    fields = []
    for turns in (100, 250):
        found = answer(f"{line} --at 0 0 -0.014 --set coil.loop.turns={turns} loop_and_sphere")
        fields.append((found["points"][0] if line == "solve" else found)["B"][2])
    assert fields[1] == pytest.approx(2.5 * fields[0], rel=1e-12)


def test_a_map_records_the_changed_device(command, answer, tmp_path):
    """A map of coils alone, made by a recipe: the current for a given field follows the number of turns."""
    recipe = tmp_path / "loop_map.toml"
    (tmp_path / "loop.toml").write_text(LOOP)
    recipe.write_text('format = 1\ntitle = "A loop"\ndevice = "loop.toml"\nspacing_mm = 2.0\n')
    fields, fingerprints = [], set()
    for turns in (100, 250):
        path = tmp_path / f"{turns}.h5"
        assert command("map -o", path, recipe, f"--set=parameters.turns={turns}")[0] == 0
        record = read_info(path).provenance
        assert read_device(record.device_text).coils[0].turns == turns
        fields.append(answer("probe --at 0 0 -0.02 --currents 1", path)["B"][2])
        fingerprints.add(record.fingerprint)
    assert fields[1] == pytest.approx(2.5 * fields[0], rel=1e-12)
    assert len(fingerprints) == 2
