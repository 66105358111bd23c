"""The pages of the repository, and the blocks of code in them."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    path for folder in (".", "docs", "geometry", "maps", "thesis") for path in (ROOT / folder).glob("*.md")
)
PAGES += sorted((ROOT / "docs").glob("*/*.md"))


def named(path: Path) -> str:
    """Path of a file relative to the repository."""
    return str(path.relative_to(ROOT))


def blocks(page: Path | str, language: str = "python", below: str = "") -> list[str]:
    """Code blocks of a page in a language, after a heading if given; a page of docs/ by its name."""
    text = (ROOT / "docs" / page).read_text()
    return re.findall(rf"^```(?:{language})\n(.*?)^```$", text[text.index(below) :], re.DOTALL | re.MULTILINE)
