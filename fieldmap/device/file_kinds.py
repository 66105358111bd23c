"""Which of the four kinds of TOML files a file is, told by its keys, so that the wrong one is named as what it is."""

from pathlib import Path
from typing import Any

from fieldmap.device.document import Document, load_document
from fieldmap.errors import DeviceFileError, FieldmapError, Problem

# Keys that only this kind of file has, and the command that takes it.
_KINDS = {
    "device": ({"coil", "body", "material", "payload", "driver", "workspace"}, "check"),
    "recipe": ({"spacing_mm", "box"}, "map"),
    "scenario": ({"control", "duration_s", "sensors", "start"}, "simulate"),
    "study": ({"vary", "variant"}, "study"),
}


def kind_of(data: dict[str, Any]) -> str | None:
    """Device, recipe, scenario or study; None for data that has keys of no kind, or of several.

    >>> kind_of({"format": 1, "coil": []}), kind_of({"format": 1})
    ('device', None)
    """
    found = [kind for kind, (keys, _) in _KINDS.items() if keys & data.keys()]
    return found[0] if len(found) == 1 else None


def wrong_kind(path: Path, data: dict[str, Any], wanted: str) -> Problem | None:
    """What is wrong with a file that is clearly of another kind than the wanted one; None for any other."""
    found = kind_of(data)
    if found is None or found == wanted:
        return None
    keys, command = _KINDS[found]
    key = next(key for key in data if key in keys)
    remedy = f"`fieldmap {command}` takes it"
    if wanted == "recipe" and found == "device":
        remedy += f'; a recipe names it (device = "{path.name}") and how fine the map shall be (spacing_mm)'
    return Problem(str(path), f"must be a {wanted} file", f'a {found} file, by its key "{key}"', remedy)


def load_input_file(path: Path, what: str, error: type[FieldmapError]) -> Document:
    """The file, parsed; `error` if it cannot be read, or is clearly of another kind than `what`."""
    try:
        document = load_document(path)
    except DeviceFileError as unreadable:
        raise error(*unreadable.problems) from None
    wrong = wrong_kind(path, document.data, what)
    if wrong is not None:
        raise error(wrong)
    return document
