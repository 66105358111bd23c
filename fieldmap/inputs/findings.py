"""Errors found in the data of a file, before they get a file and a line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

from fieldmap.inputs.key_paths import Location
from fieldmap.records import Record

# Values of several places that one key names.
_MOST_STATED = 4


@dataclass(frozen=True, repr=False)
class Finding(Record):
    """An error at a location of the data; the other fields are those of `fieldmap.errors.Problem`."""

    location: Location
    must_hold: str
    received: str
    remedy: str

    def below(self, *steps: str | int) -> "Finding":
        """The finding for data that lie below these steps of a file."""
        return replace(self, location=(*steps, *self.location))


def shown(value: Any) -> str:
    """The offending value as the user wrote it, shortened."""
    if isinstance(value, dict):
        return "a table" if value else "an empty table"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def changed_in_words(file: str, changes: Mapping[str, Any], stated: Mapping[str, Sequence[Any]]) -> str:
    """The keys of a file that a caller has set, each with the values that the file states; empty without any.

    >>> changed_in_words("hold.toml", {"duration_s": 0.5, "sensor.delay_s": 0.01}, {"duration_s": [5.0]})
    'hold.toml with duration_s = 0.5 (5.0 in the file), sensor.delay_s = 0.01 (not in the file)'
    """
    words = []
    for key, value in changes.items():
        known = list(dict.fromkeys(shown(one) for one in stated.get(key, ())))
        several = [*known[:_MOST_STATED], *(["..."] if len(known) > _MOST_STATED else [])]
        words.append(f"{key} = {shown(value)} ({', '.join(several) or 'not'} in the file)")
    # On one line: it is one of a list of assumptions, and a comment of a recorded text.
    return " ".join(f"{file} with {', '.join(words)}".split()) if words else ""


def one_of(words: list[str]) -> str:
    """List of allowed words."""
    return ", ".join(f'"{word}"' for word in words)


def meant(word: Any, words: list[str], otherwise: str, quote: str = '"') -> str:
    """The remedy for an unknown word: the most similar known word, or the remedy `otherwise`."""
    guess = closest(word, words)
    return f"did you mean {quote}{guess}{quote}?" if guess else otherwise


def closest(word: Any, words: list[str]) -> str | None:
    """The known word most similar to a word, or None."""
    near = get_close_matches(str(word), words, n=1, cutoff=0.6)
    if near:
        return near[0]
    folded = {known.lower(): known for known in words}
    near = get_close_matches(str(word).lower(), list(folded), n=1, cutoff=0.6)
    return folded[near[0]] if near else None
