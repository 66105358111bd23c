"""Scenes: what is drawn has the numbers of the field, and the pictures have content, colours and a colour bar."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv

import fieldmap
from fieldmap.cli import main
from fieldmap.errors import InputError
from fieldmap.levitation import EquilibriumSurface, ReachableSet, zonotope
from fieldmap.plot.device_drawing import FLUX
from fieldmap.plot.field_scenes import IRON_FLUX, field_lines, iron_elements, sampled
from fieldmap.plot.forces import LEVEL, magnetic_force, places_in_box, shift_surface
from fieldmap.plot.gather import shown_mesh
from fieldmap.plot.places import box_grid
from fieldmap.plot.scales import colour_bar, colour_bar_by_decades
from fieldmap.plot.scenes import SCENES, axes_of, make_scene, save_scene
from fieldmap.plot.shown import Shown, ShownRun
from tests.plot.conftest import Harmonic, needs_opengl, pixels_of

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
    """3 mm down in a second."""
    time = np.linspace(0.0, 1.0, 20)
    position = np.column_stack([0 * time, 0 * time, -0.012 - 0.003 * time])
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))
    device = replace(fieldmap.read_device("loop_and_sphere"), payload=payload)
    return ShownRun("falling", device, time, position, upright, time[:, None], position, None, "")


def three_ways():
    """Forces of three coils, 4 mN along z and 0.2 mN along x and y at most, and 1 mN without currents."""
    per_ampere = np.array([[1e-4, 0.0, 1e-3], [0.0, 1e-4, 1e-3], [-1e-4, -1e-4, 2e-3]])
    lower, upper, constant = -np.ones(3), np.ones(3), np.array([0.0, 0.0, 1e-3])
    corners, triangles, volume = zonotope(per_ampere, lower, upper)
    about = {"quantity": "force", "position": np.zeros(3), "moment": np.array([0.0, 0.0, 1.0])}
    of_coils = {"coil_names": ("a", "b", "c"), "lower": lower, "upper": upper, "per_ampere": per_ampere}
    solid = {"vertices": corners + constant, "triangles": triangles, "volume": volume}
    return ReachableSet(**about, **of_coils, constant=constant, **solid)


@needs_opengl
def test_a_thin_set_is_drawn_wider_and_says_so(shown):
    scene = make_scene(shown, "reachable", window=(300, 240))
    solid = scene.actors[next(iter(scene.actors))].mapper.dataset
    scene.close()
    found = shown.reachable
    assert axes_of("reachable", "force", shown) == ("20 Fx, mN", "20 Fy, mN", "Fz, mN")
    drawn = np.array(solid.bounds).reshape(3, 2)
    corners = 1e3 * np.array([20.0, 20.0, 1.0]) * found.vertices
    np.testing.assert_allclose(drawn.T, [corners.min(axis=0), corners.max(axis=0)], rtol=1e-5)
    # Wider, but not wider than high.
    assert (np.ptp(drawn, axis=1) / np.ptp(drawn[2]) > 0.4).all()
    assert np.ptp(drawn, axis=1).max() == np.ptp(drawn[2])


def test_a_flat_set_is_refused(shown):
    flat = replace(shown.reachable, triangles=np.empty((0, 3), dtype=np.int64))
    with pytest.raises(InputError):
        make_scene(replace(shown, reachable=flat), "reachable", window=(300, 240))


def tilted_plane():
    """x = 20 mm times the x signal, the current rising with y; no place for one corner."""
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
    """Share of the picture that is neither white nor grey."""
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
        # The colour bar stands on the right, where the scene does not reach.
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
    force = magnetic_force(simple.state, simple.currents, simple.payload, places)
    x, y, z = places.T
    by_hand = simple.payload.moment * np.column_stack([-3 * x, -3 * y, 6 * z])
    np.testing.assert_allclose(np.abs(force), np.abs(by_hand), atol=1e-12)


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
    """About the smallest and the largest, whatever is not known; a label at each step between them, with the decimals
    that it needs."""
    for bar, values, limits, labels, form in [
        (colour_bar, [3.1, np.nan, 11.7], (2.0, 12.0), 6, "%.0f"),
        (colour_bar, [-0.31, 0.29], (-0.4, 0.3), 8, "%.1f"),
        (colour_bar, [20.0, 26.0], (20.0, 26.0), 7, "%.0f"),
        # Of one value: a thousandth of it, or of the unit, above it.
        (colour_bar, [500.0, 500.0], (500.0, 500.5), 6, "%.1f"),
        (colour_bar, [-500.0, -500.0 + 1e-11], (-500.0, -499.5), 6, "%.1f"),
        (colour_bar, [0.0, 0.0], (0.0, 1e-3), 6, "%.4f"),
        # Numbers of their own, however small.
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
    assert axes_of("shift", "y", Shown("")) == ("x signal, %", "y signal, %", "y, mm")


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
def test_a_file_for_paraview(shown, tmp_path):
    scene = make_scene(shown, "iron")
    blocks = pv.read(save_scene(scene, tmp_path / "iron.vtm"))
    scene.close()
    surface = next(block for block in blocks if IRON_FLUX in block.array_names)
    largest = np.linalg.norm(shown.flux_density, axis=1).max()
    assert surface[IRON_FLUX].max() == pytest.approx(largest, rel=1e-6)


@needs_opengl
def test_a_page_for_a_browser(shown, tmp_path):
    pytest.importorskip("trame_vtk")
    scene = make_scene(shown, "iron")
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
    # The sphere in the middle and the colour bar on the right, in colours.
    assert coloured(image) > 0.005
    assert coloured(image[:, 600:]) > 0.002


@needs_opengl
def test_the_command(tmp_path, capsys, monkeypatch):
    # Smoothed edges take three quarters of the time of drawing.
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
