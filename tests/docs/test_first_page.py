"""The introductory sentences agree everywhere, and the numbers of README.md equal those of their pages."""

import re
import tomllib
from pathlib import Path

import pytest

import fieldmap
from fieldmap.cli.application import application

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
VALIDATION = "".join(page.read_text() for page in sorted((ROOT / "docs").glob("validation*.md")))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
HEADLINES = {
    "README.md": README,
    "docs/index.md": (ROOT / "docs" / "index.md").read_text(),
    "mkdocs.yml": (ROOT / "mkdocs.yml").read_text(),
    "pyproject.toml": PROJECT["description"],
    "fieldmap": fieldmap.__doc__ or "",
    "fieldmap --help": application().help or "",
}


@pytest.mark.parametrize("place", HEADLINES)
def test_what_is_meshed_is_said_alike(place):
    """The iron has finite elements, so "no finite elements" would be false."""
    text = HEADLINES[place].lower()
    assert "only the iron is meshed, never the air" in text
    assert not re.search(r"\b(?:no|without) finite elements?\b", text)


def test_the_licence_is_the_one_that_is_named():
    licence = (ROOT / "LICENSE").read_text()
    assert licence.startswith("BSD 3-Clause")
    assert PROJECT["license"] == "BSD-3-Clause"
    assert "BSD 3-Clause" in HEADLINES["README.md"]
    assert "BSD 3-Clause" in HEADLINES["docs/index.md"]


def largest(case: str, quantity: str) -> float:
    """Largest size of a quantity in the rows of docs/validation*.md whose case matches."""
    rows = re.findall(r"^\| (.*?) \| (.*?) \| ([-\d.e+]+) \|", VALIDATION, re.MULTILINE)
    found = [abs(float(value)) for name, what, value in rows if re.match(case, name) and what == quantity]
    assert found
    return max(found)


def figure(pattern: str) -> list[float]:
    """The numbers of README.md that match a pattern; the match must be unique."""
    found = re.findall(pattern, README)
    assert len(found) == 1, pattern
    return [float(number) for number in found[0]]


def test_accuracy_is_that_of_the_validation_page():
    percent = figure(r"B within ([\d.]+) % and its gradient within ([\d.]+) % of independent axisymmetric")
    disks = r"disk(?:, core)?(?:, plate)?, (?:mu_r|iron)"
    found = [100 * largest(disks, "error of B"), 100 * largest(disks, "error of gradient")]
    assert percent == pytest.approx(found, rel=1e-9)
    unit = figure(
        r"B is within ([\d.]+) % and its gradient within ([\d.]+) % of reference values from two finite-element"
    )
    case = "unit, coil 5, refinement 1$"
    found = [100 * largest(case, f"error of {what}, signed") for what in ("B", "gradient")]
    assert unit == pytest.approx(found, rel=1e-9)


def test_the_time_of_a_lookup_is_that_of_its_page():
    batch, one = figure(
        r"B and its gradient in (\d+) ns a point for a batch.*? in ([\d.]+) µs for a single point"
    )
    (error,) = re.findall(r"B within ([\d.e-]+) of its largest component", README)
    page = (ROOT / "docs" / "lookup.md").read_text()
    assert f"takes {batch:.0f} ns a point for B and gradient of a batch" in page
    assert f"{one:g} µs for a single point from Python" in page
    (row,) = re.findall(r"^\| `harmonic` \| [\d ]+;.*$", page, re.MULTILINE)
    assert float(error) == float(row.strip("|").split("|")[5])


def test_the_main_job_is_that_of_its_output():
    """The first page shows some lines of the output on the page of recipes."""
    states, minutes = figure(r"from (\d+) solved states: ([\d.]+) minutes")
    assert (states, minutes) == tuple(figure(r"cost +(\d+) states in ([\d.]+) minutes"))
    whole = (ROOT / "docs" / "recipes.md").read_text()
    (shown,) = re.findall(r"^```text\n(maps/out/workspace.h5.*?)^```$", README, re.DOTALL | re.MULTILINE)
    lines = iter(whole.splitlines())
    assert [line for line in shown.splitlines() if line != "..." and line not in lines] == []


def test_numbers_of_the_thesis_are_those_of_the_validation_page():
    line = re.search(r"(\d+) of (\d+) sharp numbers agree; (\d+) misprints; (\d+) numbers in all", VALIDATION)
    assert line
    agree, sharp, misprints, total = line.groups()
    page = (ROOT / "docs" / "thesis.md").read_text()
    assert f"{total} numbers are compared" in page
    assert f"{agree} of {sharp} agree" in page
    assert f"{misprints} more are misprints" in page


def test_the_gallery_is_there_and_leads_somewhere():
    text = (ROOT / "docs" / "index.md").read_text()
    pictures = re.findall(r"\[!\[[^\]]*\]\(([^)]+)\)\]\(([^)#]+)", text)
    assert len(pictures) == 4
    assert [place for pair in pictures for place in pair if not (ROOT / "docs" / place).is_file()] == []


def test_the_first_picture_suits_light_and_dark_pages_and_leads_somewhere():
    picture = re.search(r'<a href="([^"]+)"><picture>(.*?)</picture></a>', README, re.DOTALL)
    assert picture
    page, *files = picture[1], *re.findall(r'src(?:set)?="([^"]+)"', picture[2])
    assert files == ["docs/images/desk_levitator_dark.png", "docs/images/desk_levitator.png"]
    assert [place for place in (page, *files) if not (ROOT / place).is_file()] == []


def test_the_first_page_is_short():
    assert len(README.encode()) <= 8192
