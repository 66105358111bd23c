"""Writes out the short forms of device files: included files, parameters, arithmetic, defaults, copies, mirror images.

The result is the data of a file without short forms. `Document.origins` says where each part of it was written, so an
error in the fifth copy of a table is reported at the line of that table.
"""

import copy
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from fieldmap.device.coils import COIL_KEYS
from fieldmap.device.patterns import Image, Place, Repeat
from fieldmap.device.placement import MOST_COPIES
from fieldmap.device.shapes import SHAPE_KEYS
from fieldmap.errors import DeviceFileError, InputError, Problem
from fieldmap.inputs.declared import record_of
from fieldmap.inputs.document import Document, parse, schema_findings
from fieldmap.inputs.expressions import ExpressionError, Value, evaluate, is_expression
from fieldmap.inputs.findings import Finding, one_of, shown
from fieldmap.inputs.key_paths import Location, matches, value_at
from fieldmap.inputs.tables import is_number
from fieldmap.inputs.writing import Writing
from fieldmap.shipped import is_file, shipped_file

TABLES = ("body", "coil")
"""Arrays of tables that can be repeated and mirrored, and that can have defaults."""
_NAMED = (*TABLES, "section", "joint", "sensor")
_OWN = ("include", "without", "parameters", "defaults")
DEEPEST = 8
MOST_FILES = 32
MOST_TABLES = 5000
MOST_STEPS = 50
Table = dict[str, Any]
Names = Mapping[str, Value]
Texts = dict[Location, str]
_Pattern = TypeVar("_Pattern", Repeat, Image)


def expand(document: Document, parameters: Mapping[str, Value] | None = None) -> Document:
    """A device document with its short forms written out; one without any is returned as it is.

    parameters: values that replace those of the file. Raises DeviceFileError with one Problem for every error.
    """
    if not _has_short_forms(document.data):
        return document
    problems: list[Problem] = []
    layers = _layers(document, problems, ())
    if problems:
        raise DeviceFileError(*problems)
    work = _Expansion(document)
    try:
        work.parameters(layers, parameters or {})
        for layer in layers:
            work.layer(layer)
    except RecursionError:
        work.refuse((), "arrays and tables must not nest this deep", "hundreds of levels", "write them flat")
    if work.findings:
        raise DeviceFileError(*work.result().problems(work.findings))
    return work.result()


def _has_short_forms(data: Any) -> bool:
    if isinstance(data, Mapping):
        keys = {*_OWN, "repeat", "mirror"}
        return bool(keys & set(data)) or any(map(_has_short_forms, data.values()))
    return is_expression(data) or (isinstance(data, list) and any(map(_has_short_forms, data)))


def _layers(document: Document, problems: list[Problem], above: tuple[Path, ...]) -> list[Document]:
    """The document and the files that it includes, in order: each file comes before the one that includes it."""
    given = document.data.get("include", [])
    names = [given] if isinstance(given, str) else given
    layers: list[Document] = []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        wrong = Finding(("include",), "must be a file name or a list of them", shown(given), 'write "a.toml"')
        problems += document.problems([wrong])
        names = []
    here = (*above, document.path.resolve())
    folder = here[0].parent
    if above:
        document = replace(document, data=_with_files_from(document.data, document.path.parent, folder))
    for name in names:
        beside = document.path.parent / name
        path = beside if not document.alone and is_file(beside) else shipped_file("geometry", name)
        if path is None:
            fault = "must be an existing file, beside this one or among the shipped ones", "correct the path"
        elif path.resolve() in here:
            fault = "a file must not include itself, directly or by way of others", "remove it"
        elif len(here) > DEEPEST:
            fault = f"files include each other at most {DEEPEST} deep", "include fewer"
        elif len(layers) > MOST_FILES:
            fault = f"a device is made of at most {MOST_FILES} files", "include fewer"
        else:
            try:
                layers += _layers(parse(path, DeviceFileError), problems, here)
            except InputError as error:
                problems += error.problems
            continue
        problems += document.problems([Finding(("include",), fault[0], shown(name), fault[1])])
    return [*layers, document]


def _with_files_from(data: Any, folder: Path, main: Path) -> Any:
    """Data of an included file. Names of files that lie in its folder, but not in `main`, become relative to `main`."""
    if isinstance(data, list):
        return [_with_files_from(one, folder, main) for one in data]
    if not isinstance(data, dict):
        return data
    named = {key: _with_files_from(one, folder, main) for key, one in data.items()}
    file = named.get("file")
    if isinstance(file, str) and is_file(folder / file) and not is_file(main / file):
        named["file"] = os.path.relpath(folder / file, main)
    return named


@dataclass
class _Expansion:
    """The data written out so far, where each part was written, and the errors."""

    document: Document
    data: Table = field(default_factory=dict)
    origins: dict[Location, tuple[Document, Location]] = field(default_factory=dict)
    computed: Texts = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    names: dict[str, Value] = field(default_factory=dict)

    def result(self) -> Document:
        return replace(
            self.document, data=self.data, raw=self.document, origins=self.origins, computed=self.computed
        )

    def refuse(self, location: Location, must_hold: str, received: str, remedy: str) -> None:
        self.findings.append(Finding(location, must_hold, received, remedy))

    # ---- parameters ----

    def parameters(self, layers: Sequence[Document], given: Mapping[str, Value]) -> None:
        """Compute all parameters. A file's parameters replace those of the same name in the files that it includes."""
        raw: Table = {}
        for layer in layers:
            table = layer.data.get("parameters", {})
            self.origins[("parameters",)] = (layer, ("parameters",))
            if not isinstance(table, dict):
                self.refuse(("parameters",), "must be a table", shown(table), "write [parameters]")
                continue
            for name, value in table.items():
                self.origins[("parameters", name)] = (layer, ("parameters", name))
                if not name.isidentifier() or name.startswith("_"):
                    must_hold = "a parameter's name has letters, digits and _, and begins with a letter"
                    self.refuse(("parameters", name), must_hold, shown(name), "rename it")
                    continue
                raw[name] = value
        raw |= {name: value for name, value in given.items() if name in raw}
        for name in raw:
            self._parameter(name, raw, ())
        if raw:
            self.data["parameters"] = {name: self.names[name] for name in raw if name in self.names}

    def _parameter(self, name: str, raw: Table, above: tuple[str, ...]) -> None:
        place: Location = ("parameters", name)
        if name in self.names:
            return
        if name in above or len(above) > MOST_STEPS:
            chain = " -> ".join((*above, name))
            must_hold = f"parameters must not go round in a circle, nor take more than {MOST_STEPS} steps"
            self.refuse(place, must_hold, chain[:80], "write a number")
            self.names[name] = 1.0
            return
        value = raw[name]
        for text in value if isinstance(value, list) else [value]:
            for other in re.findall(r"\w+", text) if is_expression(text) else ():
                if other in raw:
                    self._parameter(other, raw, (*above, name))
        known: Names = {key: one for key, one in self.names.items() if key != name}
        computed = self.values(value, known, place)
        entries = computed if isinstance(computed, list) else [computed]
        if not all(is_number(one) or isinstance(one, str) for one in entries):
            remedy = 'write for instance gap = 2.5, or gap = "= 2*radius"'
            self.refuse(place, "must be a number, a text, or a list of these", shown(value), remedy)
            computed = 1.0
        self.names.setdefault(name, computed)

    # ---- values ----

    def values(
        self, value: Any, names: Names, location: Location, texts: Texts | None = None, pattern: bool = False
    ) -> Any:
        """A value with its expressions computed. texts: the expressions are added here, or to `computed` if None.
        pattern: whether {...} in strings is filled in."""
        texts = self.computed if texts is None else texts
        if isinstance(value, dict | list):
            entries = value.items() if isinstance(value, dict) else enumerate(value)
            done = {key: self.values(one, names, (*location, key), texts, pattern) for key, one in entries}
            return done if isinstance(value, dict) else list(done.values())
        if is_expression(value):
            found = self._evaluate(value, names, location)
            if found is None:
                return 1.0
            texts[location] = value
            return found
        if pattern and isinstance(value, str) and "{" in value:
            return self._filled(value, names, location)
        return value

    def _evaluate(self, text: str, names: Names, location: Location) -> Value | None:
        try:
            return evaluate(text, names)
        except ExpressionError as wrong:
            self.refuse(location, wrong.must_hold, wrong.received, wrong.remedy)
            return None

    def _filled(self, text: str, names: Names, location: Location) -> str:
        filled, rest = "", text
        while "{" in rest:
            before, _, rest = rest.partition("{")
            inside, closed, rest = rest.partition("}")
            if not closed:
                self.refuse(location, "every { needs its }", shown(text), 'write for instance "core {k}"')
                return text
            value = self._evaluate(inside, names, location)
            filled += before + (f"{value:g}" if is_number(value) else str(value))
        return filled + rest

    # ---- one file ----

    def layer(self, layer: Document) -> None:
        """Add the data of a file to those of the files before it."""
        self._leave_out(layer)
        for key, value in layer.data.items():
            if key in TABLES and isinstance(value, list):
                for k, table in enumerate(value):
                    self._tables(layer, key, k, table)
            elif key not in _OWN:
                self._other(layer, key, value)
        self._check_defaults(layer)

    def _leave_out(self, layer: Document) -> None:
        """Remove the included values that `without` names, and the entries of `provenance` that match nothing then."""
        given = layer.data.get("without", [])
        patterns = [given] if isinstance(given, str) else given
        self.origins[("without",)] = (layer, ("without",))
        if not isinstance(patterns, list) or not all(isinstance(one, str) for one in patterns):
            remedy = 'write without = ["body.centre core"]'
            self.refuse(("without",), "must be a key path or a list of them", shown(given), remedy)
            return
        sources = self.data.get("provenance", {})
        before = [path for path in sources if patterns and matches(self.data, path)]
        for pattern in patterns:
            found = matches(self.data, pattern) if pattern.partition(".")[0] not in ("", "*", *_OWN) else []
            if not found:
                must_hold = "must be a key path of an included file"
                self.refuse(("without",), must_hold, shown(pattern), "correct the path, or remove it")
            for location in reversed(found):
                self._remove(location)
        for path in before:
            if not matches(self.data, path):
                self._remove(("provenance", path))

    def _remove(self, location: Location) -> None:
        """Remove a value from the data. In an array the entries after it move up."""
        *above, last = location
        del value_at(self.data, tuple(above))[last]
        self._forget(location)
        if isinstance(last, int):
            depth = len(above)

            def up(one: Location) -> Location:
                step = one[depth] if len(one) > depth and one[:depth] == location[:depth] else None
                follows = isinstance(step, int) and step > last
                return (*one[:depth], int(one[depth]) - 1, *one[depth + 1 :]) if follows else one

            self.computed = {up(one): text for one, text in self.computed.items()}
            self.origins = {up(one): place for one, place in self.origins.items()}

    def _check_defaults(self, layer: Document) -> None:
        defaults = layer.data.get("defaults", {})
        tables = defaults if isinstance(defaults, dict) else {"": defaults}
        for name, table in tables.items():
            place: Location = ("defaults", name) if name else ("defaults",)
            self.origins[place] = (layer, place)
            if name not in TABLES or not isinstance(table, dict):
                must_hold = f"defaults are tables of {one_of(list(TABLES))}"
                remedy = "write [defaults.body] or [defaults.coil] with keys below"
                self.refuse(place, must_hold, shown(table), remedy)

    def _other(self, layer: Document, key: str, value: Any) -> None:
        """Add a key other than bodies and coils: materials and provenance by name, entries of arrays as `_add`. Other
        values are replaced."""
        if key in ("material", "provenance") and isinstance(value, dict):
            into = self.data.setdefault(key, {})
            self.origins.setdefault((key,), (layer, (key,)))
            if isinstance(into, dict):
                for name, one in value.items():
                    self._forget((key, name))
                    self.origins[(key, name)] = (layer, (key, name))
                    into[name] = self.values(one, self.names, (key, name))
                return
        if isinstance(value, list) and isinstance(self.data.get(key), list):
            for k, one in enumerate(value):
                self._add(layer, key, (key, k), self.values(one, self.names, (key, len(self.data[key]))), {})
            return
        self._forget((key,))
        self.origins[(key,)] = (layer, (key,))
        self.data[key] = self.values(value, self.names, (key,))

    def _forget(self, location: Location) -> None:
        """Delete the origins and expressions of a value that is removed or replaced."""
        for known in (self.computed, self.origins):
            for other in [one for one in known if one[: len(location)] == location]:
                del known[other]

    def _tables(self, layer: Document, key: str, k: int, table: Any) -> None:
        """Add the table of a body or coil with its defaults, copies and mirror images."""
        place: Location = (key, len(self.data.get(key, [])))
        self.origins[place] = (layer, (key, k))
        if not isinstance(table, dict):
            self._add(layer, key, (key, k), table, {})
            return
        defaults = layer.data.get("defaults", {})
        given = defaults.get(key) if isinstance(defaults, dict) else None
        common: Table = given if isinstance(given, dict) else {}
        own = {name: value for name, value in table.items() if name not in ("repeat", "mirror")}
        defaulted = {name: ("defaults", key, name) for name in common if name not in own}
        before, texts = len(self.findings), dict(self.computed)
        copies = list(self._copies(table, {**common, **own}, place))
        mirrors = table.get("mirror", [])
        for mirror in mirrors if isinstance(mirrors, list) else [mirrors]:
            copies += self._images(mirror, copies, (*place, "mirror"))
        if len(self.data.get(key, [])) + len(copies) > MOST_TABLES:
            self.refuse(place, f"a device has at most {MOST_TABLES} tables of a kind", "more", "repeat less")
        if len(self.findings) > before:  # reported once for all copies, at the table as written
            self.computed = texts
            self.findings[before:] = dict.fromkeys(self.findings[before:])
            copies = [(own, {})]
        for copied, computed in copies:
            here: Location = (key, len(self.data.get(key, [])))
            for location, text in computed.items():
                self.computed[(*here, *location[len(place) :])] = text
            self._add(layer, key, (key, k), copied, defaulted)

    def _add(
        self, layer: Document, key: str, raw: Location, table: Any, defaulted: Mapping[str, Location]
    ) -> None:
        """Add an entry to an array, or change the keys of an included file's entry of the same name."""
        entries = self.data.setdefault(key, [])
        self.origins.setdefault((key,), (layer, (key,)))
        name = table.get("name") if isinstance(table, dict) else None
        for j, known in enumerate(entries):
            included = self.origins[(key, j)][0] is not layer
            if key in _NAMED and included and name is not None and known.get("name") == name:
                for changed, value in table.items():
                    if changed in defaulted:
                        continue
                    self._forget((key, j, changed))
                    known[changed] = value
                    self.origins[(key, j, changed)] = (layer, (*raw, changed))
                return
        place: Location = (key, len(entries))
        entries.append(table)
        self.origins[place] = (layer, raw)
        for one, location in defaulted.items():
            self.origins[(*place, one)] = (layer, location)

    # ---- copies ----

    def _copies(self, raw: Table, table: Table, place: Location) -> Iterator[tuple[Table, Texts]]:
        """The copies of a table, each with the expressions of its computed numbers. raw: the table as written."""
        if "repeat" not in raw:
            texts: Texts = {}
            yield self.values(table, self.names, place, texts), texts
            return
        settings = self._settings(raw["repeat"], (*place, "repeat"))
        if settings is None:
            return
        copies, local = settings
        for k in range(copies.count or 0):
            names = {**self.names, "k": float(k + 1), **{name: one[k] for name, one in local.items()}}
            texts = {}
            copied = self.values(table, names, place, texts, pattern=True)
            yield _placed(copied, partial(copies.place, k)), texts

    def _settings(self, repeat: Any, here: Location) -> tuple[Repeat, dict[str, list[Any]]] | None:
        """The checked `repeat` table, and the lists of values per copy; None if something is wrong."""
        if not isinstance(repeat, dict):
            remedy = 'write repeat = { count = 6, about = "z" }'
            self.refuse(here, "must be a table", shown(repeat), remedy)
            return None
        before = len(self.findings)
        given = self.values(repeat, self.names, here)
        local = {name: value for name, value in given.items() if name not in Repeat.model_fields}
        for name, value in local.items():
            if not isinstance(value, list) or not name.isidentifier() or name == "k":
                known = one_of(list(Repeat.model_fields))
                must_hold = f"values per copy are lists by names of their own; known keys are {known}"
                self.refuse((*here, name), must_hold, shown(value), "write for instance x = [1, 2, 3]")
        lengths = {len(value) for value in local.values() if isinstance(value, list)}
        own: Table = {"count": max(lengths)} if lengths else {}
        own |= {key: value for key, value in given.items() if key not in local}
        count = own.get("count")
        own |= {"count": int(count)} if isinstance(count, float) and count.is_integer() else {}
        made = self._checked(Repeat, own, here)
        for name, value in local.items():
            if made is not None and isinstance(value, list) and len(value) != made.count:
                must_hold = f"must have one value for each of the {made.count} copies"
                self.refuse((*here, name), must_hold, f"{len(value)} values", "list one for each copy")
        return None if len(self.findings) > before or made is None else (made, local)

    def _checked(self, table: type[_Pattern], given: Table, here: Location) -> _Pattern | None:
        """The checked table of copies or of an image; None if something is wrong."""
        found = schema_findings(table, given)
        self.findings += [replace(one, location=(*here, *one.location)) for one in found]
        return None if found else table.model_validate(given)

    def _images(
        self, mirror: Any, copies: list[tuple[Table, Texts]], here: Location
    ) -> list[tuple[Table, Texts]]:
        """The images of copies in one mirror."""
        given = {"plane": mirror} if isinstance(mirror, str) else mirror
        if not isinstance(given, dict) or 2 * len(copies) > MOST_COPIES:
            remedy = 'write mirror = "x", or mirror = { plane = "x", at_mm = 10, name = "{name} left" }'
            self.refuse(here, 'must be the plane, "x", "y" or "z"', shown(mirror), remedy)
            return []
        image = self._checked(Image, self.values(given, self.names, here), here)
        return [] if image is None else [(self._image(one, image, here), texts) for one, texts in copies]

    def _image(self, table: Table, mirror: Image, here: Location) -> Table:
        usual = "{name}_mirrored_" if here[0] == "coil" else "{name} mirrored "
        image = copy.deepcopy(table)
        if isinstance(table.get("name"), str):
            names = {**self.names, "name": table["name"]}
            pattern = usual + mirror.plane if mirror.name is None else mirror.name
            image["name"] = self._filled(pattern, names, here)
        for part in (image, *_part_tables(image)):
            self._reflect(part, mirror.axis, here)
        return _placed(image, mirror.place)

    def _reflect(self, table: Table, axis: int, here: Location) -> None:
        """Reflect a shape or winding that is not symmetric. Wrong keys stay; the schema refuses them later."""
        # A value that is not a text becomes a str that names no shape.
        keys = SHAPE_KEYS.get(str(table.get("shape"))) or COIL_KEYS.get(str(table.get("kind")))
        own = {key: value for key, value in table.items() if keys is not None and key in keys.model_fields}
        if keys is None or schema_findings(keys, own):
            return
        record = record_of(keys.model_validate(own))
        try:
            reflected = record.reflected(axis)
        except InputError as error:
            for one in error.problems:
                self.refuse(here, f"must be {one.must_hold}", one.received, one.remedy)
            return
        if reflected is not record:
            for key in Writing("").table(record, keys):
                del table[key]
            table |= Writing("").table(reflected, keys)


def _placed(table: Table, change: Callable[[list[float], list[float]], Place]) -> Table:
    """A table with its place, or the places of its parts, changed. Wrong places stay; the schema refuses them later.

    A table without a place gets none if it stays at the origin: an included body of its name may have one.
    """
    for one in _part_tables(table) or [table]:
        position, rotation = one.get("position_mm", [0.0] * 3), one.get("rotation_deg", [0.0] * 3)
        if _is_vector(position) and _is_vector(rotation):
            position, rotation = change(position, rotation)
            if any(position) or "position_mm" in one:
                one["position_mm"] = position
            if any(rotation) or "rotation_deg" in one:
                one["rotation_deg"] = rotation
    return table


def _part_tables(table: Table) -> list[Table]:
    parts = table.get("part")
    return [part for part in parts if isinstance(part, dict)] if isinstance(parts, list) else []


def _is_vector(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(is_number, value))
