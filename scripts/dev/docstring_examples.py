"""Extension of the API reference: doctest examples become code blocks, and annotated types are shown as plain types.

The docstrings are plain prose with doctest examples at their end; Markdown alone would read ">>>" as a quotation.
Doctest flags are left out. `Annotated[float, Key(...)]` is shown as the type alone; the pages of keys describe the key
of the field in files. Loaded by mkdocs.yml.
"""

import re
from contextlib import suppress
from typing import Any

import griffe

_FENCE = "```pycon"
_FLAG = re.compile(r"\s*# doctest:.*$")


class DocstringExamples(griffe.Extension):
    """Fences the doctest examples of every object that is loaded, and shows plain types of attributes."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for each object of the package."""
        if obj.docstring is not None:
            obj.docstring.value = fenced(obj.docstring.value)

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called before the fields of data classes become signatures, when aliases of types are known."""
        modules = [pkg]
        while modules:
            module = modules.pop()
            modules += module.modules.values()
            for field in (one for each in module.classes.values() for one in each.attributes.values()):
                if not field.is_alias:
                    field.annotation = plain_type(field.annotation, pkg)


def plain_type(annotation: Any, package: griffe.Module) -> Any:
    """The type in an `Annotated[...]` or in an alias of one; any other annotation unchanged."""
    meant = annotation
    if isinstance(annotation, griffe.ExprName | griffe.ExprAttribute):
        # Names outside the package, such as a library's class, stay.
        with suppress(KeyError, AttributeError, griffe.AliasResolutionError):
            meant = package[annotation.canonical_path.removeprefix(f"{package.name}.")].value  # type: ignore[union-attr]
    if isinstance(meant, griffe.ExprSubscript) and meant.canonical_path == "typing.Annotated":
        return next(iter(meant.slice.elements))  # type: ignore[union-attr]
    return annotation


def fenced(text: str) -> str:
    """The text with a fence around each run of lines from a ">>>" to the next empty line."""
    lines: list[str] = []
    inside = False
    for line in text.splitlines():
        if not inside and line.lstrip().startswith(">>>"):
            inside = True
            lines.append(_FENCE)
        elif inside and not line.strip():
            inside = False
            lines.append("```")
        lines.append(_FLAG.sub("", line) if inside else line)
    if inside:
        lines.append("```")
    return "\n".join(lines)
