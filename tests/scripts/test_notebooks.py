"""Notebooks agree with the tested pages."""

import ast
import json

import pytest

from tests.docs.pages import ROOT, blocks

PAGES = sorted((ROOT / "docs" / "notebooks").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_notebook_holds_the_code_and_the_output_of_its_page(page, program):
    written = page.with_suffix(".ipynb").read_text(encoding="utf-8")
    notebook = program("notebooks", "dev").notebook
    assert written == notebook(page.read_text(encoding="utf-8")), "run python scripts/dev/notebooks.py"
    cells = json.loads(written)["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert [ast.dump(ast.parse(cell)) for cell in code] == [ast.dump(ast.parse(one)) for one in blocks(page)]
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert any(cell.get("outputs") for cell in cells)


def test_there_are_notebooks():
    assert len(PAGES) >= 3
