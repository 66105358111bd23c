import numpy as np
import pytest
import pyvista as pv

import fieldmap
from fieldmap.errors import FieldmapError
from fieldmap.plot import device_scene, save_picture
from fieldmap.plot.device_drawing import COPPER, CURRENT, FLUX, IRON, MAGNET, SENSOR, VIEW
from fieldmap.plot.rendering import require_renderer
from fieldmap.plot.scales import MILLIMETRES, add_rulers
from fieldmap.plot.solids import winding_surface
from fieldmap.plot.style import INK
from fieldmap.sources import unit_flux_density
from tests.plot.conftest import Crooked, crooked_device, needs_opengl, pixels_of
from tests.plot.scene_reading import bars_of, bounds_of, check_legible, data_of, labels_of, solids_of


class Ramp:
    """|B| = 2 mT per mm of depth, straight down; independent of x and y."""

    coil_names = ("loop",)
    lower, upper = np.array([-0.004, -0.004, -0.03]), np.array([0.004, 0.004, -0.02])

    def field(self, points, currents):
        return currents[0] * np.column_stack([0 * points[:, 0], 0 * points[:, 1], 2.0 * points[:, 2]])

    def gradient(self, points, currents):
        return np.tile(currents[0] * np.diag([0.0, 0.0, 2.0]), (len(points), 1, 1))


@pytest.fixture
def device():
    return fieldmap.read_device("loop_and_sphere")


@needs_opengl
def test_slices_hold_the_size_of_the_field_at_their_points(device):
    scene = device_scene(device, Ramp(), [1.0])
    drawn = [actor.mapper.dataset for actor in scene.actors.values() if isinstance(actor, pv.Actor)]
    scene.close()
    planes = [data for data in drawn if FLUX in data.array_names]
    for plane in planes:
        np.testing.assert_allclose(plane[FLUX], np.abs(2.0 * plane.points[:, 2]), rtol=1e-6)
    assert [plane.bounds[axis : axis + 2] for plane, axis in zip(planes, (0, 2), strict=True)] == [(0, 0)] * 2


@needs_opengl
def test_the_scene_spans_the_device_in_millimetres(device):
    scene = device_scene(device, axes=False)
    coil = device.coils[0]
    reach = 1e3 * coil.outer_radius
    x_low, x_high, *_ = scene.bounds
    scene.close()
    # The arrow is within 4 mm of the winding.
    assert reach <= x_high < reach + 4.0
    assert -reach - 4.0 < x_low <= -reach + 0.1


@needs_opengl
def test_every_coil_and_body_is_drawn():
    device = fieldmap.read_device("disk_six_cores")
    scene = device_scene(device, axes=False, hide=("disk",))
    low, high = scene.bounds[4:]
    scene.close()
    lowest = min(1e3 * (c.placement.position[2] - c.height / 2) for c in device.coils)
    workspace = 1e3 * device.workspace.lower[2]
    assert low == pytest.approx(min(lowest, workspace), abs=0.1)
    assert high == pytest.approx(46.0, abs=0.1)  # top of the cores, Appendix A-3


@needs_opengl
def test_a_picture_is_not_blank(device, tmp_path):
    path = save_picture(tmp_path / "device.png", device, Ramp(), [1.0], window_size=(600, 360))
    pixels = pixels_of(path)
    left, right = pixels[:, :300], pixels[:, 300:]
    for panel in (left, right):
        assert 0.02 < np.mean(panel.sum(axis=2) < 750) < 0.9
    copper = (pixels[:, :, 0] > pixels[:, :, 2] + 60) & (pixels[:, :, 1] > pixels[:, :, 2])
    assert copper.sum() > 500
    # The colours of the slice and its bar occur in the right panel only.
    green = (pixels[:, :, 1] > pixels[:, :, 0] + 40) & (pixels[:, :, 1] > 100)
    assert green[:, 300:].sum() > 100
    assert green[:, :300].sum() == 0


def test_without_opengl_there_is_a_message_and_no_crash(monkeypatch):
    monkeypatch.setattr("fieldmap.plot.rendering.can_render", lambda: False)
    with pytest.raises(FieldmapError, match="libegl1"):
        require_renderer()


@needs_opengl
@pytest.mark.parametrize(("name", "translucent"), [("eight_coils", 1), ("disk_six_cores", 0)])
def test_what_stands_before_the_workspace_is_translucent(name, translucent):
    """One of eight coils around a cube is between the cube and the viewer; no coil above a workspace is."""
    scene = device_scene(fieldmap.read_device(name), axes=False)
    opacities = [actor.prop.opacity for actor in solids_of(scene, COPPER)]
    scene.close()
    assert sum(opacity < 0.5 for opacity in opacities) == translucent
    assert sorted(opacities)[translucent:] == [1.0] * (len(opacities) - translucent)


def turn_of(arrow, centre):
    """1 if an arrow is counter-clockwise about a centre (3,), mm, seen from above, else -1."""
    points = np.asarray(arrow.points, dtype=float) - centre
    # The base of the tip is the widest place of an arrow, and the tail is farthest from it.
    tip = points[np.argmax(np.abs(points[:, 2] - np.median(points[:, 2])))]
    tail = points[np.argmax(np.linalg.norm(points - tip, axis=1))]
    return int(np.sign(tail[0] * tip[1] - tail[1] * tip[0]))


@needs_opengl
def test_arrows_point_as_the_currents_flow():
    device = fieldmap.read_device("drive_unit")
    currents = [1.0, -2.0, 0.0, 1.0, 1.0, -1.0]
    scene = device_scene(device, currents=currents, axes=False)
    drawn = [actor.mapper.dataset for actor in solids_of(scene, CURRENT)]
    names = [a.GetInput() for a in scene.actors.values() if hasattr(a, "GetInput")]
    scene.close()
    assert [text for text in names if text in device.coil_names] == list(device.coil_names)
    assert len(drawn) == 5
    flowing = [(coil, ampere) for coil, ampere in zip(device.coils, currents, strict=True) if ampere]
    for arrow, (coil, ampere) in zip(drawn, flowing, strict=True):
        middle = np.array(pv.merge([winding_surface(coil)]).center)
        # Counter-clockwise if the coil's own field points up at its middle.
        up = unit_flux_density(coil, 1e-3 * middle[None])[0, 2] * ampere
        assert turn_of(arrow, middle) == np.sign(up)


# Ends of the parts, mm.
BAR, BALL = [[-10, 30], [27, 33], [40, 50]], [[-35, -25], [-15, -5], [45, 55]]
RING, FRAME = [[20, 40], [0, 20], [16, 24]], [[-35, -15], [13, 27], [24, 36]]
ROOM = [[-4, 5], [-6, 2], [-30, -10]]


@pytest.fixture
def crooked():
    """crooked(**options): the scene of the crooked device with these options."""
    made = []

    def draw(**options):
        made.append(device_scene(crooked_device(), **options))
        return made[-1]

    yield draw
    for scene in made:
        scene.close()


def ends(scene, colour):
    return [np.reshape(actor.bounds, (3, 2)) for actor in solids_of(scene, colour)]


@needs_opengl
def test_all_of_a_machine_stands_in_its_place(crooked):
    scene = crooked(field=Crooked(), currents=[1.5, -0.5], magnet_at=[0.001, -0.002, -0.02])
    check_legible(scene)
    for colour, expected in ((IRON, [BAR, BALL]), (COPPER, [RING, FRAME])):
        np.testing.assert_allclose(ends(scene, colour), expected, atol=0.03)
    magnet, moment = ends(scene, MAGNET)
    np.testing.assert_allclose(magnet, [[-1, 3], [-4, 0], [-25, -15]], atol=0.01)
    np.testing.assert_allclose(moment[2], [-15, -5], atol=0.01)
    # Slender: less wide than a third of its length.
    assert np.ptp(moment[:2], axis=1).max() <= 3.0
    # Sharp edges of the bar, the ring, the frame and the magnet in ink; the ball has none; then the workspace.
    inked = [one for one in solids_of(scene, INK) if not one.mapper.scalar_visibility]
    edges, (room, *rulers) = inked[:3], [one for one in inked if not one.prop.lighting]
    assert rulers == []
    for actor, where in zip(edges, (BAR, RING, FRAME), strict=True):
        np.testing.assert_allclose(bounds_of(actor), where, atol=0.03)
        assert actor.prop.line_width < room.prop.line_width
    np.testing.assert_allclose(bounds_of(room), ROOM, atol=1e-6)
    assert {actor.prop.opacity for actor in solids_of(scene, IRON) + solids_of(scene, COPPER)} == {1.0}
    planes = [one for one in solids_of(scene) if one.mapper.array_name == FLUX]
    assert [plane.mapper.dataset.dimensions for plane in planes] == [(1, 81, 81), (81, 1, 81)]
    lowest, highest = np.inf, 0.0
    for plane, axis, at in zip(planes, (0, 1), (0.5, -2.0), strict=True):
        where = np.array(ROOM, float)
        where[axis] = at
        np.testing.assert_allclose(bounds_of(plane), where, atol=1e-6)
        data = plane.mapper.dataset
        flux = 1e3 * np.linalg.norm(Crooked().field(1e-3 * data.points, [1.5, -0.5]), axis=1)
        np.testing.assert_allclose(data[FLUX], flux, rtol=1e-5)
        lowest, highest = min(lowest, flux.min()), max(highest, flux.max())
        assert not plane.prop.lighting
    # One bar for both planes, in round numbers around their values.
    (bar,) = bars_of(scene)
    assert bar.title == "B, mT"
    assert lowest - 10.0 < bar.range[0] <= lowest < highest <= bar.range[1] < highest + 10.0
    assert {tuple(plane.mapper.scalar_range) for plane in planes} == {bar.range}


@needs_opengl
def test_directions_lie_before_the_slices_all_of_one_length(crooked):
    """In cells a seventh of the longest side, 20 mm, long: 3 by 7 and 3 by 7, with one row of 7 in common."""
    scene = crooked(field=Crooked(), currents=[1.5, -0.5])
    (white,) = solids_of(scene, "white")
    points = np.asarray(data_of(white).points, float)
    arrow = pv.Arrow(start=(-0.5, 0.0, 0.0), tip_length=0.4, tip_radius=0.15, shaft_radius=0.05)
    each = points.reshape(-1, arrow.n_points, 3)
    tips = each[:, int(np.argmax(arrow.points[:, 0]))]
    tails = each[:, np.asarray(arrow.points[:, 0]) <= -0.5 + 1e-6].mean(axis=1)
    along, middles = tips - tails, 0.5 * (tips + tails)
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 0.62 * 20 / 7, rtol=1e-4)
    # Arrows are 0.3 mm from the places in the slices towards the viewer, who is at +x and -y.
    places = 1e-3 * (middles - [0.3, -0.3, 0.0])
    flux = Crooked().field(places, [1.5, -0.5])
    np.testing.assert_allclose(
        along / np.linalg.norm(along, axis=1)[:, None],
        flux / np.linalg.norm(flux, axis=1)[:, None],
        atol=1e-4,
    )
    in_x, in_y = (np.abs(1e3 * places[:, axis] - at) < 1e-3 for axis, at in ((0, 0.5), (1, -2.0)))
    assert (len(places), in_x.sum(), in_y.sum(), (in_x & in_y).sum()) == (35, 21, 21, 7)


@needs_opengl
def test_sensors_are_small_arrows(crooked):
    """One at each sensor, shorter than a fifth of the device."""
    sensors = [
        fieldmap.FieldSensor("a", [0.0, 0.0, 0.01], [0, 0, -1]),
        fieldmap.FieldSensor("b", [0.01, 0.0, 0.0], [1, 0, 0]),
    ]
    scene = device_scene(crooked_device().replace(sensors=sensors))
    first, second = ends(scene, SENSOR)
    assert first[2, 0] == pytest.approx(10.0, abs=1e-4)
    assert second[0, 1] == pytest.approx(10.0, abs=1e-4)
    whole = max(np.ptp(where, axis=1).max() for colour in (IRON, COPPER) for where in ends(scene, colour))
    assert 0.03 * whole < np.ptp(first[2]) < 0.2 * whole
    assert ends(crooked(), SENSOR) == []
    scene.close()


@needs_opengl
def test_every_option_of_a_machine(crooked):
    plain = crooked()
    assert (len(ends(plain, IRON)), len(solids_of(plain, CURRENT)), len(solids_of(plain, "white"))) == (
        2,
        2,
        0,
    )
    assert plain.window_size == [1200, 1200]
    assert [one.words for one in labels_of(plain) if one.words in MILLIMETRES] == list(MILLIMETRES)
    names = {one.GetInput(): one for one in plain.actors.values() if hasattr(one, "GetInput")}
    assert {"ring", "frame"} <= set(names)
    hidden = crooked(
        hide=("ball",), axes=False, names=False, iron_opacity=0.6, coil_opacity=0.8, currents=[0.0, -2.0]
    )
    (bar,) = ends(hidden, IRON)
    np.testing.assert_allclose(bar, BAR, atol=0.03)
    assert labels_of(hidden) == [] == [one for one in hidden.actors.values() if hasattr(one, "GetInput")]
    for colour, opacity in ((IRON, 0.6), (COPPER, 0.8)):
        assert {actor.prop.opacity for actor in solids_of(hidden, colour)} == {opacity}
    # A coil without current has no arrow; a negative current turns the arrow.
    (arrow,) = solids_of(hidden, CURRENT)
    np.testing.assert_allclose(bounds_of(arrow)[:2].mean(axis=1), np.mean(FRAME, axis=1)[:2], atol=6.0)
    assert arrow.mapper.dataset.bounds != solids_of(plain, CURRENT)[1].mapper.dataset.bounds
    without = crooked(field=Crooked(), directions=False, magnet_at=None)
    assert solids_of(without, "white") == solids_of(without, MAGNET) == []
    drawn_into = pv.Plotter(off_screen=True, window_size=[310, 230])
    assert crooked(plotter=drawn_into) is drawn_into
    assert crooked(window_size=(410, 330), names=False).window_size == [410, 330]


@needs_opengl
def test_names_stand_off_their_windings_before_them_towards_the_viewer(crooked):
    """2 mm off the ring of 10 mm radius, at 0.28 of its height of 8 mm, and 5 mm nearer to the viewer."""
    scene = crooked(axes=False)
    names = {one.GetInput(): one for one in scene.actors.values() if hasattr(one, "GetInput")}
    ring = names["ring"]
    towards = np.array(VIEW)
    flat = towards[:2] / np.linalg.norm(towards[:2])
    expected = [30.0, 10.0, 20.0 + 0.28 * 8.0] + 12.0 * np.array([*flat, 0.0]) + 5.0 * towards
    np.testing.assert_allclose(ring.GetPosition(), expected, atol=0.4)
    look = ring.GetTextProperty()
    assert (look.GetJustificationAsString(), look.GetVerticalJustificationAsString()) == ("Centered",) * 2
    assert (look.GetColor(), look.GetBold(), 20 < look.GetFontSize() < 40) == ((0.0, 0.0, 0.0), 1, True)
    assert not ring.GetPickable()
    for name, where in (("ring", RING), ("frame", FRAME)):
        corners = np.array(np.meshgrid(*where)).reshape(3, -1).T
        assert np.array(names[name].GetPosition()) @ towards > (corners @ towards).max() - 2.0


@needs_opengl
@pytest.mark.parametrize(("count", "opacity"), [(2, 0.6), (3, 0.25)])
def test_more_than_a_tenth_of_the_workspace_behind_a_body_lets_it_be_seen(count, opacity):
    """Beads on the lines from two or three of 27 places to the viewer, far from each other's lines."""
    places = np.array([[5.0, -6.0, -30.0], [-4.0, 2.0, -10.0], [0.5, -2.0, -20.0]])[:count]
    beads = [fieldmap.Body(f"bead{k}", "iron", fieldmap.Sphere(0.0005), 0.0003) for k in range(3)]
    at = 1e-3 * (places + 40.0 * np.array(VIEW) - [0.0, 0.0, 0.5])
    parts = [bead.moved(one).parts[0] for bead, one in zip(beads, at, strict=False)]
    body = fieldmap.Body("beads", "iron", parts, 0.0003)
    scene = device_scene(crooked_device(bodies=[body]), axes=False, iron_opacity=0.6)
    assert [actor.prop.opacity for actor in solids_of(scene, IRON)] == [opacity]
    scene.close()


def test_the_numbers_of_a_stretched_ruler_are_those_of_what_is_drawn():
    """A box of 2 by 3 by 12, drawn with factors of 50, 20 and 1."""
    scene, stretch = pv.Plotter(off_screen=True), np.array([50.0, 20.0, 1.0])
    scene.add_mesh(pv.Box((0.0, 100.0, 10.0, 70.0, -12.0, 0.0)))
    add_rulers(scene, titles=("a", "b", "c"), stretch=stretch)
    labels, (_, *rulers) = labels_of(scene), [data_of(one) for one in solids_of(scene)]
    scene.close()
    for axis, (ruler, title) in enumerate(
        zip(rulers, ("a\nstretched 50 times", "b\nstretched 20 times", "c"), strict=True)
    ):
        marks = np.asarray(ruler.points, float).reshape(-1, 2, 3)[1:, 0, axis]
        *numbers, last = [labels.pop(0).words for _ in range(len(marks) + 1)]
        assert (len(numbers) >= 2, last) == (True, title)
        np.testing.assert_allclose(marks, stretch[axis] * np.array(numbers, float), atol=1e-4)


@pytest.mark.parametrize(
    ("options", "titles", "size", "spread"),
    [
        ({}, MILLIMETRES, 18, 1.0),
        ({"font_size": 12, "titles": ("a", "b", "c"), "spread": 2.0}, ("a", "b", "c"), 12, 2.0),
    ],
)
def test_rulers_stand_off_the_box_and_their_words_off_the_rulers(options, titles, size, spread):
    """The rulers are 4 % of the longest side off the box, ticks a hundredth long, labels off the ticks, farther for a
    small window; on a short side the steps are as fine as for half the longest."""
    scene = pv.Plotter(off_screen=True)
    scene.add_mesh(pv.Box((0.0, 100.0, 10.0, 70.0, -12.0, 0.0)))
    add_rulers(scene, **options)
    labels, (_, *rulers) = labels_of(scene), [data_of(one) for one in solids_of(scene)]
    scene.close()
    assert {one.size for one in labels} == {size}
    x, y, z = titles
    words = [one.words for one in labels]
    assert words == ["0", "20", "40", "60", "80", "100", x, "20", "40", "60", y, "-10", "0", z]
    low, high = np.array([-4.0, 6.0, -16.0]), np.array([104.0, 74.0, 4.0])
    outward = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.6], [-1.0, 0.0, 0.0]])
    for axis, (ruler, way, aligned) in enumerate(
        zip(rulers, outward, ("Centered", "Left", "Right"), strict=True)
    ):
        first, last = low.copy(), low.copy()
        first[0] = last[0] = high[0] if axis == 1 else low[0]
        last[axis] = high[axis]
        (line, *marks) = np.asarray(ruler.points, float).reshape(-1, 2, 3)
        np.testing.assert_allclose(line, [first, last], atol=1e-4)
        *numbers, title = [labels.pop(0) for _ in range(len(marks) + 1)]
        at = np.tile(first, (len(marks), 1))
        at[:, axis] = [float(one.words) for one in numbers]
        np.testing.assert_allclose(marks, np.stack([at, at + 1.2 * way], axis=1), atol=1e-4)
        assert {one.across for one in numbers} == {aligned}
        shares = [
            np.subtract(one.place, place) @ way / (way @ way) for one, place in zip(numbers, at, strict=True)
        ]
        np.testing.assert_allclose([one.place for one in numbers], at + shares[0] * way, atol=1e-4)
        assert 1.5 * spread < shares[0] < 4.0 * spread
        assert title.across == "Centered"
        if axis == 2:
            np.testing.assert_allclose(title.place, last + [0.0, 0.0, 6.0 * spread], atol=1e-4)
            continue
        off = title.place - 0.5 * (first + last)
        farther = off @ way / (way @ way)
        np.testing.assert_allclose(off, farther * way, atol=1e-4)
        assert 2.0 * shares[0] < farther < 20.0 * spread
