"""What a study file may hold: device, iron, currents, quantities, and variants or what is optimised."""

from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import Field

from fieldmap import records
from fieldmap.errors import StudyError
from fieldmap.inputs.declared import Key, table_of
from fieldmap.inputs.findings import one_of
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import Text, Versioned, broken
from fieldmap.studies.design import OptimiseKeys, Search
from fieldmap.studies.quantities import TAKEN
from fieldmap.studies.study import (
    Axis,
    AxisKeys,
    CurrentsKeys,
    IronKeys,
    OneVariant,
    Record,
    StatedCurrents,
    StudyIron,
)


def _one_of_each(keys: Any) -> None:
    for names in (("device", "recipe"), ("vary", "variant", "optimise")):
        there = [name for name in names if getattr(keys, name)]
        if len(there) != 1:
            received = " and ".join(there) or "none of them"
            raise broken(f"a study has {' or '.join(names)}", received, "give one of them")
    if keys.recipe is not None and keys.iron is not None:
        remedy = "leave [iron] out, or name the device"
        raise broken("iron is that of the recipe", "recipe and [iron]", remedy)


def _names_of_their_own(keys: Any) -> None:
    for what in ("vary", "variant", "currents"):
        names = [entry.name for entry in getattr(keys, what)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise broken(f"every {what} needs a name of its own", one_of(twice), "rename one")
    taken = [entry.name for entry in keys.vary if entry.name in TAKEN]
    if taken:
        must_hold = "the names of the data set's own axes and variables are taken"
        raise broken(must_hold, one_of(taken), "rename it")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StudySettings(records.Record):
    """A study file."""

    title: Annotated[str, Key(Text, "one line about the study")]
    device: Annotated[str | None, Key(Text | None, "device file or name of a shipped device")] = None
    recipe: Annotated[str | None, Key(Text | None, "map recipe, whose device and iron are taken")] = None
    iron: Annotated[StudyIron | None, Key(IronKeys | None, "how the iron is modelled")] = None
    vary: Annotated[tuple[Axis, ...], Key(list[AxisKeys], "[[vary]]: all combinations of these values")] = ()
    variant: Annotated[
        tuple[OneVariant, ...], Key(list[table_of(OneVariant)], "[[variant]]: one by one")  # type: ignore[misc]
    ] = ()
    currents: Annotated[
        tuple[StatedCurrents, ...],
        Key(Annotated[list[CurrentsKeys], Field(min_length=1)], "[[currents]] tables"),
    ]
    record: Annotated[Record, Key(table_of(Record), "the recorded quantities")] = field(
        default_factory=Record
    )
    optimise: Annotated[
        Search | None, Key(OptimiseKeys | None, "instead of variants: a search for the best values")
    ] = None


STUDY = FileKind(
    "study",
    table_of(StudySettings, "", "StudyFile", (Versioned,), rules=(_one_of_each, _names_of_their_own)),
    StudyError,
    "maps",
    "studies",
)
