"""Pictures of devices and maps, figures of the thesis.

Depends on: device, iron (meshes of bodies that are no simple shape), thesis; pyvista and matplotlib, of which this
room is the only door. Nothing else imports it.
"""

from fieldmap.view.picture import save_picture
from fieldmap.view.scene import device_scene

__all__ = ["device_scene", "save_picture"]
