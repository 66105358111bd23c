"""The headers of the C core for other programs."""

import re
from pathlib import Path

FOLDER = Path(__file__).parent
"""Where the headers lie, for a compiler's -I."""
_INCLUDED = re.compile(r'^#include "(\w+\.h)"\n', re.MULTILINE)


def in_one(name: str, without: frozenset[str] = frozenset()) -> str:
    """The text of a header with those that it includes in their places, each once, but for those in `without`."""
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
