"""Every `fieldmap ...` line in the documentation is accepted by the program."""

import contextlib
import itertools
import re
import shlex
from pathlib import Path

import pytest
import typer

from fieldmap.cli.application import application
from fieldmap.cli.arguments import join_lists
from fieldmap.shipped import shipped_names
from fieldmap.thesis import part_names, row_names
from tests.docs.pages import PAGES, ROOT, named

# A separate program: a command keeps the help options of the context in which it was first parsed; these have none.
PROGRAM = application.__wrapped__()
IN_BLOCK = re.compile(r"^(?:    |\$ )(?:\.venv/bin/)?(fieldmap .*)$", re.MULTILINE)
IN_TEXT = re.compile(r"`(fieldmap (?!COMMAND)[^`\n]*)`")
PLACEHOLDER = re.compile(r"[A-Z_]+")
CODE = re.compile(r"^```(?:python|c)\n.*?^```$", re.DOTALL | re.MULTILINE)


def command_lines(path: Path) -> list[tuple[str, bool]]:
    """Command lines of a page, and whether each is complete (in a block) or a mention in the text."""
    text = CODE.sub("", path.read_text())
    return [(line, True) for line in IN_BLOCK.findall(text)] + [
        (line, False) for line in IN_TEXT.findall(text)
    ]


ALL = [(named(path), line, whole) for path in PAGES for line, whole in command_lines(path)]


def words_of(line: str) -> list[str]:
    line = re.split(r" > |#", line)[0]
    return join_lists(shlex.split(re.sub(r"[\[\]]", "", line))[1:])


def test_there_are_command_lines():
    assert len(ALL) > 25


@pytest.mark.parametrize(("page", "line", "whole"), ALL, ids=lambda value: str(value)[:60])
def test_options_exist(page, line, whole):
    """The program itself parses the line, without running the command."""
    words = words_of(line)
    if not words or words[0].startswith("--"):
        known = {
            name for parameter in PROGRAM.params for name in (*parameter.opts, *parameter.secondary_opts)
        }
        given = {word for word in words if word.startswith("--")}
        assert given <= known | {"--help"}, f"{page}: {line}"
        return
    command = PROGRAM.commands.get(words[0])
    assert command is not None, f"{page}: no command {words[0]}"
    if whole:
        with contextlib.suppress(typer.Exit):
            command.make_context(words[0], words[1:])
    options = {word.split("=")[0] for word in words[1:] if word.startswith("--")}
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    assert options <= known, f"{page}: {line}"


@pytest.mark.parametrize(("page", "line", "whole"), ALL, ids=lambda value: str(value)[:60])
def test_files_exist(page, line, whole):
    """Shipped devices and recipes exist under the names on the pages."""
    known = {"map": ("maps", ""), "study": ("maps", "studies"), "fit": ("maps", "fits")}
    known["optimise"] = known["study"]
    known |= dict.fromkeys(("simulate", "linearise", "tune"), ("maps", "scenarios"))
    words = words_of(line)
    if len(words) < 2 or words[1].startswith("-") or PLACEHOLDER.fullmatch(words[1]):
        return
    if words[0] == "thesis":
        rows = itertools.takewhile(lambda word: not word.startswith("-"), words[1:])
        assert set(rows) <= {*row_names(), *part_names()}, f"{page}: {line}"
        return
    source = words[1]
    if source.endswith(".toml"):
        assert (ROOT / source).is_file() or "/" not in source, f"{page}: {line}"
    elif not source.endswith((".h5", ".csv")):
        kind, subfolder = known.get(words[0], ("geometry", ""))
        names = [Path(name).name for name in shipped_names(kind, subfolder)]
        shipped_map = kind == "geometry" and (ROOT / "maps" / f"{source}.h5").is_file()
        assert source in names or shipped_map, f"{page}: {line}"


def test_every_command_is_on_its_page():
    text = (ROOT / "docs" / "commands.md").read_text()
    assert [name for name in PROGRAM.commands if f"`fieldmap {name}" not in text] == []
