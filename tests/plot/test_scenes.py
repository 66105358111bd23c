"""Scenes: their numbers are the field's, and the pictures have content, colours and a colour bar."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista as pv

import fieldmap
from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.levitation import EquilibriumSurface, ReachableSet, zonotope
from fieldmap.levitation.balance import upright_force
from fieldmap.plot.animation import TIME
from fieldmap.plot.device_drawing import COPPER, FLUX, IRON, MAGNET
from fieldmap.plot.field_scenes import IRON_FLUX, field_lines, iron_elements, sampled
from fieldmap.plot.forces import LEVEL, places_in_box, reachable_axes, shift_surface
from fieldmap.plot.gather import shown_device, shown_mesh
from fieldmap.plot.places import box_grid
from fieldmap.plot.scales import MILLIMETRES, colour_bar, colour_bar_by_decades
from fieldmap.plot.scenes import SCENES, axes_of, drawn_ranges, make_scene, save_scene
from fieldmap.plot.shown import Shown, ShownRun
from fieldmap.plot.solids import extent
from fieldmap.plot.style import COLOURS, INK
from tests.plot.conftest import Crooked, Harmonic, crooked_device, needs_opengl, pixels_of
from tests.plot.scene_reading import (
    bars_of,
    bounds_of,
    check_legible,
    data_of,
    filled,
    labels_of,
    solids_of,
    words_of,
)

LOWER, UPPER = np.array([-0.004, -0.004, -0.020]), np.array([0.004, 0.004, -0.012])


@pytest.fixture(scope="module")
def shown():
    """The loop and its iron sphere at 2 A."""
    device = fieldmap.read_device("loop_and_sphere")
    unit = fieldmap.solve_linear(device)
    currents = np.array([2.0])
    payload = fieldmap.read_device("single_electromagnet").payload
    return Shown(
        "loop and sphere, 2 A",
        device,
        unit,
        currents,
        LOWER,
        UPPER,
        everywhere=True,
        mesh=unit.mesh,
        flux_density=unit.at(currents).element_flux_density,
        payload=payload,
        equilibrium=np.array([0.0, 0.0, -0.014]),
        surface=tilted_plane(),
        reachable=three_ways(),
        run=falling(payload),
    )


def falling(payload):
    """A run: 3 mm down in a second."""
    time = np.linspace(0.0, 1.0, 20)
    position = np.column_stack([0 * time, 0 * time, -0.012 - 0.003 * time])
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))
    device = replace(fieldmap.read_device("loop_and_sphere"), payload=payload)
    return ShownRun("falling", device, time, position, upright, time[:, None], position, None, "")


def three_ways():
    """Forces of three coils, at most 4 mN along z and 0.2 mN along x and y, and 1 mN without currents."""
    per_ampere = np.array([[1e-4, 0.0, 1e-3], [0.0, 1e-4, 1e-3], [-1e-4, -1e-4, 2e-3]])
    lower, upper, constant = -np.ones(3), np.ones(3), np.array([0.0, 0.0, 1e-3])
    corners, triangles, volume = zonotope(per_ampere, lower, upper)
    about = {"quantity": "force", "position": np.zeros(3), "moment": np.array([0.0, 0.0, 1.0])}
    of_coils = {"coil_names": ("a", "b", "c"), "lower": lower, "upper": upper, "per_ampere": per_ampere}
    solid = {"vertices": corners + constant, "triangles": triangles, "volume": volume}
    return ReachableSet(**about, **of_coils, constant=constant, **solid)


ELEMENTS = SimpleNamespace(
    points=1e-3 * np.array([[0, 0, 0], [10, 0, 0], [0, 20, 0], [0, 0, 30], [0, 0, -60.0]]),
    tets=np.array([[0, 1, 2, 3], [0, 2, 1, 4]]),
)
CURRENTS = np.array([1.5, -0.5])


@pytest.fixture
def crooked():
    """The crooked device with everything that scenes can draw, all made up; force and weight on the payload are
    0.12 (0.3, -0.65, 2.25) N and -0.098 N along z."""
    device = crooked_device()
    return Shown(
        "crooked, 1.5 A",
        device,
        Crooked(),
        CURRENTS,
        Crooked.lower,
        Crooked.upper,
        mesh=ELEMENTS,
        flux_density=np.array([[0.3, 0.0, 0.4], [0.0, 1.2, 0.5]]),
        payload=device.payload,
        equilibrium=np.array([0.001, -0.002, -0.025]),
        surface=tilted_plane(),
        reachable=three_ways(),
        run=falling(device.payload),
    )


@pytest.fixture
def drawn(crooked):
    """drawn(what, quantity, **other): the scene of the crooked device."""
    made = []

    def draw(what, quantity="", **other):
        made.append(make_scene(replace(crooked, **other), what, quantity, window=(500, 400)))
        return made[-1]

    yield draw
    for scene in made:
        scene.close()


# The moment pi 0.002^2 0.01 1.2 / mu0 times the gradient of Bz.
FORCE = 0.12 * np.array([0.3, -0.65, 2.25])
TITLES = {
    "device": ("magnet cylinder of 4 x 10 mm in balance; red arrow: its moment", None),
    "mesh": ("", None),
    "iron": ("", "B in iron, T"),
    "lines": ("", "B, mT"),
    "slices": ("arrows: direction of B", "B, mT"),
    "surfaces": ("", "B, mT"),
    "forces": ("arrows: force on the magnet, whose centre lies in their middle", "force, mN"),
    "equilibrium": (
        "red: the magnet in balance; arrows: magnetic force and weight together",
        "net force, mN",
    ),
    "difference": ("", "d B, T"),
    "shift": ("", "current, A"),
    "reachable": ("", None),
    "path": ("red: outline of the magnet at the end; black: the path that was asked for", "time, s"),
}


@needs_opengl
@pytest.mark.parametrize("what", SCENES)
def test_every_scene_has_its_words_and_fills_the_picture(drawn, what):
    scene = drawn(what)
    check_legible(scene)
    legend, title = TITLES[what]
    (words,) = words_of(scene)
    assert words.words == f"crooked, 1.5 A\n{legend}".rstrip()
    assert words.place == pytest.approx((0.02, 0.985))
    assert [bar.title for bar in bars_of(scene)] == ([] if title is None else [title])
    # Except the bar's own actor, every actor coloured by numbers has the bar's title.
    assert list(drawn_ranges(scene)) == ([] if title is None else [title])
    boxed = [
        one
        for one in solids_of(scene, INK)
        if np.allclose(bounds_of(one), 1e3 * np.column_stack((Crooked.lower, Crooked.upper)))
    ]
    if what in ("lines", "slices", "surfaces", "forces", "equilibrium", "difference", "path"):
        assert boxed[-1].mapper.dataset.n_lines == 12
        assert not boxed[-1].prop.lighting
    elif what != "device":
        assert boxed == []
    axes = {
        "shift": ("x signal, %", "y signal, %", "x, mm"),
        "reachable": ("Fx, mN\nstretched 20 times", "Fy, mN\nstretched 20 times", "Fz, mN"),
    }
    told = [one.words for one in labels_of(scene)]
    assert [one for one in told if "," in one] == list(axes.get(what, MILLIMETRES))
    # Centred, with room for rulers and the bar; upright, seen from the front, a little from the right and above.
    ends = filled(scene, extent(scene))
    np.testing.assert_allclose(ends.sum(axis=1), 0.0, atol=1e-6)
    assert ends.max() == pytest.approx(1 / (1.4 if what == "shift" else 1.3), abs=1e-6)
    towards = np.subtract(scene.camera.position, scene.camera.focal_point)
    expected = np.array([0.42, -1.0, 0.75 if what == "shift" else 0.27])
    np.testing.assert_allclose(
        towards / np.linalg.norm(towards), expected / np.linalg.norm(expected), atol=1e-6
    )
    assert scene.camera.up == (0.0, 0.0, 1.0)
    near, far = scene.camera.clipping_range
    assert near < np.linalg.norm(towards) < far
    assert scene.window_size == [500, 400]


LEANING = fieldmap.PayloadPiece(
    fieldmap.MagnetCylinder(0.002, 0.001, 1.2), fieldmap.placed([0.001, 0, 0], [0, 90, 0])
)
SOFT = fieldmap.PayloadPiece(fieldmap.SoftSphere(0.003, mu_r=1000.0), fieldmap.placed([-0.001, 0, 0]))
BOX = fieldmap.WorkspaceBox(Crooked.lower, Crooked.upper)


@needs_opengl
@pytest.mark.parametrize(
    ("workspace", "carried", "legend", "middle", "solids"),
    [
        (
            BOX,
            {"magnet": fieldmap.MagnetCylinder(0.004, 0.01, 1.2)},
            "magnet cylinder of 4 x 10 mm in the middle of the workspace; red arrow: its moment",
            [0.5, -2.0, -20.0],
            (2, 0),
        ),
        (
            fieldmap.WorkspaceCylinder([0.001, 0.002, -0.03], 0.004, 0.02),
            {"pieces": [SOFT]},
            "soft sphere of 3 mm in the middle of the workspace",
            [0.0, 2.0, -20.0],
            (0, 1),
        ),
        (
            BOX,
            {"pieces": [LEANING, SOFT]},
            "payload in the middle of the workspace; red arrow: its moment",
            [1.5, -2.0, -20.0],
            (2, 1),
        ),
        (
            BOX,
            {"pieces": [LEANING, LEANING]},
            "payload in the middle of the workspace; red arrows: moments of its magnets",
            [1.5, -2.0, -20.0],
            (4, 0),
        ),
        (BOX, {"moment": 0.1}, "", None, (0, 0)),
        (None, {"magnet": fieldmap.MagnetSphere(0.004, 1.2)}, "", None, (0, 0)),
    ],
)
def test_a_device_holds_its_payload_in_the_middle_of_its_workspace(
    workspace, carried, legend, middle, solids
):
    device = crooked_device(bodies=(), workspace=workspace, payload=fieldmap.Payload(0.01, **carried))
    scene = make_scene(shown_device(device), window=(500, 400))
    (words,) = words_of(scene)
    red, grey = solids_of(scene, MAGNET), solids_of(scene, IRON)
    scene.close()
    assert words.words == f"A crooked machine\n{legend}".rstrip()
    assert (len(red), len(grey)) == solids
    if middle is not None:
        np.testing.assert_allclose(bounds_of((red or grey)[0]).mean(axis=1), middle, atol=0.01)


@needs_opengl
def test_a_device_without_a_payload_shows_none():
    scene = make_scene(shown_device(crooked_device(payload=None)), window=(500, 400))
    assert (words_of(scene)[0].words, solids_of(scene, MAGNET)) == ("A crooked machine", [])
    scene.close()


@needs_opengl
def test_the_moment_of_a_small_bead_is_seen():
    """Its arrow is 0.4 of the shortest side of the workspace, 8 mm; that of a large magnet is as long as the magnet."""
    for diameter, length in ((0.001, 3.2), (0.006, 6.0)):
        payload = fieldmap.Payload(1e-5, magnet=fieldmap.MagnetSphere(diameter, 1.2), direction="down")
        scene = make_scene(shown_device(crooked_device(payload=payload)), window=(500, 400))
        ball, arrow = (bounds_of(one)[2] for one in solids_of(scene, MAGNET))
        scene.close()
        np.testing.assert_allclose(ball, [-20.0 - 500 * diameter, -20.0 + 500 * diameter], atol=0.01)
        np.testing.assert_allclose(arrow, [ball[0] - length, ball[0]], atol=0.01)


@needs_opengl
def test_a_picture_is_as_large_as_its_letters_are_made_for(crooked):
    scene = make_scene(crooked)
    assert scene.window_size == [1500, 1200]
    scene.close()


@needs_opengl
@pytest.mark.parametrize(
    ("quantity", "title", "of"),
    [
        ("B", "B, mT", lambda flux, slope: np.linalg.norm(flux, axis=1)),
        ("Bz", "Bz, mT", lambda flux, slope: flux[:, 2]),
        ("gradB", "grad B, mT/m", lambda flux, slope: np.sqrt((slope**2).sum(axis=(1, 2)))),
    ],
)
@pytest.mark.parametrize("what", ["slices", "difference"])
def test_slices_through_the_middle_and_on_the_floor(drawn, what, quantity, title, of):
    scene = drawn(what, quantity)
    # A difference has the fitting unit: here T and T/m.
    title, unit = (f"d {title.replace(', mT', ', T')}", 1.0) if what == "difference" else (title, 1e3)
    planes = [one for one in solids_of(scene) if one.mapper.array_name == title]
    assert [one.mapper.dataset.dimensions for one in planes] == [(1, 61, 61), (61, 1, 61), (61, 61, 1)]
    for plane in planes:
        points, field = 1e-3 * np.asarray(plane.mapper.dataset.points, float), Crooked()
        expected = unit * of(field.field(points, CURRENTS), field.gradient(points, CURRENTS))
        np.testing.assert_allclose(plane.mapper.dataset[title], expected, rtol=1e-5)
        assert not plane.prop.lighting
    assert bool(solids_of(scene, "white")) == (what == "slices" and quantity == "B")
    # The legend explains arrows if there are any.
    assert ("arrows" in words_of(scene)[0].words) == bool(solids_of(scene, "white"))
    values = np.concatenate([plane.mapper.dataset[title] for plane in planes])
    assert drawn_ranges(scene)[title] == pytest.approx([values.min(), values.max()])


@needs_opengl
def test_surfaces_lie_at_round_values(drawn):
    """Bz = 1.5 (-0.3 + ...) - 0.5 (...): surfaces at the labels of the bar and half-way between."""
    scene = drawn("surfaces", "Bz")
    (surface,) = [one for one in solids_of(scene) if one.mapper.array_name == "Bz, mT"]
    data = surface.mapper.dataset
    there = 1e3 * Crooked().field(1e-3 * np.asarray(data.points, float), CURRENTS)[:, 2]
    np.testing.assert_allclose(there, data["Bz, mT"], atol=1e-3)
    (bar,) = bars_of(scene)
    step = (bar.range[1] - bar.range[0]) / (bar.labels - 1)
    assert step == pytest.approx(10.0)
    levels = np.unique(np.asarray(data["Bz, mT"]).round(3))
    assert np.diff(levels) == pytest.approx(5.0)
    corners = np.array(np.meshgrid(*np.column_stack((Crooked.lower, Crooked.upper)))).reshape(3, -1).T
    ends = 1e3 * Crooked().field(corners, CURRENTS)[:, 2]
    assert levels.min() - 5.0 < ends.min() < levels.min() < levels.max() < ends.max() < levels.max() + 5.0
    assert 0.3 < surface.prop.opacity < 0.8


def probed(shown, lower, upper):
    """x, y and z of the points where lines evaluate the field."""
    places = []

    class Probe(Crooked):
        def field(self, points, currents):
            places.append(np.round(points, 9))
            return super().field(points, currents)

    field_lines(replace(shown, field=Probe(), lower=lower, upper=upper))
    return places[0].T


@needs_opengl
def test_lines_begin_in_the_middle_of_the_box_and_stay_in_it(drawn, crooked):
    scene = drawn("lines")
    assert solids_of(scene, IRON) == []
    lines = field_lines(crooked)
    # On a grid of equal spacing: 48 points along the longest side, and at least 8.
    asked = [len(np.unique(one)) for one in probed(crooked, Crooked.lower, Crooked.upper)]
    assert asked == [22, 20, 48]
    thin = np.array([0.005, -0.0055, -0.01])
    assert [len(np.unique(one)) for one in probed(crooked, Crooked.lower, thin)] == [22, 8, 48]
    np.testing.assert_allclose(
        np.reshape(lines.bounds, (3, 2)), 1e3 * np.column_stack((Crooked.lower, Crooked.upper)), atol=0.3
    )
    points = np.asarray(lines.points, float)
    middle = points[np.abs(points[:, 2] + 20.0) < 1e-6]
    for axis, (low, high) in enumerate(((-4.0, 5.0), (-6.0, 2.0))):
        places = low + (np.arange(5) + 0.5) / 5 * (high - low)
        assert set(places.round(4)) <= set(middle[:, axis].round(4))
    flux = 1e3 * np.linalg.norm(Crooked().field(1e-3 * points, CURRENTS), axis=1)
    np.testing.assert_allclose(lines[FLUX], flux, rtol=1e-4)
    (tubes,) = [one for one in solids_of(scene) if one.mapper.array_name == FLUX]
    off = bounds_of(tubes) - np.reshape(lines.bounds, (3, 2))
    # The radius is 0.15 % of the largest extent.
    assert np.abs(off).max() == pytest.approx(0.0015 * 20.0, rel=0.05)
    assert not tubes.prop.lighting
    (bar,) = bars_of(scene)
    low, high = np.percentile(flux, [10.0, 98.0])
    step = (bar.range[1] - bar.range[0]) / (bar.labels - 1)
    assert bar.range[0] <= low < bar.range[0] + step
    assert bar.range[1] - step < high <= bar.range[1]


@needs_opengl
def test_lines_of_a_solution_run_round_the_machine_with_colours_by_decades(drawn, crooked):
    """In the box of workspace and iron, plus 15 % of it on each side; iron and coils are translucent."""
    scene = drawn("lines", everywhere=True)
    around = np.array([[-4.0, 10.0], [-6.0, 20.0], [-60.0, 30.0]])
    around += 0.15 * np.ptp(around, axis=1)[:, None] * [-1.0, 1.0]
    lines = field_lines(replace(crooked, everywhere=True))
    ends = np.reshape(lines.bounds, (3, 2))
    assert (np.abs(ends - around) < 2.0).sum() >= 4
    assert (ends[:, 0] > around[:, 0] - 1e-3).all()
    assert (ends[:, 1] < around[:, 1] + 1e-3).all()
    (bar,) = bars_of(scene)
    assert np.log10(bar.range) == pytest.approx(np.round(np.log10(bar.range)))
    # All iron and copper is translucent.
    through = [one.prop.opacity for one in solids_of(scene, IRON) + solids_of(scene, COPPER)]
    assert len(through) == 4
    assert max(through) <= 0.3
    assert not [one for one in scene.actors.values() if "Billboard" in type(one).__name__]
    # Weak fields far away do not extend the scale beyond five decades.
    weak = replace(crooked, field=Harmonic(0.0, 0.0, 1.0), currents=np.ones(1), everywhere=True, device=None)
    other = make_scene(weak, "lines", window=(500, 400))
    low, high = bars_of(other)[0].range
    other.close()
    assert high / low <= 1e5 * (1 + 1e-9)


@needs_opengl
def test_elements_of_iron(drawn):
    mesh, flux = drawn("mesh"), drawn("iron", flux_density=np.array([[0.3, 0.0, 0.4], [0.0, 1.2, 0.5]]))
    faces = solids_of(mesh)[0]
    assert faces.prop.show_edges
    assert faces.mapper.dataset.n_cells == 6
    assert (faces.prop.color.hex_rgb, faces.prop.edge_color.hex_rgb) == (IRON, INK)
    np.testing.assert_allclose(bounds_of(faces), [[0, 10], [0, 20], [-60, 30]], atol=1e-4)
    (coloured,) = [one for one in solids_of(flux) if one.mapper.array_name == IRON_FLUX]
    assert sorted(coloured.mapper.dataset[IRON_FLUX]) == pytest.approx([0.5] * 3 + [1.3] * 3)
    assert not coloured.prop.lighting
    assert drawn_ranges(flux) == {IRON_FLUX: pytest.approx([0.5, 1.3])}
    # The 99.5th percentile of six faces would be 2.5 % below the largest.
    spiked = drawn("iron", flux_density=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert bars_of(spiked)[0].range == pytest.approx((0.0, 1.0))


@needs_opengl
@pytest.mark.parametrize(
    ("what", "expected"), [("forces", FORCE), ("equilibrium", FORCE - [0.0, 0.0, 0.0980665])]
)
def test_arrows_of_forces_stand_in_layers(drawn, what, expected):
    scene = drawn(what)
    (arrows,) = [
        one for one in solids_of(scene) if one.mapper.array_name and "force" in one.mapper.array_name
    ]
    size = np.linalg.norm(expected)
    np.testing.assert_allclose(arrows.mapper.dataset[arrows.mapper.array_name], 1e3 * size, rtol=1e-6)
    each = np.asarray(data_of(arrows).points, float).reshape(147, -1, 3)
    # Three layers of seven by seven; the longest arrow is 1.3 times the least distance, 9 mm / 7.
    reach = np.ptp(each @ expected / size, axis=1)
    np.testing.assert_allclose(reach, 1.3 * 9 / 7, rtol=1e-4)
    along = each @ expected / size
    middles = each.mean(axis=1) + np.outer(
        0.5 * (along.min(axis=1) + along.max(axis=1)) - along.mean(axis=1), expected / size
    )
    for axis, (low, high, count) in enumerate(((-4.0, 5.0, 7), (-6.0, 2.0, 3), (-30.0, -10.0, 7))):
        places = low + (np.arange(count) + 0.5) / count * (high - low)
        np.testing.assert_allclose(np.unique(middles[:, axis].round(2)), places, atol=0.02)
    red = solids_of(scene, MAGNET)
    assert bool(red) == (what == "equilibrium")
    if red:
        np.testing.assert_allclose(bounds_of(red[0]), [[-1, 3], [-4, 0], [-30, -20]], atol=0.01)


@needs_opengl
@pytest.mark.parametrize("what", ["slices", "forces", "surfaces"])
def test_without_currents_a_scene_shows_nothing_rather_than_failing(drawn, what):
    scene = drawn(what, field=Crooked().at([0.0, 0.0]), currents=np.zeros(2))
    for title, ends in drawn_ranges(scene).items():
        assert ends == [0.0, 0.0], title
    arrows = solids_of(scene, "white")
    assert len(arrows) == (what == "slices")
    for one in arrows:
        assert np.ptp(np.asarray(data_of(one).points).reshape(35, -1, 3), axis=1).max() < 1e-6


@needs_opengl
def test_the_surface_of_rest_is_coloured_where_its_current_varies(drawn):
    varied, plane = drawn("shift", "y"), tilted_plane()
    (surface,) = [one for one in solids_of(varied) if one.mapper.array_name == LEVEL]
    np.testing.assert_allclose(bounds_of(surface), [[-30, 30], [-20, 20], [0, 0]], atol=1e-5)
    assert not surface.prop.lighting
    assert bars_of(varied)[0].range == pytest.approx((1.3, 1.7))
    for share, bars in ((2e-6, 1), (0.5e-6, 0)):
        level = 1.5 * (1.0 + share * np.linspace(0.0, 1.0, 20).reshape(5, 4))
        even = drawn("shift", surface=replace(plane, levels=level))
        assert len(bars_of(even)) == bars
    grid = solids_of(even, INK)[0]
    assert grid.mapper.dataset.n_lines == 5 * 3 + 4 * 4 - 2


@needs_opengl
def test_what_coils_reach_is_a_solid_with_arrows_of_each(drawn, crooked):
    scene = drawn("reachable")
    solid = solids_of(scene)[0]
    assert 0.2 < solid.prop.opacity < 0.5
    size = np.ptp(bounds_of(solid), axis=1).max()
    assert size == pytest.approx(8.0)
    labels = {one.words: one for one in labels_of(scene)}
    made = crooked.reachable
    arrows = [one for one in solids_of(scene) if one.prop.ambient == 0.5]
    for name, arrow, vector, colour in zip("abc", arrows, made.per_ampere, COLOURS, strict=False):
        tip = 1e3 * np.array([20.0, 20.0, 1.0]) * (vector + [0.0, 0.0, 1e-3])
        assert arrow.prop.color.hex_rgb == colour.lower()
        points = np.asarray(arrow.mapper.dataset.points)
        np.testing.assert_allclose(points[np.argmax(points @ (tip - [0, 0, 1.0]))], tip, atol=1e-4)
        np.testing.assert_allclose(labels[name].place, [0, 0, 1.0] + 1.12 * (tip - [0, 0, 1.0]), atol=1e-4)
    # A ball at the force that carries the weight of 98 mN; its label is a twentieth of the size above.
    (ball,) = solids_of(scene, MAGNET)
    weight = np.array([0.0, 0.0, 98.0665])
    np.testing.assert_allclose(bounds_of(ball), weight[:, None] + 0.014 * size * np.array([-1, 1]), atol=2e-3)
    np.testing.assert_allclose(labels["carries it"].place, weight + [0, 0, 0.05 * size], atol=1e-3)
    for other in ({"payload": None}, {"reachable": replace(made, quantity="field")}):
        bare = drawn("reachable", **other)
        assert (solids_of(bare, MAGNET), [one for one in labels_of(bare) if one.words == "carries it"]) == (
            [],
            [],
        )
    # A coil with an upper limit of zero is drawn at its lower limit, a coil without effect is not drawn.
    downward = replace(
        made, upper=np.array([0.0, 1.0, 1.0]), per_ampere=made.per_ampere * np.array([[1.0], [1.0], [1e-9]])
    )
    scene = drawn("reachable", reachable=downward)
    labels = {one.words: one.place for one in labels_of(scene)}
    np.testing.assert_allclose(labels["a"], [-2.24, 0.0, 1.0 - 1.12], atol=1e-4)
    assert ("b" in labels, "c" in labels) == (True, False)


@pytest.mark.parametrize(
    ("share", "times"),
    [(1.0, 1), (0.51, 1), (0.499, 2), (0.21, 2), (0.199, 5), (0.099, 10), (0.0499, 20), (0.0199, 50)]
    + [(0.0099, 100), (0.00499, 200), (0.00199, 500), (0.00101, 500), (0.0, 500)],
)
def test_thin_sets_are_drawn_wider_by_round_numbers(share, times):
    """Extents of 0.04 N along x and z, and of a share of that along y."""
    found = SimpleNamespace(
        vertices=np.array([[0.0, 0.0, 0.0], [0.04, 0.04 * share, 0.04]]), quantity="field", unit="T"
    )
    assert reachable_axes(found) == (("Bx, mT", "By, mT", "Bz, mT"), (1, times, 1))


@needs_opengl
def test_the_path_of_a_run_and_its_end(drawn):
    scene = drawn("path")
    (path,) = [one for one in solids_of(scene) if one.mapper.array_name == TIME]
    data = path.mapper.dataset
    np.testing.assert_allclose(data.points[:, 2], -12.0 - 3.0 * data[TIME], rtol=1e-5)
    assert (data.n_points, path.prop.lighting, path.prop.render_lines_as_tubes) == (20, False, True)
    wanted = next(one for one in solids_of(scene, INK) if one.mapper.dataset.n_points == 20)
    np.testing.assert_allclose(bounds_of(wanted), bounds_of(path))
    assert wanted.prop.line_width < path.prop.line_width
    # The magnet of 4 mm by 10 mm, 15 mm below the sensed point, as edges.
    (magnet,) = solids_of(scene, MAGNET)
    np.testing.assert_allclose(bounds_of(magnet), [[-2, 2], [-2, 2], [-20, -10]], atol=0.01)
    assert magnet.mapper.dataset.n_lines
    assert {wanted.prop.lighting, magnet.prop.lighting} == {False}


@needs_opengl
def test_a_thin_set_is_drawn_wider_and_says_so(crooked):
    scene = make_scene(crooked, "reachable", window=(300, 240))
    solid = scene.actors[next(iter(scene.actors))].mapper.dataset
    scene.close()
    found = crooked.reachable
    assert axes_of("reachable", "force", crooked) == (("Fx, mN", "Fy, mN", "Fz, mN"), (20, 20, 1))
    drawn = np.array(solid.bounds).reshape(3, 2)
    corners = 1e3 * np.array([20.0, 20.0, 1.0]) * found.vertices
    np.testing.assert_allclose(drawn.T, [corners.min(axis=0), corners.max(axis=0)], rtol=1e-5)
    # Wider, but at most as wide as high.
    assert (np.ptp(drawn, axis=1) / np.ptp(drawn[2]) > 0.4).all()
    assert np.ptp(drawn, axis=1).max() == np.ptp(drawn[2])


def test_a_flat_set_is_refused(crooked):
    flat = replace(crooked.reachable, triangles=np.empty((0, 3), dtype=np.int64))
    with pytest.raises(InputError):
        make_scene(replace(crooked, reachable=flat), "reachable", window=(300, 240))


def tilted_plane():
    """x = 20 mm times the x signal, with the current rising with y, and one corner missing."""
    x, y = np.linspace(-0.3, 0.3, 5), np.linspace(-0.2, 0.2, 4)
    positions = np.zeros((5, 4, 3))
    positions[..., 0] = 0.02 * x[:, None]
    levels = 1.5 + y[None, :] + 0.0 * x[:, None]
    positions[0, 0] = levels[0, 0] = np.nan
    return EquilibriumSurface(x, y, positions, levels, np.isfinite(levels), 1.0, ())


QUADRATIC = Harmonic(0.0, 0.0, 6.0)
"""B_z = 3 z^2 - 1.5 (x^2 + y^2)."""


@pytest.fixture
def simple():
    payload, box = fieldmap.read_device("drive_unit").payload, np.full(3, 0.02)
    return Shown("simple", None, QUADRATIC, np.array([1.0]), -box, box, payload=payload)


def coloured(image):
    """Share of the pixels that are neither white nor grey."""
    return float(np.mean(image.max(axis=2) - image.min(axis=2) > 40))


@needs_opengl
@pytest.mark.parametrize("what", SCENES)
def test_every_scene_has_content(shown, what, tmp_path):
    scene = make_scene(shown, what, window=(400, 320))
    bars = list(scene.scalar_bars.keys())
    image = pixels_of(save_scene(scene, tmp_path / f"{what}.png"))
    scene.close()
    assert 0.005 < np.mean(image.sum(axis=2) < 740) < 0.9
    assert len(bars) == (0 if what in ("device", "mesh", "reachable") else 1)
    if bars:
        assert bars[0].strip().endswith(("T", "mN", "uN", "mT/m", " A", " s"))
        assert coloured(image) > 0.005
        # The colour bar is on the right, outside the scene.
        right = image[:, int(0.86 * image.shape[1]) :]
        assert coloured(right) > 0.02


@pytest.mark.parametrize(
    ("name", "formula"),
    [
        ("B", lambda x, y, z: np.sqrt(9 * (x**2 + y**2) * z**2 + (3 * z**2 - 1.5 * (x**2 + y**2)) ** 2)),
        ("Bz", lambda x, y, z: 3 * z**2 - 1.5 * (x**2 + y**2)),
        ("gradB", lambda x, y, z: np.sqrt(54 * z**2 + 18 * (x**2 + y**2))),
    ],
)
def test_quantities_are_those_of_the_field(simple, name, formula):
    (box,), title = sampled([box_grid(simple.box, (5, 5, 5))], simple, name)
    x, y, z = 1e-3 * np.asarray(box.points).T
    np.testing.assert_allclose(box[title], 1e3 * formula(x, y, z), rtol=1e-6, atol=1e-12)


def test_the_force_is_that_of_a_vertical_dipole(simple):
    places = places_in_box(simple.box)
    force = upright_force(simple.state, simple.currents, simple.payload, places)
    x, y, z = places.T
    by_hand = simple.payload.moment * np.column_stack([-3 * x, -3 * y, 6 * z])
    np.testing.assert_allclose(force, by_hand, atol=1e-12)


@needs_opengl
def test_the_magnet_is_drawn_where_it_floats(tmp_path):
    path = tmp_path / "floating.png"
    words = ["show", "single_electromagnet", "--what", "equilibrium", "--currents", "1"]
    assert main([*words, "--save", str(path)]) == 0
    image = pixels_of(path)
    red = (image[:, :, 0] > image[:, :, 1] + 80) & (image[:, :, 0] > image[:, :, 2] + 80)
    # The sphere floats 44 mm below the core (thesis, Fig. 2-6), in the middle of a box from 30 to 60 mm.
    assert red.sum() > 300
    assert np.mean(np.nonzero(red), axis=1) / image.shape[:2] == pytest.approx([0.52, 0.5], abs=0.04)


def test_elements_fill_the_iron_and_carry_its_flux(shown):
    grid = iron_elements(shown)
    radius = 1e3 * shown.device.bodies[0].parts[0].shape.radius
    assert grid.volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.05)
    sizes = np.asarray(grid.compute_cell_sizes()["Volume"])
    mean = (sizes @ shown.flux_density) / sizes.sum()
    np.testing.assert_allclose(mean, shown.field.flux_density(shown.mesh.body_names[0]), rtol=1e-4)
    np.testing.assert_allclose(grid[IRON_FLUX], np.linalg.norm(shown.flux_density, axis=1))


def test_field_lines_follow_the_field(simple):
    lines = field_lines(simple)
    assert lines.n_lines > 5
    parts = [np.asarray(lines.get_cell(k).points) for k in range(lines.n_lines)]
    ahead = np.concatenate([np.diff(points, axis=0) for points in parts])
    middle = np.concatenate([5e-4 * (points[1:] + points[:-1]) for points in parts])
    b = simple.flux_density_at(middle)
    sizes = np.linalg.norm(ahead, axis=1), np.linalg.norm(b, axis=1)
    keep = (sizes[0] > 1e-3) & (sizes[1] > 1e-5)
    cosine = (np.abs(np.sum(ahead * b, axis=1))[keep]) / (sizes[0] * sizes[1])[keep]
    assert np.median(cosine) > 0.999
    assert np.percentile(cosine, 5) > 0.97
    assert (np.asarray(lines[FLUX]) >= 0).all()


def test_colour_bars_have_round_limits():
    """Limits around the smallest and largest known value; a label at each step between, with the decimals that
    it needs."""
    for bar, values, limits, labels, form in [
        (colour_bar, [3.1, np.nan, 11.7], (2.0, 12.0), 6, "%.0f"),
        (colour_bar, [-0.31, 0.29], (-0.4, 0.3), 8, "%.1f"),
        (colour_bar, [20.0, 26.0], (20.0, 26.0), 7, "%.0f"),
        # A constant: the upper limit is a thousandth of it, or of the unit, above.
        (colour_bar, [500.0, 500.0], (500.0, 500.5), 6, "%.1f"),
        (colour_bar, [-500.0, -500.0 + 1e-11], (-500.0, -499.5), 6, "%.1f"),
        (colour_bar, [0.0, 0.0], (0.0, 1e-3), 6, "%.4f"),
        # The scale follows the numbers, however small.
        (colour_bar, [0.0, 5.9e-9], (0.0, 6e-9), 7, "%.9f"),
        (colour_bar_by_decades, [0.3, 800.0], (0.1, 1000.0), 5, "%g"),
        (colour_bar_by_decades, [0.02, 0.03], (0.01, 0.1), 2, "%g"),
        (colour_bar_by_decades, [10.0, 10.0], (10.0, 100.0), 2, "%g"),
    ]:
        made = bar("B, mT", values)
        told = made["scalar_bar_args"]
        assert made["clim"] == pytest.approx(limits, abs=1e-12)
        assert (told["n_labels"], told["fmt"], told["title"].strip()) == (labels, form, "B, mT")
        assert made.get("log_scale", False) is (bar is colour_bar_by_decades)


def test_the_surface_of_rest_holds_signals_places_and_currents():
    surface = shift_surface(tilted_plane(), "x")
    assert surface.n_cells == 11
    x, y, height = np.asarray(surface.points).T
    np.testing.assert_allclose(height, 0.2 * x, atol=1e-6)  # mm over %
    np.testing.assert_allclose(surface[LEVEL], 1.5 + 0.01 * y, rtol=1e-6)
    assert axes_of("shift", "y", Shown("")) == (("x signal, %", "y signal, %", "y, mm"), (1, 1, 1))


@needs_opengl
def test_a_small_difference_is_drawn_in_microtesla(simple):
    tiny = replace(simple, field=QUADRATIC, currents=np.array([1e-3]))
    scene = make_scene(tiny, "difference", window=(300, 240))
    (title,) = scene.scalar_bars.keys()
    data = [actor.mapper.dataset for actor in scene.actors.values() if isinstance(actor, pv.Actor)]
    scene.close()
    plane = next(d for d in data if title.strip() in d.array_names)
    by_hand = 1e6 * np.linalg.norm(tiny.flux_density_at(1e-3 * np.asarray(plane.points, dtype=float)), axis=1)
    assert title.strip() == "d B, uT"
    np.testing.assert_allclose(plane[title.strip()], by_hand, rtol=1e-5, atol=1e-6)


def test_a_field_at_other_currents_than_those_shown_is_refused(simple):
    with pytest.raises(InputError) as caught:
        replace(simple, currents=np.array([2.0]))
    assert caught.value.problems[0].where == "Shown(currents)"


def test_what_is_not_there_is_named(simple):
    with pytest.raises(InputError, match="mesh"):
        make_scene(simple, "iron")
    with pytest.raises(InputError, match="device, mesh"):
        make_scene(simple, "everything")
    with pytest.raises(InputError, match="B, Bz, gradB"):
        make_scene(simple, "slices", "H")


@needs_opengl
def test_a_file_for_paraview(crooked, tmp_path):
    scene = make_scene(crooked, "iron")
    blocks = pv.read(save_scene(scene, tmp_path / "iron.vtm"))
    scene.close()
    surface = next(block for block in blocks if IRON_FLUX in block.array_names)
    largest = np.linalg.norm(crooked.flux_density, axis=1).max()
    assert surface[IRON_FLUX].max() == pytest.approx(largest, rel=1e-6)


def points_of(described):
    """Hashes of the arrays of points in a description of a scene."""
    found = []
    for key, value in described.items() if isinstance(described, dict) else enumerate(described):
        if key == "points" and isinstance(value, dict):
            found.append(value["hash"])
        elif isinstance(value, dict | list):
            found += points_of(value)
    return found


@needs_opengl
def test_a_page_holds_the_scene_its_words_and_the_titles_of_its_axes(drawn, tmp_path, monkeypatch):
    """The page has the scene's numbers, is in perspective, and rotates about its middle."""
    pytest.importorskip("trame_vtk")
    from trame_vtk.tools import vtksz2html

    packed, write = [], vtksz2html.write_html
    monkeypatch.setattr(vtksz2html, "write_html", lambda data, page: packed.append(data) or write(data, page))
    scene = drawn("shift")
    title, titles = 'where "it"\n<rests>\\', ("one, %", "two, %", "50 three, mm")
    axes = ("one, %", "two, %", "three, mm"), (1, 1, 50)
    text = save_scene(scene, tmp_path / "new" / "shift.html", title, axes).read_text()
    words = "where 'it'\\A  rests>\\A drag: turn; wheel: zoom; shift and drag: move"
    assert f'content: "{words}"' in text
    assert re.findall("<title>(.*?)</title>", text, re.DOTALL) == [html.escape(title)]
    assert scene.camera.parallel_projection is False
    with zipfile.ZipFile(io.BytesIO(packed[0])) as archive:
        told = json.loads(archive.read("index.json"))
    camera = next(iter(told["scene"]["extra"]["centerOfRotation"])), scene.camera.focal_point[0]
    assert camera[0] == pytest.approx(camera[1])
    assert all(title in json.dumps(told["scene"]) for title in titles)
    surface = next(one.mapper.dataset for one in solids_of(scene) if one.mapper.array_name == LEVEL)
    held = [
        base64.b64decode(told["hashes"][name]["content"])
        for name in points_of(told["scene"])
        if name in told["hashes"]
    ]
    assert np.asarray(surface.points, np.float32).tobytes() in held


@needs_opengl
def test_a_page_for_a_browser(crooked, tmp_path):
    pytest.importorskip("trame_vtk")
    scene = make_scene(crooked, "iron")
    path = save_scene(scene, tmp_path / "iron.html", 'loop "and" <sphere>')
    scene.close()
    text = path.read_text()
    assert "<title>loop &quot;and&quot; &lt;sphere&gt;</title>" in text
    assert "<script src=" not in text
    names = ("chromium", "google-chrome", "chromium-headless-shell")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        pytest.skip("no Chromium on this machine")
    picture = tmp_path / "page.png"
    flags = "--headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --use-gl=angle"
    flags += f" --virtual-time-budget=15000 --window-size=800,600 --user-data-dir={tmp_path / 'profile'}"
    words = [browser, *flags.split(), f"--screenshot={picture}", path.as_uri()]
    subprocess.run(words, capture_output=True, timeout=120, check=True)
    image = pixels_of(picture)
    # The sphere in the middle and the colour bar on the right have colours.
    assert coloured(image) > 0.005
    assert coloured(image[:, 600:]) > 0.002


@needs_opengl
def test_the_command(tmp_path, capsys, monkeypatch):
    # Smoothing edges takes three quarters of the drawing time.
    monkeypatch.setattr(pv.Plotter, "enable_anti_aliasing", lambda *_, **__: None)
    path, words = tmp_path / "new" / "loop.png", ["show", "loop_and_sphere", "--refinement", "0.5", "--save"]
    assert main([*words, str(path), "--what", "iron", "--currents", "2"]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert coloured(pixels_of(path)) > 0.02
    assert main([*words, str(tmp_path / "mesh.png"), "--what", "mesh"]) == 0


def test_a_mesh_is_shown_whatever_the_material():
    device = fieldmap.read_device("loop_and_sphere")
    name = device.bodies[0].material
    weak = replace(device.materials[name], mu_r=0.5)
    assert len(shown_mesh(replace(device, materials={name: weak}), 0.3).mesh.tets) > 10
    with pytest.raises(InputError) as error:
        shown_mesh(replace(device, bodies=()))
    assert error.value.problems[0].where == device.name
