"""Whether this machine can draw without a screen."""

import os
import subprocess
import sys
from functools import lru_cache

import pyvista as pv
from vtkmodules.vtkCommonCore import vtkLogger

from fieldmap.errors import FieldmapError

# Uses VTK directly, because loading pyvista takes a second more.
_PROGRAM = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkFiltersSources import vtkCubeSource
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter
)
box, mapper, actor = vtkCubeSource(), vtkPolyDataMapper(), vtkActor()
mapper.SetInputConnection(box.GetOutputPort())
actor.SetMapper(mapper)
renderer, window, picture = vtkRenderer(), vtkRenderWindow(), vtkWindowToImageFilter()
renderer.AddActor(actor)
window.OffScreenRenderingOn()
window.AddRenderer(renderer)
window.Render()
picture.SetInput(window)
picture.Update()
"""


# Windows of VTK without a screen: by the graphics driver, or by Mesa in memory.
_WITHOUT_SCREEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"


@lru_cache(maxsize=1)
def can_render() -> bool:
    """Draw a box in another process, because without OpenGL the renderer would end its process.

    This takes a second or two, once, and only on a Linux machine without a display. The window class that works is then
    set for this process, too, in VTK's environment variable, so that VTK does not search for a screen and complain.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        return True
    given = os.environ.get(_CHOICE)
    for choice in (given,) if given else _WITHOUT_SCREEN:
        environment = {**os.environ, _CHOICE: choice}
        program = [sys.executable, "-c", _PROGRAM]
        tried = subprocess.run(program, capture_output=True, timeout=120, check=False, env=environment)
        if tried.returncode == 0:
            os.environ[_CHOICE] = choice
            return True
    return False


def require_renderer() -> None:
    """Raise FieldmapError if nothing can be drawn."""
    # If the display no longer exists (an old DISPLAY), VTK complains but draws without it.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    if not can_render():
        raise FieldmapError.of(
            "fieldmap.plot",
            "the machine must offer OpenGL",
            "neither a display nor EGL nor OSMesa",
            "install EGL (Debian: libegl1) or OSMesa (libosmesa6), or draw on another machine",
        )


def new_scene(size: tuple[int, int], off_screen: bool = True, panels: int = 1) -> pv.Plotter:
    """An empty scene on white paper, with panels side by side. Raises FieldmapError if nothing can be drawn."""
    require_renderer()
    scene = pv.Plotter(off_screen=off_screen, window_size=list(size), shape=(1, panels), border=False)
    scene.background_color = pv.Color("white")
    return scene


def require_window(scene: pv.Plotter) -> None:
    """Raise FieldmapError if there is no screen to show a scene."""
    kind = scene.render_window.GetClassName() if scene.render_window is not None else ""
    if kind in _WITHOUT_SCREEN:
        raise FieldmapError.of(
            "fieldmap.plot",
            "a window needs a screen",
            f"none (DISPLAY is {os.environ.get('DISPLAY') or 'not set'})",
            "add --save FILE.png, or .html for a page that turns in a browser",
        )
