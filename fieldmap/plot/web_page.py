"""A scene as one HTML file that any browser turns and zooms, without a server and without a network.

trame-vtk (an optional extra) brings the viewer, vtk.js in one page, and turns the scene into what that viewer reads.
"""

import html
import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pyvista as pv

from fieldmap.extras import require
from fieldmap.plot.scales import MILLIMETRES
from fieldmap.plot.style import INK
from fieldmap.store.whole_files import write_whole

# The viewer empties the page's body, but not what a style sheet puts after it.
_HEAD = """<title>{title}</title><style>body::after {{ content: "{words}"; white-space: pre; position: fixed;
left: 1em; top: .6em; z-index: 99; color: #22282e; font: 15px system-ui, sans-serif; pointer-events: none; }}"""
_HOW = "drag: turn; wheel: zoom; shift and drag: move"


def save_web_page(
    scene: pv.Plotter, path: str | Path, title: str = "", axes: tuple[str, str, str] = MILLIMETRES
) -> Path:
    """Write the scene to an HTML file of some MB, with a line of text and titles of its axes.

    The viewer knows no labels at points, so the rulers get axes of the viewer's own beside them. Raises FieldmapError
    where trame-vtk is not installed.
    """
    require("trame_vtk", "web", "fieldmap.plot.save_web_page", "save a .png")
    from trame_vtk.modules.vtk import serializers
    from trame_vtk.tools.vtksz2html import write_html

    scene.renderer.show_bounds(xtitle=axes[0], ytitle=axes[1], ztitle=axes[2], color=INK, font_size=10)
    # The viewer does not know parallel projection.
    scene.camera.parallel_projection = False
    scene.renderer.reset_camera()
    scene.render()
    packed, page = io.BytesIO(), io.StringIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("index.json", json.dumps(_description(scene, serializers)))
    write_html(packed.getvalue(), page)
    quoted = title.replace("\\", "").replace('"', "'").replace("<", " ")
    head = _HEAD.format(title=html.escape(title), words=f"{quoted}\\A {_HOW}")
    # In the place of the viewer's own title.
    content = re.sub("<title>.*?</title>\\s*<style>", lambda _: head, page.getvalue(), count=1)
    write_whole(Path(path), content.encode())
    return Path(path)


def _description(scene: pv.Plotter, tools: Any) -> dict[str, Any]:
    """What the viewer reads: the scene as JSON, and every array under the hash that stands for it."""
    tools.initialize_serializers()
    context = tools.SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    window = scene.render_window
    described = tools.serialize(None, window, tools.reference_id(window), context, 1)
    camera = scene.renderer.GetActiveCamera()
    described["extra"] = {
        "vtkRefId": tools.reference_id(window),
        "centerOfRotation": camera.GetFocalPoint(),
        "camera": tools.reference_id(camera),
    }
    arrays = {
        entry["hash"]: entry | {"content": context.get_cached_data_array(entry["hash"], False)}
        for entry in tools.extract_array_hash(described)
    }
    return {"hashes": arrays, "scene": described}
