"""Material laws, one module each. A module that is put into this folder is a choice of device files.

A law is a frozen class (`fieldmap.device.materials.base.Material`) and the keys of its [material.NAME] table
(`MaterialKeys`), which register themselves. CONTRIBUTING.md has the steps.
"""

import importlib
import pkgutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, Union

from pydantic import Tag

from fieldmap.device.materials.base import (
    Curves,
    LawPoints,
    Material,
    MaterialKeys,
    SaturatingMaterial,
    keys_of_table,
    material_choices,
)
from fieldmap.inputs.tables import chosen_with

for _module in pkgutil.iter_modules([str(Path(__file__).parent)]):
    importlib.import_module(f"{__name__}.{_module.name}")

__all__ = [
    "AnyMaterial",
    "Curves",
    "LawPoints",
    "Material",
    "MaterialKeys",
    "SaturatingMaterial",
    "keys_of_table",
    "material_choices",
]


def _tag(table: dict[str, Any]) -> Any:
    keys = keys_of_table(table)
    return table.get("kind") if keys is None else keys.tag


if TYPE_CHECKING:
    AnyMaterial: TypeAlias = MaterialKeys
else:
    # The keys of all laws, chosen by the table.
    AnyMaterial = Annotated[
        Union[tuple(Annotated[keys, Tag(keys.tag)] for keys in material_choices())],  # noqa: UP007
        chosen_with(_tag),
    ]
