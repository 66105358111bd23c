"""The pictures written next to a map: files, content, and pictures that a map cannot have."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.currents import divide_currents
from fieldmap.curves import Series
from fieldmap.io.map_summary import summarise_map
from fieldmap.levitation import ShiftBesideMeasured
from fieldmap.lookup import open_map
from fieldmap.plot import map_pictures
from fieldmap.plot.map_pictures import save_map_pictures, shift_curves, shift_message
from fieldmap.plot.rendering import can_render
from tests.plot.conftest import pixels_of

SIGNALS = np.array([0.1, 0.2])
# Measured on a rig: source, n, reading and height of the sensor, level, zero, signals; then positions and models.
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
    # A map without a recorded device has no 3-D picture.
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
    # Relative to the reading at signal 0; in a linear map both rules coincide, and no force acts along x.
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


CYLINDER = fm.Payload(0.010, magnet=fm.MagnetCylinder(0.004, 0.010, 1.2))
ABOUT = SimpleNamespace(title="A map", device_text="text")


@pytest.fixture
def drawn(harmonic_map, monkeypatch):
    """drawn(**summary): the pictures, the saved figure, and the arguments of the 3-D picture, for two coils about the
    middle of a box, (10, -10) mm, at 3 A and 2 A."""
    coils = {"left": (0.02, 0.09, 1.0, (0.01, -0.01)), "right": (0.01, 0.07, 0.5, (0.01, -0.01))}
    opened = harmonic_map(lower=(-0.01, -0.03, -0.05), reference=[3.0, 2.0], **coils)
    saved = {}

    def keep(name):
        return lambda *given, **options: saved.update({name: (given, options)}) or Path(f"{name}.png")

    monkeypatch.setattr(map_pictures, "open_map", lambda path: opened)
    monkeypatch.setattr(map_pictures, "save_figure", keep("figure"))
    monkeypatch.setattr(map_pictures, "save_picture", keep("picture"))
    monkeypatch.setattr(map_pictures, "recorded_device", lambda text, solids: (text, solids))

    def draw(payload=CYLINDER, lift=(), shifts=(), about=ABOUT):
        info = SimpleNamespace(reference_current=np.array([3.0, 2.0]), provenance=about)
        summary = SimpleNamespace(
            path=Path("folder/map.h5"), info=info, lift=lift, payload=payload, shifts=shifts
        )
        told = save_map_pictures(summary)
        return told, saved["figure"], saved.get("picture")

    return draw


def row(current, height):
    return SimpleNamespace(current=current, height=height)


def test_pictures_at_the_current_that_carries_the_magnet_in_the_middle(drawn):
    """At the middle one of the heights with a current, rounded to a milliampere."""
    rows = [row(None, -0.02), row(1.0, -0.022), row(1.23456, -0.0254), row(1.5, -0.028), row(None, -0.03)]
    told, ((figure, path, kind), _), ((at, device, field, currents, magnet, caption), options) = drawn(
        lift=rows
    )
    assert [(one.shows, one.path, one.problem) for one in told] == [
        ("figure", Path("figure.png"), ""),
        ("3-D picture", Path("picture.png"), ""),
    ]
    assert (path, at, kind) == (Path("folder/map.png"), Path("folder/map_3d.png"), "drawn figure")
    assert (device, currents.tolist(), magnet) == (("text", True), [1.235, 1.235], (0.0, 0.0, -0.0254))
    assert caption == "they carry the magnet at z = -25 mm; arrows: net force on it"
    assert (options, field.coil_names) == ({"forces": True}, ("left", "right"))
    left, right, *_ = figure.axes
    lines = left.get_title("left").split("\n")
    assert lines[:2] == ["1.235 A in each of 2 coils", "red: where lift equals weight, and the magnet there"]
    assert lines[2].startswith("arrows: net force, up to ")
    (magnet,) = left.patches
    assert (magnet.get_x(), magnet.get_y()) == pytest.approx((-2.0, -30.4))
    assert (magnet.get_width(), magnet.get_height()) == pytest.approx((4.0, 10.0))
    assert magnet.get_facecolor()[3] == 0.0
    assert 1.0 < magnet.get_linewidth() < 2.5
    # On the axis Bz = (0.03 + 0.16 z + 0.75 z^2) I.
    (line,) = right.lines
    z = 1e-3 * line.get_xdata()
    assert (len(z), z[0], z[-1]) == (201, pytest.approx(-0.05), pytest.approx(-0.01))
    np.testing.assert_allclose(line.get_ydata(), 1e3 * 1.235 * (0.03 + 0.16 * z + 0.75 * z**2), rtol=1e-9)
    assert (right.get_xlabel(), right.get_ylabel()) == ("z (mm)", "Bz (mT)")
    assert right.get_title("left") == "On the axis, 1.235 A in each of 2 coils"
    assert figure.get_suptitle() == "A map"
    assert figure.get_size_inches() == pytest.approx((11.4, 5.2))
    figure.draw_without_rendering()
    narrow, wide = left.get_subplotspec().get_gridspec().get_width_ratios()
    assert 0.5 < narrow / wide < 0.9
    assert left.bbox.x1 < figure.axes[2].bbox.x0 < right.bbox.x0 < left.bbox.x1 + 0.25 * figure.bbox.width


def test_pictures_of_a_map_that_carries_nothing(drawn):
    """At its reference currents, without a magnet; with two rows the second counts as the middle."""
    _, ((figure, *_), _), ((*_, currents, magnet, caption), _) = drawn(lift=[row(None, -0.02)])
    assert (currents.tolist(), magnet, caption) == ([3.0, 2.0], None, "")
    left = figure.axes[0]
    assert left.get_title("left").split("\n")[0] == "left: 3 A, right: 2 A"
    assert "red" not in left.get_title("left")
    assert not left.patches
    _, _, ((*_, currents, magnet, _), _) = drawn(lift=[row(1.0, -0.02), row(2.0, -0.03)])
    assert (currents.tolist(), magnet) == ([2.0, 2.0], (0.0, 0.0, -0.03))
    # Only a cylinder has an outline.
    sphere = fm.Payload(0.010, magnet=fm.MagnetSphere(0.004, 1.2))
    _, ((figure, *_), _), _ = drawn(payload=sphere, lift=[row(1.0, -0.02)])
    assert (len(figure.axes[0].patches), "red" in figure.axes[0].get_title("left")) == (0, False)
    _, ((figure, *_), _), _ = drawn(payload=None, shifts=(SHIFT,))
    assert figure.axes[0].get_title("left") == "plane y = -10 mm\nleft: 3 A, right: 2 A"
    assert figure.axes[1].get_ylabel() == "Bz (mT)"


def test_a_map_that_records_no_device_says_why_there_is_no_picture(drawn):
    (figure, scene), _, picture = drawn(about=SimpleNamespace(title="A map", device_text=""))
    assert (figure.problem, scene.path, picture) == ("", None, None)
    assert (
        scene.problem
        == f"{Path('folder/map_3d.png')} not drawn: the map must record its device; none recorded"
    )


def test_shifts_stand_beside_what_was_measured(drawn, monkeypatch):
    """Relative to the reading at signal 0; the name of a line that ends early says that the map ends."""
    asked = []

    def surface(opened, payload, x, y, level, height, division, hold_height):
        asked.append((len(x), x[0], x[-1], y, level, height, division.n, hold_height))
        positions = np.zeros((len(x), 1, 3))
        positions[:, 0, 0] = 0.002 + (0.02 if hold_height else 0.03) * x
        if not hold_height:
            positions[x > 0.15] = np.nan
        return SimpleNamespace(positions=positions)

    monkeypatch.setattr(map_pictures, "equilibrium_surface", surface)
    _, ((figure, *_), _), _ = drawn(shifts=(SHIFT,))
    about = (81, 0.0, 0.2, [0.0], 2.0, -0.1, 1.25)
    assert asked == [(*about, True), (*about, False)]
    axes = figure.axes[1]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x signal", "x of the magnet (mm)")
    title = "Where the magnet comes to rest at z = -100 mm as one direction signal rises\nNothing is fitted"
    assert axes.get_title("left") == title
    dots, held, level = axes.lines
    np.testing.assert_allclose(dots.get_data(), [[0.0, 0.1, 0.2], [-0.1, 1.0, 2.0]], atol=1e-12)
    x = np.linspace(0.0, 0.2, 81)
    np.testing.assert_allclose(held.get_data(), [x, -0.1 + 20.0 * x], atol=1e-9)
    np.testing.assert_allclose(level.get_data(), [x, np.where(x > 0.15, np.nan, -0.1 + 30.0 * x)], atol=1e-9)
    words = {text.get_text() for text in axes.get_legend().get_texts()}
    assert {"measured on the rig, Table 2"} <= words
    curves = shift_curves(None, None, SHIFT)
    names = [series.name for series in curves.series]
    assert names == ["measured on the rig, Table 2", "lift constant", "mean current 2.000 A (map ends)"]
    assert [(one.kind, one.points) for one in curves.series] == [
        ("measured", True),
        ("ours", False),
        ("ours", False),
    ]
    # The measured magnet moves from -0.1 to 2 mm; at the end the model is at 3.9 mm, off by 1.9 mm of 2.1 mm.
    assert (
        curves.message
        == "Equilibrium moves 2 mm at signal 0.2; at constant lift the model follows within 90 %"
    )


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ([0.0, 4.5, 8.1], "10 %"),
        ([0.0, 4.0, 9.9], "10 %"),
        ([0.0, 4.9, np.nan], "10 % up to 0.2"),
        ([1.8, 4.0, 9.0], "20 %"),
    ],
)
def test_the_message_of_a_shift(model, words):
    """Relative to the measured movement, 9 mm, as far as the model goes."""
    signals = [0.0, 0.2, 0.4]
    measured = Series("measured", signals, [0.5, 4.5, 9.5], "measured", points=True)
    ours = Series("ours", signals, 0.5 + np.array(model))
    expected = f"Equilibrium moves 9 mm at signal 0.4; at constant lift the model follows within {words}"
    assert shift_message(measured, ours) == expected
