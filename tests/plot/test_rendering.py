"""The off-screen renderer is tested once, in a subprocess, and then chosen for this process."""

import subprocess
from types import SimpleNamespace

import pytest

from fieldmap.errors import FieldmapError
from fieldmap.plot import rendering
from fieldmap.plot.rendering import can_render, new_scene, require_window
from tests.plot.conftest import needs_opengl

EGL, IN_MEMORY = "vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"
CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"


@pytest.mark.parametrize(
    ("platform", "display", "given", "works", "tried", "chosen"),
    [
        ("linux", "", None, {EGL, IN_MEMORY}, [EGL], EGL),
        ("linux", "", None, {IN_MEMORY}, [EGL, IN_MEMORY], IN_MEMORY),
        ("linux", "", None, set(), [EGL, IN_MEMORY], None),
        # Only the user's choice is tried.
        ("linux", "", "own", {"own"}, ["own"], "own"),
        ("linux", "", "own", {EGL}, ["own"], None),
        # With a screen, and on other systems, nothing is tried.
        ("linux", ":0", None, set(), [], True),
        ("darwin", "", None, set(), [], True),
        ("win32", "", None, set(), [], True),
    ],
)
def test_what_can_draw_is_tried_and_chosen(monkeypatch, platform, display, given, works, tried, chosen):
    asked = []

    def run(program, env, timeout, **options):
        assert (options, timeout > 30.0) == ({"capture_output": True, "check": False}, True)
        compile(program[-1], "program", "exec")
        asked.append(env[CHOICE])
        return SimpleNamespace(returncode=0 if env[CHOICE] in works else -11)

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(rendering.sys, "platform", platform)
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setenv(CHOICE, given or "")
    assert can_render.__wrapped__() is bool(chosen)
    assert asked == tried
    if isinstance(chosen, str):
        assert rendering.os.environ[CHOICE] == chosen


def test_it_is_looked_for_once():
    assert can_render.cache_info().maxsize == 1


def window(kind):
    made = None if kind is None else SimpleNamespace(GetClassName=lambda: kind)
    return SimpleNamespace(render_window=made)


@pytest.mark.parametrize("kind", [EGL, IN_MEMORY])
def test_a_window_needs_a_screen(monkeypatch, kind):
    for display, words in (("", "none (DISPLAY is not set)"), (":9", "none (DISPLAY is :9)")):
        monkeypatch.setenv("DISPLAY", display)
        with pytest.raises(FieldmapError) as error:
            require_window(window(kind))
        assert error.value.problems[0].received == words


@pytest.mark.parametrize("kind", ["vtkXOpenGLRenderWindow", "vtkCocoaRenderWindow", None])
def test_where_there_is_a_screen_a_window_may_open(kind):
    require_window(window(kind))


@needs_opengl
@pytest.mark.parametrize(("options", "panels"), [({}, 1), ({"panels": 3}, 3)])
def test_a_new_scene_is_white_and_has_its_panels_side_by_side(options, panels):
    scene = new_scene((300, 200), **options)
    places = [renderer.GetViewport() for renderer in scene.renderers]
    papers = {renderer.GetBackground() for renderer in scene.renderers}
    made = scene.window_size, scene.off_screen
    scene.close()
    assert made == ([300, 200], True)
    assert [(one[0], one[2]) for one in places] == [
        (pytest.approx(k / panels), pytest.approx((k + 1) / panels)) for k in range(panels)
    ]
    assert papers == {(1.0, 1.0, 1.0)}
