"""Functions in the reference describe each of their arguments in a section Parameters."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

griffe = pytest.importorskip("griffe")

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "api").glob("*.md"))


@pytest.fixture(scope="module")
def package():
    return griffe.load("fieldmap", search_paths=[ROOT], docstring_parser="numpy", resolve_aliases=True)


def entries(page):
    """Names after ":::"."""
    return re.findall(r"^::: fieldmap\.([\w.]+)", page.read_text(encoding="utf-8"), re.MULTILINE)


def target(found):
    return found.final_target if found.is_alias else found


def functions(found) -> Iterator:
    """The public functions that an entry shows: the function itself, or those of a module or class."""
    if found.is_function:
        yield found
    elif found.is_class or found.is_module:
        for name, member in found.members.items():
            imported = found.is_module and member.is_alias
            if not name.startswith("_") and not imported:
                yield from functions(target(member))


def described(function) -> set[str]:
    """Arguments in the section Parameters of a function, and of the base-class methods that it overrides."""
    names = set()
    if function.docstring is not None:
        for section in function.docstring.parse("numpy", warnings=False):
            if section.kind is griffe.DocstringSectionKind.parameters:
                names |= {name.strip("* ") for one in section.value for name in one.name.split(",")}
    if function.parent.is_class:
        for base in function.parent.mro():
            overridden = base.members.get(function.name)
            if overridden is not None and target(overridden).is_function:
                names |= described(target(overridden))
    return names


def lacking(function) -> list[str]:
    arguments = {parameter.name.strip("*") for parameter in function.parameters}
    return sorted(arguments - {"self", "cls"} - described(function))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_argument_is_described(package, page):
    shown = [one for entry in entries(page) for one in functions(target(package[entry]))]
    documented = [one for one in shown if one.docstring is not None]
    assert {one.path: lacking(one) for one in documented if lacking(one)} == {}


def test_an_argument_without_a_word_is_found():
    text = 'def f(a, *b):\n    """Short.\n\n    Parameters\n    ----------\n    a\n        One.\n    """\n'
    with griffe.temporary_visited_module(text) as module:
        assert lacking(module["f"]) == ["b"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_have_a_section_of_their_own(package, page):
    """In a docstring with sections, an example without a heading would belong to the last section."""
    for entry in entries(page):
        for one in functions(target(package[entry])):
            text = "" if one.docstring is None else one.docstring.value
            if ">>>" in text and re.search(r"^(Parameters|Returns|Raises)\n-+$", text, re.MULTILINE):
                assert re.search(r"^Examples\n-+$", text, re.MULTILINE), one.path


def lines(found, members=None) -> int:
    """Lines of the docstrings that an entry shows, plus six for each heading."""
    count = 6 + (found.docstring.value.count("\n") + 1 if found.docstring else 0)
    for name, member in found.members.items() if found.is_class or found.is_module else ():
        imported = found.is_module and member.is_alias
        shown = not name.startswith("_") if members is None else name in members
        if shown and not imported and (target(member).docstring or target(member).is_function):
            count += lines(target(member))
    return count


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_are_ten_screens_or_less(page, package):
    """A screen of 900 pixels shows 40 to 54 such lines."""
    shown = re.findall(r"^::: fieldmap\.([\w.]+)\n((?:    .*\n)*)", page.read_text(), re.MULTILINE)
    assert shown
    total = 0
    for name, options in shown:
        listed = re.search(r"members: \[(.*?)\]", options)
        total += lines(target(package[name]), listed and re.split(r",\s*", listed[1]))
    assert total < 490
