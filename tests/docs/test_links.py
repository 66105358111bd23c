"""Links between pages resolve, and the site's navigation lists every page."""

import importlib
import re
from pathlib import Path
from types import ModuleType
from typing import get_origin

import pytest

from tests.docs.pages import PAGES, ROOT, named

SITE = [path for path in PAGES if path.is_relative_to(ROOT / "docs")]
FENCE = re.compile(r"^```.*?^```\n", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
NETWORK = ("http://", "https://")


def prose(path: Path) -> str:
    """A page without its blocks of code."""
    return FENCE.sub("", path.read_text())


def anchors(path: Path) -> set[str]:
    """Anchors of headings, on the site and on the usual repository hosts."""
    headings = re.findall(r"^#+ (.*)$", prose(path), re.MULTILINE)
    plain = (re.sub(r"[`*\[\]]|\(.*?\)", "", heading).strip().lower() for heading in headings)
    return {re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading)) for heading in plain}


def relative_links(path: Path) -> list[str]:
    return [link for link in LINK.findall(prose(path)) if not link.startswith(NETWORK)]


def test_the_pages_link_to_each_other():
    assert sum(len(relative_links(path)) for path in PAGES) > 40


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_relative_links_resolve(page):
    for link in relative_links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{named(page)}: {link}"
        assert target.is_relative_to(ROOT), f"{named(page)}: {link}"
        if anchor:
            assert anchor in anchors(target), f"{named(page)}: {link}"


def test_the_site_links_to_nothing_outside_itself():
    """Link targets of a page of docs/ must be part of the site."""
    for path in SITE:
        for link in relative_links(path):
            target = (path.parent / link.partition("#")[0]).resolve()
            assert target.is_relative_to(ROOT / "docs"), f"{named(path)}: {link}"


def test_the_navigation_lists_every_page_once():
    settings = (ROOT / "mkdocs.yml").read_text()
    navigation = settings[settings.index("\nnav:") : settings.index("\nvalidation:")]
    listed = re.findall(r": (\S+\.md)$", navigation, re.MULTILINE)
    assert sorted(listed) == sorted(str(path.relative_to(ROOT / "docs")) for path in SITE)


def test_every_page_is_found_by_its_title():
    """No two pages have the same title, nor two entries of the navigation."""
    settings = (ROOT / "mkdocs.yml").read_text()
    navigation = settings[settings.index("\nnav:") : settings.index("\nvalidation:")]
    entries = re.findall(r"- (.+): \S+\.md$", navigation, re.MULTILINE)
    titles = [re.findall(r"^# (.*)$", prose(path), re.MULTILINE) for path in SITE]
    assert [named(path) for path, found in zip(SITE, titles, strict=True) if len(found) != 1] == []
    for names in (entries, [found[0] for found in titles]):
        plain = [re.sub(r"\W+", " ", name).strip().lower() for name in names]
        assert sorted(name for name in set(plain) if plain.count(name) > 1) == []


def test_the_site_is_built_and_read_without_a_network():
    settings = (ROOT / "mkdocs.yml").read_text()
    assert "://" not in settings
    assert "font: false" in settings


def test_every_public_function_is_in_the_reference():
    import fieldmap

    pages = {path.stem: path.read_text() for path in (ROOT / "docs" / "api").glob("*.md")}
    page = pages["public"] + pages["public_use"]
    packages = {name for name in fieldmap.__all__ if isinstance(getattr(fieldmap, name), ModuleType)}
    everything = "\n".join(pages.values())
    assert [name for name in packages if f"::: fieldmap.{name}." not in everything] == []
    for name in fieldmap._PARTS:
        module = getattr(fieldmap, name).__module__
        assert re.search(rf"^::: {module}(\.{name})?$", everything, re.MULTILINE), name
    others = {*packages, *fieldmap._PARTS}
    functions = [name for name in fieldmap.__all__ if not name.startswith("_") and name not in others]
    assert [
        name for name in functions if not re.search(rf"^::: fieldmap\.\w+\.{name}$", page, re.MULTILINE)
    ] == []


def test_pages_that_the_code_names_exist():
    """Docstrings and messages point to docs/ and to other files of the repository."""
    named_files = set()
    for path in (ROOT / "fieldmap").rglob("*.py"):
        named_files |= set(re.findall(r"\bdocs/[\w/]+\.md\b", path.read_text()))
    assert len(named_files) > 3
    assert [name for name in sorted(named_files) if not (ROOT / name).is_file()] == []


@pytest.mark.parametrize("page", [*SITE, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=named)
def test_files_of_the_repository_that_pages_name_exist(page):
    """In `code`: a file or a folder. NAME, ROW and PART are placeholders."""
    places = re.findall(r"`((?:fieldmap|tests|scripts|geometry|maps)/[\w./]*)`", page.read_text())
    chosen = [
        place
        for place in places
        if not re.search("NAME|ROW|PART", place) and not place.startswith("maps/out")
    ]
    assert [place for place in chosen if not (ROOT / place).exists()] == []


@pytest.mark.parametrize("page", [*SITE, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=named)
def test_names_of_the_package_that_pages_give_exist(page):
    """In `code`: a module, or a name in it. NAME is a placeholder."""
    for name in re.findall(r"`(fieldmap(?:\.\w+)+)`", page.read_text()):
        if name.endswith((".NAME", ".h")):
            continue
        found: object = importlib.import_module("fieldmap")
        for part in name.split(".")[1:]:
            if not hasattr(found, part):
                importlib.import_module(f"{found.__name__}.{part}")
            found = getattr(found, part)


CITED = re.compile(r"docs/((?:theory/)?\w+\.md),?\s+(\(\d+\)(?:(?:,\s+|-|\s+and\s+|\s+to\s+)\(\d+\))*)")


def test_equations_that_docstrings_cite_exist():
    """Checks page and number; whether it is the right equation, only a reader can tell."""
    cited = {
        (page, number)
        for path in (ROOT / "fieldmap").rglob("*.py")
        for page, numbers in CITED.findall(path.read_text())
        for number in re.findall(r"\d+", numbers)
    }
    assert len(cited) > 60
    pages = {page: (ROOT / "docs" / page).read_text() for page, _ in cited}
    missing = [f"{page} ({number})" for page, number in cited if f"\\tag{{{number}}}" not in pages[page]]
    assert missing == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "theory").glob("*.md")), ids=named)
def test_equations_are_numbered_once(page):
    numbers = re.findall(r"\\tag\{(\w+)\}", page.read_text())
    assert numbers
    assert len(numbers) == len(set(numbers))


PACKAGES = [
    "control", "control.identification", "dynamics", "instruments", "interop", "interpolants", "io", "iron",
    "levitation", "lookup", "maps", "parallel", "planar", "sources", "store", "studies", "plot", "thesis",
]  # fmt: skip


@pytest.fixture(scope="module")
def reference():
    """All names listed on the pages of the reference."""
    pages = (ROOT / "docs" / "api").glob("*.md")
    return {name for page in pages for name in re.findall(r"^::: ([\w.]+)$", page.read_text(), re.MULTILINE)}


@pytest.mark.parametrize("package", PACKAGES)
def test_every_function_and_class_of_a_package_is_in_the_reference(package, reference):
    """Under the package, under the module that defines the name, or as part of that module."""

    def home(value):
        return getattr(value, "__module__", "")

    module = importlib.import_module(f"fieldmap.{package}")
    values = {name: getattr(module, name) for name in module.__all__}
    offered = [name for name, value in values.items() if callable(value) and get_origin(value) is None]
    assert len(offered) > 1
    missing = [
        name
        for name in offered
        if not {f"fieldmap.{package}.{name}", home(values[name]), f"{home(values[name])}.{name}"} & reference
    ]
    assert missing == []


def test_no_package_with_public_names_is_forgotten():
    import pkgutil

    import fieldmap

    names = [module.name for module in pkgutil.iter_modules(fieldmap.__path__)]
    public = [name for name in names if getattr(importlib.import_module(f"fieldmap.{name}"), "__all__", [])]
    assert set(public) - set(PACKAGES) <= {"device"}
