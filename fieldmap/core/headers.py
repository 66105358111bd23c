"""The headers of the C core for other programs."""

import re
from pathlib import Path

FOLDER = Path(__file__).parent
"""Folder of the headers, for the option -I of a compiler."""
_INCLUDED = re.compile(r'^#include "(\w+\.h)"\n', re.MULTILINE)


def in_one(name: str, without: frozenset[str] = frozenset()) -> str:
    """Return the text of a header with the headers that it includes, each once, except those in `without`."""
    known = set(without)

    def with_included(header: str) -> str:
        known.add(header)
        text = (FOLDER / header).read_text(encoding="utf-8")
        return _INCLUDED.sub(lambda found: included(found[1], found[0]), text)

    def included(header: str, line: str) -> str:
        if header in without:
            return line
        return "" if header in known else with_included(header)

    return with_included(name)
