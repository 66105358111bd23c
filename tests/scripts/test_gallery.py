"""The gallery: one page with all pictures that could be made, and the names of the missing ones."""

import re
from pathlib import Path

import click
import pytest

from fieldmap.cli.application import application
from fieldmap.thesis import Curves, Series
from fieldmap.thesis.computation import PartResult


@pytest.fixture
def gallery(program):
    return program("gallery")


def test_the_figures_of_a_row_stand_on_the_page(gallery, tmp_path, monkeypatch):
    line = Curves(
        "Fig. 4-7: <Fx>", "x (mm)", "force (N)", (Series("ours", [0.0, 1.0], [1.0, 2.0]),), "A remark."
    )
    parts = [
        PartResult("S9_constants", "constants", curves=(line, line)),
        PartResult("S9_superposition", "sums", curves=(line,)),
        PartResult("S12", "lift", problem="no map"),
    ]
    monkeypatch.setattr(gallery, "attempt_rows", lambda *_: iter(parts))
    sections, missing = gallery.draw_all(tmp_path, gallery.figures(tmp_path, tmp_path, []))
    assert {title[:3]: len(pictures) for title, pictures in sections.items()} == {"S9:": 3}
    page = gallery.write_page(tmp_path, sections, missing).read_text()
    files = re.findall(r'src="([^"]+)"', page)
    assert len(set(files)) == 3
    for file in files:
        assert (tmp_path / file).read_bytes()[:4] == b"\x89PNG"
    assert "&lt;Fx&gt;" in page
    assert "<Fx>" not in page
    assert "S12: no map" in page
    assert re.search(r">4-7</a> \w", page)
    places = re.findall(r' id="([^"]+)"', page)
    assert len(places) == len(set(places))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(places)


def test_scenes_without_their_map_are_named(gallery, tmp_path, monkeypatch):
    commands = []

    def pretend(words):
        commands.append(words)
        Path(words[-1]).write_bytes(b"")
        return 0

    monkeypatch.setattr(gallery, "run_command", pretend)

    def drawn():
        return gallery.draw_all(tmp_path, gallery.scenes(tmp_path, tmp_path / "maps"))

    sections, missing = drawn()
    without_map = [command for _, _, command in gallery.SCENES if "MAPS" not in command]
    titles = [picture.title for picture in sections["Scenes"]]
    assert len(titles) == len(without_map)
    assert len(missing) == len(gallery.SCENES) - len(titles)
    assert all("fieldmap map" in text for text in missing)
    commands.clear()
    assert [picture.title for picture in drawn()[0]["Scenes"]] == titles  # existing pictures are kept
    assert commands == []


def test_every_command_of_a_scene_is_one(gallery):
    program = application.__wrapped__()  # as in tests/cli/test_manners.py
    for _, _, command in gallery.SCENES:
        name, *words = command.split()
        with click.Context(program) as context:
            known = program.get_command(context, name)
            known.make_context(name, [*words, "--save", "a.png"], parent=context)
