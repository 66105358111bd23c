"""Base of data objects and results: one line as text, a card in notebooks, plain Python; and a frozen dict that can be
pickled."""

import dataclasses
from collections.abc import Mapping
from html import escape
from typing import Any, ClassVar, NoReturn, TypeVar

import numpy as np

from fieldmap.plain import Plain, plain

LONGEST = 400
"""Largest number of characters in the text of an object."""
_LONGEST_VALUE = 80
_MOST_NUMBERS = 9

Key = TypeVar("Key")
Value = TypeVar("Value")


class FrozenDict(dict[Key, Value]):
    """A dict that does not change. Unlike `types.MappingProxyType` it can be pickled and copied.

    >>> FrozenDict(a=1)["a"]
    1
    """

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError(f"{type(self).__name__} does not change: make a new one")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = __ior__ = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)


class Record:
    """Base of frozen data classes that users see: `repr` in one line, an HTML card, `to_dict`.

    Declare the data class with `repr=False`.

    >>> @dataclasses.dataclass(frozen=True, repr=False)
    ... class Place(Record):
    ...     name: str
    ...     points: np.ndarray
    >>> Place("far", np.zeros((1000, 3)))
    Place(name='far', points=array (1000, 3))
    """

    # Tells type checkers that every subclass is a data class.
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    def __repr__(self) -> str:
        return one_line(self)

    def _repr_html_(self) -> str:
        return card(type(self).__name__, dict(_shown(self)))

    def to_dict(self) -> dict[str, Plain]:
        """The fields by their names, as plain Python, SI units."""
        names = [field.name for field in dataclasses.fields(self)]
        return {name: _plain_or_text(getattr(self, name)) for name in names}


def card(title: str, rows: Mapping[str, str], picture: str = "") -> str:
    """An HTML table for notebooks, with one line for each name and text, and a picture below."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(text)}</td></tr>"
        for name, text in rows.items()
    )
    return f"<table><caption><b>{escape(title)}</b></caption>{cells}</table>{picture}"


def one_line(record: object) -> str:
    """A data class in one line of at most `LONGEST` characters: names and values, large arrays by their shape."""
    values = ", ".join(f"{name}={text}" for name, text in _shown(record))
    return shortened(f"{type(record).__name__}({values})")


def count_of(number: int, singular: str, plural: str) -> str:
    """A number with its noun: "1 body", "2 bodies".

    >>> count_of(1, "body", "bodies"), count_of(0, "body", "bodies")
    ('1 body', '0 bodies')
    """
    return f"{number:,} {singular if number == 1 else plural}"


def tuple_line(named: Any) -> str:
    """A named tuple in one line, in the style of `one_line`.

    >>> from typing import NamedTuple
    >>> class Gains(NamedTuple):
    ...     K: np.ndarray
    ...     __repr__ = tuple_line
    >>> Gains(np.eye(20))
    Gains(K=array (20, 20))
    """
    values = ", ".join(f"{name}={short(value)}" for name, value in named._asdict().items())
    return shortened(f"{type(named).__name__}({values})")


def shortened(text: str, longest: int = LONGEST) -> str:
    """A text in one line, cut where it is too long."""
    line = " ".join(text.split())
    return line if len(line) <= longest else f"{line[: longest - 3]}..."


def _shown(record: object) -> list[tuple[str, str]]:
    """Names and short texts of the fields that differ from their defaults."""
    shown = []
    for field in dataclasses.fields(record):  # type: ignore[arg-type]
        value = getattr(record, field.name)
        if not field.repr or (field.default is not dataclasses.MISSING and value is field.default):
            continue
        shown.append((field.name, short(value)))
    return shown


def short(value: object) -> str:
    """A value in a few words.

    >>> short(np.zeros((4, 3))), short([1.5, 2.0]), short({"steel": 1})
    ('array (4, 3)', '[1.5, 2.0]', '{steel}')
    """
    if isinstance(value, np.ndarray):
        small = value.size <= _MOST_NUMBERS and value.dtype != object
        if not small:
            return f"array {value.shape}"
        return shortened(str((np.round(value, 9) if value.dtype.kind == "f" else value).tolist()))
    if isinstance(value, Mapping):
        return shortened("{" + ", ".join(map(str, value)) + "}", _LONGEST_VALUE)
    if isinstance(value, list | tuple):
        if all(isinstance(item, bool | int | float | str | None) for item in value):
            return shortened(repr(value), _LONGEST_VALUE)
        names = [getattr(item, "name", None) for item in value]
        if all(isinstance(name, str) for name in names):
            return shortened("[" + ", ".join(map(str, names)) + "]", _LONGEST_VALUE)
        return f"{len(value)} {type(value[0]).__name__}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        name = getattr(value, "name", None)
        return type(value).__name__ + (f"({name!r})" if isinstance(name, str) else "")
    return shortened(repr(value), _LONGEST_VALUE)


def _plain_or_text(value: object) -> Plain:
    try:
        own = getattr(value, "to_dict", None)
        if own is not None and not isinstance(value, type):
            return own()
        if isinstance(value, Mapping):
            return {str(key): _plain_or_text(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [_plain_or_text(item) for item in value]
        return plain(value)
    except TypeError:
        return short(value)
