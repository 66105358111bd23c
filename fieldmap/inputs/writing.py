"""Records written as the data of a file, the inverse of `fieldmap.inputs.declared`, and the errors in them.

The schema of files checks the data, and each finding is reported at the path of the attribute.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic_core import PydanticCustomError

from fieldmap.errors import Problem
from fieldmap.inputs.declared import Declared, Key, in_file, keys_of
from fieldmap.inputs.findings import Finding, shown
from fieldmap.inputs.key_paths import Location
from fieldmap.inputs.tables import UNITS, Table
from fieldmap.records import Record

_BOUND = re.compile(r"^must be (greater than|at least|less than|at most) [-\d.e+]+$")
_NUMBER = re.compile(r"-?\d[\d.e+-]*")


@dataclass(repr=False)
class Writing(Record):
    """Data of a file, written from records.

    paths: of attributes, by locations of the data. keys: attribute and `Key`, by locations. findings: values that data
    cannot hold. unwritten: names of records without keys, which are left out. see: remedy that refers to the
    documentation. data: of the whole file.
    """

    see: str
    paths: dict[Location, str] = field(default_factory=dict)
    keys: dict[Location, tuple[str, Key]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    unwritten: list[str] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)

    def refuse(self, location: Location, path: str, must_hold: str, value: object) -> None:
        """Note a value of a type that the data of a file cannot hold."""
        self.paths[location] = path
        received = shown(value) if isinstance(value, str | bool | int | float) else type(value).__name__
        self.findings.append(Finding(location, must_hold, received, self.see))

    def table(
        self,
        record: Any,
        table: type[Table],
        location: Location = (),
        path: str = "",
        without: tuple[str, ...] = (),
    ) -> dict[str, Any]:
        """The keys of a record, except those at their defaults. without: attributes that are left out.

        Keys that the table does not have are written as well, for the schema to refuse.
        """
        data: dict[str, Any] = {table.choice[0]: table.choice[1]} if table.choice else {}
        elsewhere = {*without, *table.beside, *(one.attribute for one in table.declared.values())}
        known = {key: one for key, one in keys_of(type(record)).items() if one.attribute not in elsewhere}
        for key, one in {**table.declared, **known}.items():
            if one.attribute in without:
                continue
            place: Location = (*location, key)
            self.paths[place] = f"{path}.{one.attribute}" if path else one.attribute
            self.keys[place] = one.attribute, one.about
            value = self._value(getattr(record, one.attribute), one, place)
            default = in_file(one.default, one.about)
            needed = key in table.model_fields and table.model_fields[key].is_required()
            if value is not None and (needed or (type(value), value) != (type(default), default)):
                data[key] = value
        for attribute, inner in table.beside.items():
            part, at = getattr(record, attribute), f"{path}.{attribute}"
            if isinstance(part, tuple):
                (part,), at = part, f"{at}[0]"
            data |= self._record(part, [inner], location, at)
        return data

    def _value(self, value: Any, one: Declared, place: Location) -> Any:
        """Value in the unit of the file. A record becomes a table; a sequence or mapping of records, one of tables."""
        tables = list(tables_of(one.about.rule))
        if value is None:
            return None
        if not tables:
            try:
                return in_file(value, one.about)
            except PydanticCustomError as error:
                told = error.context or {}
                self.findings.append(Finding(place, told["must_hold"], told["received"], told["remedy"]))
                return None
        path = self.paths[place]
        if isinstance(value, Mapping):
            by_name = {
                name: self._record(each, tables, (*place, name), f"{path}[{name!r}]")
                for name, each in value.items()
                if not self._leaves_out(each, tables, one.hint, str(name))
            }
            return by_name or None
        if isinstance(value, tuple) and get_origin(one.hint) is tuple:
            found: list[Any] = []
            for k, each in enumerate(value):
                if not self._leaves_out(each, tables, one.hint, str(getattr(each, "name", place[-1]))):
                    found.append(self._record(each, tables, (*place, len(found)), f"{path}[{k}]"))
            return found
        if self._leaves_out(value, tables, one.hint, str(place[-1])):
            return None
        return self._record(value, tables, place, path)

    def _leaves_out(self, record: Any, tables: list[type[Table]], hint: Any, name: str) -> bool:
        """Whether a record is of a class derived by a user, or cannot be written to a file; notes its name."""
        derived = isinstance(record, _classes_in(hint)) and all(
            one.makes is not type(record) for one in tables
        )
        if derived or getattr(record, "unwritten", False):
            self.unwritten.append(name)
            return True
        return False

    def _record(
        self, record: Any, tables: list[type[Table]], location: Location, path: str
    ) -> dict[str, Any]:
        """The table of a record, which one of several tables can write."""
        self.paths.setdefault(location, path)
        own = [one for one in tables if one.makes is type(record)]
        if not own:
            names = dict.fromkeys(one.makes.__name__ for one in tables if one.makes)
            self.refuse(location, path, f"must be one of {', '.join(names)}", record)
            return {}
        chosen = next((one for one in own if _takes(one, record)), None)
        if chosen is not None:
            return self.table(record, chosen, location, path)
        # No table takes the record: one of its parts fits no table, or the choice among the tables is missing.
        for attribute in own[0].beside:
            inner = [one.beside[attribute] for one in own if attribute in one.beside]
            part = getattr(record, attribute)
            if not any(_takes(one, part) for one in inner):
                return self._record(part, inner, (*location, attribute), f"{path}.{attribute}")
        return self.table(record, own[-1], location, path)

    # ---- problems ----

    def problem(self, finding: Finding, title: str) -> Problem:
        """The problem of a finding: a title and the path of its attribute, with names and units of attributes."""
        path, steps = self._attribute_path(finding.location), finding.location
        # The key, without entry numbers after it.
        place = steps[: max((k + 1 for k, step in enumerate(steps) if isinstance(step, str)), default=0)]
        about = self.keys[place][1] if place in self.keys else None
        unit = f" {_in_words(about.unit)}" if about and UNITS.get(about.unit, 1.0) != 1.0 else ""
        must_hold, received, remedy = (
            self._in_code(text, place[:-1]) for text in (finding.must_hold, finding.received, finding.remedy)
        )
        return Problem(
            f"{title}: {path}" if path else title,
            must_hold + (unit if _BOUND.match(finding.must_hold) else ""),
            received + (unit if _NUMBER.fullmatch(finding.received) else ""),
            remedy.replace(
                "its unit is the last part of the key",
                "lengths are in m, masses in kg, all else in SI units as well",
            ),
        )

    def _in_code(self, text: str, table: Location) -> str:
        """A text about keys of a table with the names of attributes; numbers get the unit of their key."""
        for known, (attribute, about) in self.keys.items():
            key = str(known[-1])
            if known[:-1] == table and UNITS.get(about.unit, 1.0) != 1.0 and key in text:
                with_number = rf"\b{key}\b((?:/2)? = [-\d.e+]+)"
                text = re.sub(with_number, rf"{attribute}\1 {_in_words(about.unit)}", text)
                text = re.sub(rf"\b{key}\b", attribute, text)
        return text

    def _attribute_path(self, location: Location) -> str:
        known = next((n for n in range(len(location), 0, -1) if location[:n] in self.paths), 0)
        path = self.paths[location[:known]] if known else ""
        for step in location[known:]:
            path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else step
        return path


def tables_of(rule: Any) -> Iterable[type[Table]]:
    """The tables in an annotation: all of a choice, and those of the entries of a list or mapping."""
    if isinstance(rule, type) and issubclass(rule, Table):
        yield rule
    origin, arguments = get_origin(rule), get_args(rule)
    if origin is Annotated:
        yield from tables_of(arguments[0])
    elif origin in (Union, UnionType, list, dict):
        for one in arguments:
            yield from tables_of(one)


def _classes_in(hint: Any) -> tuple[type, ...]:
    """The classes of records that the type of a field names."""
    if isinstance(hint, type) and not get_args(hint):
        return (hint,) if issubclass(hint, Record) else ()
    return tuple(one for argument in get_args(hint) for one in _classes_in(argument))


def _takes(table: type[Table], record: Any) -> bool:
    """Whether a record and its parts are written in a table; a part may be a sequence of one record."""
    if table.makes is not type(record) or not (table.takes is None or table.takes(record)):
        return False
    parts = ((inner, getattr(record, attribute)) for attribute, inner in table.beside.items())
    return all(
        _takes(inner, part[0] if isinstance(part, tuple) and len(part) == 1 else part)
        for inner, part in parts
    )


def _in_words(unit: str) -> str:
    return unit.replace("g_mm2", "g mm^2")
