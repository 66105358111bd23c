"""The devices of a study: the device file's data with some keys changed."""

import copy
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from fieldmap.device.cross_checks import all_paths
from fieldmap.device.reader import device_of
from fieldmap.errors import DeviceFileError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding, closest, shown
from fieldmap.inputs.key_paths import Location, dotted, matches, value_at
from fieldmap.studies.schema import StudyFile, VaryKeys
from fieldmap.studies.study import Axis, Value, Variant, setting_words

Settings = tuple[tuple[str, Value], ...]
LARGEST_STUDY = 10_000


def axes_of(contents: StudyFile) -> tuple[Axis, ...]:
    """The varied keys; none where the variants are listed one by one."""
    return tuple(Axis(entry.name, entry.key, tuple(entry.values)) for entry in contents.vary)


def changed(document: Document, settings: Settings) -> Document:
    """The document with some keys set; a whole number stays one where both are."""
    data = copy.deepcopy(document.data)
    for pattern, value in settings:
        for location in matches(data, pattern):
            table, before = value_at(data, location[:-1]), value_at(data, location)
            whole = isinstance(before, int) and isinstance(value, float) and value.is_integer()
            table[location[-1]] = int(value) if whole else value
    return replace(document, data=data)


def key_findings(contents: StudyFile, document: Document) -> list[Finding]:
    """Keys that the device file does not have, and studies of too many variants."""
    known: list[str] = []
    found = []
    for location, key in _keys(contents):
        at = matches(document.data, key)
        if at and all(isinstance(value_at(document.data, place), int | float | str) for place in at):
            continue
        known = known or all_paths(document.data)
        guess = closest(key, [path for path in known if path != key])
        remedy = (
            f'did you mean "{guess}"?'
            if guess
            else "write the key into the device file, with a value to begin with"
        )
        received = shown(key) + (", an array or a table" if at else "")
        found.append(
            Finding(location, f"must be a key with one value in {document.path.name}", received, remedy)
        )
    found += _set_twice(contents, document)
    count = 1
    for entry in contents.vary:
        count *= len(entry.values)
    if max(count, len(contents.variant)) > LARGEST_STUDY:
        must_hold = f"a study has at most {LARGEST_STUDY} variants"
        found.append(Finding(("vary",), must_hold, f"{count}", "leave out values, or make several studies"))
    return found


def _set_twice(contents: StudyFile, document: Document) -> Iterator[Finding]:
    """Keys that two tables of [[vary]], or two lines of one, set."""
    first: dict[Location, Location] = {}
    for location, key in _keys(contents) if contents.vary else ():
        for place in matches(document.data, key):
            if first.setdefault(place, location) != location:
                received = f"{dotted(document.data, place)}, set before by another one"
                yield Finding(location, "every key is set once", received, "leave one of them out")
                break


def _keys(contents: StudyFile) -> Iterator[tuple[Location, str]]:
    for k, entry in enumerate(contents.vary):
        yield ("vary", k, "key"), entry.key
        for j, linked in enumerate(entry.linked):
            for i, key in enumerate(linked.keys):
                yield ("vary", k, "linked", j, "keys", i), key
    for k, variant in enumerate(contents.variant):
        for key in variant.set:
            yield ("variant", k, "set", key), key


def variants_of(contents: StudyFile, document: Document) -> tuple[Variant, ...]:
    """All variants, the last axis fastest. The device files are not checked here."""
    if contents.variant:
        return tuple(
            Variant(entry.name, (k,), tuple(entry.set.items()), changed(document, tuple(entry.set.items())))
            for k, entry in enumerate(contents.variant)
        )
    return tuple(_combined(contents.vary, place, document) for place in _places(contents.vary))


def _places(vary: Sequence[VaryKeys]) -> Iterator[tuple[int, ...]]:
    return itertools.product(*(range(len(entry.values)) for entry in vary))


def _combined(vary: Sequence[VaryKeys], place: tuple[int, ...], document: Document) -> Variant:
    values = {entry.name: entry.values[k] for entry, k in zip(vary, place, strict=True)}
    settings = tuple(pair for entry in vary for pair in _settings(entry, values[entry.name]))
    return Variant(setting_words(values), place, settings, changed(document, settings))


def _settings(entry: VaryKeys, value: Any) -> Iterator[tuple[str, Value]]:
    yield entry.key, value
    for linked in entry.linked:
        for key in linked.keys:
            yield key, linked.offset + linked.factor * value


def variant_findings(contents: StudyFile, variants: tuple[Variant, ...]) -> list[Finding]:
    """What the device schema refuses in a variant, each complaint once, at the study's table that causes it."""
    found: dict[tuple[str, str, str], Finding] = {}
    for number, variant in enumerate(variants):
        try:
            device_of(variant.document)
        except DeviceFileError as error:
            location: Location = ("variant", number) if contents.variant else ("vary",)
            for problem in error.problems:
                key = problem.where.split(": ", 1)[-1]
                location = _cause(contents, variant, key) or location
                must_hold = f"{key} of the device {problem.must_hold}"
                received = f"{problem.received} in the variant {variant.name}"
                same = (key, problem.must_hold, problem.received)
                found.setdefault(same, Finding(location, must_hold, received, problem.remedy))
    return list(found.values())


def _cause(contents: StudyFile, variant: Variant, key: str) -> Location | None:
    """The axis whose key, or one that follows it, is the one complained about."""
    for k, entry in enumerate(contents.vary):
        patterns = [(("vary", k, "values"), entry.key)]
        patterns += [(("vary", k, "linked"), name) for linked in entry.linked for name in linked.keys]
        for location, pattern in patterns:
            places = matches(variant.document.data, pattern)
            if set(places) & set(matches(variant.document.data, key)):
                return location
    return None
