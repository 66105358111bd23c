"""`fieldmap show` and `fieldmap app` in numbers, and on a machine without a screen."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.cli import main
from fieldmap.device.model import Payload
from fieldmap.device.payload import PayloadPiece, SoftSphere
from fieldmap.errors import InputError, Problem
from fieldmap.io import FieldSource, find_source
from fieldmap.levitation import reachable
from fieldmap.lookup import interpolate, open_map
from fieldmap.plot.gather import DEFAULT_LIMIT, floating_height, shown_field
from fieldmap.plot.rendering import can_render
from fieldmap.store import Grid, MapData
from tests.conftest import DEVICES

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
    assert (
        main(["app", machine.map, "--save", str(tmp_path / "app.png"), "--json", "--current-limit", "5"]) == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert [slider["name"] for slider in told["sliders"]] == ["coil loop", "magnet z"]
    assert told["lift"] == pytest.approx(1.0)
    np.testing.assert_allclose(told["equilibrium"], told["place"], atol=1e-5)


def test_the_shift_is_shown_where_the_magnet_floats():
    """dBz/dz = b + c z per ampere on the axis: the weight is carried at one height."""
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    x, y, z = grid.points().T
    b, c = 0.04, 1.0
    radial = -0.5 * (b + c * z)
    flux = np.column_stack([radial * x, radial * y, b * z + 0.5 * c * (z**2 - 0.5 * (x**2 + y**2))])
    slope = np.zeros((125, 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = radial
    slope[:, 2, 2] = b + c * z
    slope[:, 0, 2] = slope[:, 2, 0] = -0.5 * c * x
    slope[:, 1, 2] = slope[:, 2, 1] = -0.5 * c * y
    arrays = {"flux_density": flux.reshape(1, 5, 5, 5, 3), "gradient": slope.reshape(1, 5, 5, 5, 3, 3)}
    field = interpolate(MapData(grid, ("coil",), [1.0], **arrays), kind="global")
    bounds = (field.lower, field.upper)
    about = ("a.h5", "", "map", ("coil",), bounds, Payload(0.010, 0.8), None, None)
    source = FieldSource(*about, make=lambda: field)
    height, why = floating_height(source, np.array([3.0]))
    assert height == pytest.approx((0.010 * 9.80665 / (0.8 * 3.0) - b) / c, abs=1e-8)
    assert "nowhere" not in why
    middle = -0.02 + 0.5 * 4 * 0.01
    height, why = floating_height(source, np.array([0.1]))
    assert height == pytest.approx(middle, abs=1e-12)
    assert "nowhere" in why


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


def test_the_shift_of_a_map_of_four_coils():
    """Coil k: Bz = 0.1 z + 2 (z^2 - (r - r_k)^2 / 2) per ampere, r_k in the corners of a square of 40 mm.

    The magnet rests at the centroid of the currents, and a signal s along x or y moves it by s times 20 mm.
    """
    grid = Grid([-0.02] * 3, [0.01] * 3, (5, 5, 5))
    flux, slope = np.zeros((4, 125, 3)), np.zeros((4, 125, 3, 3))
    for k, place in enumerate(0.02 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])):
        dx, dy, z = (grid.points() - [*place, 0.0]).T
        along = -0.05 - 2 * z
        flux[k] = np.column_stack([along * dx, along * dy, 0.1 * z + 2 * z**2 - dx**2 - dy**2])
        slope[k, :, 0, 0] = slope[k, :, 1, 1] = along
        slope[k, :, 2, 2] = 0.1 + 4 * z
        slope[k, :, 0, 2] = slope[k, :, 2, 0] = -2 * dx
        slope[k, :, 1, 2] = slope[k, :, 2, 1] = -2 * dy
    names = ("a", "b", "c", "d")
    arrays = {"flux_density": flux.reshape(4, 5, 5, 5, 3), "gradient": slope.reshape(4, 5, 5, 5, 3, 3)}
    field = interpolate(MapData(grid, names, np.ones(4), **arrays), kind="global")
    about = ("a.h5", "", "map", names, field.bounds, Payload(0.010, 0.8), None, None)
    shown = shown_field(FieldSource(*about, make=lambda: field), np.full(4, 2.0), "shift", height=-0.01)
    x, y = np.meshgrid(shown.surface.x_signals, shown.surface.y_signals, indexing="ij")
    np.testing.assert_allclose(shown.surface.positions[..., 0], 0.02 * x, atol=1e-8)
    np.testing.assert_allclose(shown.surface.positions[..., 1], 0.02 * y, atol=1e-8)


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


def test_the_app_wants_a_map(tmp_path, capsys):
    assert main(["app", "drive_unit", "--save", str(tmp_path / "a.png")]) == 2
    assert "drive_unit" in capsys.readouterr().err
    assert main(["app", "some.h5", "--save", str(tmp_path / "a.html")]) == 2
    assert ".png" in capsys.readouterr().err


def test_bad_requests(tmp_path):
    assert main(["show", "loop_and_sphere", "--save", str(tmp_path / "picture.bmp")]) == 2
    assert main(["show", "loop_and_sphere", "--what", "all", "--save", str(tmp_path / "a.png")]) == 2
    assert main(["show", "nothing_here", "--save", str(tmp_path / "a.png")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_what_a_map_reaches_is_within_the_limit_of_its_driver(dipole_map, circle_of_six, tmp_path):
    device = (DEVICES / "everything.toml").read_text(encoding="utf-8")
    source = find_source(dipole_map(circle_of_six, tmp_path / "six.h5", device))
    assert source.driver.current_limit != DEFAULT_LIMIT
    found = shown_field(source, np.zeros(6), "reachable", kind="B").reachable
    middle = 0.5 * (source.bounds[0] + source.bounds[1])
    expected = reachable(source.field, middle, source.driver.current_limit)
    assert found.largest_along([0, 0, 1]) == pytest.approx(expected.largest_along([0, 0, 1]), rel=1e-12)


def test_reachable_forces_on_soft_iron_are_searched(dipole_map, circle_of_six, tmp_path):
    """Within the limit, which some current takes, and said to be a search's."""
    device = (DEVICES / "everything.toml").read_text(encoding="utf-8")
    bead = Payload(1e-4, pieces=(PayloadPiece(SoftSphere(1e-3, mu_r=100.0)),))
    source = replace(find_source(dipole_map(circle_of_six, tmp_path / "six.h5", device)), payload=bead)
    one = shown_field(source, np.zeros(6), "reachable", kind="force", limit=0.02)
    assert not one.reachable.exact
    assert one.reachable.moment.soft
    assert any("134 directions" in text for text in one.assumptions)
    assert np.abs(one.reachable.currents).max() == pytest.approx(0.02, rel=1e-9)
    told = one.to_dict()["reachable"]
    assert np.shape(told["values"]) == (134, 3)
