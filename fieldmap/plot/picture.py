"""The picture of a device: all of it on the left, coils, workspace and field on the right."""

from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.device.model import Device
from fieldmap.field import AnyField, as_field, coil_currents, require_bounds
from fieldmap.plot.device_drawing import VIEW, arrows_at, device_scene
from fieldmap.plot.forces import net_force
from fieldmap.plot.places import MM, plane_of
from fieldmap.plot.rendering import new_scene
from fieldmap.plot.scales import add_words
from fieldmap.plot.solids import extent, winding_surface, workspace_outline
from fieldmap.plot.style import save_screenshot
from fieldmap.plot.words import amperes_in_words
from fieldmap.typing import Array, PathLike

# Numbers of arrows along x and z, and their distance in front of the plane of the field, m.
_ARROWS, _IN_FRONT = (7, 9), 3e-4
_VIEW = np.array(VIEW)
FROM_ABOVE = np.array([0.42, -1.0, 0.75])


def save_picture(
    path: PathLike,
    device: Device,
    field: AnyField | None = None,
    currents: ArrayLike | None = None,
    magnet_at: ArrayLike | None = None,
    caption: str = "",
    window_size: tuple[int, int] = (2000, 1240),
    forces: bool = False,
) -> Path:
    """Draw a device in two panels and save it as PNG: all of it, and coils and workspace from near.

    Parameters
    ----------
    path
        Path of the picture.
    device, field, currents, magnet_at
        As for `device_scene`.
    caption
        A line below the field.
    window_size
        Size of the picture, pixels.
    forces
        Whether arrows show the sum of magnetic force and weight on the payload's magnet, at positions in the plane
        y = middle of the field's box, instead of the direction of B. For a device with a payload.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    FieldmapError
        On a machine without OpenGL.

    Examples
    --------
    >>> import fieldmap                                                           # doctest: +SKIP
    >>> save_picture("drive_unit.png", fieldmap.read_device("drive_unit"))        # doctest: +SKIP
    PosixPath('drive_unit.png')
    """
    scene = new_scene(window_size, panels=2)
    scene.subplot(0, 0)
    device_scene(
        device, currents=_by_name(device, field, currents), magnet_at=magnet_at, plotter=scene, names=False
    )
    look_at(scene, extent(scene), margin=0.14)
    add_words(scene, device.title, (0.03, 0.98))
    scene.subplot(0, 1)
    forces = forces and field is not None and device.payload is not None
    device_scene(device, field, currents, magnet_at, axes=False, plotter=scene, directions=not forces)
    look_at(scene, core_bounds(device))
    if field is not None and forces:
        _add_net_force(scene, device, field, currents)
    if field is not None:
        of = as_field(field).coil_names
        words = amperes_in_words(coil_currents(1.0 if currents is None else currents, of), of)
        words += "" if forces else "; arrows: direction of B"
        red = not forces and magnet_at is not None and device.payload is not None
        words += ", red: moment of the magnet" if red else ""
        words += f"\n{caption}" if caption else ""
        add_words(scene, words, (0.03, 0.02))
    save_screenshot(scene, path)
    scene.close()
    return Path(path)


def _by_name(device: Device, field: AnyField | None, currents: ArrayLike | None) -> Any:
    """Currents of a device's coils, A, from the currents of a field's coils; 1 A in coils that the field lacks."""
    if field is None or currents is None:
        return currents
    names = as_field(field).coil_names
    flowing = dict(zip(names, coil_currents(currents, names), strict=True))
    return [flowing.get(name, 1.0) for name in device.coil_names]


def _add_net_force(scene: pv.Plotter, device: Device, field: AnyField, currents: ArrayLike | None) -> None:
    source = as_field(field)
    box = require_bounds(source)
    amperes = coil_currents(1.0 if currents is None else currents, source.coil_names)
    assert device.payload is not None
    places, _ = plane_of(box, "y", None, _ARROWS)
    force = net_force(source, amperes, device.payload, places)
    # The longest arrow fits into a cell and is centred in it.
    cell = MM * float(np.min((box[1] - box[0])[[0, 2]] / _ARROWS))
    arrows = arrows_at(places - [0.0, _IN_FRONT, 0.0], force, cell)
    scene.add_mesh(arrows, color="white", lighting=False, show_scalar_bar=False)


def core_bounds(device: Device) -> Array:
    """Box (3, 2), mm, of the coils and the workspace, which the right panel shows."""
    surfaces = [winding_surface(coil) for coil in device.coils]
    if device.workspace is not None:
        surfaces.append(workspace_outline(device.workspace))
    return extent(pv.merge(surfaces))


def look_at(
    scene: pv.Plotter,
    bounds: Array,
    margin: float = 0.06,
    view: Array = _VIEW,
    size: tuple[int, int] | None = None,
) -> None:
    """Parallel projection from the front that just holds the box (3, 2).

    view (3,): towards the viewer. size: of the window, pixels; by default its initial size.
    """
    forward, right, up = _directions(view)
    across, along = _seen(bounds, right, up)
    middle = 0.5 * (across.min() + across.max()) * right + 0.5 * (along.min() + along.max()) * up
    width, height = scene.window_size if size is None else size
    scene.camera.parallel_projection = True
    scene.camera.focal_point = tuple(middle)
    scene.camera.position = tuple(middle - 10.0 * np.ptp(bounds) * forward)
    scene.camera.up = (0.0, 0.0, 1.0)
    # Half the height of the view; panels stand side by side.
    as_high = np.ptp(across) * height * len(scene.renderers) / width
    scene.camera.parallel_scale = 0.5 * (1.0 + margin) * max(np.ptp(along), as_high)
    scene.renderer.ResetCameraClippingRange()


def extent_seen(bounds: Array, view: Array = _VIEW) -> tuple[float, float]:
    """Width and height of the box (3, 2) as `look_at` shows it, in the unit of the box."""
    _, right, up = _directions(view)
    across, along = _seen(bounds, right, up)
    return float(np.ptp(across)), float(np.ptp(along))


def _directions(view: Array) -> tuple[Array, Array, Array]:
    """Unit vectors forward, right and up of a viewer in the direction `view` (3,)."""
    forward = -view / np.linalg.norm(view)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return forward, right, np.cross(right, forward)


def _seen(bounds: Array, right: Array, up: Array) -> tuple[Array, Array]:
    """Coordinates (8,) of the corners of a box along two directions."""
    corners = np.array(np.meshgrid(*bounds, indexing="ij")).reshape(3, -1).T
    return corners @ right, corners @ up
