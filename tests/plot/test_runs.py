"""Recorded runs as pictures: the body at its recorded poses, the stamp, and colours for time and current."""

import sys
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista as pv
from PIL import Image

import fieldmap
from fieldmap.cli import main
from fieldmap.plot import animation
from fieldmap.plot.animation import CURRENT, TIME, body_parts, outline, path_samples, save_animation
from fieldmap.plot.device_drawing import IRON, MAGNET
from fieldmap.plot.scales import MILLIMETRES
from fieldmap.plot.shown import ShownRun
from fieldmap.plot.solids import extent
from fieldmap.plot.style import INK
from fieldmap.store import RunRecord, is_run_file, write_runs
from tests.plot.conftest import crooked_device, needs_opengl
from tests.plot.scene_reading import bars_of, bounds_of, check_legible, filled, labels_of, solids_of, words_of
from tests.plot.test_picture import CORE

TIMES = np.linspace(0.0, 30.0, 301)
WINDOW = (320, 192)


def signals():
    """A circle of 2 mm, 44 mm below the core, with the current rising from 1 to 2 A and a quarter turn about x."""
    angle = 2 * np.pi * TIMES / 30.0
    position = np.column_stack([0.002 * np.cos(angle), 0.002 * np.sin(angle), np.full(301, -0.044)])
    half = 0.25 * np.pi * TIMES / 30.0
    quaternion = np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half])
    return position, quaternion, 1.0 + TIMES[:, None] / 30.0


@pytest.fixture
def run():
    device = fieldmap.read_device("single_electromagnet")
    position, quaternion, currents = signals()
    return ShownRun("A circle", device, TIMES, position, quaternion, currents, position, None, "fell out")


@pytest.fixture
def run_file(tmp_path):
    position, quaternion, currents = signals()
    arrays = {"time": (TIMES, "s", "time"), "quaternion": (quaternion, "1", "w, x, y, z")}
    for name, lifted in (("position", 0.0), ("sensed", 0.005), ("reference", 0.005)):
        arrays[name] = (position + [0, 0, lifted], "m", "x, y, z")
    arrays["currents"] = (currents, "A", "coil")
    about = {"title": "A circle", "scenario": 'device = "single_electromagnet"', "changes": "{}"}
    return write_runs(tmp_path / "run.h5", [RunRecord(arrays, {"event": ""})], about)


def test_the_pose_turns_and_moves(run):
    tip = run.pose(-1) @ [0.0, 0.0, 3.0, 1.0]
    np.testing.assert_allclose(tip[:3], [2.0, -3.0, -44.0], atol=1e-9)
    np.testing.assert_allclose((run.pose(75) @ [0, 0, 0, 1])[:3], [0.0, 2.0, -44.0], atol=1e-9)


def test_the_outline_spans_the_magnet(run):
    surface, _ = body_parts(run)[0]
    np.testing.assert_allclose(outline(surface).bounds, surface.bounds, atol=0.01)
    cylinder = pv.Cylinder(direction=(0, 0, 1), radius=3.0, height=8.0, resolution=64)
    assert outline(cylinder).length == pytest.approx(cylinder.length, rel=1e-6)
    assert outline(cylinder).n_cells == 128  # two rims, no facets between


def test_the_outline_of_a_sphere_is_three_circles():
    circles = outline(pv.Sphere(radius=2.0, theta_resolution=40, phi_resolution=40))
    np.testing.assert_allclose(np.linalg.norm(circles.points, axis=1), 2.0, rtol=0.01)
    in_plane = np.abs(circles.points) < 1e-6
    assert in_plane.any(axis=1).all()
    # The points of one circle include four of the other two.
    assert (in_plane.sum(axis=0) >= 36).all()


@needs_opengl
def test_a_gif_moves_and_changes_colour(run, tmp_path):
    path = save_animation(run, tmp_path / "run.gif", frames=3, window=WINDOW)
    with Image.open(path) as picture:
        assert picture.n_frames == 3
        assert picture.size == WINDOW
        # The 30 s take 10 s.
        assert picture.info["duration"] == pytest.approx(1e4 / 3, rel=0.02)
        # The animation repeats.
        assert picture.info["loop"] == 0
        frames = []
        for k in range(3):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB")).astype(int))
    red, green, blue = np.moveaxis(np.array(frames), -1, 0)
    # The coil on the left, without the colour bar; the path on the right.
    coil, near = np.s_[:, :, :130], np.s_[:, :, 160:]
    yellow = ((red > blue + 60) & (green > blue + 60))[coil].sum(axis=(1, 2))
    violet = ((blue > green + 30) & (red > green + 10))[coil].sum(axis=(1, 2))
    assert yellow[2] > 100 > yellow[0]
    assert violet[0] > 100 > violet[2]
    orange = ((red > 180) & (abs(green - 94) < 40) & (blue < 60))[near].sum(axis=(1, 2))
    assert (np.diff(orange) > 0).all()
    assert list(tmp_path.iterdir()) == [path]


@pytest.fixture
def crooked():
    """A run of the crooked device: 3 s in 7 samples, a quarter turn about x, and a body about its magnet."""
    time = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])
    position = 1e-3 * np.column_stack([time, -2.0 * time, -20.0 + time])
    half = 0.25 * np.pi * (time - 1.0) / 3.0
    quaternion = np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half])
    currents = np.column_stack([time, -0.5 * time])
    wanted = position + [0.0, 0.0, 0.002]
    about = (time, position, quaternion, currents, wanted, (0.006, 0.009), "fell out")
    return ShownRun("A run of the crooked machine " * 3, crooked_device(), *about)


@pytest.fixture
def watched(crooked, monkeypatch):
    """watched(**options): for each picture of an animation the content of both panels; then the written frames."""

    def draw(run=crooked, only=99, **options):
        frames, told, written = [], [], {}

        def read(scene, *_, **__):
            for k in range(2 if len(frames) < 2 * only else 0):
                scene.subplot(0, k)
                check_legible(scene, smallest=8.5)
                coils = [
                    one.mapper.dataset[CURRENT][[0, -1]].tolist()
                    for one in solids_of(scene)
                    if one.mapper.array_name == CURRENT
                ]
                looks = [
                    (one.prop.color.hex_rgb.lower(), one.prop.opacity, one.prop.line_width, bounds_of(one))
                    for one in solids_of(scene)
                ]
                about = {
                    "coils": coils,
                    "looks": looks,
                    "words": words_of(scene),
                    "labels": labels_of(scene),
                    "bars": bars_of(scene),
                }
                core = np.array(CORE, float)
                frames.append(
                    SimpleNamespace(core=filled(scene, core), held=filled(scene, extent(scene)), **about)
                )
            return len(frames)

        def write(path, pictures, per_second, window):
            written.update(pictures=list(pictures), per_second=per_second, window=window)

        monkeypatch.setattr(pv.Plotter, "screenshot", read)
        monkeypatch.setattr(pv.Plotter, "render", lambda *_, **__: None)
        monkeypatch.setattr(animation, "_write_gif", write)
        monkeypatch.setattr(animation, "whole_file", lambda path, kind: nullcontext(path))
        save_animation(run, "run.gif", progress=lambda *words: told.append(words), **options)
        return frames[::2], frames[1::2], told, written

    return draw


@needs_opengl
def test_a_film_shows_the_machine_on_the_left_and_the_body_from_near_on_the_right(watched, crooked):
    left, right, told, written = watched()
    # Twelve pictures a second for the 3 s of the run.
    assert (len(left), written["per_second"], written["window"]) == (36, 12.0, (960, 576))
    assert [share for _, share in told] == pytest.approx(np.arange(36) / 36)
    moments = np.searchsorted(crooked.time, np.linspace(1.0, 4.0, 36)).tolist()
    assert (moments[0], moments[-1]) == (0, 6)
    for k, one, near in zip(moments, left, right, strict=True):
        currents = crooked.currents[k]
        assert one.coils == [[pytest.approx(ampere)] * 2 for ampere in currents]
        x, y, z = 1e3 * crooked.position[k]
        (stamp,) = near.words
        event = "   fell out" if k == 6 else ""
        assert stamp.words == f"t = {crooked.time[k]:6.2f} s   x {x:+.2f}  y {y:+.2f}  z {z:.2f} mm{event}"
        assert stamp.place == pytest.approx((0.03, 0.97))
        # The magnet turned about x, on the right its outline.
        red = [ends for colour, *_, ends in one.looks if colour == MAGNET]
        outline = [ends for colour, _, width, ends in near.looks if colour == MAGNET]
        assert len(red) == len(outline) == 1
        turn = np.pi / 2 * (crooked.time[k] - 1.0) / 3.0
        along = 5 * np.cos(turn) + 2 * np.sin(turn), 5 * np.sin(turn) + 2 * np.cos(turn)
        expected = np.array([[x - 2, x + 2], [y - along[1], y + along[1]], [z - along[0], z + along[0]]])
        np.testing.assert_allclose(red[0], expected, atol=0.05)
        np.testing.assert_allclose(outline[0], expected, atol=0.05)
        # The path up to this time.
        (trail,) = (ends for colour, *_, ends in near.looks if colour == "#d55e00")
        np.testing.assert_allclose(
            trail,
            1e3
            * np.column_stack([crooked.position[: k + 1].min(axis=0), crooked.position[: k + 1].max(axis=0)]),
            atol=1e-4,
        )


@needs_opengl
def test_what_does_not_move_in_a_film(watched, crooked):
    (left, *_), (right, *_), _, written = watched(frames=2, window=(640, 320))
    assert (len(written["pictures"]), written["per_second"], written["window"]) == (
        2,
        pytest.approx(2 / 3),
        (640, 320),
    )
    (words,) = left.words
    assert (
        words.words
        == "A run of the crooked machine A run of the\ncrooked machine A run of the crooked machine"
    )
    assert words.place == pytest.approx((0.04, 0.03))
    (bar,) = left.bars
    assert (bar.title, bar.range) == ("current, A", pytest.approx((-2.0, 4.0)))
    assert left.core.max() == pytest.approx(1 / 1.3)
    ends = {
        colour: [where for one, *_, where in left.looks if one == colour] for colour in (IRON, INK, "#8fa3b5")
    }
    np.testing.assert_allclose(
        ends[IRON], [[[-10, 30], [27, 33], [40, 50]], [[-35, -25], [-15, -5], [45, 55]]], atol=0.02
    )
    np.testing.assert_allclose(ends[INK], [[[-4, 5], [-6, 2], [-30, -10]]], atol=1e-5)
    # The body, 12 mm wide and 9 mm high, is translucent, so that the magnet is visible.
    (opacity,) = (opacity for one, opacity, *_ in left.looks if one == "#8fa3b5")
    assert 0.1 < opacity < 0.6
    np.testing.assert_allclose(np.ptp(ends["#8fa3b5"][0], axis=1), [12, 12, 9], atol=0.02)
    # On the right a box around all positions of the magnet, its rulers, and the reference path.
    box = next(where for one, *_, where in right.looks if one == INK)
    np.testing.assert_allclose(box, [[-1, 6], [-10, 0], [-24, -11]], atol=0.02)
    (wanted,) = (where for one, *_, where in right.looks if one == "#9aa3ab")
    np.testing.assert_allclose(wanted, [[1, 4], [-8, -2], [-17, -14]], atol=1e-4)
    assert [one.words for one in right.labels if "," in one.words] == list(MILLIMETRES)
    assert {one.size for one in right.labels} == {13}
    assert 0.5 < right.held.max() < 1.0


@needs_opengl
def test_a_film_is_ten_seconds_long_at_most_and_one_at_least(watched, crooked):
    """The caption names the ratio to real time."""
    for end, count, words in (
        (40.0, 120, "\nshown at 4 times real time"),
        (0.5, 12, "\nshown at 0.5 times real time"),
        (5.0, 60, ""),
    ):
        time = 1.0 + np.linspace(0.0, end, 7)
        (first, *_), _, _, written = watched(
            replace(crooked, time=time, title=f"{23 * 'x'} {24 * 'y'}"), only=1, window=(64, 64)
        )
        assert (len(written["pictures"]), written["per_second"]) == (count, pytest.approx(12.0))
        assert first.words[0].words == f"{23 * 'x'} {24 * 'y'}{words}"


def test_what_stands_for_a_body(crooked):
    """Magnet and translucent body, a solid body alone, the magnet alone, or a ball of 1 mm radius."""
    bare = crooked_device(payload=None)
    for run, sizes, opacities in (
        (crooked, [[4, 4, 10], [12, 12, 9]], [1.0, 0.3]),
        (replace(crooked, device=bare), [[12, 12, 9]], [1.0]),
        (replace(crooked, body=None), [[4, 4, 10]], [1.0]),
        (replace(crooked, body=None, device=bare), [[2, 2, 2]], [1.0]),
    ):
        parts = body_parts(run)
        found = [np.ptp(np.reshape(surface.bounds, (3, 2)), axis=1) for surface, _ in parts]
        np.testing.assert_allclose(found, sizes, atol=0.03)
        assert [look.get("opacity", 1.0) for _, look in parts] == pytest.approx(opacities)


@pytest.mark.parametrize(("count", "drawn"), [(5, 5), (2000, 2000), (4001, 2000)])
def test_a_path_is_drawn_with_two_thousand_points_at_most(count, drawn):
    """Evenly spread, including both ends."""
    samples = path_samples(SimpleNamespace(time=np.arange(count)))
    assert (len(samples), samples[0], samples[-1]) == (drawn, 0, count - 1)
    assert set(np.diff(samples)) <= {count // drawn, -(-count // drawn)}


@needs_opengl
def test_an_mp4_is_given_whole_frames_of_its_size_at_its_speed(run, tmp_path, monkeypatch):
    """A stand-in for the library, whose generator starts when it gets None."""
    told, frames = {}, []

    def write_frames(path, size, **options):
        told.update(options, path=path, size=size)
        return SimpleNamespace(send=frames.append, close=lambda: told.update(closed=len(frames)))

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(write_frames=write_frames))
    monkeypatch.setattr(animation, "whole_file", lambda path, kind: nullcontext(path))
    save_animation(run, tmp_path / "run.mp4", frames=3, window=(160, 96))
    nothing, *pictures = frames
    assert nothing is None
    assert [(one.shape, one.flags["C_CONTIGUOUS"]) for one in pictures] == [((96, 160, 3), True)] * 3
    assert (told["path"], told["size"], told["fps"]) == (
        str(tmp_path / "run.mp4"),
        (160, 96),
        pytest.approx(0.3),
    )
    assert (told["codec"], told["pix_fmt_out"], told["closed"]) == ("libx264", "yuv420p", 4)
    # The scale is 0 to 10, and the default 5.
    assert 5 <= told["quality"] <= 9


@needs_opengl
def test_an_mp4_has_the_frames(run, tmp_path):
    reason = "imageio-ffmpeg (extra `video`) is not installed"
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason=reason)
    path = save_animation(run, tmp_path / "run.mp4", frames=4, window=WINDOW)
    assert imageio_ffmpeg.count_frames_and_secs(str(path)) == (4, pytest.approx(10.0, rel=0.01))


@needs_opengl
def test_the_command_takes_a_run(run_file, tmp_path):
    assert is_run_file(run_file)
    assert not is_run_file(__file__)
    target = tmp_path / "path.vtm"
    assert main(["show", str(run_file), "--save", str(target)]) == 0
    blocks = pv.read(target)
    path = next(block for block in blocks if TIME in block.array_names)
    np.testing.assert_allclose(path[TIME], TIMES, rtol=1e-6)
    np.testing.assert_allclose(np.hypot(path.points[:, 0], path.points[:, 1]), 2.0, rtol=1e-5)
    # The reference of the sensed point, 5 mm above, is drawn for the centre of mass.
    heights = {round(float(block.bounds[5]), 3) for block in blocks if block.n_points == 301}
    assert heights == {-44.0}


def test_bad_requests(run_file, tmp_path, capsys):
    picture = ["--save", str(tmp_path / "a.png")]
    assert main(["show", str(run_file), "--what", "slices", "--currents", "1", *picture]) == 2
    problems = capsys.readouterr().err
    assert "--what" in problems
    assert "--currents" in problems
    empty = write_runs(tmp_path / "none.h5", [], {"title": "", "scenario": "", "changes": ""})
    assert main(["show", "loop_and_sphere", "--save", str(tmp_path / "a.gif")]) == 2
    for what in (["loop_and_sphere", "--what", "path"], [str(empty)]):
        assert main(["show", *what, *picture]) == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["none.h5", "run.h5"]
