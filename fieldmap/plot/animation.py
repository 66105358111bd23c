"""Pictures of a recorded run: the path with the body in space, and an animation of the machine with its currents, the
body from near, and the time. Lengths in mm."""

import textwrap
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from PIL import Image

from fieldmap.device.placement import AXES
from fieldmap.extras import require
from fieldmap.plot import solids
from fieldmap.plot.device_drawing import IRON, MAGNET
from fieldmap.plot.picture import core_bounds, look_at
from fieldmap.plot.places import MM
from fieldmap.plot.rendering import new_scene
from fieldmap.plot.scales import add_coloured, add_rulers, add_words, colour_bar
from fieldmap.plot.shown import Shown, ShownRun
from fieldmap.plot.style import INK
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import Array, Index, PathLike

TIME = "time, s"
_SMOOTH: dict[str, Any] = {"smooth_shading": True, "split_sharp_edges": True}
_POINTS = 2000
"""Largest number of points of the drawn path."""


def body_parts(run: ShownRun) -> list[tuple[pv.PolyData, dict[str, Any]]]:
    """Surfaces of the body about the origin, upright, mm, with their options for add_mesh."""
    parts: list[tuple[pv.PolyData, dict[str, Any]]] = []
    payload = run.device.payload
    surface = None if payload is None else solids.payload_surface(payload)
    if surface is not None:
        parts.append((surface, {"color": MAGNET, "ambient": 0.3, **_SMOOTH}))
    if run.body is not None:
        look = {"color": "#8fa3b5", "opacity": 0.3 if parts else 1.0, "ambient": 0.4}
        parts.append((solids.upright_cylinder(*run.body), look))
    return parts or [(pv.Sphere(radius=1.0), {"color": MAGNET})]


def path_samples(run: ShownRun) -> Index:
    """Samples of the drawn path."""
    return np.unique(np.linspace(0, len(run.time) - 1, min(_POINTS, len(run.time))).astype(np.int64))


def add_path(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """The path coloured by time, the reference path, and the outline of the magnet at the end."""
    run = shown.run
    assert run is not None
    samples = path_samples(run)
    path = pv.lines_from_points(MM * run.position[samples])
    path[TIME] = run.time[samples]
    add_coloured(scene, path, TIME, line_width=5, render_lines_as_tubes=True, lighting=False)
    scene.add_mesh(pv.lines_from_points(MM * run.wanted[samples]), color=INK, line_width=2, lighting=False)
    magnet = outline(body_parts(run)[0][0]).transform(run.pose(-1), inplace=False)
    scene.add_mesh(magnet, color=MAGNET, line_width=2, lighting=False)


def outline(surface: pv.PolyData) -> pv.PolyData:
    """Edges of a surface, which hide nothing behind them; three circles for a sphere."""
    edges = solids.sharp_edges(surface)
    if edges.n_points:
        return edges
    return pv.merge([surface.slice(normal=normal, origin=surface.center) for normal in AXES])


WINDOW, FRAMES_PER_SECOND, MOST_SECONDS = (960, 576), 12, 10.0
CURRENT = "current, A"
_FONT = 9


def save_animation(
    run: ShownRun,
    path: PathLike,
    progress: Callable[[str, float], None] | None = None,
    frames: int | None = None,
    window: tuple[int, int] = WINDOW,
) -> Path:
    """Write a run as .gif or .mp4 of ten seconds at most; a longer run is shown faster, with the factor in the picture.

    Parameters
    ----------
    run
        A recorded run.
    path
        Ends in .gif or .mp4.
    progress
        Called with a word and the share of drawn frames.
    frames
        Number of frames; twelve per second by default.
    window
        Size of a frame, pixels; for .mp4 multiples of 16.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    FieldmapError
        For .mp4 without imageio-ffmpeg (an optional extra), or on a machine without OpenGL.
    """
    target = Path(path)
    write = _write_gif
    if target.suffix != ".gif":
        ffmpeg = require("imageio_ffmpeg", "video", "fieldmap.plot.save_animation", "save a .gif")
        write = partial(_write_mp4, ffmpeg)
    seconds = float(np.clip(run.time[-1] - run.time[0], 1.0, MOST_SECONDS))
    count = max(2, round(FRAMES_PER_SECOND * seconds)) if frames is None else frames
    pictures = _pictures(run, count, seconds, window, progress)
    with whole_file(target, "film") as partly:
        write(partly, pictures, count / seconds, window)
    return target


def _write_gif(path: Path, pictures: Iterator[Any], per_second: float, _: tuple[int, int]) -> None:
    first, *others = (
        Image.fromarray(picture).quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        for picture in pictures
    )
    duration = round(1000 / per_second)
    first.save(path, save_all=True, append_images=others, duration=duration, loop=0, optimize=False)


def _write_mp4(
    ffmpeg: Any, path: Path, pictures: Iterator[Any], per_second: float, window: tuple[int, int]
) -> None:
    # Browsers and players need yuv420p.
    encoder = ffmpeg.write_frames(
        str(path), window, fps=per_second, codec="libx264", pix_fmt_out="yuv420p", quality=7
    )
    encoder.send(None)
    for picture in pictures:
        encoder.send(np.ascontiguousarray(picture))
    encoder.close()


def _pictures(
    run: ShownRun,
    count: int,
    seconds: float,
    window: tuple[int, int],
    progress: Callable[[str, float], None] | None,
) -> Iterator[Any]:
    """Images (height, width, 3) of 8 bits, evenly spaced in time."""
    scene = new_scene(window, panels=2)
    scene.enable_anti_aliasing("msaa", multi_samples=4)
    moments = np.searchsorted(run.time, np.linspace(run.time[0], run.time[-1], count))
    moving = _build(scene, run, (run.time[-1] - run.time[0]) / seconds)
    for done, k in enumerate(moments.clip(0, len(run.time) - 1)):
        if progress is not None:
            progress("drawing", done / count)
        moving(int(k))
        yield scene.screenshot(None, return_img=True)
    scene.close()


def _build(scene: pv.Plotter, run: ShownRun, speed: float) -> Callable[[int], None]:
    """Draw everything once, and return a function that moves it to a sample."""
    scene.subplot(0, 0)
    coils = _add_machine(scene, run)
    bodies = [scene.add_mesh(surface, **look) for surface, look in body_parts(run)]
    look_at(scene, core_bounds(run.device), margin=0.3)
    slower = "" if np.isclose(speed, 1.0) else f"\nshown at {speed:.3g} times real time"
    words = textwrap.fill(run.title, 48) + slower
    add_words(scene, words, (0.04, 0.03), _FONT)
    scene.subplot(0, 1)
    samples, points = path_samples(run), MM * run.position[path_samples(run)]
    trail = _add_near(scene, run, points)
    # The body is an outline here, because it would hide the path.
    magnet, look = body_parts(run)[0]
    bodies.append(scene.add_mesh(outline(magnet), color=look["color"], line_width=2, lighting=False))

    def move(k: int) -> None:
        for surface, current in zip(coils, run.currents[k], strict=True):
            surface[CURRENT] = np.full(surface.n_points, current)
        for actor in bodies:
            actor.user_matrix = run.pose(k)
        # Later points of the path coincide with the present one.
        trail.points = np.where((samples <= k)[:, None], points, MM * run.position[k])
        scene.subplot(0, 1)
        add_words(scene, _stamp(run, k), (0.03, 0.97), _FONT, name="stamp")
        scene.render()

    return move


def _stamp(run: ShownRun, k: int) -> str:
    x, y, z = MM * run.position[k]
    event = f"   {run.event}" if run.event and k == len(run.time) - 1 else ""
    return f"t = {run.time[k]:6.2f} s   x {x:+.2f}  y {y:+.2f}  z {z:.2f} mm{event}"


def _add_machine(scene: pv.Plotter, run: ShownRun) -> list[pv.PolyData]:
    """Draw iron, workspace, and coils with their current as colour. Returns the coils."""
    for body in run.device.bodies:
        scene.add_mesh(solids.body_surface(run.device, body), color=IRON, ambient=0.35, **_SMOOTH)
    if run.device.workspace is not None:
        scene.add_mesh(
            solids.workspace_outline(run.device.workspace), color=INK, line_width=1.5, lighting=False
        )
    settings = colour_bar(CURRENT, run.currents)
    place = {"position_x": 0.84, "position_y": 0.22, "height": 0.4}
    settings["scalar_bar_args"] |= {"title_font_size": 16, "label_font_size": 14, **place}
    surfaces: list[pv.PolyData] = []
    for coil in run.device.coils:
        surface = solids.winding_surface(coil)
        surface[CURRENT] = np.zeros(surface.n_points)
        first = not surfaces
        add_coloured(scene, surface, CURRENT, settings, ambient=0.6, diffuse=0.5, show_scalar_bar=first)
        surfaces.append(surface)
    return surfaces


def _add_near(scene: pv.Plotter, run: ShownRun, points: Array) -> pv.PolyData:
    """Draw the reference path, rulers around all positions of the magnet, and the path so far, which is returned."""
    reach = solids.extent(body_parts(run)[0][0]).T
    room = (points.min(axis=0) + reach[0]) / MM, (points.max(axis=0) + reach[1]) / MM
    scene.add_mesh(solids.box_edges(room), color=INK, line_width=1, opacity=0.25)
    add_rulers(scene, font_size=13, spread=1.7)
    look_at(scene, solids.extent(scene), margin=0.3)
    wanted = MM * run.wanted[path_samples(run)]
    scene.add_mesh(pv.lines_from_points(wanted), color="#9aa3ab", line_width=1.5, lighting=False)
    trail = pv.lines_from_points(points)
    scene.add_mesh(trail, color="#D55E00", line_width=4, render_lines_as_tubes=True, lighting=False)
    return trail
