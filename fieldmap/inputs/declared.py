"""Records of input files, declared once.

Each field of a frozen class is annotated with a `Key`: the rule for its value in the unit of the file, its meaning, and
its unit. From these follow the table that reads files (`table_of`), the record that is made of a table (`record_of`),
and the data of a file that a record is written as (`fieldmap.inputs.writing`).

>>> from dataclasses import dataclass
>>> from typing import ClassVar
>>> from fieldmap.inputs.tables import Length
>>> @dataclass(frozen=True)
... class Ball:
...     '''Ball, centred at the origin.'''
...     kind: ClassVar[str] = "ball"
...     radius: Annotated[float, Key(Length, "radius", "mm")]
>>> table = table_of(Ball, "shape")
>>> record_of(table.model_validate({"shape": "ball", "radius_mm": 20.0}))
Ball(radius=0.02)
"""

import dataclasses
import types
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Tag, ValidationInfo, create_model, field_validator, model_validator

from fieldmap.errors import InputError, Problem
from fieldmap.inputs.document import schema_findings
from fieldmap.inputs.tables import UNITS, Table, chosen_with, read_only
from fieldmap.records import FrozenDict, Record

# Aliases of type Any: their members are known only when the program runs, which type checkers do not accept.
_ANNOTATED: Any = Annotated
_LITERAL: Any = Literal
_UNION: Any = Union


@dataclasses.dataclass(frozen=True, repr=False)
class Key(Record):
    """How a field of a record is written in files.

    Attributes
    ----------
    rule : annotation of the value in the unit of the file, with its bounds; `...` if it is the type of the field.
    text : meaning of the value.
    unit : last part of the key, one of `UNITS`.
    name : name of the key, if it is not the name of the field.
    check : function that raises `broken` for a value that contradicts the keys before it.
    make : function that converts the value of a file before its unit is applied.
    write : inverse of `make`; raises `broken` for a value that a file cannot state.
    written : default in files, if it is not the default of the field.
    examples : for the pages of keys.
    """

    rule: Any
    text: str
    unit: str = ""
    name: str = ""
    check: Callable[[Any, ValidationInfo], None] | None = None
    make: Callable[[Any], Any] | None = None
    write: Callable[[Any], Any] | None = None
    written: Any = None
    examples: tuple[Any, ...] = ()


@cache
def keys_of(record: type) -> dict[str, tuple[str, Key, Any]]:
    """The fields that have a `Key`: key in files -> (name of the field, its `Key`, type of the field)."""
    found = {}
    hints = get_type_hints(record, include_extras=True)
    for field in dataclasses.fields(record):
        hint = hints[field.name]
        about = next((one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Key)), None)
        if about is not None:
            kind = get_args(hint)[0]
            if about.rule is ...:
                # Python flattens nested annotations: the bounds of the type are in the same list as the key.
                bounds = [one for one in hint.__metadata__ if one is not about]
                if get_origin(kind) is tuple:
                    # A list in a file is accepted for a tuple.
                    bounds.append(Field(strict=False))
                about = dataclasses.replace(about, rule=_ANNOTATED[kind, *bounds] if bounds else kind)
            found[_key_name(field.name, about)] = (field.name, about, kind)
    return found


def first_line(record: type) -> str:
    """The first line of a class's docstring."""
    return (record.__doc__ or "").split("\n", 1)[0]


def table_of(
    record: type,
    choose: str = "",
    name: str = "",
    bases: tuple[type[Table], ...] = (Table,),
    without: tuple[str, ...] = (),
    rules: tuple[Callable[[Any], None], ...] = (),
    *,
    beside: Mapping[str, type[Table]] | None = None,
    needed: tuple[str, ...] = (),
    instead: Mapping[str, Key] | None = None,
    takes: Callable[[Any], bool] | None = None,
    text: str = "",
) -> Any:
    """Make the table (a pydantic model) that reads a record from a file.

    Keys with a check come after the others, because a check may read them.

    Parameters
    ----------
    record
        Frozen data class whose fields have keys.
    choose
        Key whose value, `record.kind`, selects this table among several.
    name
        Name of the table's class.
    bases
        Tables whose keys the new one has as well. They make no records.
    without
        Fields that have no key in the file.
    rules
        Functions that raise `broken` for keys that contradict each other.
    beside
        Tables of fields that are records themselves, or sequences of one record. Their keys are keys of this table.
    needed
        Fields that the file must state although they have a default.
    instead
        Keys that replace those of the class.
    takes
        Function that says whether a record is written in this table, for several tables that make the same record.
    text
        Description in one line; that of the record unless given.

    Returns
    -------
    type
        The class of the table.
    """
    text = text or first_line(record)
    fields: dict[str, Any] = {}
    if choose:
        fields[choose] = (_LITERAL[record.kind], Field(description=text.removesuffix(".")))  # type: ignore[attr-defined]
    keys = _keys_of_table(record, without, instead or {})
    stated = {field.name: field for field in dataclasses.fields(record)}
    checks: dict[str, Any] = {}
    for key, (attribute, about, _) in keys.items():
        options: dict[str, Any] = {"description": about.text}
        if about.examples:
            options["examples"] = list(about.examples)
        has_default = attribute not in (*needed, *(instead or {}))
        default = default_of(stated[attribute]) if has_default else dataclasses.MISSING
        if has_default and (about.written is not None or _stands_for_none(default)):
            options["default"] = about.written
        elif isinstance(default, Record):
            options["default"] = about.rule()
        elif default is not dataclasses.MISSING:
            written = in_file(default, about)
            options["default"] = tuple(written) if _is_tuple(about.rule) else written
            options["validate_default"] = about.check is not None
        fields[key] = (about.rule, Field(**options))
        if about.check is not None:
            checks[f"_check_{key}"] = field_validator(key)(_checked(about.check))
    if rules:
        checks["_keep_rules"] = _keeping(rules)
    parts = dict(beside or {})
    made = create_model(
        name or f"{record.__name__}Keys",
        __base__=(*parts.values(), *bases) if bases != (Table,) else tuple(parts.values()) or bases,
        __doc__=text,
        __module__=record.__module__,
        __validators__=checks,
        **fields,
    )
    made.makes, made.declared, made.beside, made.takes = record, keys, parts, takes
    made.choice = (choose, record.kind) if choose else None  # type: ignore[attr-defined]
    return made


def _keys_of_table(
    record: type, without: tuple[str, ...], instead: Mapping[str, Key]
) -> dict[str, tuple[str, Key, Any]]:
    """As `keys_of`, without the fields `without`, and with the keys `instead`. Keys with a check come last."""
    found = {key: one for key, one in keys_of(record).items() if one[0] not in (*without, *instead)}
    hints = get_type_hints(record)
    for attribute, about in instead.items():
        found[_key_name(attribute, about)] = attribute, about, hints[attribute]
    return dict(sorted(found.items(), key=lambda each: each[1][1].check is not None))


def _is_tuple(rule: Any) -> bool:
    """Whether the values of a rule are tuples, with bounds or without."""
    return get_origin(get_args(rule)[0] if get_origin(rule) is Annotated else rule) is tuple


def _key_name(attribute: str, about: Key) -> str:
    name = about.name or attribute
    return f"{name}_{about.unit}" if about.unit else name


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


def default_of(field: dataclasses.Field[Any]) -> Any:
    """Default of a field; `dataclasses.MISSING` if it has none."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _stands_for_none(default: Any) -> bool:
    """Whether a default is None in the table of a file: an empty text, or an infinite bound."""
    return default == "" if isinstance(default, str) else isinstance(default, float) and np.isinf(default)


def in_file(value: Any, about: Key) -> Any:
    """A value in the unit of the file. A value that is not a number stays as it is."""
    return _in_unit(about.write(value) if about.write else value, UNITS.get(about.unit, 1.0))


def _in_unit(value: Any, scale: float) -> Any:
    if isinstance(value, tuple | list | np.ndarray):
        return [_in_unit(one, scale) for one in value]
    if isinstance(value, Mapping):
        return dict(value)
    value = value.item() if isinstance(value, np.generic) else value
    return value / scale if isinstance(value, float) and scale != 1.0 else value


def check_fields(record: Any) -> None:
    """Check a record that was made in Python against the rules of its keys.

    Raises
    ------
    InputError
        With a problem for every field that breaks a rule.
    """
    kind, table = type(record), _plain_table(type(record))
    keys = keys_of(kind)
    data = {key: in_file(getattr(record, name), about) for key, (name, about, _) in keys.items()}
    problems: dict[str, Problem] = {}
    for finding in schema_findings(table, data):
        name, about, _ = keys[str(finding.location[0])]
        entry = "".join(f"[{step}]" for step in finding.location[1:] if isinstance(step, int))
        # The bound in the message is in the unit of the file.
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
    """Classes derived from `base` that define `kind`, by its value."""
    waiting, found = [base], dict[str, type]()
    while waiting:
        derived = type.__subclasses__(waiting.pop())
        waiting += derived
        found |= {each.kind: each for each in derived if "kind" in vars(each)}  # type: ignore[attr-defined]
    return dict(sorted(found.items()))


def choice_of(tables: Iterable[Any], key: str) -> Any:
    """Annotation for one of several tables; the value of `key` selects which."""
    by_tag = {get_args(table.model_fields[key].annotation)[0]: table for table in tables}
    return choice_with(by_tag, lambda table: table.get(key), key)


def choice_with(tables: Mapping[str, Any], choose: Callable[[dict[str, Any]], Any], key: str = "kind") -> Any:
    """Annotation for one of several tables by tag; `choose` gives the tag of a raw table, mainly by `key`."""
    tagged = [Annotated[table, Tag(tag)] for tag, table in tables.items()]
    return Annotated[_UNION[tuple(tagged)], chosen_with(choose, key)]


def record_of(table: Table, folder: Path = Path(), **others: Any) -> Any:
    """Make the record of a table, in SI units.

    Parameters
    ----------
    table
        Table of a class that `table_of` made.
    folder
        Folder to which paths in the table are relative.
    others
        Values of the fields that are not read from the table.
    """
    record = type(table).makes
    assert record is not None
    return record(**fields_of(table, folder, **others))


def fields_of(table: Table, folder: Path = Path(), **others: Any) -> dict[str, Any]:
    """The arguments with which `record_of` makes the record of a table."""
    return _fields_in(type(table), table, folder, others)


def _fields_in(kind: type[Table], table: Table, folder: Path, others: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of the record that `kind` makes. The table has the keys of `kind`, and maybe others."""
    assert kind.makes is not None
    values, stated = {}, {field.name: field for field in dataclasses.fields(kind.makes)}
    for key, (attribute, about, hint) in kind.declared.items():
        value = getattr(table, key)
        left_out = value is None and _stands_for_none(default_of(stated[attribute]))
        if attribute not in others and not left_out:
            values[attribute] = _in_si(about.make(value) if about.make else value, about, hint, folder)
    for attribute, inner in kind.beside.items():
        assert inner.makes is not None
        part = inner.makes(**_fields_in(inner, table, folder, {}))
        values[attribute] = (part,) if is_sequence_of(kind.makes, attribute) else part
    more = {name: value for name, value in table.also_makes().items() if name in stated}
    return values | more | dict(others)


@cache
def is_sequence_of(record: type, attribute: str) -> bool:
    """Whether a field holds several records."""
    return get_origin(get_type_hints(record)[attribute]) is tuple


def _in_si(value: Any, about: Key, hint: Any, folder: Path) -> Any:
    scale = UNITS.get(about.unit, 1.0)
    kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    if value is None:
        return None
    if isinstance(value, Table):
        return record_of(value, folder)
    if Path in kinds:
        return (folder / value).resolve()
    if isinstance(value, dict):
        return FrozenDict({name: _in_si(one, about, None, folder) for name, one in value.items()})
    if isinstance(value, list | tuple | np.ndarray):
        if any(get_origin(kind) is tuple for kind in kinds) or any(isinstance(one, str) for one in value):
            return tuple(_in_si(one, about, None, folder) for one in value)
        if np.dtype(np.int64) in map(_number, kinds):
            return np.array(value, dtype=np.int64)
        return read_only(value, scale)
    return value * scale if isinstance(value, float) else value


def _number(hint: Any) -> Any:
    """The dtype in the annotation of an array; None for other annotations."""
    if get_origin(hint) is get_origin(NDArray[Any]):
        return np.dtype(get_args(get_args(hint)[1])[0])
    return None
