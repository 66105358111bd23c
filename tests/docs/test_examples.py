"""Python blocks marked `<!-- runs -->` run, page by page in one go, and print what the block after them shows."""

import contextlib
import io
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    path for folder in (".", "docs", "geometry", "maps", "thesis") for path in (ROOT / folder).glob("*.md")
)
PAGES += sorted((ROOT / "docs").glob("*/*.md"))
MARKED = re.compile(
    r"<!-- runs -->\n```python\n(?P<code>.*?)^```\n(?:<!-- prints -->\n```text\n(?P<prints>.*?)^```\n)?",
    re.DOTALL | re.MULTILINE,
)
WITH_EXAMPLES = [path for path in PAGES if MARKED.search(path.read_text())]


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_front_door_has_examples():
    assert {"README.md", "docs/tour.md"} <= {named(path) for path in WITH_EXAMPLES}


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=named)
def test_examples(path: Path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in MARKED.finditer(path.read_text()):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block["code"], f"{named(path)}, example", "exec"), names)
        assert printed.getvalue() == (block["prints"] or "")


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_marker_belongs_to_a_block(page):
    """A marker with a slip in it would silently run nothing."""
    text = page.read_text()
    blocks = list(MARKED.finditer(text))
    assert len(re.findall(r"^<!-- runs -->$", text, re.MULTILINE)) == len(blocks)
    assert len(re.findall(r"^<!-- prints -->$", text, re.MULTILINE)) == sum(
        block["prints"] is not None for block in blocks
    )


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_python_blocks_are_python(path: Path):
    """Those that are too slow to run at least compile."""
    for code in re.findall(r"^```python\n(.*?)^```$", path.read_text(), re.DOTALL | re.MULTILINE):
        compile(code, named(path), "exec")


def test_examples_of_docstrings_become_blocks(monkeypatch):
    pytest.importorskip("griffe")
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    from docstring_examples import fenced

    text = "What.\n\n>>> f(1)  # doctest: +SKIP\n2\n\nMore."
    assert fenced(text) == "What.\n\n```pycon\n>>> f(1)\n2\n```\n\nMore."
    assert fenced("No example.") == "No example."
    sys.modules.pop("docstring_examples")
