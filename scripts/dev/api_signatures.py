"""Write signatures into docs/api, as a comment above each entry, for readers of the pages in a checkout. The site does
not show these comments, because mkdocstrings writes the signatures there.

    python scripts/dev/api_signatures.py

Names and defaults only; units and types are in the docstrings. A test checks that the pages are up to date.
"""

import inspect
import re
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "docs" / "api"
_WIDTH = 116
_ENTRY = re.compile(r"^(?:<!-- signatures\n(?:.*\n)*?-->\n\n)?::: (?P<name>[\w.]+)$", re.MULTILINE)


def with_signatures(page: str) -> str:
    """The text of a page with a comment above every entry that has signatures."""

    def commented(entry: re.Match[str]) -> str:
        lines = list(signatures(entry["name"]))
        comment = "\n".join(["<!-- signatures", *lines, "-->\n\n"]) if lines else ""
        return f"{comment}::: {entry['name']}"

    return _ENTRY.sub(commented, page)


def signatures(name: str) -> Iterator[str]:
    """Signatures of a function, or of a class and its own public methods; none for anything else."""
    found, short = _named(name), name.rpartition(".")[2]
    if inspect.isclass(found):
        if not issubclass(found, BaseException) and not getattr(found, "_is_protocol", False):
            yield from _lines(short, found)
        for method, value in vars(found).items():
            function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            if inspect.isfunction(function) and not method.startswith("_"):
                yield from _lines(f"  .{method}", function, drop=not isinstance(value, staticmethod))
    elif callable(found):
        yield from _lines(short, found)


def _named(name: str) -> Any:
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: Any = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


def _lines(name: str, function: Callable[..., Any], drop: bool = False) -> Iterator[str]:
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    given = list(signature.parameters.values())[int(drop) :]
    plain = [one.replace(annotation=inspect.Parameter.empty, default=_default(one.default)) for one in given]
    text = str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))
    # "-->" would end the comment.
    words = f"{name}{text}".replace("-->", "->").split(", ")
    line = words[0]
    for word in words[1:]:
        if len(line) + len(word) + 2 > _WIDTH:
            yield f"{line},"
            line = f"      {word}"
        else:
            line = f"{line}, {word}"
    yield line


class _Words:
    """A default that is shown as a word, because the text of an object may be long or contain its address."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _default(value: Any) -> Any:
    if value is inspect.Parameter.empty or value is None or isinstance(value, bool | int | float | str):
        return value
    text = repr(value)
    short = len(text) <= 40 and " at 0x" not in text and not text.startswith("<")
    return _Words(text if short else "...")


def main() -> None:
    """Write every page again."""
    for path in sorted(FOLDER.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if (new := with_signatures(text)) != text:
            path.write_text(new, encoding="utf-8")
            print(path.name)


if __name__ == "__main__":
    main()
