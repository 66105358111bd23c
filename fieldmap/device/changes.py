"""A device file with some keys set to other values: for variants of a study, and for one run of a command."""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.device.cross_checks import all_paths
from fieldmap.device.expansion import expand
from fieldmap.errors import DeviceFileError
from fieldmap.inputs.document import Document
from fieldmap.inputs.findings import Finding, meant, shown
from fieldmap.inputs.key_paths import Location, matches, value_at

Settings = Iterable[tuple[str, Any]]


def changed(document: Document, settings: Settings) -> Document:
    """The document with some keys set. A float without fraction replaces a whole number as a whole number.

    Parameters are set first, and values that depend on them are computed anew. A key that the document lacks is
    ignored; `key_finding` reports it.
    """
    settings = list(settings)
    stated = {
        key: [value_at(document.data, place) for place in matches(document.data, key)] for key, _ in settings
    }
    parameters = _parameters(document, settings)
    if parameters and document.raw is not None:
        document = expand(document.raw, parameters)
    data = copy.deepcopy(document.data)
    places = {place: document.origins[place] for place in document.origins}
    computed = dict(document.computed)
    given = Document(Path(f"{document.path.name}, as changed"), "", {})
    for pattern, value in settings:
        for location in matches(data, pattern):
            if location[0] == "parameters":
                continue
            table, before = value_at(data, location[:-1]), value_at(data, location)
            whole = isinstance(before, int) and isinstance(value, float) and value.is_integer()
            table[location[-1]] = int(value) if whole else value
            computed.pop(location, None)
            places[location] = (given, location)
    return replace(
        document, data=data, origins=places, computed=computed, changes=dict(settings), stated=stated
    )


def with_changes(document: Document, changes: Mapping[str, Any]) -> Document:
    """The document with existing keys set. Raises DeviceFileError with one Problem for every key that it lacks."""
    if not isinstance(changes, Mapping) or not all(isinstance(key, str) for key in changes):
        must_hold = "must be a mapping of key paths to values"
        remedy = 'write for instance {"parameters.gap": 120.0}'
        raise DeviceFileError.of("changes", must_hold, shown(changes), remedy)
    changes = {key: _plain(value) for key, value in changes.items()}
    parameters = {key: value for key, value in changes.items() if _is_parameter(key)}
    after = changed(document, parameters.items()) if parameters else document
    wrong = [key_finding((key,), key, document, arrays=True) for key in parameters]
    wrong += [key_finding((key,), key, after, arrays=True) for key in changes if key not in parameters]
    found = [finding for finding in wrong if finding is not None]
    if found:
        # Reported without a line, since no line of the document has the wrong key.
        raise DeviceFileError(*Document(document.path, "", {}).problems(found))
    return changed(document, changes.items())


def key_finding(location: Location, key: str, document: Document, arrays: bool = False) -> Finding | None:
    """The finding for a key that cannot be set: the document lacks it, or it holds a table. location: of the finding.

    arrays: whether a key that holds an array of numbers or texts may be set.
    """
    at = matches(document.data, key)
    if at and all(_is_value(value_at(document.data, place), arrays) for place in at):
        return None
    others = [path for path in all_paths(document.data) if path != key]
    remedy = meant(key, others, "write the key into the device file, with a value to begin with")
    received = shown(key) + (", a table" if at and arrays else ", an array or a table" if at else "")
    must_hold = f"must be a key with {'a' if arrays else 'one'} value in {document.path.name}"
    return Finding(location, must_hold, received, remedy)


def _is_value(value: Any, arrays: bool) -> bool:
    if isinstance(value, list):
        return arrays and not any(isinstance(entry, dict) for entry in value)
    return isinstance(value, int | float | str)


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists, which TOML knows."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _is_parameter(key: str) -> bool:
    return key.startswith("parameters.")


def _parameters(document: Document, settings: Settings) -> dict[str, Any]:
    """Values of the parameters that are set, by name; the whole list if one of its entries is set."""
    given: dict[str, Any] = {}
    for pattern, value in settings:
        for location in matches(document.data, pattern) if _is_parameter(pattern) else ():
            name, entry = location[1], location[2:]
            if not entry:
                given[str(name)] = value
                continue
            if name not in given:
                entries = value_at(document.data, location[:2])
                given[str(name)] = [
                    document.computed.get((*location[:2], k), one) for k, one in enumerate(entries)
                ]
            given[str(name)][entry[0]] = value
    return given
