"""Shapes of coils, one module each. A module that is put into this folder is a choice of device files.

A shape is a frozen class (`fieldmap.device.coils.base.Coil`) and the keys of its [[coil]] table (`CoilKeys`), which
register themselves. CONTRIBUTING.md has the steps.
"""

import importlib
import pkgutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias, Union

from pydantic import Tag

from fieldmap.device.coils.base import Coil, CoilKeys, CoilName, coil_choices
from fieldmap.device.coils.winding import WindingPath
from fieldmap.inputs.tables import chosen_by

for _module in pkgutil.iter_modules([str(Path(__file__).parent)]):
    importlib.import_module(f"{__name__}.{_module.name}")

__all__ = ["AnyCoil", "Coil", "CoilKeys", "CoilName", "WindingPath", "coil_choices"]

if TYPE_CHECKING:
    AnyCoil: TypeAlias = CoilKeys
else:
    # The keys of all shapes, chosen by `kind`.
    AnyCoil = Annotated[
        Union[tuple(Annotated[keys, Tag(kind)] for kind, keys in coil_choices().items())],  # noqa: UP007
        chosen_by("kind"),
    ]
