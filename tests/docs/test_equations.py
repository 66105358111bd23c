"""Every equation that code, tests or pages cite by number is on its page; numbers are unique and without gaps."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
THEORY = {path.name: path for path in (ROOT / "docs" / "theory").glob("*.md")}
BLOCK = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)
TAG = re.compile(r"\\tag\{(\w+)\}")
NUMBERS = r"\(\d+\)(?:(?:, | and |\.\.|-| to )\(\d+\))*"
# "docs/theory/iron.md (3), (5)", "[theory](theory/dynamics.md#..), (31)..(36)" and "(3)-(5) of docs/theory/iron.md".
AFTER = re.compile(rf"theory/([a-z_]+\.md)(?:#[\w-]+)?\)?[,:]? ({NUMBERS})")
BEFORE = re.compile(rf"({NUMBERS}) of (?:docs/)?theory/([a-z_]+\.md)")
FILES = [
    path for folder in ("fieldmap", "tests", "scripts") for path in sorted((ROOT / folder).rglob("*.py"))
]
FILES += sorted((ROOT / "docs").rglob("*.md"))


def numbered(page: Path) -> list[int]:
    """Numbers of the equations of a page; "5a" is the second half of 5."""
    tags = [tag for block in BLOCK.findall(page.read_text()) for tag in TAG.findall(block)]
    return [int(tag) for tag in tags if tag.isdigit()]


def cited(words: str) -> list[int]:
    """All numbers of "(3), (5)..(7)"."""
    found: list[int] = []
    for before, number in re.findall(r"(\.\.|-| to )?\((\d+)\)", words):
        found += range(found[-1] + 1, int(number)) if before else []
        found.append(int(number))
    return found


def citations() -> list[tuple[Path, str, list[int]]]:
    """File, theory page, and the cited numbers of that page."""
    found = []
    for path in FILES:
        text = path.read_text()
        # Most files cite nothing; collapsing their whitespace would take most of the time.
        if "theory/" not in text:
            continue
        text = re.sub(r"\s+", " ", text)
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


@pytest.mark.parametrize("name", sorted(THEORY))
def test_every_equation_that_a_page_cites_of_its_own_is_there(name):
    """Numbers before "of [another page]" belong to that page."""
    text = re.sub(
        r"^```(?!math).*?^```$|`[^`\n]*`", "", THEORY[name].read_text(), flags=re.DOTALL | re.MULTILINE
    )
    own = re.findall(r"(?<![\w.)])\((\d{1,2})\)(?! (?:of|in) \[)", text)
    assert {int(number) for number in own} <= set(numbered(THEORY[name]))


def test_ranges_are_read():
    assert cited("(3), (5)..(7)") == [3, 5, 6, 7]


PAGES = sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "api")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_formulas_are_whole(page):
    """Braces, delimiters and environments are closed, and no formula is left as ASCII art."""
    text = page.read_text()
    formulas = BLOCK.findall(text)
    code = re.compile(r"^```.*?^```$|^    .*$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
    prose = code.sub("", text)
    assert prose.count("$") % 2 == 0
    formulas += re.findall(r"\$([^$]+)\$", prose)
    for formula in formulas:
        plain = re.sub(r"\\[{}]", "", formula)
        assert plain.count("{") == plain.count("}"), formula
        assert len(re.findall(r"\\left(?![a-z])", formula)) == len(
            re.findall(r"\\right(?![a-z])", formula)
        ), formula
        begun = re.findall(r"\\begin\{(\w+\*?)\}", formula)
        assert sorted(begun) == sorted(re.findall(r"\\end\{(\w+\*?)\}", formula)), formula
        assert not re.search(r"[\u0370-\u03ff\u2070-\u209f\u00b2\u00b3\u2200-\u22ff]", formula), formula
    plain_blocks = re.findall(r"^```text\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert [b for b in plain_blocks if re.search(r"=.*  \(\d+\)$", b, re.MULTILINE)] == []
