"""Shapes of iron. A module in this folder adds choices to device files, and so does a module that an installed package
names as an entry point of the group "fieldmap.shapes". docs/extend.md has the steps.
"""

from pathlib import Path
from typing import Any

from fieldmap.device.shapes.base import Shape, ShapeOfFile
from fieldmap.extensions import import_modules, installed_modules
from fieldmap.inputs.declared import kinds_of, table_of

import_modules(__name__, Path(__file__).parent)
installed_modules("fieldmap.shapes")

__all__ = ["SHAPE_KEYS", "Shape", "ShapeOfFile"]

SHAPE_KEYS: dict[str, Any] = {kind: table_of(shape, "shape") for kind, shape in kinds_of(Shape).items()}
"""Tables of device files, by kind."""
