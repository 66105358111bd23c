"""Shapes of coils, one module each. A module in this folder adds a choice to device files, and so does a module that an
installed package names as an entry point of the group "fieldmap.coils". docs/extend.md has the steps.
"""

from pathlib import Path
from typing import Any

from fieldmap.device.coils.base import Coil
from fieldmap.device.coils.winding import WindingPath
from fieldmap.device.placement import PLACEMENT
from fieldmap.extensions import import_modules, installed_modules
from fieldmap.inputs.declared import choice_of, kinds_of, table_of

import_modules(__name__, Path(__file__).parent)
installed_modules("fieldmap.coils")

__all__ = ["COIL_KEYS", "AnyCoil", "Coil", "WindingPath"]

COIL_KEYS: dict[str, Any] = {
    kind: table_of(shape, "kind", beside={"placement": PLACEMENT}) for kind, shape in kinds_of(Coil).items()
}
"""Tables of device files, by kind."""

AnyCoil: Any = choice_of(COIL_KEYS.values(), "kind")
