"""No picture of the pages is stale: the record of each equals the content that its command draws today.

test_examples.py checks the pictures that pages draw themselves. Figures of the thesis without a map are drawn here.
For pictures that take minutes the inputs are compared: a changed device, recipe or study needs a new picture.
`pytest tests/docs --rewrite-pictures` draws all quick pictures, and records the inputs of the slow ones anew.
"""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from fieldmap.device import read_device
from fieldmap.io.json_schema import FILE_KINDS
from fieldmap.plot.device_drawing import device_scene
from fieldmap.plot.figures import curves_figure, save_curves
from fieldmap.plot.gather import shown_device
from fieldmap.plot.rendering import can_render
from fieldmap.plot.scenes import make_scene, save_scene
from fieldmap.plot.style import DARK_PAPER, INK, dark_path, in_the_dark, scene_in_the_dark
from fieldmap.thesis.printed import figure_numbers, read_part
from tests.computed_parts import computed
from tests.docs.conftest import IMAGES, digest, records
from tests.docs.pages import ROOT
from tests.docs.picture_record import differences, figure_record, scene_record

needs_opengl = pytest.mark.skipif(not can_render(), reason="no OpenGL on this machine")
KINDS = {kind.name: kind for kind in FILE_KINDS}
# Picture -> part and number of the figure; none needs a map.
FIGURES = {
    "figure_2_9_current_ratio.png": ("S5_current_ratio", "2-9"),
    "figure_4_7_formula.png": ("S9_constants", "4-7"),
}
# Picture -> command that draws it, and the files that determine its content, as KIND:NAME or part:NAME.
LONG = {
    "app.png": (
        "fieldmap app maps/out/workspace.h5 --force-scale 2.1",
        ("device:drive_unit", "recipe:workspace"),
    ),
    "desk_levitator.png": ("fieldmap show desk_levitator", ("device:desk_levitator",)),
    "drive_unit.png": (
        "python scripts/view.py drive_unit maps/out/workspace.h5 --amperes 1.5 --sensor-mm 10",
        ("device:drive_unit",),
    ),
    "figure_6_5.png": (
        "fieldmap thesis S14_x_branches --report report",
        ("part:S14_x_branches", "device:drive_unit", "recipe:division"),
    ),
    "five_coils.png": ("fieldmap show five_coils", ("device:five_coils",)),
    "floating_disc.png": ("fieldmap show floating_disc", ("device:floating_disc",)),
    "joints_x.png": (
        "fieldmap thesis S14_x_joints --report report",
        ("part:S14_x_joints", "device:drive_unit_joints"),
    ),
    "joints_y.png": (
        "fieldmap thesis S14_y_joints --report report",
        ("part:S14_y_joints", "device:drive_unit_joints"),
    ),
    "pole_disk.png": ("fieldmap study pole_disk", ("study:pole_disk", "device:drive_unit")),
    "reachable.png": (
        "fieldmap show eight_coils --what reachable --quantity B --limit 5",
        ("device:eight_coils",),
    ),
    "remembering_gain.png": (
        "python scripts/studies/remembering_study.py --only pictures",
        ("device:drive_unit_joints", "recipe:remembering"),
    ),
    "remembering_step.png": (
        "python scripts/studies/remembering_study.py --only pictures",
        ("device:drive_unit_joints", "recipe:remembering", "scenario:vertical_step"),
    ),
    "show.png": ("fieldmap show drive_unit --what iron", ("device:drive_unit", "recipe:workspace")),
    "workspace.png": ("make map", ("device:drive_unit", "recipe:workspace")),
}


def contents(name: str) -> str:
    """Digest of a file's data, without comments and layout, and with its short forms expanded."""
    kind, _, file = name.partition(":")
    if kind == "part":
        part = read_part(file)
        data: object = [part.inputs, {key: [one.text for one in row] for key, row in part.numbers.items()}]
    else:
        data = KINDS[kind].load(KINDS[kind].find(file)).data
    return hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()


@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_the_thesis_are_those_that_their_rows_draw(name, hold_picture, tmp_path, monkeypatch):
    part, number = FIGURES[name]
    curves = next(one for one in computed(part).curves if number in figure_numbers(one.title))
    figure = curves_figure(curves)
    monkeypatch.setenv("FIELDMAP_PICTURES", "both")
    drawn = save_curves(curves, tmp_path / name)
    row = part.partition("_")[0]
    command = f"FIELDMAP_PICTURES=both python scripts/gallery.py --only figures --rows {row}"
    hold_picture(name, command, "shows", figure_record(figure), drawn)
    with in_the_dark(figure):
        hold_picture(dark_path(name).name, command, "shows", figure_record(figure), dark_path(drawn))


@pytest.mark.parametrize("name", LONG)
def test_what_the_others_show_has_not_changed_since(name, hold_picture):
    command, files = LONG[name]
    for one in (name, dark_path(name).name):
        inputs = {file: contents(file) for file in files}
        hold_picture(one, f"FIELDMAP_PICTURES=both {command}", "inputs", inputs)


@needs_opengl
@pytest.mark.parametrize("name", ["desk_levitator.png", "five_coils.png", "floating_disc.png"])
def test_pictures_of_devices_are_those_that_show_draws(name, hold_picture, rewriting, tmp_path, monkeypatch):
    """Solids, windings, current arrows, and the workspace with the payload in it."""
    scene = make_scene(shown_device(read_device(LONG[name][1][0].removeprefix("device:"))))
    command = f"FIELDMAP_PICTURES=both {LONG[name][0]}"
    light = dark = None
    if rewriting:
        monkeypatch.setenv("FIELDMAP_PICTURES", "both")
        light = save_scene(scene, tmp_path / name)
        dark = dark_path(light)
    hold_picture(name, command, "scene", scene_record(scene), light)
    with scene_in_the_dark(scene):
        hold_picture(dark_path(name).name, command, "scene", scene_record(scene), dark)
    scene.close()


@needs_opengl
@pytest.mark.parametrize("name", ["drive_unit.png", "show.png"])
def test_the_device_is_drawn_as_in_the_pictures_of_its_field(name, hold_picture):
    """Solids, windings, current arrows and the workspace; the field in the picture needs a map."""
    scene = device_scene(read_device(LONG[name][1][0].removeprefix("device:")))
    command = f"FIELDMAP_PICTURES=both {LONG[name][0]}"
    hold_picture(name, command, "scene", scene_record(scene))
    with scene_in_the_dark(scene):
        hold_picture(dark_path(name).name, command, "scene", scene_record(scene))
    scene.close()


def test_every_picture_is_there_in_the_dark_as_well():
    """Both have the same size; the corners of the dark one have the dark background, of the light one white."""
    light = [path for path in sorted(IMAGES.glob("*.png")) if not path.stem.endswith("_dark")]
    assert len(light) > 12
    for path in light:
        one, other = (np.asarray(Image.open(file).convert("RGB")) for file in (path, dark_path(path)))
        assert one.shape == other.shape, path.name
        for image, paper in ((one, "white"), (other, DARK_PAPER)):
            corners = image[[0, 0, -1, -1], [0, -1, 0, -1]]
            assert np.abs(corners - 255 * np.array(to_rgb(paper))).max() <= 1, path.name
        # No ink remains dark on the dark background.
        assert np.mean(is_near(other, INK) & ~is_near(other, DARK_PAPER)) < 0.003, path.name


def is_near(image, colour):
    """Whether each pixel of an image of bytes is this colour, within 1."""
    apart = [
        channel.astype(np.int16) - round(255 * c) for channel, c in zip(image.T, to_rgb(colour), strict=True)
    ]
    return np.all([(one > -2) & (one < 2) for one in apart], axis=0)


def test_every_picture_has_a_record_of_this_very_file():
    assert sorted(records()) == sorted(path.name for path in IMAGES.glob("*.png"))
    assert {name: entry["sha256"] for name, entry in records().items()} == {
        path.name: digest(path) for path in IMAGES.glob("*.png")
    }


def test_every_picture_stands_on_a_page_beside_what_makes_it():
    """A page contains the words of its command, or is the page that draws it."""
    pages = {path: path.read_text() for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]}
    for name, entry in records().items():
        light = name.replace("_dark.png", ".png")
        showing = [path for path, text in pages.items() if re.search(rf"\]\([\w/.]*images/{light}\)", text)]
        assert showing, name
        made_by = entry["made_by"].removeprefix("FIELDMAP_PICTURES=both ")
        if made_by.endswith(".md"):
            assert ROOT / made_by in showing, name
        elif made_by.startswith("fieldmap "):
            words = " ".join(made_by.split()[:3])
            assert any(words in text for text in pages.values()), name


def test_a_changed_curve_is_seen():
    figure = Figure()
    axes = figure.add_subplot(xlabel="x (mm)", ylabel="B (mT)", title="Bz")
    axes.plot([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], label="ours")
    record = json.loads(json.dumps(figure_record(figure)))
    assert differences(record, figure_record(figure)) == []
    axes.lines[0].set_ydata([1.0, 2.0, 3.1])
    assert [text.split(":")[0] for text in differences(record, figure_record(figure))] == [
        "axes[0].lines[0].y"
    ]
    axes.lines[0].set_ydata([1.0, 2.0, 3.0])
    axes.set_xlabel("x (m)")
    assert [text.split(":")[0] for text in differences(record, figure_record(figure))] == ["axes[0].x"]
    axes.plot([0.0], [1.0])
    assert len(differences(record, figure_record(figure))) == 2


def test_pictures_of_pages_are_in_the_records():
    """Every figure that a page saves under the name of one of its pictures, as test_examples.py checks."""
    for path in sorted((ROOT / "docs").rglob("*.md")):
        text = path.read_text()
        saved = set(re.findall(r"(?:savefig\(\"|--save )([\w]+\.png)", text))
        shown = {Path(place).name for place in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", text)}
        for name in saved & shown:
            assert records()[name]["made_by"] == str(path.relative_to(ROOT))
