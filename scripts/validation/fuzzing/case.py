"""What one mutation is, and what it may cost."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Generator = np.random.Generator


@dataclass(frozen=True)
class Case:
    """One mutation, written and ready to be read.

    change: what was done, in words. read: what a program does with it. fault: what is wrong with what `read` gave, ""
    for nothing. command: the same by the command line, where there is one.
    """

    change: str
    read: Callable[[], Any]
    fault: Callable[[Any], str]
    command: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kind:
    """A kind of input.

    prepare(folder): makes what is needed once, reads the sound original and returns the maker of cases,
    make(rng, number). seconds: processor time that no mutation may exceed. megabytes: memory that none may ask for,
    beyond what reading the original takes. through_command: every how many cases the command line is tried as well,
    0 for never. names_files: whether such a file may name others, which then are read. starts_processes: whether
    its reader tries it in a process of its own.
    """

    name: str
    prepare: Callable[[Path], Callable[[Generator, int], Case]]
    seconds: float = 2.0
    megabytes: float = 200.0
    through_command: int = 25
    names_files: bool = False
    starts_processes: bool = False


def no_fault(answer: Any) -> str:
    """For what has no answer to compare."""
    return ""


def not_finite(value: Any, where: str = "", depth: int = 0) -> str:
    """The place of the first number in a nest of data classes, mappings, arrays and lists that is NaN or infinite."""
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
