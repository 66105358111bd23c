"""Whether this machine can draw without a screen."""

import os
import subprocess
import sys
from functools import lru_cache

from vtkmodules.vtkCommonCore import vtkLogger

from fieldmap.errors import FieldmapError, Problem

_PROGRAM = (
    "import pyvista; p = pyvista.Plotter(off_screen=True); p.add_mesh(pyvista.Box()); p.screenshot(None)"
)


@lru_cache(maxsize=1)
def can_render() -> bool:
    """Draw a box in another process: without OpenGL the renderer does not fail, it takes its process down.

    A second or two, once, and only on a Linux machine without a display.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        return True
    tried = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, timeout=120, check=False)
    return tried.returncode == 0


def require_renderer() -> None:
    """Raise FieldmapError where nothing can be drawn."""
    # Without a display VTK draws by EGL, after a line about an X server that nobody asked for.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    if not can_render():
        raise FieldmapError(
            Problem(
                "fieldmap.view",
                "the machine must offer OpenGL",
                "neither a display nor EGL nor OSMesa",
                "install EGL (Debian: libegl1) or OSMesa (libosmesa6), or draw on another machine",
            )
        )
