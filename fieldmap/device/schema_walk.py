"""Which keys and choices does the schema know at a place? Follows the annotations of the schema classes."""

from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag

from fieldmap.device.key_paths import Location, has, value_at


@dataclass(frozen=True)
class Place:
    """The table class that the data chose at a location, and the other choices it had there by tag."""

    table: type[BaseModel] | None
    choices: dict[str, type[BaseModel]]

    def keys(self) -> list[str]:
        """Known keys of this table."""
        return list(self.table.model_fields) if self.table else []

    def owners(self, key: str) -> list[str]:
        """Tags of the choices that know the key."""
        return [tag for tag, table in self.choices.items() if key in table.model_fields]


def without_tags(data: Any, location: Location) -> Location:
    """Remove the names of union members, which pydantic puts into a location; keep what is in the data."""
    plain: Location = ()
    for k, step in enumerate(location):
        if step == "[key]" or (not has(value_at(data, plain), step) and k < len(location) - 1):
            continue
        plain = (*plain, step)
    return plain


def place_at(root: type[BaseModel], data: Any, location: Location) -> Place:
    """Walk from the root along a location of pydantic (with tags) to the table that it ends in."""
    here: Any = root
    choices: dict[str, type[BaseModel]] = {}
    for step in location:
        members = _members(here)
        if members:
            choices, here = members, members.get(str(step))
            continue
        choices = {}
        here = _below(here, step)
    if members := _members(here):
        return Place(None, members)
    return Place(here if _is_table(here) else None, choices)


def description(table: type[BaseModel] | None, key: str) -> str | None:
    """What the schema says about a key."""
    field = table.model_fields.get(key) if table else None
    return field.description if field else None


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _plain(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def _is_union(annotation: Any) -> bool:
    return get_origin(annotation) in (Union, UnionType)


def _members(annotation: Any) -> dict[str, type[BaseModel]]:
    """Tag -> class of a tagged union, looking through `| None`."""
    annotation = _plain(annotation)
    if not _is_union(annotation):
        return {}
    members: dict[str, type[BaseModel]] = {}
    for member in get_args(annotation):
        tags = [extra.tag for extra in get_args(member)[1:] if isinstance(extra, Tag)]
        members |= {tags[0]: _plain(member)} if tags else _members(member)
    return members


def _below(annotation: Any, step: Any) -> Any:
    """The annotation of an entry or a key."""
    annotation = _plain(annotation)
    if _is_table(annotation):
        field = annotation.model_fields.get(step)
        annotation = _plain(field.annotation) if field else None
        tables = [member for member in get_args(annotation) if _is_table(member)]
        return tables[0] if _is_union(annotation) and tables else annotation
    arguments = get_args(annotation)
    return arguments[-1] if get_origin(annotation) in (list, dict) else None
