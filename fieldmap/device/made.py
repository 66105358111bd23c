"""Base class of the parts of a machine: wrong arguments are reported like wrong keys of a file."""

import dataclasses
import inspect
import os
import re
from abc import ABC
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self, get_args, get_origin, get_type_hints

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.inputs.declared import keys_of
from fieldmap.inputs.explain import REQUIRED
from fieldmap.inputs.findings import meant
from fieldmap.records import Record
from fieldmap.typing import Array
from fieldmap.usual_values import warn_if_unusual

_signature = cache(inspect.signature)


class _PlainSignature:
    """The signature that `help` and editors show, without the annotations for keys of files."""

    def __get__(self, _: object, cls: type) -> inspect.Signature:
        whole = _signature(cls.__init__)  # type: ignore[misc]
        types = get_type_hints(cls, include_extras=True)
        return inspect.Signature(
            [
                # Classes of this package without their modules.
                one.replace(
                    annotation=re.sub(
                        r"fieldmap\.[\w.]*\.", "", inspect.formatannotation(get_args(types[name])[0])
                    )
                )
                if get_origin(types.get(name)) is Annotated
                else one
                for name, one in list(whole.parameters.items())[1:]
            ]
        )


class Made(Record, ABC):
    """A part of a machine, or the machine.

    >>> @dataclasses.dataclass(frozen=True, repr=False)
    ... class Ball(Made):
    ...     radius: float
    >>> Ball(raduis=0.01)
    Traceback (most recent call last):
    fieldmap.errors.InputError: Ball.raduis: known keys here are radius; received the unknown key "raduis"; ...
    """

    __signature__ = _PlainSignature()

    def __new__(cls, *arguments: Any, **named: Any) -> Self:
        """Raises InputError for unknown and for missing arguments."""
        try:
            given = _signature(cls.__init__).bind(None, *arguments, **named).arguments
        except TypeError as error:
            problems = _problems(cls, arguments, named) if dataclasses.is_dataclass(cls) else []
            if problems:
                raise InputError(*problems) from error
        else:
            for declared in keys_of(cls).values() if dataclasses.is_dataclass(cls) else ():
                where = f"{cls.__name__}.{declared.attribute}"
                warn_if_unusual(where, given.get(declared.attribute), declared.about.unit)
        return super().__new__(cls)

    def __reduce_ex__(self, protocol: Any) -> Any:
        # Protocol 1 makes an object without a call of `__new__`, which requires arguments.
        return super().__reduce_ex__(1)

    def __post_init__(self) -> None:
        """Lists and tuples of numbers become read-only arrays, and texts become paths, in fields of these types."""
        for name in _fields_of_type(type(self), Path):
            value = getattr(self, name)
            if isinstance(value, str | os.PathLike):
                object.__setattr__(self, name, Path(value))
        for name in _fields_of_type(type(self), Array):
            value = getattr(self, name)
            if not isinstance(value, list | tuple):
                continue
            try:
                array = np.array(value, dtype=np.float64)
            except (TypeError, ValueError, OverflowError):
                continue  # reported when a device is made of it
            array.setflags(write=False)
            object.__setattr__(self, name, array)


@cache
def _fields_of_type(cls: type[Any], kind: Any) -> tuple[str, ...]:
    hints = get_type_hints(cls)
    return tuple(field.name for field in dataclasses.fields(cls) if hints[field.name] in (kind, kind | None))


def _problems(cls: type, arguments: tuple[Any, ...], named: dict[str, Any]) -> list[Problem]:
    fields = [field for field in dataclasses.fields(cls) if field.init]  # type: ignore[arg-type]
    names, found = [field.name for field in fields], []
    for name in named:
        if name not in names:
            must_hold, received = f"known keys here are {', '.join(names)}", f'the unknown key "{name}"'
            remedy = meant(name, names, "remove it", quote="")
            found.append(Problem(f"{cls.__name__}.{name}", must_hold, received, remedy))
    if len(arguments) > len(names):
        must_hold = f"takes {len(names)} values: {', '.join(names)}"
        found.append(Problem(cls.__name__, must_hold, f"{len(arguments)} values", "remove what is too much"))
    for field in fields[len(arguments) :]:
        optional = (field.default, field.default_factory) != (dataclasses.MISSING, dataclasses.MISSING)
        if field.name not in named and not optional:
            place = f"{cls.__name__}.{field.name}"
            found.append(Problem(place, REQUIRED, "nothing", f"add {field.name}"))
    return found
