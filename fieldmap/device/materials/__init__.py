"""Material laws, one module each. A module in this folder adds a choice to device files, and so does a module that an
installed package names as an entry point of the group "fieldmap.materials". docs/extend.md has the steps.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from fieldmap.device.materials.base import LawPoints, Material, SaturatingMaterial
from fieldmap.device.materials.bh_table import BHTableFromFileKeys
from fieldmap.extensions import import_modules, installed_modules
from fieldmap.inputs.declared import choice_with, kinds_of, record_of, table_of
from fieldmap.inputs.tables import Table, read_only

import_modules(__name__, Path(__file__).parent)
installed_modules("fieldmap.materials")

__all__ = [
    "MATERIAL_KEYS",
    "AnyMaterial",
    "Curves",
    "LawPoints",
    "Material",
    "SaturatingMaterial",
    "keys_of_table",
    "material_of",
    "named_file",
]

Curves = Mapping[str, tuple[list[float], list[float]]]
"""Field strengths (A/m) and flux densities (T) of measured curves, by the name of their file."""

_FROM_FILE = "bh_table from a file"

MATERIAL_KEYS: dict[str, Any] = {
    **{kind: table_of(law, "kind") for kind, law in kinds_of(Material).items()},
    _FROM_FILE: BHTableFromFileKeys,
}
"""Tables of device files by kind; a B-H table that names a file has an entry of its own."""


def _tag(table: Mapping[str, Any]) -> Any:
    kind = table.get("kind")
    return _FROM_FILE if kind == "bh_table" and "file" in table else kind


def keys_of_table(table: Mapping[str, Any]) -> Any:
    """The class that reads a raw [material.NAME] table; None for an unknown kind."""
    tag = _tag(table)
    return MATERIAL_KEYS.get(tag) if isinstance(tag, str) else None


def named_file(table: Mapping[str, Any]) -> str | None:
    """The material file that a raw table names."""
    file = table["file"] if _tag(table) == _FROM_FILE else None
    return file if isinstance(file, str) else None


def material_of(table: Table, name: str, curves: Curves) -> Material:
    """The material of a table, in SI. curves: of the material files that tables name."""
    more: dict[str, Any] = {}
    if isinstance(table, BHTableFromFileKeys):
        more = dict(zip(("h", "b"), map(read_only, curves[table.file]), strict=True))
    made: Material = record_of(table, name=name, **more)
    return made


if TYPE_CHECKING:
    AnyMaterial: TypeAlias = Table
else:
    AnyMaterial = choice_with(MATERIAL_KEYS, _tag)
