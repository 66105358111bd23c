"""Kinds of files that people write. Each package registers its own; here they are found, read and told apart."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from fieldmap.errors import InputError, Problem
from fieldmap.inputs.document import Document, parse, schema_findings
from fieldmap.inputs.findings import closest, one_of
from fieldmap.records import Record
from fieldmap.shipped import is_file, shipped_file, shipped_names
from fieldmap.typing import PathLike

# Packages that register kinds. They are imported only to say what a file is that the reader at work does not know.
_PACKAGES = ("device", "planar", "maps", "studies", "dynamics")

Contents = TypeVar("Contents", bound=BaseModel)


@dataclass(frozen=True, repr=False)
class FileKind(Record, Generic[Contents]):
    """One kind of TOML file.

    name: as people call it, such as "device". schema: what the file may hold. error: raised for a file that is wrong.
    folder, subfolder: where the shipped files of this kind lie. keys: top-level keys that tell this kind from others.
    mark: a key with the value that only this kind gives it; it goes before keys. taken_by: what reads such a file, for
    people who gave it to something else. refers_to: kinds of file that a file of this kind names, each with a remedy
    for people who gave that file instead; {file} stands for its name. json_schema: file of the shipped JSON Schema.
    expand: writes out the short forms of a file; raises `error`. short_forms: top-level keys that are gone then.
    """

    name: str
    schema: type[Contents]
    error: type[InputError]
    folder: str
    subfolder: str = ""
    keys: frozenset[str] = frozenset()
    mark: tuple[str, str] | None = None
    taken_by: str = ""
    refers_to: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    json_schema: str | None = None
    expand: Callable[[Document], Document] | None = None
    short_forms: frozenset[str] = frozenset()

    def find(self, path_or_name: PathLike) -> Path:
        """The file at a path, or the shipped one of that name; raises `error` if there is neither."""
        if not isinstance(path_or_name, str | os.PathLike):
            must_hold, remedy = f"must be the path or name of a {self.name} file", "write it in quotes"
            raise self.error(Problem(self.name, must_hold, type(path_or_name).__name__, remedy))
        path = Path(path_or_name)
        if is_file(path):
            return path
        shipped = shipped_file(self.folder, str(Path(self.subfolder) / path))
        if shipped is not None:
            return shipped
        names = [Path(name).name for name in shipped_names(self.folder, self.subfolder)]
        guess = closest(path.stem, names)
        remedy = f'did you mean "{guess}"?' if guess else f"give a path, or one of {one_of(names)}"
        must_hold = f"must be a {self.name} file or the name of a shipped {self.name}"
        raise self.error(Problem(str(path_or_name), must_hold, "no such file", remedy))

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
        """Raise `error` if the document is clearly of another kind; one of no kind passes."""
        data = document.data
        known = self.schema.model_fields.keys() | self.short_forms
        if self.keys & data.keys() and data.keys() <= known:
            return
        found = kind_of(data)
        if found is None or found is self:
            return
        key = found.mark[0] if found.mark else next(key for key in data if key in found.keys)
        remedy = found.taken_by
        if found.name in self.refers_to:
            remedy += "; " + self.refers_to[found.name].format(file=document.path.name)
        received = f'a {found.name} file, by its key "{key}"'
        raise self.error(Problem(str(document.path), f"must be a {self.name} file", received, remedy))

    def is_marked(self, data: Mapping[str, Any]) -> bool:
        """Does the data carry the mark of this kind?"""
        return self.mark is not None and data.get(self.mark[0]) == self.mark[1]


_KINDS: dict[str, FileKind[Any]] = {}


def register(kind: FileKind[Contents]) -> FileKind[Contents]:
    """Enter a kind into the list of those that are told apart, and return it."""
    _KINDS[kind.name] = kind
    return kind


def every_kind() -> list[FileKind[Any]]:
    """The kinds of all packages."""
    for package in _PACKAGES:
        import_module(f"fieldmap.{package}")
    return list(_KINDS.values())


def kind_of(data: Mapping[str, Any]) -> FileKind[Any] | None:
    """The kind of a file's data: the one that knows the most of its keys; None if there is none, or several.

    >>> kind_of({"format": 1, "coil": []}).name, kind_of({"format": 1})
    ('device', None)
    """
    kinds = every_kind()
    for kind in kinds:
        if kind.is_marked(data):
            return kind
    found = [kind for kind in kinds if kind.mark is None and kind.keys & data.keys()]
    known = [len(data.keys() & kind.schema.model_fields.keys()) for kind in found]
    best = [kind for kind, count in zip(found, known, strict=True) if count == max(known)]
    return best[0] if len(best) == 1 else None
