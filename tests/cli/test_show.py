"""`fieldmap show` and `fieldmap app` in numbers, and on a machine without a screen."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.cli import main
from fieldmap.errors import InputError, Problem
from fieldmap.lookup import open_map
from fieldmap.plot.rendering import can_render

needs_opengl = pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")


def on_axis(z, amperes):
    """B_z of a loop of 1000 turns and 44 mm radius, T."""
    return mu_0 * 1000 * amperes * 0.044**2 / (2 * (0.044**2 + z**2) ** 1.5)


@pytest.mark.usefixtures("unsmoothed")
@needs_opengl
def test_slices_in_numbers(machine, tmp_path, capsys):
    picture = tmp_path / "slices.png"
    words = ["show", machine.map, "--quantity", "Bz", "--currents", "2", "--save", str(picture), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["what"], told["saved"], told["currents"]) == ("slices", str(picture), [2.0])
    # Lowest at the bottom, highest on the axis at the top, 60 mm below the loop.
    low, high = told["ranges"]["Bz, mT"]
    assert high == pytest.approx(1e3 * on_axis(-0.060, 2.0), rel=1e-3)
    assert low == pytest.approx(1e3 * on_axis(-0.124, 2.0), rel=0.02)
    assert told["upper"] == [0.006, 0.006, -0.06]
    assert told["assumptions"]


@needs_opengl
def test_an_equilibrium_in_numbers(machine, tmp_path, capsys):
    picture = str(tmp_path / "floating.png")
    words = ["--currents", "4", "--json"]
    assert main(["show", machine.map, "--what", "equilibrium", "--save", picture, *words]) == 0
    shown = json.loads(capsys.readouterr().out)["equilibrium"]
    assert main(["equilibrium", machine.map, *words]) == 0
    np.testing.assert_allclose(shown, json.loads(capsys.readouterr().out)["position"], atol=1e-9)


@needs_opengl
def test_reachable_flux_densities_in_numbers(six_coils, tmp_path, capsys):
    """The ends of the set along z: every coil at its limit, with the sense that helps."""
    words = ["--what", "reachable", "--quantity", "B", "--at-mm", "3 -2 -95", "--limit", "2.5"]
    picture = tmp_path / "set.png"
    assert main(["show", str(six_coils), *words, "--save", str(picture), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["reachable"]
    opened = open_map(six_coils)
    each = np.array([opened.field([0.003, -0.002, -0.095], row)[2] for row in np.eye(6)])
    assert max(corner[2] for corner in told["vertices"]) == pytest.approx(2.5 * np.abs(each).sum(), rel=1e-9)
    assert told["position"] == pytest.approx([0.003, -0.002, -0.095])
    assert picture.is_file()
    # Forces want a payload, which this map does not record.
    assert main(["show", str(six_coils), "--what", "reachable", "--save", str(picture)]) == 2


@pytest.mark.usefixtures("unsmoothed")
def test_the_app_in_numbers(machine, tmp_path, capsys):
    assert main(["app", machine.map, "--save", str(tmp_path / "app.png"), "--json", "--limit", "5"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [slider["name"] for slider in told["sliders"]] == ["coil loop", "magnet z"]
    assert told["lift"] == pytest.approx(1.0)
    np.testing.assert_allclose(told["equilibrium"], told["place"], atol=1e-5)


@pytest.mark.parametrize(("words", "height"), [(["--height-mm", "-87"], -0.087), ([], None)])
def test_the_height_of_the_shift_is_passed_on_in_metres(machine, monkeypatch, words, height):
    """The shift itself takes a map of six coils: tests/plot/test_scenes.py."""
    asked = []

    def gathered(source, currents, what, minus, z, *of_reachable):
        asked.append((source.name, what, z))
        raise InputError(Problem("shown_field", "asked", "enough", "stop"))

    monkeypatch.setattr("fieldmap.plot.gather.shown_field", gathered)
    assert main(["show", machine.map, "--what", "shift", "--save", "shift.png", *words]) == 2
    assert asked == [("loop.h5", "shift", height if height is None else pytest.approx(height, abs=1e-15))]


@needs_opengl
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux machines have no screen")
def test_without_a_screen_a_picture_comes_without_a_word(machine, tmp_path):
    """A process of its own: VTK chooses what it draws with once, and complained about an X server."""
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    picture = tmp_path / "device.png"
    program = [sys.executable, "-m", "fieldmap", "show", machine.device, "--save", str(picture)]
    done = subprocess.run(program, capture_output=True, text=True, env=environment, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    assert picture.stat().st_size > 10_000


@needs_opengl
@pytest.mark.skipif(sys.platform != "linux" or "DISPLAY" in os.environ, reason="there is a screen")
@pytest.mark.parametrize("words", [["show", "device"], ["app", "map"]])
def test_without_a_screen_there_is_no_window_but_a_message(machine, capsys, words):
    assert main([words[0], getattr(machine, words[1])]) == 1
    told = capsys.readouterr().err
    assert "needs a screen" in told
    assert "--save" in told
