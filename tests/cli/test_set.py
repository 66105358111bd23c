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


TOLD = "thin_loop.toml with coil.loop.turns = 250 (1000 in the file)"


@pytest.mark.parametrize(
    "line",
    [
        "check",
        "solve --currents 1",
        "probe --currents 1 --at 0 0 -0.02",
        "currents --lift --at 0 0 -0.02",
        "equilibrium --currents 10",
        "show --what slices --save slices.png",
    ],
)
def test_answers_tell_once_what_was_changed(answer, machine, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for changes, count in ((["--set", "coil.loop.turns=250"], 1), ([], 0)):
        told = str(answer(line, machine.device, *changes))
        assert (told.count(TOLD), told.count(" in the file)")) == (count, count)


@pytest.mark.parametrize("line", ["simulate", "linearise", "tune --axis z --phase-margin 40"])
def test_answers_about_a_scenario_tell_what_was_changed(answer, written, line):
    changes = ["--set=control.z.upper=20", "--set=reference.0.by_mm=0.4", "--set=noise.seed=3"]
    (words,) = (one for one in answer(line, written(), *changes)["assumptions"] if " in the file)" in one)
    stated = ("control.z.upper = 20 (10.0 in", "reference.0.by_mm = 0.4 (0.5 in", "noise.seed = 3 (not in")
    assert words == f"step.toml with {', '.join(f'{one} the file)' for one in stated)}"
    assert " in the file)" not in str(answer(line, written()))


def test_what_varies_is_told_with_its_runs_alone(answer, written):
    line = "simulate --set duration_s=0.02 --vary control.z.Kc=0.4,0.6"
    (words,) = (one for one in answer(line, written())["assumptions"] if " in the file)" in one)
    assert words == "step.toml with duration_s = 0.02 (1.0 in the file)"


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
        told = f"loop.toml with parameters.turns = {turns} (100 in the file)"
        assert answer("info", path)["assumptions"].count(told) == 1
        fields.append(answer("probe --at 0 0 -0.02 --currents 1", path)["B"][2])
        fingerprints.add(record.fingerprint)
    assert fields[1] == pytest.approx(2.5 * fields[0], rel=1e-12)
    assert len(fingerprints) == 2
