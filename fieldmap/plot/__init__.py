"""Pictures of devices and maps, and figures that are given as data.

Depends on: device, levitation (forces), iron (meshes of bodies without a simple shape), interop; pyvista and
matplotlib, which no other package imports.
"""

from fieldmap.extras import needs

# Every module of this package draws, so a missing library is reported here for all of them.
with needs("plot", "pictures"):
    import matplotlib
    import PIL
    import pyvista
    import scipy

    del matplotlib, PIL, pyvista, scipy

from fieldmap.plot.device_drawing import device_scene
from fieldmap.plot.picture import save_picture
from fieldmap.plot.scenes import SCENES, make_scene, save_scene
from fieldmap.plot.shown import Shown
from fieldmap.plot.slices import field_along, field_slice, force_slice, sensing_slice

__all__ = [
    "SCENES",
    "Shown",
    "device_scene",
    "field_along",
    "field_slice",
    "force_slice",
    "make_scene",
    "save_picture",
    "save_scene",
    "sensing_slice",
]
