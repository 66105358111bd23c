"""Recorded runs as pictures: the body stands where it was, the stamp and the colours say when and with what current."""

import numpy as np
import pytest
import pyvista as pv
from PIL import Image

import fieldmap
from fieldmap.cli import main
from fieldmap.plot.animation import TIME, body_parts, outline, save_animation
from fieldmap.plot.shown import ShownRun
from fieldmap.store import RunRecord, is_run_file, write_runs
from tests.plot.conftest import needs_opengl

TIMES = np.linspace(0.0, 30.0, 301)
WINDOW = (320, 192)


def signals():
    """Round a circle of 2 mm, 44 mm below the core, the current rising from 1 to 2 A, a quarter turn about x."""
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
    # Of the points of one circle the two others share four.
    assert (in_plane.sum(axis=0) >= 36).all()


@needs_opengl
def test_a_gif_moves_and_changes_colour(run, tmp_path):
    path = save_animation(run, tmp_path / "run.gif", frames=3, window=WINDOW)
    with Image.open(path) as picture:
        assert picture.n_frames == 3
        assert picture.size == WINDOW
        # Ten seconds for thirty.
        assert picture.info["duration"] == pytest.approx(1e4 / 3, rel=0.02)
        frames = []
        for k in range(3):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB")).astype(int))
    red, green, blue = np.moveaxis(np.array(frames), -1, 0)
    # On the left, without the colour bar, the coil; on the right the path.
    coil, near = np.s_[:, :, :130], np.s_[:, :, 160:]
    yellow = ((red > blue + 60) & (green > blue + 60))[coil].sum(axis=(1, 2))
    violet = ((blue > green + 30) & (red > green + 10))[coil].sum(axis=(1, 2))
    assert yellow[2] > 100 > yellow[0]
    assert violet[0] > 100 > violet[2]
    orange = ((red > 180) & (abs(green - 94) < 40) & (blue < 60))[near].sum(axis=(1, 2))
    assert (np.diff(orange) > 0).all()
    assert list(tmp_path.iterdir()) == [path]


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
    # What was asked of the sensed point, 5 mm above, is drawn where the centre of mass should be.
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
