"""Records of input files: one declaration of each key for reading, checking and writing.

Each field of a frozen class is annotated with a `Key`: its meaning, its unit in the file, and the rule for its value in
that unit. From the keys `table_of` makes the table that reads files, `record_of` makes a record of such a table, and
`fieldmap.inputs.writing` writes a record as the data of a file.

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
from pydantic import Field, Tag, ValidationInfo, create_model, field_validator, model_validator

from fieldmap.errors import InputError, Problem
from fieldmap.inputs.document import schema_findings
from fieldmap.inputs.tables import UNITS, Choice, Table, in_unit, read_only
from fieldmap.records import FrozenDict, Record
from fieldmap.typing import Index

# Aliases of type Any: their members are known only when the program runs, which type checkers do not accept.
_ANNOTATED: Any = Annotated
_LITERAL: Any = Literal
_UNION: Any = Union


@dataclasses.dataclass(frozen=True, repr=False)
class Key(Record):
    """How a field of a record is written in files.

    Attributes
    ----------
    rule : annotation of the value in the unit of the file, with its bounds; `...` stands for the type of the field.
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


@dataclasses.dataclass(frozen=True, repr=False)
class Declared(Record):
    """A field of a record and its key in files. default: `dataclasses.MISSING` if the field has none."""

    attribute: str
    about: Key
    hint: Any
    default: Any

    @property
    def stands_for_none(self) -> bool:
        """Whether the default is an empty text or an infinite number; the table of a file has None instead."""
        default = self.default
        return default == "" if isinstance(default, str) else isinstance(default, float) and np.isinf(default)


@cache
def keys_of(record: type) -> dict[str, Declared]:
    """The fields that have a `Key`, by their keys in files."""
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
            found[_key_name(field.name, about)] = Declared(field.name, about, kind, default_of(field))
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
        By field, the table of the record that the field holds, alone or as the only one of a sequence. Its keys become
        keys of this table.
    needed
        Fields that the file must state although they have a default.
    instead
        By field, keys that replace those of the class.
    takes
        Function that says whether a record is written in this table, for several tables that make the same record.
    text
        Description in one line; the first line of the record's docstring unless given.

    Returns
    -------
    type
        The class of the table.
    """
    text, parts, instead = text or first_line(record), dict(beside or {}), instead or {}
    fields: dict[str, Any] = {}
    if choose:
        fields[choose] = (_LITERAL[record.kind], Field(description=text.removesuffix(".")))  # type: ignore[attr-defined]
    keys = {key: one for key, one in keys_of(record).items() if one.attribute not in (*without, *instead)}
    hints = get_type_hints(record)
    for attribute, about in instead.items():
        keys[_key_name(attribute, about)] = Declared(attribute, about, hints[attribute], dataclasses.MISSING)
    keys = dict(sorted(keys.items(), key=lambda each: each[1].about.check is not None))
    checks = {"_keep_rules": _keeping(rules)} if rules else {}
    for key, one in keys.items():
        fields[key] = _field(one, one.attribute not in needed)
        if one.about.check is not None:
            checks[f"_check_{key}"] = field_validator(key)(_checked(one.about.check))
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


def _field(one: Declared, optional: bool) -> Any:
    """A key as the annotation and the field of a pydantic model."""
    about, rule = one.about, one.about.rule
    options: dict[str, Any] = {"description": about.text}
    if about.examples:
        options["examples"] = list(about.examples)
    if optional and (about.written is not None or one.stands_for_none):
        options["default"] = about.written
    elif optional and isinstance(one.default, Record):
        options["default"] = rule()
    elif optional and one.default is not dataclasses.MISSING:
        written = in_file(one.default, about)
        plain = get_args(rule)[0] if get_origin(rule) is Annotated else rule
        options["default"] = tuple(written) if get_origin(plain) is tuple else written
        options["validate_default"] = about.check is not None
    return rule, Field(**options)


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


def in_file(value: Any, about: Key) -> Any:
    """A value in the unit of the file, as plain data. A value that is not a number stays as it is."""
    return _in_unit(about.write(value) if about.write else value, UNITS.get(about.unit, 1.0))


def _in_unit(value: Any, unit: float) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_in_unit(one, unit) for one in value]
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, int | float) and not isinstance(value, bool) and unit != 1.0:
        try:
            number = float(value)
        except OverflowError:
            return float("inf")
        return in_unit(number, unit) if np.isfinite(number) else number
    return value


def check_fields(record: Any) -> None:
    """Check a record that was made in Python against the rules of its keys.

    Raises
    ------
    InputError
        With a problem for every field that breaks a rule.
    """
    kind, table = type(record), _plain_table(type(record))
    keys = keys_of(kind)
    data = {
        key: in_file(getattr(record, one.attribute), one.about)
        for key, one in keys.items()
        if not (one.stands_for_none and getattr(record, one.attribute) == one.default)
    }
    problems: dict[str, Problem] = {}
    for finding in schema_findings(table, data):
        field = keys[str(finding.location[0])]
        name, about = field.attribute, field.about
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
    """Classes derived from `base` that define `kind`, by their kinds."""
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
    """Annotation for one of several tables by tag. `choose` returns the tag of a raw table; `key` is the key that
    usually decides."""
    tagged = [Annotated[table, Tag(tag)] for tag, table in tables.items()]
    choice = Choice(lambda table: choose(table) if isinstance(table, dict) else None, key=key)
    return Annotated[_UNION[tuple(tagged)], choice]


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
    record: Any = type(table).makes
    return record(**fields_of(table, folder, **others))


def fields_of(
    table: Table, folder: Path = Path(), kind: type[Table] | None = None, /, **others: Any
) -> dict[str, Any]:
    """The arguments for the record of a table, or for the record of `kind`, which is one of its `beside`."""
    kind = kind or type(table)
    values = {}
    for key, one in kind.declared.items():
        value = getattr(table, key)
        if one.attribute not in others and not (value is None and one.stands_for_none):
            made = one.about.make(value) if one.about.make else value
            values[one.attribute] = _in_si(made, one.about, one.hint, folder)
    for attribute, inner in kind.beside.items():
        values[attribute] = inner.makes(**fields_of(table, folder, inner))
    known = {field.name for field in dataclasses.fields(kind.makes)}  # type: ignore[arg-type]
    return values | {name: value for name, value in table.also_makes().items() if name in known} | others


def _in_si(value: Any, about: Key, hint: Any, folder: Path) -> Any:
    kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    scale = UNITS.get(about.unit, 1.0)
    if isinstance(value, Table):
        return record_of(value, folder)
    if isinstance(value, dict):
        return FrozenDict({name: _in_si(one, about, None, folder) for name, one in value.items()})
    if isinstance(value, list | tuple | np.ndarray):
        if any(get_origin(kind) is tuple for kind in kinds) or any(isinstance(one, str) for one in value):
            return tuple(_in_si(one, about, None, folder) for one in value)
        return np.array(value, dtype=np.int64) if Index in kinds else read_only(value, scale)
    if Path in kinds and value is not None:
        return (folder / value).resolve()
    return value * scale if isinstance(value, float) else value
