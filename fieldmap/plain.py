"""Results as plain Python, for JSON, TOML and other programs.

Results of the package have `to_dict()`, with numbers in SI units unless the key names another unit.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np

Plain: TypeAlias = bool | int | float | str | list["Plain"] | dict[str, "Plain"] | None
"""Values that JSON can hold."""


class Result(Protocol):
    """Interface of every result."""

    def to_dict(self) -> dict[str, Plain]:
        """The result as plain Python."""


def plain(value: object) -> Plain:
    """A value made of mappings, sequences, numpy arrays, data classes, results and paths, as plain Python.

    A number that is not finite becomes None. Raises TypeError for anything else.

    >>> plain({"B": np.array([0.0, np.nan]), "file": Path("a.h5")})
    {'B': [0.0, None], 'file': 'a.h5'}
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain_fields(value)
    raise TypeError(f"plain: cannot turn {type(value).__name__} into plain Python")


def plain_items(**items: object) -> dict[str, Plain]:
    """The values by their names, as plain Python.

    >>> plain_items(position=np.zeros(3), currents=(1.5,))
    {'position': [0.0, 0.0, 0.0], 'currents': [1.5]}
    """
    return {name: plain(item) for name, item in items.items()}


def plain_fields(result: object) -> dict[str, Plain]:
    """The fields of a data class by their names, as plain Python.

    >>> from fieldmap.errors import Problem
    >>> plain_fields(Problem("x", "must be positive", "-1", "give a positive number"))["received"]
    '-1'
    """
    if not dataclasses.is_dataclass(result) or isinstance(result, type):
        raise TypeError(f"plain_fields: {type(result).__name__} is no data class")
    return {field.name: plain(getattr(result, field.name)) for field in dataclasses.fields(result)}
