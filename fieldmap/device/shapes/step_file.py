"""Solids of STEP files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from fieldmap.device.shapes.base import ShapeOfFile
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, Text


@dataclass(frozen=True, repr=False)
class StepFile(ShapeOfFile):
    """Solids of a STEP file.

    `scale` turns the file's length unit into metres.
    """

    kind: ClassVar[str] = "step_file"
    program: ClassVar[str] = "STEP"
    instead_of_mirror: ClassVar[str] = "make the mirrored solid in the program that wrote the file"

    path: Annotated[Path, Key(Text, "path of the STEP file, relative to the device file", name="file")]
    scale: Annotated[float, Key(Length, "length of the STEP file's unit", "mm", "unit")] = 1e-3
