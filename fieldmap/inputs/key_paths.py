"""Key paths of a file: dotted paths for readers, made from locations in the data, and resolved to them."""

import re
from collections.abc import Iterator
from fnmatch import translate
from functools import lru_cache
from typing import Any

Step = str | int
Location = tuple[Step, ...]


def value_at(data: Any, location: Location) -> Any:
    """The value at a location, or None if the location does not exist."""
    for step in location:
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def has(data: Any, step: Step) -> bool:
    """Whether a table has the key, or an array the index."""
    if isinstance(data, dict):
        return step in data
    return isinstance(data, list) and isinstance(step, int) and step < len(data)


def dotted(data: Any, location: Location) -> str:
    """Readable path: entries of an array by their name if they have one, else counted from 1.

    >>> dotted({"body": [{"name": "disk", "radius_mm": 66}]}, ("body", 0, "radius_mm"))
    'body.disk.radius_mm'
    """
    return ".".join(_label(data, location, k) for k in range(len(location)))


def _label(data: Any, location: Location, k: int) -> str:
    step = location[k]
    if isinstance(step, str):
        return step
    name = value_at(data, (*location[: k + 1], "name"))
    return name if isinstance(name, str) and _alone(data, location[:k], name) else str(step + 1)


def _alone(data: Any, array: Location, name: str) -> bool:
    entries = value_at(data, array)
    return sum(isinstance(entry, dict) and entry.get("name") == name for entry in entries) == 1


def matches(data: Any, pattern: str) -> list[Location]:
    """All locations that a dotted path names.

    A step is a key, the name of an array's entry, an entry's number from 1 (if no entry has that name), * for any, a
    pattern with * and ?, such as "core *", for all keys or names that match it, or several patterns separated by |.

    >>> matches({"body": [{"name": "core 1", "a": 1}, {"name": "core 2", "b": 2}]}, "body.core *.a|b")
    [('body', 0, 'a'), ('body', 1, 'b')]
    """
    found: list[tuple[Location, Any]] = [((), data)]
    for step in pattern.split("."):
        found = [
            ((*location, key), value_at(here, (key,)))
            for location, here in found
            for key in _keys(here, step)
        ]
    return [location for location, _ in found]


def _keys(here: Any, step: str) -> list[Step]:
    if step != "*" and (like := _pattern(step)):
        return [key for key in _keys(here, "*") if _is_like(here, key, like)]
    if isinstance(here, dict):
        return list(here) if step == "*" else [step] if step in here else []
    if not isinstance(here, list):
        return []
    if step == "*":
        return list(range(len(here)))
    named = [k for k, entry in enumerate(here) if isinstance(entry, dict) and entry.get("name") == step]
    if named or not step.isdigit():
        return list(named)
    return [int(step) - 1] if 1 <= int(step) <= len(here) else []


@lru_cache(maxsize=1000)
def _pattern(step: str) -> re.Pattern[str] | None:
    """The pattern of a step; None for a step without wildcards. Cached, since many tables are matched with a step."""
    if not any(character in step for character in "*?|"):
        return None
    return re.compile("|".join(translate(one) for one in step.split("|")))


def _is_like(here: Any, key: Step, like: re.Pattern[str]) -> bool:
    if isinstance(key, str):
        return like.match(key) is not None
    name = value_at(here, (key, "name"))
    return like.match(str(key + 1)) is not None or (isinstance(name, str) and like.match(name) is not None)


def tables(data: Any, key: str) -> Iterator[tuple[Location, dict[str, Any]]]:
    """The entries of an array of tables; entries that are no tables are skipped."""
    entries = data.get(key)
    if isinstance(entries, list):
        for k, entry in enumerate(entries):
            if isinstance(entry, dict):
                yield (key, k), entry
