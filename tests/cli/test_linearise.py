"""`fieldmap linearise`: what is written and refused."""

import json

import numpy as np
import pytest


def test_models_are_written(command, six_coils, tmp_path):
    words = (
        "linearise",
        "horizontal_pid",
        "--map",
        six_coils,
        "--set",
        "plate.thickness_mm=1.0",
        "--depths",
        "9,11",
    )
    code, _, err = command(*words, "-o", tmp_path / "linear.npz")
    assert code == 0, err
    stored = np.load(tmp_path / "linear.npz")
    assert stored["A"].shape == (2, 6, 6)
    assert stored["loop_A"].shape[0] == 2
    code, text, err = command(*words, "--json")
    answer = json.loads(text)
    np.testing.assert_allclose([point["A"] for point in answer["points"]], stored["A"])
    poles = np.linalg.eigvals(stored["A"][1])
    assert max(pole for pole, _ in (mode["pole"] for mode in answer["points"][1]["modes"])) == pytest.approx(
        poles.real.max()
    )
    code, _, _ = command(*words, "--set", "control.z.Kc=0.0")
    assert code == 1
    code, _, err = command(*words[:4], "--depths", "a", "-o", tmp_path / "x.csv")
    assert code == 2
    assert "--depths" in err
    assert ".npz" in err


def test_what_rounding_leaves_of_a_mode_is_printed_as_zero(command):
    # Nothing but rounding turns an upright magnet of one axis about that axis.
    code, text, err = command("linearise", "hold", "--map", "sample", "--set", "field.scale=2")
    assert code == 0, err
    turning = [line.split() for line in text.splitlines() if "turn_z" in line]
    assert [words[-2] for words in turning] == ["0", "0"]


def test_a_machine_that_cannot_carry_its_payload_anywhere_says_so(command):
    # The shipped map's six coils need 5.8 A at its highest place, and their driver gives 3.55 A.
    code, _, err = command("simulate", "hold", "--map", "sample")
    assert code == 1
    told = " ".join(err.split())
    assert "3.55 A" in told
    assert "lighter payload" in told
