"""Make Jupyter notebooks from the pages of docs/notebooks: cells of text, of code, and the output of the code.

    python scripts/dev/notebooks.py

The pages are the source: the tests run them. Pictures stay links to docs/images.
"""

import json
import re
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
BLOCK = re.compile(
    r"^<!-- runs -->\n+```python\n(?P<code>.*?)^```\n(?:<!-- prints -->\n+```text\n(?P<prints>.*?)^```\n)?",
    re.DOTALL | re.MULTILINE,
)
LANGUAGE = {"name": "python", "file_extension": ".py", "mimetype": "text/x-python"}


def notebook(page: str) -> str:
    """The notebook (nbformat 4.5) of a page, as text."""
    cells: list[dict[str, Any]] = []
    end = 0
    for block in BLOCK.finditer(page):
        cells += _text(page[end : block.start()], len(cells))
        output = [{"output_type": "stream", "name": "stdout", "text": _lines(block["prints"])}]
        cells.append(
            {
                "cell_type": "code",
                "id": f"cell-{len(cells)}",
                "metadata": {},
                "execution_count": None,
                "outputs": output if block["prints"] else [],
                "source": _lines(block["code"].rstrip("\n")),
            }
        )
        end = block.end()
    cells += _text(page[end:], len(cells))
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    about = {"kernelspec": kernel, "language_info": LANGUAGE}
    whole = {"cells": cells, "metadata": about, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _text(text: str, number: int) -> list[dict[str, Any]]:
    stripped = text.strip()
    cell = {"cell_type": "markdown", "id": f"cell-{number}", "metadata": {}, "source": _lines(stripped)}
    return [cell] if stripped else []


def _lines(text: str | None) -> list[str]:
    return (text or "").splitlines(keepends=True)


def main() -> None:
    """Write every notebook beside its page."""
    for page in sorted(FOLDER.glob("*.md")):
        path = page.with_suffix(".ipynb")
        path.write_text(notebook(page.read_text(encoding="utf-8")), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
