"""Mutations, kinds of input, and their limits of time and memory."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Generator = np.random.Generator


@dataclass(frozen=True)
class Case:
    """One mutation, written and ready to be read.

    change: description of the mutation. read: reads it, as a program does. fault: describes errors in the result of
    `read`, "" for none. command: words of the command line that reads it, if there is one.
    """

    change: str
    read: Callable[[], Any]
    fault: Callable[[Any], str]
    command: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kind:
    """A kind of input.

    prepare(folder): makes all files once, reads the valid original and returns the maker of cases, make(rng, number).
    seconds: largest processor time of a mutation. megabytes: largest memory of a mutation beyond that of the original.
    through_command: the command line also reads every `through_command`-th case, 0 for never. names_files: whether such
    a file may name other files, which are then read. starts_processes: whether its reader uses a process of its own.
    """

    name: str
    prepare: Callable[[Path], Callable[[Generator, int], Case]]
    seconds: float = 2.0
    megabytes: float = 200.0
    through_command: int = 25
    names_files: bool = False
    starts_processes: bool = False


def no_fault(answer: Any) -> str:
    """`fault` of a kind without a result to compare."""
    return ""


def not_finite(value: Any, where: str = "", depth: int = 0) -> str:
    """Place of the first NaN or infinity in nested data classes, mappings, arrays and lists; "" if there is none."""
    if depth > 12 or isinstance(value, str | bytes | bool | Path) or value is None:
        return ""
    if isinstance(value, int | float | np.generic | np.ndarray):
        numbers = np.asarray(value)
        return "" if numbers.dtype.kind not in "fc" or np.isfinite(numbers).all() else where or "the value"
    if isinstance(value, dict):
        members = list(value.items())
    elif isinstance(value, list | tuple | set | frozenset):
        members = list(enumerate(value))
    else:
        fields = getattr(type(value), "model_fields", None) or getattr(value, "__dataclass_fields__", {})
        members = [(name, getattr(value, name)) for name in fields]
    for name, member in members:
        found = not_finite(member, f"{where}.{name}", depth + 1)
        if found:
            return found
    return ""
