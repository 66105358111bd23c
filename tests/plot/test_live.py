"""A map behind sliders: what follows a moved slider is what the map itself answers, and closed forms say."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import IndependentCurrents, LiftAndDirections, divide_currents
from fieldmap.device.model import MagnetCylinder, Payload
from fieldmap.errors import InputError
from fieldmap.levitation import find_equilibrium
from fieldmap.plot.live_window import LiveMap, LiveWindow, _controls
from fieldmap.plot.style import text_properties
from tests.plot.conftest import harmonic, needs_opengl

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
    # Twice the force at half the currents.
    np.testing.assert_allclose(2 * answer.currents, [c.value for c in live.controls[:2]])


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
    """Of the division's signals, or of the coils; only the domain of the model is read."""

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
