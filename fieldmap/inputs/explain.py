"""Findings for people from the errors of a schema, with the keys and choices that the schema allows at each place."""

from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag
from pydantic_core import ErrorDetails

from fieldmap.inputs.findings import Finding, meant, one_of, shown
from fieldmap.inputs.key_paths import Location, has, value_at
from fieldmap.inputs.tables import PATTERNS, Choice, Table
from fieldmap.records import Record


@dataclass(frozen=True, repr=False)
class Place(Record):
    """The table class that the data chose at a location, the choices there by tag, and the key that chooses."""

    table: type[BaseModel] | None
    choices: dict[str, type[BaseModel]]
    choosing_key: str = ""


def without_tags(data: Any, location: Location) -> Location:
    """Remove the names of union members, which pydantic puts into a location; keep what is in the data."""
    plain: Location = ()
    for k, step in enumerate(location):
        here = value_at(data, plain)
        # The last step may be a key that is missing from a table.
        missing_key = k == len(location) - 1 and isinstance(here, dict)
        if step == "[key]" or not (has(here, step) or missing_key):
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
        return Place(None, members, _choosing_key(here))
    return Place(here if _is_table(here) else None, choices)


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


def _choosing_key(annotation: Any) -> str:
    """The key by which people choose a member of a tagged union, looking through `| None`."""
    while True:
        for extra in get_args(annotation)[1:] if get_origin(annotation) is Annotated else ():
            if isinstance(extra, Choice):
                return extra.key
        plain = _plain(annotation)
        if not _is_union(plain):
            return ""
        tagged = [member for member in get_args(plain) if get_origin(member) is Annotated]
        if len(tagged) != 1:
            return ""
        annotation = tagged[0]


def _below(annotation: Any, step: Any) -> Any:
    """The annotation of an entry or a key."""
    annotation = _plain(annotation)
    if _is_table(annotation):
        field = annotation.model_fields.get(step)
        chosen = [extra for extra in field.metadata if isinstance(extra, Choice)] if field else []
        if field and chosen:
            return Annotated[field.annotation, chosen[0]]
        annotation = _plain(field.annotation) if field else None
        tables = [member for member in get_args(annotation) if _is_table(member)]
        return tables[0] if _is_union(annotation) and tables else annotation
    arguments = get_args(annotation)
    return arguments[-1] if get_origin(annotation) in (list, dict) else None


REQUIRED = "this key is required"


def explain(error: ErrorDetails, root: type[BaseModel], data: Any) -> Finding:
    """The finding for one error that validating `data` against `root` raised."""
    location = without_tags(data, error["loc"])
    kind = error["type"]
    if kind == "rule":
        context = error["ctx"]
        return Finding(location, context["must_hold"], context["received"], context["remedy"])
    if kind == "missing":
        return _missing(location, place_at(root, data, error["loc"][:-1]))
    if kind == "extra_forbidden":
        return _unknown_key(location, place_at(root, data, error["loc"][:-1]))
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _choice(location, place_at(root, data, error["loc"]), error["input"])
    context, received = error.get("ctx", {}), shown(error["input"])
    if kind in ("too_short", "too_long"):
        received = f"{context['actual_length']} entries, {received}"
    if kind in _TOLD:
        must_hold, remedy = _TOLD[kind]
        return Finding(location, must_hold.format(**context), received, remedy)
    # An error kind that no schema uses today gets pydantic's own words.
    must_hold, remedy = PATTERNS.get(context.get("pattern", ""), (error["msg"], "correct the value"))
    return Finding(location, must_hold, received, remedy)


def _missing(location: Location, place: Place) -> Finding:
    key = str(location[-1])
    field = place.table.model_fields.get(key) if place.table else None
    about = field.description if field else None
    return Finding(location, REQUIRED, "nothing", f"add {key}" + (f" ({about})" if about else ""))


def _unknown_key(location: Location, place: Place) -> Finding:
    key, known = str(location[-1]), list(place.table.model_fields) if place.table else []
    owners = [tag for tag, table in place.choices.items() if key in table.model_fields]
    remedy = meant(key, known, "remove it", quote="")
    if owners:
        remedy = f"{key} belongs to {one_of(owners)}: remove it, or change the table to that"
    return Finding(location, f"known keys here are {', '.join(known)}", f'the unknown key "{key}"', remedy)


def _choice(location: Location, place: Place, table: Any) -> Finding:
    """The finding for a table whose kind is missing or unknown."""
    if not isinstance(table, dict):
        must_hold, remedy = _AS_TABLE
        return Finding(location, must_hold, shown(table), remedy)
    key = place.choosing_key
    chosen_by = [t.model_fields[key].annotation for t in place.choices.values() if key in t.model_fields]
    names = list(dict.fromkeys(word for one in chosen_by for word in get_args(one)))
    allowed = f"{key} must be one of {one_of(names)}"
    if key not in table:
        others = [t.written_as for t in place.choices.values() if issubclass(t, Table) and t.written_as]
        remedy = ", or ".join([f'add {key} = "{names[0]}" or another', *others])
        return Finding((*location, key), allowed, "nothing", remedy)
    remedy = meant(table[key], names, "choose one of these")
    return Finding((*location, key), allowed, shown(table[key]), remedy)


_CORRECT = "correct the number; its unit is the last part of the key"
_AS_TABLE = "must be a table", "write it as [header] with its keys below, not as a value"
_TOLD = {
    "float_type": ("must be a number", "write it without quotes, for example 12.5"),
    "int_type": ("must be a whole number", "write it without quotes and without a decimal point"),
    "finite_number": (
        "must be a finite number",
        "replace nan or inf by a number, or leave the key out if it is optional",
    ),
    "string_type": ("must be a text", 'put it in quotes, for example "steel"; quote dotted keys as well'),
    "string_too_short": ("must not be empty", "write a few words"),
    "list_type": (
        "must be an array",
        "write [a, b, c], or [[double brackets]] around the header of a repeated table",
    ),
    "dict_type": _AS_TABLE,
    "model_type": _AS_TABLE,
    "model_attributes_type": _AS_TABLE,
    "greater_than": ("must be greater than {gt:g}", _CORRECT),
    "greater_than_equal": ("must be at least {ge:g}", _CORRECT),
    "less_than": ("must be less than {lt:g}", _CORRECT),
    "less_than_equal": ("must be at most {le:g}", _CORRECT),
    "too_short": ("needs at least {min_length} entries", "add what is missing"),
    "too_long": ("takes at most {max_length} entries", "remove what is too much"),
    "literal_error": ("must be {expected}", "write it exactly so"),
}
"""(must hold, remedy) of the simple errors."""
