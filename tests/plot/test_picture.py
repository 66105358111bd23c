"""The picture of a device in two panels, read from its scene before closing; and the extent seen by a camera."""

from types import SimpleNamespace

import numpy as np
import pytest
import pyvista as pv

from fieldmap.plot import picture
from fieldmap.plot.device_drawing import COPPER, CURRENT, FLUX, IRON, MAGNET, VIEW
from fieldmap.plot.picture import core_bounds, extent_seen, look_at, save_picture
from fieldmap.plot.scales import MILLIMETRES
from fieldmap.plot.solids import extent
from tests.plot.conftest import Crooked, crooked_device, needs_opengl
from tests.plot.scene_reading import (
    bars_of,
    check_legible,
    data_of,
    filled,
    labels_of,
    seen,
    solids_of,
    words_of,
)

CORE = [[-35, 40], [-6, 27], [-30, 36]]


@pytest.fixture
def panels(monkeypatch, tmp_path):
    """panels(device, ...): the content of both panels of a picture."""

    def draw(device, *given, **options):
        found = []

        def read(scene, path):
            for k in range(2):
                scene.subplot(0, k)
                check_legible(scene, smallest=13.0)
                solids = {
                    colour: len(solids_of(scene, colour))
                    for colour in (IRON, COPPER, CURRENT, MAGNET, "white")
                }
                white = [np.asarray(data_of(one).points, float) for one in solids_of(scene, "white")]
                planes = [one for one in solids_of(scene) if one.mapper.array_name == FLUX]
                words = [(one.words, one.place) for one in words_of(scene)]
                held = filled(scene, extent(scene) if k == 0 else CORE)
                about = {
                    "white": white,
                    "planes": len(planes),
                    "words": words,
                    "held": held,
                    "bars": bars_of(scene),
                }
                arrows = [one.mapper.dataset.bounds for one in solids_of(scene, CURRENT)]
                # The left panel has rulers.
                assert [one.words for one in labels_of(scene) if "mm" in one.words] == [*MILLIMETRES][
                    : 3 - 3 * k
                ]
                billboards = [one for one in scene.actors.values() if "Billboard" in type(one).__name__]
                found.append(SimpleNamespace(solids=solids, arrows=arrows, names=len(billboards), **about))
            found.append(tuple(scene.window_size))

        monkeypatch.setattr(picture, "save_screenshot", read)
        assert save_picture(tmp_path / "a.png", device, *given, **options) == tmp_path / "a.png"
        return found

    return draw


@needs_opengl
def test_both_panels_show_the_machine_and_the_right_one_its_field(panels):
    device = crooked_device()
    left, right, size = panels(device, Crooked(), [1.5, -0.5], [0.001, 0.0, -0.02], "a caption")
    assert size == (2000, 1240)
    assert left.words == [("A crooked machine", pytest.approx((0.03, 0.98)))]
    words = "ring: 1.5 A, frame: -0.5 A; arrows: direction of B, red: moment of the magnet\na caption"
    assert right.words == [(words, pytest.approx((0.03, 0.02)))]
    assert (left.planes, right.planes, len(left.white), len(right.white)) == (0, 2, 0, 1)
    for one in (left, right):
        assert [one.solids[colour] for colour in (IRON, COPPER, CURRENT, MAGNET)] == [2, 2, 2, 2]
    assert (left.names, right.names) == (0, 2)
    # The left panel holds everything with some margin; coils and workspace nearly fill the right panel.
    assert left.held.max() == pytest.approx(1 / 1.14)
    assert right.held.max() == pytest.approx(1 / 1.06)
    for one in (left, right):
        np.testing.assert_allclose(one.held.sum(axis=1), 0.0, atol=1e-9)
    # Both panels have the arrows of the given currents; without a field, of 1 A.
    assert left.arrows == right.arrows
    plain, _, _ = panels(device)
    assert plain.arrows[0] == left.arrows[0]
    assert plain.arrows[1] != left.arrows[1]


@needs_opengl
def test_words_and_arrows_of_a_picture_of_forces(panels):
    """Net force of magnetic force and weight: 7 by 9 arrows 0.3 mm before the plane y = -2 mm, one cell width long."""
    _, right, size = panels(crooked_device(), Crooked(), [1.5, -0.5], forces=True, window_size=(600, 400))
    assert size == (600, 400)
    assert right.words == [("ring: 1.5 A, frame: -0.5 A", pytest.approx((0.03, 0.02)))]
    (points,) = right.white
    each = points.reshape(63, -1, 3)
    along = 0.12 * np.array([0.3, -0.65, 2.25]) - [0.0, 0.0, 0.0980665]
    along /= np.linalg.norm(along)
    share = each @ along
    np.testing.assert_allclose(np.ptp(share, axis=1), 9 / 7, rtol=1e-4)
    middles = each.mean(axis=1) + np.outer(
        share.min(axis=1) + 0.5 * np.ptp(share, axis=1) - share.mean(axis=1), along
    )
    np.testing.assert_allclose(middles[:, 1], -2.3, atol=0.02)
    for axis, low, size, count in ((0, -4.0, 9.0, 7), (2, -30.0, 20.0, 9)):
        expected = low + (np.arange(count) + 0.5) / count * size
        np.testing.assert_allclose(np.unique(middles[:, axis].round(1)), expected, atol=0.06)
    # Without a payload there is no force.
    _, bare, _ = panels(crooked_device(payload=None), Crooked(), forces=True)
    assert bare.words == [("1 A in each of 2 coils; arrows: direction of B", pytest.approx((0.03, 0.02)))]
    assert len(bare.white[0].reshape(-1, 3)) > 1
    nothing, no_field, _ = panels(crooked_device(), forces=True)
    assert (no_field.words, no_field.planes, nothing.planes) == ([], 0, 0)


@needs_opengl
def test_coils_that_the_field_does_not_know_carry_one_ampere(panels):
    class Ring(Crooked):
        coil_names, SLOPES, FLUX = ("ring",), Crooked.SLOPES[:1], Crooked.FLUX[:1]

    positive, *_ = panels(crooked_device(), Ring(), [2.0])
    turned, *_ = panels(crooked_device(), Ring(), [-2.0])
    without, *_ = panels(crooked_device(), Ring(), [0.0])
    assert positive.arrows[1] == turned.arrows[1] == without.arrows[0]
    assert (len(turned.arrows), len(without.arrows)) == (2, 1)
    assert positive.arrows[0] != turned.arrows[0]


def test_the_core_is_coils_and_workspace():
    np.testing.assert_allclose(core_bounds(crooked_device()), CORE, atol=0.02)
    np.testing.assert_allclose(core_bounds(crooked_device(workspace=None))[2], [16, 36], atol=0.02)


@pytest.mark.parametrize("bounds", [[[0, 100], [-5, 5], [20, 30]], [[0, 10], [-50, 20], [-90, 30]]])
@pytest.mark.parametrize("panels", [1, 2])
def test_a_camera_just_holds_a_box(bounds, panels):
    """Flat and tall boxes, with one and two panels; the camera is outside, above the middle, and clips nothing."""
    scene = pv.Plotter(off_screen=True, window_size=[500, 400], shape=(1, panels))
    scene.add_mesh(pv.Box(np.ravel(bounds)))
    box = np.array(bounds, float)
    for options, margin, view, size in (
        ({}, 0.06, VIEW, (500, 400)),
        (
            {"margin": 0.5, "view": np.array([1.0, 2.0, 0.5]), "size": (300, 900)},
            0.5,
            (1.0, 2.0, 0.5),
            (300, 900),
        ),
    ):
        look_at(scene, box, **options)
        ends = filled(scene, box, size)
        np.testing.assert_allclose(ends.sum(axis=1), 0.0, atol=1e-9)
        assert ends.max() == pytest.approx(1 / (1 + margin))
        away = np.subtract(scene.camera.position, scene.camera.focal_point)
        np.testing.assert_allclose(np.cross(away, view), 0.0, atol=1e-6)
        assert away @ view > 0.0
        depth = np.array(np.meshgrid(*bounds)).reshape(3, -1).T @ away / np.linalg.norm(away)
        place = np.array(scene.camera.position) @ away / np.linalg.norm(away)
        near, far = scene.camera.clipping_range
        assert near < place - depth.max() < place - depth.min() < far
        # The visible extent in units of the box.
        across, up = extent_seen(box, np.array(view))
        panel = size[0] / panels / size[1]
        assert np.ptp(ends, axis=1) == pytest.approx(
            [across / panel / scene.camera.parallel_scale, up / scene.camera.parallel_scale]
        )
    assert seen(scene, [scene.camera.focal_point], (300, 900))[0] == pytest.approx([0.0, 0.0])
    scene.close()


def test_what_is_seen_of_a_box_from_the_front():
    """Along y, and from above at 45 degrees: x is unchanged, y and z are projected."""
    box = np.array([[0.0, 3.0], [0.0, 4.0], [0.0, 5.0]])
    assert extent_seen(box, np.array([0.0, -1.0, 0.0])) == pytest.approx((3.0, 5.0))
    assert extent_seen(box, np.array([0.0, -1.0, 1.0])) == pytest.approx((3.0, 9.0 / np.sqrt(2.0)))
    assert extent_seen(box, np.array([2.0, 0.0, 0.0])) == pytest.approx((4.0, 5.0))
