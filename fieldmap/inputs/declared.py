"""Records that people write, declared once: what a file says of a field stands beside the field.

A field of a frozen class is annotated with a `Key`: the rule for its value in the unit of the file, its meaning, and
the unit. From these follow the table that reads files (`table_of`), the object that the table makes (`record_of`), and
the key that an attribute is written as (`Table.declared`).

>>> from dataclasses import dataclass
>>> from typing import ClassVar
>>> from fieldmap.inputs.tables import Length
>>> @dataclass(frozen=True)
... class Ball:
...     '''Ball, centred at the origin.'''
...     kind: ClassVar[str] = "ball"
...     radius: Annotated[Length, Key(..., "radius", "mm")]
>>> table = table_of(Ball, "shape")
>>> record_of(table.model_validate({"shape": "ball", "radius_mm": 20.0}))
Ball(radius=0.02)
"""

import dataclasses
import types
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Tag, ValidationInfo, create_model, field_validator, model_validator

from fieldmap.errors import InputError, Problem
from fieldmap.inputs.document import schema_findings
from fieldmap.inputs.tables import UNITS, Table, chosen_by, read_only
from fieldmap.records import Record

# Of members that are not known before the program runs.
_ANNOTATED: Any = Annotated
_LITERAL: Any = Literal
_UNION: Any = Union


@dataclasses.dataclass(frozen=True, repr=False)
class Key(Record):
    """How a field of a record is written in files.

    rule: annotation of the value in the unit of the file, with its bounds; `...` where that is the type of the field.
    text: what the value is. unit: the last part
    of the key, one of `UNITS`. name: of the key, where it is not that of the field. check: raises `broken` for a value
    that does not go with the keys before it. make: what becomes of the value before its unit is applied. written: the
    default in files, where it is not that of the field. examples: for the pages of keys.
    """

    rule: Any
    text: str
    unit: str = ""
    name: str = ""
    check: Callable[[Any, ValidationInfo], None] | None = None
    make: Callable[[Any], Any] | None = None
    written: Any = None
    examples: tuple[Any, ...] = ()


@cache
def keys_of(record: type) -> dict[str, tuple[str, Key, Any]]:
    """Of each field with a `Key`: the key in files -> (name of the field, its `Key`, the type of the field)."""
    found = {}
    hints = get_type_hints(record, include_extras=True)
    for field in dataclasses.fields(record):
        hint = hints[field.name]
        about = next((one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Key)), None)
        if about is not None:
            name, kind = about.name or field.name, get_args(hint)[0]
            if about.rule is ...:
                # Annotations of annotations are one: the bounds of the type stand beside the key.
                bounds = [one for one in hint.__metadata__ if one is not about]
                about = dataclasses.replace(about, rule=_ANNOTATED[kind, *bounds] if bounds else kind)
            found[f"{name}_{about.unit}" if about.unit else name] = (field.name, about, kind)
    return found


def first_line(record: type) -> str:
    """The first sentence of a class's description."""
    return (record.__doc__ or "").split("\n", 1)[0]


def table_of(
    record: type,
    choose: str = "",
    name: str = "",
    bases: tuple[type[Table], ...] = (Table,),
    without: tuple[str, ...] = (),
    rules: tuple[Callable[[Any], None], ...] = (),
) -> Any:
    """The table of a file that makes a record. choose: the key whose value, `record.kind`, chooses it among others;
    name: of the table's class; bases: tables whose keys it has as well; without: fields that the file does not state;
    rules: raise `broken` for tables whose keys do not go together.

    Keys with a check come behind the others, which the check may look at.
    """
    text = first_line(record)
    fields: dict[str, Any] = {}
    if choose:
        fields[choose] = (_LITERAL[record.kind], Field(description=text.removesuffix(".")))  # type: ignore[attr-defined]
    keys = {key: found for key, found in keys_of(record).items() if found[0] not in without}
    stated = {field.name: field for field in dataclasses.fields(record)}
    checks: dict[str, Any] = {}
    for key, (attribute, about, _) in sorted(keys.items(), key=lambda each: each[1][1].check is not None):
        options: dict[str, Any] = {"description": about.text}
        if about.examples:
            options["examples"] = list(about.examples)
        default = _default_of(stated[attribute])
        if about.written is not None or _stands_for_none(default):
            options["default"] = about.written
        elif isinstance(default, Record):
            options["default"] = about.rule()
        elif default is not dataclasses.MISSING:
            options |= {"default": _in_file(default, about.unit), "validate_default": about.check is not None}
        fields[key] = (about.rule, Field(**options))
        if about.check is not None:
            checks[f"_check_{key}"] = field_validator(key)(_checked(about.check))
    if rules:
        checks["_keep_rules"] = _keeping(rules)
    made = create_model(
        name or f"{record.__name__}Keys",
        __base__=bases,
        __doc__=text,
        __module__=record.__module__,
        __validators__=checks,
        **fields,
    )
    made.makes = record
    made.declared = {
        key: (attribute, UNITS.get(about.unit, 1.0)) for key, (attribute, about, _) in keys.items()
    }
    return made


def _checked(check: Callable[[Any, ValidationInfo], None]) -> Any:
    def checked(cls: type, value: Any, info: ValidationInfo) -> Any:
        check(value, info)
        return value

    return classmethod(checked)


def _keeping(rules: tuple[Callable[[Any], None], ...]) -> Any:
    def keep(table: Any) -> Any:
        for rule in rules:
            rule(table)
        return table

    return model_validator(mode="after")(keep)


def _default_of(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _stands_for_none(default: Any) -> bool:
    """Whether a default cannot be written: an empty text, or a bound at infinity."""
    return default == "" if isinstance(default, str) else isinstance(default, float) and np.isinf(default)


def _in_file(default: Any, unit: str) -> Any:
    """A default in the unit of the file; what is no number stays as it is."""
    if isinstance(default, tuple | np.ndarray):
        return [_in_file(one, unit) for one in default]
    default = default.item() if isinstance(default, np.generic) else default
    scale = UNITS.get(unit, 1.0)
    return default / scale if isinstance(default, float) and scale != 1.0 else default


def check_fields(record: Any) -> None:
    """The rules of its keys, of a record made in Python. Raises InputError with every field that breaks one."""
    kind, table = type(record), _plain_table(type(record))
    keys = keys_of(kind)
    data = {key: _in_file(getattr(record, name), about.unit) for key, (name, about, _) in keys.items()}
    problems: dict[str, Problem] = {}
    for finding in schema_findings(table, data):
        name, about, _ = keys[str(finding.location[0])]
        entry = "".join(f"[{step}]" for step in finding.location[1:] if isinstance(step, int))
        # A bound is that of the file, in its unit.
        must_hold = (
            f"{finding.must_hold} {about.unit}" if finding.must_hold[-1].isdigit() else finding.must_hold
        )
        problem = Problem(
            f"{kind.__name__}({name}{entry})",
            must_hold.rstrip(),
            f"{getattr(record, name)}",
            f"give in SI units: {about.text}",
        )
        problems.setdefault(problem.where, problem)
    if problems:
        raise InputError(*problems.values())


@cache
def _plain_table(record: type) -> Any:
    return table_of(record)


def kinds_of(base: type) -> dict[str, type]:
    """The classes derived from a base that have a `kind` of their own, by kind."""
    waiting, found = [base], dict[str, type]()
    while waiting:
        derived = type.__subclasses__(waiting.pop())
        waiting += derived
        found |= {each.kind: each for each in derived if "kind" in vars(each)}  # type: ignore[attr-defined]
    return dict(sorted(found.items()))


def choice_of(tables: Iterable[Any], key: str) -> Any:
    """The annotation of a table that is one of several, chosen by the value of a key."""
    tagged = [Annotated[table, Tag(get_args(table.model_fields[key].annotation)[0])] for table in tables]
    return Annotated[_UNION[tuple(tagged)], chosen_by(key)]


def record_of(table: Table, folder: Path = Path(), **others: Any) -> Any:
    """The record of a table that `table_of` made, in SI. folder: that paths are relative to. others: fields of the
    record that its table does not have."""
    record = type(table).makes
    assert record is not None
    fields, stated = keys_of(record), {field.name: field for field in dataclasses.fields(record)}
    values = {}
    for key in type(table).declared:
        attribute, about, hint = fields[key]
        value = getattr(table, key)
        if value is None and _stands_for_none(_default_of(stated[attribute])):
            continue
        values[attribute] = _in_si(about.make(value) if about.make else value, about, hint, folder)
    more = {name: value for name, value in table.also_makes().items() if name in stated}
    return record(**(values | more | others))


def _in_si(value: Any, about: Key, hint: Any, folder: Path) -> Any:
    scale = UNITS.get(about.unit, 1.0)
    kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    if value is None:
        return None
    if isinstance(value, Table):
        return record_of(value, folder)
    if Path in kinds:
        return (folder / value).resolve()
    if isinstance(value, list | np.ndarray):
        if any(get_origin(kind) is tuple for kind in kinds) or any(isinstance(one, str) for one in value):
            return tuple(_in_si(one, about, None, folder) for one in value)
        if np.dtype(np.int64) in map(_number, kinds):
            return np.array(value, dtype=np.int64)
        return read_only(value, scale)
    return value * scale if isinstance(value, float) else value


def _number(hint: Any) -> Any:
    """The type of the numbers of an array's annotation."""
    if get_origin(hint) is get_origin(NDArray[Any]):
        return np.dtype(get_args(get_args(hint)[1])[0])
    return None
