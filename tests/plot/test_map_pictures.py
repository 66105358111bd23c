"""The pictures that lie beside a map: files, what they show, and what a map cannot show."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.currents import divide_currents
from fieldmap.io.map_summary import summarise_map
from fieldmap.levitation import ShiftBesideMeasured
from fieldmap.lookup import open_map
from fieldmap.plot.map_pictures import save_map_pictures, shift_curves
from fieldmap.plot.rendering import can_render
from tests.plot.conftest import pixels_of

SIGNALS = np.array([0.1, 0.2])
# Measured on a rig: source, n, reading and height of the sensor, level, zero, signals, and places beside models.
SHIFT = ShiftBesideMeasured(
    *("Table 2", 1.25, 10.0, -0.1, 2.0, -1e-4, SIGNALS),
    measured=0.010 * SIGNALS,
    constant_lift=0.011 * SIGNALS,
    levels=2.0 + SIGNALS,
    constant_level=0.012 * SIGNALS,
)


@pytest.fixture
def six_map(circle_of_six, dipole_map, tmp_path, rig):
    """The map of six dipoles, of a device with a payload."""
    return dipole_map(circle_of_six, tmp_path / "six.h5", rig(mass_g=10.0, moment_A_m2=0.8), title="Dipoles")


def dark(path):
    """Share of the pixels that are not white."""
    return float((pixels_of(path).min(axis=-1) < 230).mean())


def test_both_pictures_are_written_beside_the_map(six_map):
    figure, scene = save_map_pictures(summarise_map(six_map))
    assert (figure.shows, scene.shows) == ("figure", "3-D picture")
    assert figure.path == six_map.with_name("six.png")
    assert 0.1 < dark(figure.path) < 0.9
    if can_render():
        assert scene.path == six_map.with_name("six_3d.png")
        assert dark(scene.path) > 0.02
    else:
        assert scene.path is None
        assert scene.problem


@pytest.mark.parametrize("has_device", [True, False])
def test_a_map_without_a_payload_shows_its_field(circle_of_six, dipole_map, tmp_path, rig, has_device):
    path = dipole_map(circle_of_six, tmp_path / "bare.h5", rig() if has_device else "")
    figure, scene = save_map_pictures(summarise_map(path))
    assert dark(figure.path) > 0.1
    # What records no device cannot be drawn in space.
    assert (scene.path is not None) is (has_device and can_render())
    assert (scene.path is None) == bool(scene.problem)


def test_without_opengl_the_figure_is_drawn_all_the_same(six_map, monkeypatch):
    monkeypatch.setattr("fieldmap.plot.rendering.can_render", lambda: False)
    figure, scene = save_map_pictures(summarise_map(six_map))
    assert figure.path == six_map.with_name("six.png")
    assert (scene.path, bool(scene.problem)) == (None, True)
    assert [path.name for path in six_map.parent.glob("*.png")] == ["six.png"]


def test_the_figure_beside_measurements(six_map, legible):
    summary = summarise_map(six_map)
    curves = shift_curves(open_map(six_map), summary.payload, SHIFT)
    legible([curves])
    measured, follows, stays = curves.series
    np.testing.assert_allclose(measured.x, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(measured.y, [-0.1, 1.0, 2.0])
    # From the reading at signal 0 on; in a linear map both rules are one, and no force acts along x.
    assert follows.y[0] == stays.y[0] == pytest.approx(-0.1)
    np.testing.assert_allclose(follows.y, stays.y, atol=2e-3)
    place = np.array([1e-3 * (stays.y[-1] + 0.1), 0.0, -0.1])
    gradient = open_map(six_map).gradient(place, divide_currents(2.0, 0.2, 0.0, 1.25))
    assert abs(gradient[2, 0]) < 1e-3 * abs(gradient[2, 2])
    before = six_map.with_name("six.png")
    save_map_pictures(summary)
    without = before.read_bytes()
    save_map_pictures(replace(summary, shifts=(SHIFT,)))
    assert before.read_bytes() != without
