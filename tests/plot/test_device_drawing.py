import numpy as np
import pytest
import pyvista as pv

import fieldmap
from fieldmap.errors import FieldmapError
from fieldmap.plot import device_scene, save_picture
from fieldmap.plot.device_drawing import COPPER, CURRENT, FLUX
from fieldmap.plot.rendering import require_renderer
from fieldmap.plot.solids import winding_surface
from fieldmap.plot.words import label_step, round_numbers
from fieldmap.sources import unit_flux_density
from tests.plot.conftest import needs_opengl, pixels_of


class Ramp:
    """|B| = 2 mT per mm of depth, straight down; blind to x and y."""

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
    # The arrow runs less than 4 mm outside the winding.
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
    # The colours of the slice and its bar are in the right panel only.
    green = (pixels[:, :, 1] > pixels[:, :, 0] + 40) & (pixels[:, :, 1] > 100)
    assert green[:, 300:].sum() > 100
    assert green[:, :300].sum() == 0


def test_labels_are_round_numbers():
    assert [label_step(span) for span in (511.0, 60.0, 3.3, 0.2)] == pytest.approx([100.0, 10.0, 1.0, 0.05])
    assert round_numbers(-339.0, 172.0, 100.0).tolist() == [-300.0, -200.0, -100.0, 0.0, 100.0]


def test_without_opengl_there_is_a_message_and_no_crash(monkeypatch):
    monkeypatch.setattr("fieldmap.plot.rendering.can_render", lambda: False)
    with pytest.raises(FieldmapError, match="libegl1"):
        require_renderer()


def solids(scene, colour):
    """Actors of a colour."""
    wanted = np.array(pv.Color(colour).float_rgb)
    return [
        actor
        for actor in scene.actors.values()
        if isinstance(actor, pv.Actor) and np.allclose(actor.prop.color.float_rgb, wanted, atol=0.01)
    ]


@needs_opengl
@pytest.mark.parametrize(("name", "translucent"), [("eight_coils", 1), ("disk_six_cores", 0)])
def test_what_stands_before_the_workspace_is_translucent(name, translucent):
    """One of eight coils round a cube lies between it and the viewer; none of those above a workspace."""
    scene = device_scene(fieldmap.read_device(name), axes=False)
    opacities = [actor.prop.opacity for actor in solids(scene, COPPER)]
    scene.close()
    assert sum(opacity < 0.5 for opacity in opacities) == translucent
    assert sorted(opacities)[translucent:] == [1.0] * (len(opacities) - translucent)


def turn_of(arrow, centre):
    """1 for an arrow that runs counter-clockwise about a centre (3,), mm, seen from above, else -1."""
    points = np.asarray(arrow.points, dtype=float) - centre
    # The tip's base is the widest place of an arrow, the tail is farthest from it.
    tip = points[np.argmax(np.abs(points[:, 2] - np.median(points[:, 2])))]
    tail = points[np.argmax(np.linalg.norm(points - tip, axis=1))]
    return int(np.sign(tail[0] * tip[1] - tail[1] * tip[0]))


@needs_opengl
def test_arrows_point_as_the_currents_flow():
    device = fieldmap.read_device("drive_unit")
    currents = [1.0, -2.0, 0.0, 1.0, 1.0, -1.0]
    scene = device_scene(device, currents=currents, axes=False)
    drawn = [actor.mapper.dataset for actor in solids(scene, CURRENT)]
    names = [a.GetInput() for a in scene.actors.values() if hasattr(a, "GetInput")]
    scene.close()
    assert [text for text in names if text in device.coil_names] == list(device.coil_names)
    assert len(drawn) == 5
    flowing = [(coil, ampere) for coil, ampere in zip(device.coils, currents, strict=True) if ampere]
    for arrow, (coil, ampere) in zip(drawn, flowing, strict=True):
        middle = np.array(pv.merge([winding_surface(coil)]).center)
        # Counter-clockwise where the coil's own field points up in its middle.
        up = unit_flux_density(coil, 1e-3 * middle[None])[0, 2] * ampere
        assert turn_of(arrow, middle) == np.sign(up)
