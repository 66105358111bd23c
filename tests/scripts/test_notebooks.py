"""Notebooks are what the tested pages say."""

import ast
import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "notebooks").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_notebook_holds_the_code_and_the_output_of_its_page(page, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "dev"))
    from notebooks import notebook

    written = page.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert written == notebook(page.read_text(encoding="utf-8")), "run python scripts/dev/notebooks.py"
    sys.modules.pop("notebooks")
    cells = json.loads(written)["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    assert [ast.dump(ast.parse(cell)) for cell in code] == [ast.dump(ast.parse(block)) for block in blocks]
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert any(cell.get("outputs") for cell in cells)


def test_there_are_notebooks():
    assert len(PAGES) >= 3
