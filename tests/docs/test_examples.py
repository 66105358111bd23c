"""Blocks marked `<!-- runs -->` run in one go for each page, on files that the page writes (`<!-- file: NAME -->`). The
block after them shows all of the output (`prints`) or lines from it (`shows`)."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fieldmap.cli import main
from tests.docs.pages import PAGES, ROOT, blocks, named

MARKED = re.compile(
    r"^<!-- (?P<marker>runs|prints|shows|file: (?P<file>[\w.]+)) -->\n+```(?P<language>\w+)\n(?P<code>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
MARKER = re.compile(r"^<!-- (?:runs|prints|shows|file).*-->$", re.MULTILINE)
LANGUAGES = {
    "runs": {"python", "console"},
    "prints": {"text"},
    "shows": {"text"},
    "file": {"toml", "csv", "c"},
}
WITH_EXAMPLES = [path for path in PAGES if MARKED.search(path.read_text())]


def test_the_first_pages_have_examples():
    assert {"README.md", "docs/tour.md"} <= {named(path) for path in WITH_EXAMPLES}


def run_commands(block: str) -> None:
    """Run the lines of a console block, in this process where they are commands of fieldmap."""
    for line in re.findall(r"^\$ (.*)$", block, re.MULTILINE):
        words = shlex.split(line)
        if words[0] == "fieldmap":
            assert main(words[1:]) == 0, line
        else:  # the compiler, and the compiled program
            assert words[0] == "cc" or words[0].startswith("./"), line
            print(subprocess.run(words, check=True, capture_output=True, text=True).stdout, end="")


def shows(expected: str, printed: str) -> None:
    """Assert that these lines are among the printed lines, in this order."""
    lines = iter([line.rstrip() for line in printed.splitlines()])
    for line in expected.splitlines():
        if line.strip() not in ("", "..."):
            assert line.rstrip() in lines, f"{line}\n\n{printed}"


# The training of a map of saturating iron depends on the compiler of the core: the depth in this run changes by 0.3 %.
SHARES = {"circle.png": 1e-2, "circle_dark.png": 1e-2}


@pytest.fixture
def figures(monkeypatch, tmp_path):
    """Records of the figures saved meanwhile, by file name, in light and dark; dark files lie in `tmp_path`."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from fieldmap.plot.style import dark_path, in_the_dark
    from tests.docs.picture_record import figure_record

    seen: dict[str, dict[str, object]] = {}
    save = Figure.savefig

    def saved(figure, path, **options):
        save(figure, path, **options)
        seen[Path(path).name] = figure_record(figure)
        with in_the_dark(figure):
            # Not beside it: a figure that is written whole lies in a folder of its own meanwhile.
            dark = tmp_path / dark_path(path).name
            save(figure, dark, **options)
            seen[dark.name] = figure_record(figure)

    monkeypatch.setattr(Figure, "savefig", saved)
    with rc_context():  # pages choose the style of their figures
        yield seen


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=named)
def test_examples(path: Path, tmp_path, monkeypatch, figures, hold_picture):
    """A page from top to bottom in an empty folder; its pictures must equal the figures that it draws."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    unseen = printed = ""
    for block in MARKED.finditer(path.read_text()):
        if block["file"]:
            Path(block["file"]).write_text(block["code"])
        elif block["marker"] == "runs":
            assert unseen == ""
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                if block["language"] == "console":
                    run_commands(block["code"])
                else:
                    exec(compile(block["code"], f"{named(path)}, example", "exec"), names)
            printed = out.getvalue()
            # A page must show all output of Python; output of commands may be left out.
            unseen = printed if block["language"] == "python" else ""
        else:
            if block["marker"] == "shows":
                shows(block["code"], printed)
            else:
                assert printed == block["code"]
            unseen = ""
    assert unseen == ""
    shown = set(re.findall(r"!\[[^\]]*\]\([\w/.]*images/(\w+\.png)\)", path.read_text()))
    shown |= {name.replace(".png", "_dark.png") for name in shown}
    for name in sorted(shown & figures.keys()):
        hold_picture(name, named(path), "shows", figures[name], tmp_path / name, SHARES.get(name, 1e-3))


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_marker_belongs_to_a_block(page):
    """A misspelt marker would silently run nothing."""
    text = page.read_text()
    marked = list(MARKED.finditer(text))
    assert len(MARKER.findall(text)) == len(marked)
    assert all(block["language"] in LANGUAGES[block["marker"].split(":")[0]] for block in marked)


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_python_blocks_are_python(path: Path):
    """Blocks that are too slow to run must compile."""
    for code in blocks(path):
        compile(code, named(path), "exec")


def test_examples_of_docstrings_become_blocks_and_fields_show_their_types(monkeypatch):
    griffe = pytest.importorskip("griffe")
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "dev"))
    from docstring_examples import DocstringExamples, fenced

    text = "What.\n\n>>> f(1)  # doctest: +SKIP\n2\n\nMore."
    assert fenced(text) == "What.\n\n```pycon\n>>> f(1)\n2\n```\n\nMore."
    assert fenced("No example.") == "No example."
    start = "from dataclasses import dataclass\nfrom typing import Annotated\n"
    box = "from made.a import Width\n@dataclass\nclass Box:\n width: Width\n name: Annotated[str, 3]\n"
    code = {"a.py": f"{start}Width = Annotated[float, 3]\n", "b.py": start + box}
    with griffe.temporary_pypackage("made", code) as package:
        extensions = griffe.load_extensions(DocstringExamples())
        loaded = griffe.load("made", search_paths=[package.tmpdir], extensions=extensions)
    assert [str(one.annotation) for one in loaded["b.Box"].parameters][1:] == ["float", "str"]
    sys.modules.pop("docstring_examples")
