"""A map behind sliders: the shown values after a move are the map's own values, and closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

import fieldmap as fm
from fieldmap.currents import IndependentCurrents, LiftAndDirections, divide_currents
from fieldmap.device.model import MagnetCylinder, Payload
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.levitation import find_equilibrium
from fieldmap.lookup import magnetic_body
from fieldmap.plot.device_drawing import FLUX, MAGNET
from fieldmap.plot.live_window import FORCE, LEGEND, LiveMap, LiveWindow, _controls
from fieldmap.plot.scales import MILLIMETRES
from fieldmap.plot.style import INK, text_properties
from tests.plot.conftest import harmonic, needs_opengl
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

# On the axis Bz = a + b z + c z^2 / 2 per ampere: a force b + c z on a vertical moment of 1 A m^2.
COILS = ((0.0, 0.04, 1.0), (0.0, 0.02, 0.5))
PAYLOAD = Payload(0.010, 0.8, MagnetCylinder(0.008, 0.008, 1.3))
WEIGHT = 0.010 * 9.80665
POINTS = np.array([[0.0, 0.0, 0.0], [0.005, 0.0, 0.01], [0.0, -0.01, -0.015]])


@pytest.fixture(scope="module")
def field_map(harmonic_map):
    left, right = ((*coil, (0.0, 0.0)) for coil in COILS)
    return harmonic_map(left=left, right=right)


@pytest.fixture(scope="module")
def live(field_map):
    return LiveMap(field_map, PAYLOAD, POINTS, current_limit=5.0)


def test_a_moved_slider_gives_what_the_map_answers(field_map, live):
    assert [control.name for control in live.controls] == ["coil left", "coil right", "magnet z"]
    assert {(control.lower, control.upper) for control in live.controls[:2]} == {(-5.0, 5.0)}
    for currents in ([2.0, 1.0], [1.7, 1.4], [2.4, 0.2]):
        answer = live.answer_at([*currents, 5.0])
        np.testing.assert_array_equal(answer.currents, currents)
        b, c = np.array(currents) @ np.array(COILS)[:, 1:]
        np.testing.assert_allclose(answer.force, [0, 0, 0.8 * (b + c * 0.005)], rtol=1e-9, atol=1e-12)
        assert answer.lift == pytest.approx(0.8 * (b + c * 0.005) / WEIGHT)
        by_hand = (WEIGHT / 0.8 - b) / c
        np.testing.assert_allclose(answer.equilibrium.position, [0, 0, by_hand], atol=1e-8)
        expected = sum(i * harmonic(POINTS, *coil)[0] for i, coil in zip(currents, COILS, strict=True))
        np.testing.assert_allclose(answer.flux_density, expected, atol=1e-12)
        fresh = find_equilibrium(field_map, currents, PAYLOAD)
        np.testing.assert_allclose(answer.equilibrium.position, fresh.position, atol=1e-8)
        assert f"{1e3 * by_hand:.2f}" in answer.words


def test_it_begins_where_the_magnet_is_carried(field_map, live):
    doubled = LiveMap(field_map, PAYLOAD, POINTS, current_limit=5.0, force_scale=2.0)
    answer = doubled.answer
    assert answer.lift == pytest.approx(1.0)
    np.testing.assert_allclose(answer.equilibrium.position, answer.place, atol=1e-6)
    # Twice the force, so half the currents.
    np.testing.assert_allclose(2 * answer.currents, [c.value for c in live.controls[:2]])


def test_it_begins_with_what_the_iron_leaves_of_the_weight(tmp_path):
    device = fm.read_device("desk_levitator")
    path = fm.generate(device, tmp_path / "desk.h5", spacing=3e-3, progress=False)
    currents = []
    for field in (fm.open_map(path), fm.open_map(path, reaction=False)):
        answer = LiveMap(field, device.payload, POINTS[:1] + field.upper).answer
        assert answer.lift == pytest.approx(1.0)
        currents.append(answer.currents[0])
    assert 0.0 < currents[0] < 0.7 * currents[1]


def test_a_calibration_leaves_the_pull_of_the_iron_as_it_is(tmp_path):
    """Force and equilibrium from two maps, with and without the iron's reaction."""
    device, scale, current = fm.read_device("desk_levitator"), 1.3, 0.4
    path = fm.generate(device, tmp_path / "desk.h5", spacing=3e-3, progress=False)
    field, alone = fm.open_map(path), fm.open_map(path, reaction=False)
    live = LiveMap(field, device.payload, POINTS[:1] + field.upper, force_scale=scale)
    body = magnetic_body(device.payload)

    def force(place):
        both, own = (body.wrench(one, place, [current])[:3] for one in (field, alone))
        return scale * own + (both - own)

    answer = live.answer_at([current, -25.0])
    np.testing.assert_allclose(answer.force, force(answer.place), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        force(answer.equilibrium.position), [0, 0, live.weight], atol=1e-7 * live.weight
    )
    place, step = answer.equilibrium.position, 1e-5 * np.eye(3)
    slopes = np.array([force(place - h) - force(place + h) for h in step]).T / 2e-5
    np.testing.assert_allclose(answer.equilibrium.stiffness, slopes, atol=1e-4 * np.abs(slopes).max())


def test_without_an_equilibrium_there_are_words(live):
    answer = live.answer_at([0.1, 0.1, 0.0])
    assert answer.equilibrium is None
    assert "no equilibrium" in answer.words
    assert np.isfinite(answer.flux_density).all()
    assert live.answer_at([2.0, 1.0, 0.0]).equilibrium is not None


def test_bad_arguments(field_map):
    with pytest.raises(InputError, match="payload"):
        LiveMap(field_map, None, POINTS)
    with pytest.raises(InputError, match="current_limit"):
        LiveMap(field_map, PAYLOAD, POINTS, current_limit=0.0)


def test_saturating_maps_have_sliders_of_their_domain():
    """Sliders of the division's signals, or of the coils; only the domain of the model is read."""

    def stub(of, lower, upper):
        model = SimpleNamespace(parametrisation=of, lower=np.array(lower), upper=np.array(upper))
        return SimpleNamespace(coil_names=tuple("123456"), info=SimpleNamespace(reduced_model=model))

    domain = ([1.0, -0.4, -0.3], [2.2, 0.4, 0.3])
    currents, sliders = _controls(stub(LiftAndDirections(1.25), *domain), np.full(6, 1.5), 3.0)
    assert [(s.name, s.lower, s.value) for s in sliders] == [
        ("signal u", 1.0, 1.5),
        ("signal x", -0.4, 0.0),
        ("signal y", -0.3, 0.0),
    ]
    np.testing.assert_array_equal(currents(np.array([1.6, 0.1, 0.2])), divide_currents(1.6, 0.1, 0.2, 1.25))
    _, sliders = _controls(stub(IndependentCurrents(6), [1.0] * 6, [2.0] * 6), np.full(6, 2.5), 9.0)
    assert {(s.lower, s.upper, s.value, s.unit) for s in sliders} == {(1.0, 2.0, 2.0, "A")}


@pytest.fixture
def window(field_map):
    shown = LiveWindow(field_map, PAYLOAD, 5.0, title="two coils", off_screen=True, window=(420, 300))
    yield shown
    shown.scene.close()


@needs_opengl
def test_sliders_move_the_picture(window, field_map):
    before = window.scene.screenshot(None)
    slider = window.sliders[0]
    assert slider.GetRepresentation().GetMaximumValue() == 5.0
    slider.GetRepresentation().SetValue(2.4)
    slider.InvokeEvent("InteractionEvent")
    assert window.values[0] == pytest.approx(2.4)
    expected = window.live.answer_at(window.values)
    np.testing.assert_allclose(1e-3 * np.array(window.magnet_at), expected.equilibrium.position, atol=1e-7)
    drawn = np.concatenate([plane["B, mT"] for plane in window.planes])
    np.testing.assert_allclose(drawn, 1e3 * np.linalg.norm(expected.flux_density, axis=1))
    after = window.scene.screenshot(None)
    assert np.mean(np.abs(after.astype(int) - before) > 20) > 0.01


@needs_opengl
@pytest.mark.parametrize(
    ("size", "share"), [((400, 600), 400 / 700), ((900, 500), 500 / 700), ((1200, 800), 1.0)]
)
def test_words_fit_the_page(field_map, size, share):
    page = LiveWindow(field_map, PAYLOAD, 5.0, off_screen=True, window=(900, 700), sliders=False)
    usual = [words.GetFontSize() for words in text_properties(page.scene)]
    page.scene.render_window.SetSize(*size)
    now = [words.GetFontSize() for words in text_properties(page.scene)]
    page.scene.close()
    assert len(usual) > 8
    np.testing.assert_allclose(now, share * np.array(usual), atol=0.51)


@needs_opengl
def test_a_magnet_that_does_not_float_is_not_drawn(window):
    def red():
        image = window.scene.screenshot(None).astype(int)
        return np.sum(
            (image[:, :, 0] > image[:, :, 1] + 80)
            & (image[:, :, 0] > image[:, :, 2] + 80)
            & (image[:, :, 1] < 90)
        )

    window.move([2.0, 1.0, 5.0])
    assert red() > 20
    window.move([0.01, 0.01, 5.0])
    assert red() == 0
    assert window.magnet_at is None


# A box from (-10, -30, -50) to (30, 10, -10) mm; the coils' axis passes through its middle at (10, -10) mm.
LOWER, MIDDLE = (-0.01, -0.03, -0.05), (0.01, -0.01)


class Walled:
    """A map with a limit of 4 A for the first current."""

    def __init__(self, of):
        self.of = of

    def __getattr__(self, name):
        return getattr(self.of, name)

    def at(self, currents):
        if currents[0] > 4.0:
            raise OutsideMapError.of("left", "must lie within 4 A", f"{currents[0]}", "lower it")
        return self.of.at(currents)


@pytest.fixture(scope="module")
def aside(harmonic_map):
    """On the axis dBz/dz = 0.09 + z per ampere on the left, 0.07 + 0.5 z on the right."""
    coils = {"left": (0.0, 0.09, 1.0, MIDDLE), "right": (0.0, 0.07, 0.5, MIDDLE)}
    return Walled(harmonic_map(lower=LOWER, reference=[2.0, 3.0], **coils))


@pytest.mark.parametrize(
    ("coils", "constant", "slope", "off"),
    [
        # Slope at the reference currents, 2 A and 3 A, at 60 % of the height, z = -26 mm.
        (((0.09, 1.0), (0.07, 0.5)), None, 2 * 0.064 + 3 * 0.057, 0.0),
        # If the force at the reference currents is downward, currents of the other sign carry the magnet.
        (((-0.09, -1.0), (-0.07, -0.5)), None, -2 * 0.064 - 3 * 0.057, 0.0),
        (((0.09, 1.0), (0.07, 0.5)), (0.02, 0.1), 2 * 0.064 + 3 * 0.057, 0.0174),
        (((-0.09, -1.0), (-0.07, -0.5)), (0.02, 0.1), -2 * 0.064 - 3 * 0.057, 0.0174),
        # Without any force of the coils the reference itself.
        (((0.0, 0.0), (0.0, 0.0)), None, 0.0, 0.0),
        (((0.0, 0.0), (0.0, 0.0)), (0.02, 0.1), 0.0, 0.0174),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 1.25])
def test_where_sliders_begin(harmonic_map, coils, constant, slope, off, scale):
    """The currents start at the multiple of the reference that carries the magnet at 60 % of the height."""
    made = {name: (0.0, *bc, MIDDLE) for name, bc in zip(("left", "right"), coils, strict=True)}
    fixed = None if constant is None else (0.0, *constant, MIDDLE)
    field_map = harmonic_map(lower=LOWER, reference=[2.0, 3.0], constant=fixed, **made)
    live = LiveMap(field_map, PAYLOAD, POINTS * 0.0 + [*MIDDLE, -0.02], current_limit=50.0, force_scale=scale)
    *amperes, height = live.controls
    assert (height.name, height.unit, height.lower, height.upper) == (
        "magnet z",
        "mm",
        pytest.approx(-50.0),
        pytest.approx(-10.0),
    )
    assert height.value == pytest.approx(-26.0)
    wanted = WEIGHT / (0.8 * scale)
    share = (wanted - off) / slope if slope else 1.0
    assert [control.value for control in amperes] == pytest.approx([2.0 * share, 3.0 * share])
    if slope:
        assert live.answer.lift == pytest.approx(1.0)
    np.testing.assert_array_equal(live.initial, [control.value for control in live.controls])
    assert live.answer.place == pytest.approx([*MIDDLE, -0.026])
    assert live.weight == pytest.approx(0.010 * 9.80665)


def test_currents_begin_within_their_limit(harmonic_map):
    live = LiveMap(harmonic_map(coil=(0.0, 1e-3, 0.0, (0.0, 0.0))), PAYLOAD, POINTS)
    assert [(c.lower, c.upper, c.value) for c in live.controls[:1]] == [(-3.0, 3.0, 3.0)]


def test_answers_in_words_and_numbers(aside):
    """Two coils on one axis: b = 0.09 i + 0.07 j, c = i + 0.5 j."""
    live = LiveMap(aside, PAYLOAD, [[*MIDDLE, -0.02]], current_limit=5.0)
    answer = live.move([1.2, 0.6, -30.0])
    b, c = 0.15, 1.5
    height = (WEIGHT / 0.8 - b) / c
    assert answer.lift == pytest.approx(0.8 * (b - 0.03 * c) / WEIGHT)
    words = live.words
    assert words["currents"] == "currents, A: left: 1.200, right: 0.600"
    assert words["force"] == "moment up, fixed, force at (10.0, -10.0, -30.0) mm: (0.00, 0.00, 84.00) mN"
    assert words["lift"] == f"lift {100 * answer.lift:.1f} % of the weight"
    assert words["equilibrium"] == f"floats at (10.00, -10.00, {1e3 * height:.2f}) mm, stable along x, y"
    np.testing.assert_allclose(
        answer.flux_density, harmonic([0.0, 0.0, -0.02], 0.0, b, c)[0][None], atol=1e-12
    )
    # Reversed currents push the magnet down, and lift a magnet whose moment points down.
    turned = live.move([-1.2, -0.6, -30.0])
    assert (turned.lift, turned.equilibrium) == (pytest.approx(-answer.lift), None)
    below = LiveMap(aside, replace(PAYLOAD, direction="down"), [[*MIDDLE, -0.02]], current_limit=5.0)
    down = below.move([-1.2, -0.6, -30.0])
    assert (down.lift, down.held) == (pytest.approx(answer.lift), "moment down, fixed")
    np.testing.assert_allclose(down.equilibrium.position, [*MIDDLE, height], atol=1e-7)
    for sense in (1.0, -1.0):
        weak = live.move([0.12 * sense, 0.06 * sense, -30.0])
        assert (weak.equilibrium, weak.lift) == (None, pytest.approx(0.1 * sense * answer.lift))
        assert weak.words.startswith("no equilibrium in the box: ")
        assert ";" not in weak.words
    # After a move without equilibrium the search starts without a previous place.
    assert live.move([1.2, 0.6, -30.0]).equilibrium.position[2] == pytest.approx(height)
    beyond = live.move([4.5, 0.5, -20.0])
    assert np.isnan([beyond.lift, *beyond.force, *np.ravel(beyond.flux_density)]).all()
    assert beyond.flux_density.shape == (1, 3)
    assert (beyond.equilibrium, beyond.words) == (None, "left must lie within 4 A")
    assert beyond.place == pytest.approx([*MIDDLE, -0.02])
    assert (live.words["force"], live.words["lift"], live.words["equilibrium"]) == ("", "", beyond.words)
    # The height is limited to the box.
    for asked, held in ((-60.0, -0.05), (0.0, -0.01)):
        assert live.answer_at([1.2, 0.6, asked]).place[2] == pytest.approx(held)


@pytest.mark.parametrize("name", ["current_limit", "force_scale"])
def test_scales_and_limits_are_positive(aside, name):
    with pytest.raises(InputError) as error:
        LiveMap(aside, PAYLOAD, POINTS, **{name: 0.0})
    assert name in error.value.problems[0].where


@pytest.fixture
def shown(aside):
    """shown(**options): a window of the map aside; its title "two coils"."""
    made = []

    def open_window(**options):
        made.append(LiveWindow(aside, PAYLOAD, 5.0, 1.0, "two coils", off_screen=True, **options))
        return made[-1]

    yield open_window
    for window in made:
        window.scene.close()


@needs_opengl
def test_all_of_a_window_is_in_its_place(shown):
    window = shown()
    scene = window.scene
    assert scene.window_size == [1500, 950]
    window.move([1.2, 0.6, -30.0])
    check_legible(scene)
    title, words = words_of(scene)
    assert (title.words, title.place, title.size) == ("two coils", pytest.approx((0.02, 0.98)), 12)
    assert words.place == pytest.approx((0.02, 0.02))
    told = window.live.words
    lines = [told["currents"], f"{told['force']}, {told['lift']}", told["equilibrium"], LEGEND]
    assert words.words == "\n".join(lines)
    assert (words.size, len(words_of(scene))) == (11, 2)
    assert [one.words for one in labels_of(scene) if "," in one.words] == list(MILLIMETRES)
    box = np.array([[-10, 30], [-30, 10], [-50, -10]])
    edges = solids_of(scene, INK)[0]
    np.testing.assert_allclose(bounds_of(edges), box, atol=1e-4)
    # Three planes with |B|; one bar on the left, between the title and the words.
    planes = [one for one in solids_of(scene) if one.mapper.array_name == FLUX]
    for plane, axis, at in zip(planes, range(3), (10.0, -10.0, -50.0), strict=True):
        where = box.astype(float)
        where[axis] = at
        np.testing.assert_allclose(bounds_of(plane), where, atol=1e-4)
        data = plane.mapper.dataset
        there = 1e-3 * np.asarray(data.points, float) - [*MIDDLE, 0.0]
        expected = 1e3 * np.linalg.norm(harmonic(there, 0.0, 0.15, 1.5)[0], axis=1)
        np.testing.assert_allclose(data[FLUX], expected, atol=1e-4)
    values = np.concatenate([plane.mapper.dataset[FLUX] for plane in planes])
    (bar,) = bars_of(scene)
    assert bar.box[:2] == pytest.approx((0.03, 0.35))
    step = (bar.range[1] - bar.range[0]) / (bar.labels - 1)
    assert bar.range[0] <= values.min() < bar.range[0] + step
    assert bar.range[1] - step < values.max() <= bar.range[1]
    assert {tuple(plane.mapper.scalar_range) for plane in planes} == {bar.range}
    # The magnet of 8 mm at its equilibrium, and a force arrow a fifth of the box long where it equals the weight.
    (magnet,) = solids_of(scene, MAGNET)
    found = 1e3 * window.live.answer.equilibrium.position
    assert window.magnet_at == pytest.approx(found)
    np.testing.assert_allclose(
        np.reshape(magnet.bounds, (3, 2)), found[:, None] + np.array([-4.0, 4.0]), atol=0.05
    )
    (arrow,) = solids_of(scene, FORCE)
    tall = 0.2 * 40 * window.live.answer.lift
    np.testing.assert_allclose(bounds_of(arrow)[2], [-30.0, -30.0 + tall], atol=1e-3)
    np.testing.assert_allclose(bounds_of(arrow)[:2].mean(axis=1), [10.0, -10.0], atol=1e-3)
    tip = data_of(arrow).points[np.argmax(data_of(arrow).points[:, 2])]
    np.testing.assert_allclose(tip, [10.0, -10.0, -30.0 + tall], atol=1e-3)
    assert (magnet.visibility, arrow.visibility) == (True, True)
    # The words are below the scene, the sliders on its right.
    assert filled(scene, window._room, scene.render_window.GetSize()).max() == pytest.approx(1 / 1.6)
    numbers = window.as_numbers()
    assert [slider["value"] for slider in numbers["sliders"]] == [1.2, 0.6, -30.0]
    assert [slider["name"] for slider in numbers["sliders"]] == ["coil left", "coil right", "magnet z"]
    assert (numbers["lift"], numbers["words"]) == (window.live.answer.lift, told["equilibrium"])
    np.testing.assert_array_equal(numbers["equilibrium"], window.live.answer.equilibrium.position)
    np.testing.assert_array_equal(numbers["currents"], [1.2, 0.6])
    np.testing.assert_array_equal(numbers["place"], window.live.answer.place)
    np.testing.assert_array_equal(numbers["force"], window.live.answer.force)


@needs_opengl
def test_a_window_beyond_the_currents_of_its_map_says_so_and_shows_nothing(shown):
    window = shown(window=(900, 720))
    window.move([4.5, 0.5, -30.0])
    (magnet,), (arrow,) = (solids_of(window.scene, colour) for colour in (MAGNET, FORCE))
    assert (magnet.visibility, arrow.visibility, window.magnet_at) == (False, False, None)
    assert window.as_numbers()["equilibrium"] is None
    (bar,) = bars_of(window.scene)
    assert (bar.range, bar.labels, bar.fmt) == (pytest.approx((0.0, 1.0)), 6, "%.1f")
    lines = words_of(window.scene)[1].words.split("\n")
    assert lines == ["currents, A: left: 4.500, right: 0.500", "left must lie within 4 A", LEGEND]
    window.move([0.0, 0.0, -30.0])
    assert (arrow.visibility, window.live.answer.lift) == (True, 0.0)
    assert np.ptp(data_of(arrow).points, axis=0).max() < 1e-6
    window.move([1.2, 0.6, -30.0])
    assert (magnet.visibility, arrow.visibility) == (True, True)


@needs_opengl
@pytest.mark.parametrize("coils", [2, 8])
def test_sliders_stand_below_each_other_with_their_units(harmonic_map, coils):
    """Between 88 % and 8 % of the height for any number of sliders, and between 76 % and 97 % of the width."""
    made = {f"c{k}": (0.0, 0.04, 1.0, (0.0, 0.0)) for k in range(coils)}
    window = LiveWindow(harmonic_map(**made), PAYLOAD, 5.0, off_screen=True, window=(800, 720))
    shapes = [slider.GetRepresentation() for slider in window.sliders]
    looks = [one.GetTitleProperty() for one in shapes] + [one.GetLabelProperty() for one in shapes]
    window.scene.close()
    assert [one.GetTitleText() for one in shapes] == [*(f"coil c{k}" for k in range(coils)), "magnet z"]
    ends = [
        (one.GetPoint1Coordinate().GetValue()[:2], one.GetPoint2Coordinate().GetValue()[:2]) for one in shapes
    ]
    heights = 0.88 - 0.8 * np.arange(coils + 1) / max(coils, 6)
    for (first, last), height in zip(ends, heights, strict=True):
        assert (*first, *last) == pytest.approx((0.76, height, 0.97, height))
    assert [one.GetLabelFormat() for one in shapes] == ["%.3f A"] * coils + ["%.1f mm"]
    limits = [(one.GetMinimumValue(), one.GetMaximumValue(), one.GetValue()) for one in shapes]
    begin = [control.value for control in window.live.controls]
    assert limits == [pytest.approx((-5.0, 5.0, value)) for value in begin[:-1]] + [
        pytest.approx((-20.0, 20.0, 4.0))
    ]
    assert {to_hex(look.GetColor()) for look in looks} == {INK}
    assert {look.GetShadow() for look in looks} == {0}


@needs_opengl
def test_a_page_has_neither_sliders_nor_words_and_keeps_the_view_when_it_is_resized(shown):
    page = shown(sliders=False, window=(900, 700))
    assert (page.sliders, [one.words for one in words_of(page.scene)]) == ([], ["two coils"])
    size = page.scene.render_window.GetSize()
    assert filled(page.scene, page._room, size).max() == pytest.approx(1 / 1.42)
    page.scene.camera.position = (100.0, 200.0, 50.0)
    before = np.subtract(page.scene.camera.position, page.scene.camera.focal_point)
    page.scene.render_window.SetSize(500, 800)
    after = np.subtract(page.scene.camera.position, page.scene.camera.focal_point)
    np.testing.assert_allclose(after / np.linalg.norm(after), before / np.linalg.norm(before), atol=1e-6)
    assert filled(page.scene, page._room, (500, 800)).max() == pytest.approx(1 / 1.42)


@needs_opengl
def test_a_moment_without_a_magnet_floats_as_a_ball(aside):
    window = LiveWindow(aside, Payload(0.010, 0.8), 5.0, off_screen=True, window=(400, 300))
    window.move([1.2, 0.6, -30.0])
    (ball,) = solids_of(window.scene, MAGNET)
    assert np.ptp(np.reshape(ball.bounds, (3, 2)), axis=1) == pytest.approx([6.0] * 3, rel=0.02)
    window.scene.close()
