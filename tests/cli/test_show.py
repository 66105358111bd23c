"""`fieldmap show` and `fieldmap app` with --json, and on a machine without a screen."""

import os
import subprocess
import sys

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.lookup import open_map
from tests.cli.thin_loop import flux
from tests.plot.conftest import needs_opengl


@pytest.mark.usefixtures("unsmoothed")
@needs_opengl
def test_slices_in_numbers(answer, machine, tmp_path):
    picture = tmp_path / "slices.png"
    told = answer("show --quantity Bz --currents 2 --save", picture, machine.map)
    assert (told["what"], told["saved"], told["currents"]) == ("slices", str(picture), [2.0])
    # The field is lowest at the bottom and highest on the axis at the top, 60 mm below the loop.
    low, high = told["ranges"]["Bz, mT"]
    assert high == pytest.approx(2e3 * flux(-0.060), rel=1e-3)
    assert low == pytest.approx(2e3 * flux(-0.124), rel=0.02)
    assert told["upper"] == [0.006, 0.006, -0.06]
    assert told["assumptions"]


@needs_opengl
def test_an_equilibrium_in_numbers(answer, machine, tmp_path):
    line = "show --what equilibrium --currents 4 --save"
    shown = answer(line, tmp_path / "floating.png", machine.map)["equilibrium"]
    found = answer("equilibrium --currents 4", machine.map)["position"]
    np.testing.assert_allclose(shown, found, atol=1e-9)


@needs_opengl
def test_reachable_flux_densities_in_numbers(answer, six_coils, tmp_path):
    """The ends of the set along z have every coil at its limit, with the sign that helps."""
    picture = tmp_path / "set.png"
    line = "show --what reachable --quantity B --at-mm '3 -2 -95' --limit 2.5 --save"
    told = answer(line, picture, six_coils)["reachable"]
    opened = open_map(six_coils)
    each = np.array([opened.field([0.003, -0.002, -0.095], row)[2] for row in np.eye(6)])
    assert max(corner[2] for corner in told["vertices"]) == pytest.approx(2.5 * np.abs(each).sum(), rel=1e-9)
    assert told["position"] == pytest.approx([0.003, -0.002, -0.095])
    assert picture.is_file()


@pytest.mark.usefixtures("unsmoothed")
def test_the_app_in_numbers(answer, machine, tmp_path):
    told = answer("app --limit 5 --save", tmp_path / "app.png", machine.map)
    assert [slider["name"] for slider in told["sliders"]] == ["coil loop", "magnet z"]
    assert told["lift"] == pytest.approx(1.0)
    np.testing.assert_allclose(told["equilibrium"], told["place"], atol=1e-5)


@pytest.mark.parametrize(
    ("words", "height"), [("--height-mm=-87", pytest.approx(-0.087, abs=1e-15)), ("", None)]
)
def test_the_height_of_the_shift_is_passed_on_in_metres(command, machine, monkeypatch, words, height):
    """The shift itself needs a map of six coils: tests/plot/test_scenes.py."""
    asked = []

    def gathered(source, currents, what, minus, z, *of_reachable):
        asked.append((source.name, what, z))
        raise InputError.of("shown_field", "asked", "enough", "stop")

    monkeypatch.setattr("fieldmap.plot.gather.shown_field", gathered)
    assert command(f"show --what shift --save shift.png {words}", machine.map)[0] == 2
    assert asked == [("loop.h5", "shift", height)]


@needs_opengl
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux machines have no screen")
def test_without_a_screen_a_picture_comes_without_a_word(machine, tmp_path):
    """In a subprocess, because VTK chooses its renderer once; it must not complain about a missing X server."""
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    picture = tmp_path / "device.png"
    program = [sys.executable, "-m", "fieldmap", "show", machine.device, "--save", str(picture)]
    done = subprocess.run(program, capture_output=True, text=True, env=environment, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    assert picture.stat().st_size > 10_000


@needs_opengl
@pytest.mark.skipif(sys.platform != "linux" or "DISPLAY" in os.environ, reason="there is a screen")
@pytest.mark.parametrize("words", [["show", "device"], ["app", "map"]])
def test_without_a_screen_there_is_no_window_but_a_message(command, machine, words):
    code, _, told = command(words[0], getattr(machine, words[1]))
    assert (code, "needs a screen" in told, "--save" in told) == (1, True, True)
