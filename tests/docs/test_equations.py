"""Every equation that code, tests or pages cite by its number is on its page, each number once, without a gap."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
THEORY = {path.name: path for path in (ROOT / "docs" / "theory").glob("*.md")}
BLOCK = re.compile(r"^```text\n(.*?)^```", re.DOTALL | re.MULTILINE)
NUMBERS = r"\(\d+\)(?:(?:, | and |\.\.|-| to )\(\d+\))*"
# "docs/theory/iron.md (3), (5)", "[theory](theory/dynamics.md#..), (31)..(36)" and "(3)-(5) of docs/theory/iron.md".
AFTER = re.compile(rf"theory/([a-z_]+\.md)(?:#[\w-]+)?\)?[,:]? ({NUMBERS})")
BEFORE = re.compile(rf"({NUMBERS}) of (?:docs/)?theory/([a-z_]+\.md)")
FILES = [
    path for folder in ("fieldmap", "tests", "scripts") for path in sorted((ROOT / folder).rglob("*.py"))
]
FILES += sorted((ROOT / "docs").rglob("*.md"))


def numbered(page: Path) -> list[int]:
    """Numbers at the ends of equations, two spaces or more from them."""
    lines = [line for block in BLOCK.findall(page.read_text()) for line in block.splitlines()]
    return [int(number) for line in lines for number in re.findall(r"  \((\d+)\)(?=  |$)", line.rstrip())]


def cited(words: str) -> list[int]:
    """All numbers of "(3), (5)..(7)"."""
    found: list[int] = []
    for before, number in re.findall(r"(\.\.|-| to )?\((\d+)\)", words):
        found += range(found[-1] + 1, int(number)) if before else []
        found.append(int(number))
    return found


def citations() -> list[tuple[Path, str, list[int]]]:
    """File, page, and the numbers of it that the file cites."""
    found = []
    for path in FILES:
        text = re.sub(r"\s+", " ", path.read_text())
        found += [(path, page, cited(words)) for page, words in AFTER.findall(text)]
        found += [(path, page, cited(words)) for words, page in BEFORE.findall(text)]
    return found


@pytest.mark.parametrize("name", sorted(THEORY))
def test_every_number_is_there_once(name):
    numbers = sorted(numbered(THEORY[name]))
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_equation_that_is_cited_is_there():
    there = {name: set(numbered(path)) for name, path in THEORY.items()}
    all_of_them = citations()
    assert len(all_of_them) > 50
    missing = [
        f"{path.relative_to(ROOT)}: {page} ({number})"
        for path, page, numbers in all_of_them
        for number in numbers
        if number not in there.get(page, set())
    ]
    assert missing == []


def test_ranges_are_read():
    assert cited("(3), (5)..(7)") == [3, 5, 6, 7]
