"""Kinds of files that people write: how they are found, read and distinguished.

The marks of all kinds are listed here, so that a reader recognises files of packages above it without importing them.
The schema of a kind is in the package that reads it.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from fieldmap.errors import InputError
from fieldmap.inputs.document import Document, parse, schema_findings
from fieldmap.inputs.findings import meant, one_of
from fieldmap.records import Record
from fieldmap.shipped import is_file, shipped_alone, shipped_file, shipped_names
from fieldmap.typing import PathLike

Contents = TypeVar("Contents", bound=BaseModel)


@dataclass(frozen=True, repr=False)
class Marks(Record):
    """Marks that distinguish a kind of file.

    keys: top-level keys. key, value: a key and value that only this kind has; they take precedence over `keys`.
    taken_by: the command or function that reads such a file, for the error of another reader.
    """

    keys: frozenset[str]
    taken_by: str
    key: str = ""
    value: str = ""


MARKS: Mapping[str, Marks] = MappingProxyType(
    {
        "device": Marks(
            frozenset({"coil", "body", "material", "payload", "driver", "workspace", "include"}),
            "`fieldmap check` takes it",
        ),
        "material": Marks(
            frozenset({"H_A_per_m", "B_T"}), 'a device file names it: kind = "bh_table", file = "..."'
        ),
        "planar device": Marks(
            frozenset({"coil", "body", "material", "payload", "walls"}),
            "fieldmap.planar.read_planar_device reads it",
            "space",
            "plane",
        ),
        "recipe": Marks(frozenset({"spacing_mm", "box"}), "`fieldmap map` takes it"),
        "study": Marks(
            frozenset({"vary", "variant", "optimise"}),
            "`fieldmap study` takes it, or `fieldmap optimise` where it has [optimise]",
        ),
        "fit": Marks(frozenset({"unknown"}), "`fieldmap fit` takes it"),
        "scenario": Marks(
            frozenset({"control", "duration_s", "sensors", "start"}), "`fieldmap simulate` takes it"
        ),
    }
)
"""Marks of every kind, by its name."""


@dataclass(frozen=True, repr=False)
class FileKind(Record, Generic[Contents]):
    """One kind of TOML file.

    name: such as "device", a name in `MARKS`. schema: allowed contents. error: raised for a wrong file. folder,
    subfolder: of the shipped files of this kind. refers_to: kinds of file that a file of this kind names, each with a
    remedy for a reader that was given such a file instead; {file} stands for its name. json_schema: file of the shipped
    JSON Schema. expand: writes out the short forms of a file; raises `error`. short_forms: top-level keys that `expand`
    removes.
    """

    name: str
    schema: type[Contents]
    error: type[InputError]
    folder: str
    subfolder: str = ""
    refers_to: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    json_schema: str | None = None
    expand: Callable[[Document], Document] | None = None
    short_forms: frozenset[str] = frozenset()

    def find(self, path_or_name: PathLike) -> Path:
        """The file at a path, or the shipped file of that name. Raises `error` for a directory or a missing file.

        A name without a folder and an ending means the shipped file, whatever lies in the working folder. If a file of
        this kind has the same name there, the name is refused.
        """
        if not isinstance(path_or_name, str | os.PathLike):
            must_hold, remedy = f"must be the path or name of a {self.name} file", "write it in quotes"
            raise self.error.of(self.name, must_hold, type(path_or_name).__name__, remedy)
        path = Path(path_or_name)
        alone = shipped_alone(self.folder, path_or_name, self.subfolder)
        if alone is not None:
            self._refuse_a_second(path, alone)
            return alone
        if is_file(path):
            return path
        if os.path.isdir(path):
            raise self.error.of(str(path), "must be a file", "a directory", "name the file inside it")
        shipped = shipped_file(self.folder, str(Path(self.subfolder) / path))
        if shipped is not None:
            return shipped
        names = [Path(name).name for name in shipped_names(self.folder, self.subfolder)]
        remedy = meant(path.stem, names, f"give a path, or one of {one_of(names)}")
        must_hold = f"must be a {self.name} file or the name of a shipped {self.name}"
        raise self.error.of(str(path), must_hold, "no such file", remedy)

    def _refuse_a_second(self, path: Path, shipped: Path) -> None:
        """Raise `error` where a readable file of this kind has the name of a shipped one."""
        try:
            here = kind_of(parse(path, self.error).data) if is_file(path) else None
        except self.error:
            return
        if here == self.name:
            must_hold = f"must name one {self.name}"
            received = f"the name of the shipped {self.name} and of a file in the working folder"
            remedy = f"write .{os.sep}{path} for the file, or {shipped} for the shipped one"
            raise self.error.of(str(path), must_hold, received, remedy)

    def load(self, path: Path) -> Document:
        """The file, parsed; raises `error` if it cannot be read, or is clearly of another kind."""
        return self.prepared(parse(path, self.error))

    def prepared(self, document: Document) -> Document:
        """A parsed document with its short forms written out; raises `error` as `load`."""
        self.refuse_other_kinds(document)
        return document if self.expand is None else self.expand(document)

    def contents(self, document: Document) -> Contents:
        """The document as an instance of its schema; raises `error` with one Problem for every error of the file."""
        findings = schema_findings(self.schema, document.data)
        if findings:
            raise self.error(*document.problems(findings))
        return self.schema.model_validate(document.data)

    def refuse_other_kinds(self, document: Document) -> None:
        """Raise `error` if the document is clearly of another kind. A document of unknown kind passes."""
        data = document.data
        known = self.schema.model_fields.keys() | self.short_forms
        if MARKS[self.name].keys & data.keys() and data.keys() <= known:
            return
        found = kind_of(data)
        if found is None or found == self.name:
            return
        marks = MARKS[found]
        key = marks.key or next(key for key in data if key in marks.keys)
        remedy = marks.taken_by
        if found in self.refers_to:
            remedy += "; " + self.refers_to[found].format(file=document.path.name)
        received = f'a {found} file, by its key "{key}"'
        raise self.error.of(str(document.path), f"must be a {self.name} file", received, remedy)


def kind_of(data: Mapping[str, Any]) -> str | None:
    """The kind of a file's data, by the largest number of its marks; None if no kind or several kinds fit.

    >>> kind_of({"format": 1, "coil": []}), kind_of({"format": 1})
    ('device', None)
    """
    for name, marks in MARKS.items():
        if marks.key and data.get(marks.key) == marks.value:
            return name
    found = {name: len(marks.keys & data.keys()) for name, marks in MARKS.items() if not marks.key}
    most = max(found.values())
    best = [name for name, count in found.items() if count == most > 0]
    return best[0] if len(best) == 1 else None
