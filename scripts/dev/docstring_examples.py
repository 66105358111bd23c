"""Extension of the API reference: lines of a docstring that begin with >>> become code blocks.

The docstrings are plain prose with doctest examples at their end; Markdown alone would read ">>>" as a quotation.
Doctest flags are left out. Loaded by mkdocs.yml.
"""

import re
from typing import Any

import griffe

_FENCE = "```pycon"
_FLAG = re.compile(r"\s*# doctest:.*$")


class DocstringExamples(griffe.Extension):
    """Fences the doctest examples of every object that is loaded."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for each object of the package."""
        if obj.docstring is not None:
            obj.docstring.value = fenced(obj.docstring.value)


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
