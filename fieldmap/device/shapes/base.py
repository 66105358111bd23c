"""What a shape of iron is to the rest of the package, and how a shape of one file becomes a choice of device files.

A shape is a frozen class derived from `Shape`, in a module of its own in `fieldmap.device.shapes`; nothing else names
it. Its fields say how a [[body]] table states them (`fieldmap.inputs.declared`). Local frame: axis along z, base in the
plane z = 0, centred in x and y.
"""

from pathlib import Path
from typing import ClassVar

import numpy as np

from fieldmap.device.made import Made
from fieldmap.errors import InputError
from fieldmap.typing import Array

ROUND = 24
"""Points of a circle in drawings."""


class Shape(Made):
    """A shape of a part of a body."""

    kind: ClassVar[str]
    """The word for the shape in device files."""
    has_own_mesh: ClassVar[bool] = False
    """Whether it is a mesh already: of a body of its own, without `mesh_size`."""

    @property
    def primitive(self) -> "Shape":
        """The shape that solids, symmetry, derivatives and drawings know for it: one of this package's own.

        A new shape gives the cylinder, prism, solid of revolution or closed surface that fills the same space.
        """
        return self

    def hull(self) -> Array:
        """Points (n, 3), m, local frame, whose convex hull is that of the shape; none of a file."""
        return np.zeros((0, 3)) if self.primitive is self else self.primitive.hull()

    def reflected(self, axis: int) -> "Shape":
        """The shape seen in a mirror; the same where it is symmetric.

        Parameters
        ----------
        axis
            Local axis 0 or 1 that is turned over.

        Returns
        -------
        'Shape'
            The shape.

        Raises
        ------
        InputError
            For a file, whose contents nobody turns over.
        """
        return self if self.primitive is self else self.primitive.reflected(axis)


class ShapeOfFile(Shape):
    """A shape that another program wrote. `scale` turns the file's length unit into metres."""

    program: ClassVar[str]
    """What the file is, in a word."""
    instead_of_mirror: ClassVar[str]
    """What to do where a mirror image is wanted."""

    path: Path
    scale: float

    def reflected(self, axis: int) -> Shape:
        """Raises InputError."""
        must_hold, received = "a shape that can be mirrored", f"a {self.program} file"
        raise InputError.of("mirrored", must_hold, received, self.instead_of_mirror)
