"""Outputs of commands never replace an input or a file of another origin, and have an ending of their format.

Commands and outputs come from the declarations of the command line.
"""

import json
import shlex
import typing
from pathlib import Path

import pytest

from fieldmap.cli.application import COMMANDS, application
from fieldmap.cli.options import outputs_of
from fieldmap.store.output_formats import FORMATS, output_problems

# Command with outputs -> its line without them; {input} is an input file.
LINES = {
    "map": "map {input}",
    "export": "export {input} --to csv",
    "import": "import {input}",
    "simulate": "simulate {input}",
    "linearise": "linearise {input}",
    "study": "study {input}",
    "optimise": "optimise {input}",
    "fit": "fit {input}",
    "show": "show {input}",
    "app": "app {input} --web",
    "thesis": "thesis S7",
}
# Path parameters that are inputs.
READ = {
    ("import", "source"),
    ("identify", "log"),
    ("simulate", "map_file"),
    ("simulate", "log"),
    ("linearise", "map_file"),
    ("tune", "map_file"),
    ("thesis", "maps"),
}
OUTPUTS = [(name, output) for name, entry in COMMANDS.items() for output in outputs_of(entry.call)]
ONE_FORMAT = {"export": {".csv"}, "show": {".png", ".html", ".vtm"}}


def option_of(command, parameter):
    return next(one.opts[0] for one in application().commands[command].params if one.name == parameter)


def endings(command, parameter):
    formats = outputs_of(COMMANDS[command].call)[parameter].formats
    every = sorted({ending for name in formats for ending in FORMATS[name].endings})
    return [ending for ending in every if ending in ONE_FORMAT.get(command, every)]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_path_is_declared_as_read_or_written(name):
    hints = typing.get_type_hints(COMMANDS[name].call)
    paths = {key for key, hint in hints.items() if hint in (Path, Path | None)}
    written = set(outputs_of(COMMANDS[name].call))
    assert {(name, one) for one in paths - written} == {each for each in READ if each[0] == name}
    assert not written or name in LINES


@pytest.mark.parametrize(("name", "output"), OUTPUTS)
def test_no_output_takes_the_place_of_an_input(command, tmp_path, name, output):
    """The same file as input and output, with each ending that the output may have."""
    for ending in endings(name, output):
        read = tmp_path / f"read{ending}"
        read.write_bytes(b"read by the command")
        line = shlex.split(LINES[name].format(input=read))
        code, printed, told = command("", *line, option_of(name, output), read)
        assert (code, printed) == (2, "")
        assert f"error     {option_of(name, output)}" in told
        assert str(read) in told.split("received", 1)[1]
        assert read.read_bytes() == b"read by the command"
    assert {path.stem for path in tmp_path.iterdir()} <= {"read"}


@pytest.mark.parametrize(("name", "output"), OUTPUTS)
def test_no_output_takes_the_place_of_another_file(command, tmp_path, name, output):
    """Neither notes with a valid ending nor a file of the right format from another program are replaced."""
    read = tmp_path / "read.toml"
    read.write_text("format = 1")
    line = shlex.split(LINES[name].format(input=read))
    other = tmp_path / "other"
    if not endings(name, output):
        other.mkdir()
    for ending in endings(name, output) or ["/index.html", "/report.md", "/numbers.csv"]:
        path = tmp_path / f"other{ending}"
        path.write_text("time,x\n0,1\n")
        given = path if endings(name, output) else other
        code, printed, told = command("", *line, option_of(name, output), given)
        assert (code, printed) == (2, "")
        assert f"{path}, a text that begins with 'time,x'" in told
        assert path.read_text() == "time,x\n0,1\n"
        path.unlink()


@pytest.mark.parametrize(("name", "output"), [pair for pair in OUTPUTS if endings(*pair)])
def test_an_output_ends_as_its_format_does(command, tmp_path, name, output):
    line = shlex.split(LINES[name].format(input=tmp_path / "read.toml"))
    code, _, told = command("", *line, option_of(name, output), tmp_path / "written.out")
    assert code == 2
    assert all(ending in told for ending in endings(name, output))
    assert not list(tmp_path.iterdir())


def test_two_outputs_are_two_files(command, tmp_path):
    told = command(
        "simulate hold -o", tmp_path / "a.csv", "--save", tmp_path / "a.png", "--log", tmp_path / "a.toml"
    )[2]
    assert "error     --log" in told
    log = tmp_path / "run.txt"
    log.write_text("time,x\n")
    assert command("check loop_and_sphere --log", log)[0] == 2
    assert log.read_text() == "time,x\n"


def test_a_picture_of_another_program_is_not_drawn_over(command, machine, tmp_path):
    """Pictures without a given name, next to a map and next to a study."""
    photo = b"\x89PNG\r\n\x1a\n" + bytes(500)
    (tmp_path / "loop.h5").write_bytes(Path(machine.map).read_bytes())
    (tmp_path / "loop.png").write_bytes(photo)
    code, printed, _ = command("map -o", tmp_path / "loop.h5", machine.recipe, "--json", "--pictures")
    assert code == 0
    assert "another origin" in json.loads(printed)["pictures"][0]["problem"]
    for name in ("study pole_disk", "optimise pole_piece"):
        code, _, told = command(name, "-o", tmp_path / "loop.nc")
        assert code == 2
        assert f"error     {tmp_path / 'loop.png'}" in told
    assert (tmp_path / "loop.png").read_bytes() == photo


WRITTEN = {
    "map {recipe} --fresh -o loop.h5": ("map",),
    "export {six} --to csv -o a.csv": ("table of a field",),
    "export {six} --to vti -o a.vti": ("VTK image data",),
    "export {six} --to c --kind global -o a.fmap": ("map for C",),
    "export {six} --to c32 --kind global -o a.h": ("C header",),
    "export {six} --to fmu --kind global --sources -o a.fmu": ("unit of FMI",),
    "export {loop} --to mag-manip --spacing-mm 5 -o a.yaml": ("field for mag_manip",),
    "simulate {step} --set duration_s=0.1 -o run.h5 --save run.svg": ("recorded runs", "figure"),
    "simulate {step} --set duration_s=0.1 -o run.csv --save run.pdf": ("recorded run", "figure"),
    "linearise {step} --log run.log -o models.json": ("log", "linear models"),
    "linearise {step} -o models.npz": ("linear models",),
}


@pytest.mark.parametrize("line", WRITTEN)
def test_what_a_command_has_written_it_may_write_again(
    command, machine, written, six_coils, tmp_path, monkeypatch, line
):
    monkeypatch.chdir(tmp_path)
    words = line.format(recipe=machine.recipe, loop=machine.map, six=six_coils, step=written())
    code, _, told = command(words)
    assert code in (0, 1), told
    files = [word for word in line.split() if word in {path.name for path in tmp_path.iterdir()}]
    assert len(files) == len(WRITTEN[line])
    for name, kind in zip(files, WRITTEN[line], strict=True):
        assert output_problems(name, name, [kind]) == []
        # A written file is not accepted in place of another kind of output.
        others = [
            one
            for one in FORMATS
            if one not in (kind, "picture", "drawn figure", "kept mesh")
            and Path(name).suffix in FORMATS[one].endings
        ]
        assert all(output_problems(name, name, [one]) for one in others)
