"""Base of the data classes that users make machines of: wrong arguments are told like wrong keys of a file."""

import dataclasses
import inspect
import re
from abc import ABCMeta
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.inputs.explain import REQUIRED
from fieldmap.inputs.findings import closest
from fieldmap.records import Record
from fieldmap.typing import Array

_ARRAYS = (Array, Array | None)


class _TellsWrongArguments(ABCMeta):
    """Calls of a data class with arguments that it does not have, or without those that it needs: InputError."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        try:
            made = super().__call__(*arguments, **named)
            _take_arrays(made)
            return made
        except TypeError as error:
            problems = _problems(cls, arguments, named) if dataclasses.is_dataclass(cls) else []
            if not problems:
                raise
            raise InputError(*problems) from error

    @property
    def __signature__(cls) -> inspect.Signature:
        """What `help` and editors show: the arguments of the data class, not of the check in front of it."""
        whole = inspect.signature(cls.__init__)  # type: ignore[misc]
        # Plain types: what a file says of a field is no business of callers.
        types = get_type_hints(cls, include_extras=True)
        own = [
            one.replace(annotation=_in_short(get_args(types[name])[0]))
            if get_origin(types.get(name)) is Annotated
            else one
            for name, one in list(whole.parameters.items())[1:]
        ]
        return whole.replace(parameters=own, return_annotation=inspect.Signature.empty)


def _in_short(kind: Any) -> str:
    """A type as people write it: classes of this package without their modules."""
    return re.sub(r"fieldmap\.[\w.]*\.", "", inspect.formatannotation(kind))


def _take_arrays(made: Any) -> None:
    """Lists and tuples in the place of arrays become arrays that nobody changes, where they are numbers."""
    for name in _arrays_of(type(made)):  # type: ignore[arg-type]
        value = getattr(made, name)
        if not isinstance(value, list | tuple):
            continue
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            continue  # told when a device is made of it
        array.setflags(write=False)
        object.__setattr__(made, name, array)


@cache
def _arrays_of(cls: type[Any]) -> tuple[str, ...]:
    hints = get_type_hints(cls)
    return tuple(field.name for field in dataclasses.fields(cls) if hints[field.name] in _ARRAYS)


def _problems(cls: type, arguments: tuple[Any, ...], named: dict[str, Any]) -> list[Problem]:
    fields = [field for field in dataclasses.fields(cls) if field.init]
    names = [field.name for field in fields]
    found = []
    for name in named:
        if name not in names:
            guess = closest(name, names)
            must_hold, remedy = f"known keys here are {', '.join(names)}", f"did you mean {guess}?"
            received = f'the unknown key "{name}"'
            found.append(
                Problem(f"{cls.__name__}.{name}", must_hold, received, remedy if guess else "remove it")
            )
    if len(arguments) > len(names):
        must_hold = f"takes {len(names)} values: {', '.join(names)}"
        found.append(Problem(cls.__name__, must_hold, f"{len(arguments)} values", "remove what is too much"))
    for field in fields[len(arguments) :]:
        given = field.name in named
        optional = (field.default, field.default_factory) != (dataclasses.MISSING, dataclasses.MISSING)
        if not given and not optional:
            place = f"{cls.__name__}.{field.name}"
            found.append(Problem(place, REQUIRED, "nothing", f"add {field.name}"))
    return found


class Made(Record, metaclass=_TellsWrongArguments):
    """A part of a machine, or the machine.

    >>> @dataclasses.dataclass(frozen=True, repr=False)
    ... class Ball(Made):
    ...     radius: float
    >>> Ball(raduis=0.01)
    Traceback (most recent call last):
    fieldmap.errors.InputError: Ball.raduis: known keys here are radius; received the unknown key "raduis"; ...
    """
