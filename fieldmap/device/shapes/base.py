"""Base classes of the shapes of iron.

A shape is a frozen class derived from `Shape`, in a module of its own in `fieldmap.device.shapes`; no other code names
it. The annotations of its fields define the keys of a [[body]] table (`fieldmap.inputs.declared`). Local frame: axis
along z, base in the plane z = 0, centred in x and y.
"""

from pathlib import Path
from typing import ClassVar

import numpy as np

from fieldmap.device.made import Made
from fieldmap.errors import InputError
from fieldmap.typing import Array

ROUND = 24
"""Points on a circle in drawings."""


class Shape(Made):
    """A shape of a part of a body."""

    kind: ClassVar[str]
    """The word for the shape in device files."""
    has_own_mesh: ClassVar[bool] = False
    """Whether it is a mesh. A mesh is the only part of its body, which has no `mesh_size`."""

    @property
    def primitive(self) -> "Shape":
        """The equivalent shape of this package that solids, symmetry, derivatives and drawings use.

        A new shape returns the cylinder, prism, solid of revolution or closed surface that fills the same space.
        """
        return self

    def hull(self) -> Array:
        """Points (n, 3), m, local frame, with the convex hull of the shape; none for a shape from a file."""
        return np.zeros((0, 3)) if self.primitive is self else self.primitive.hull()

    def reflected(self, axis: int) -> "Shape":
        """The mirror image of the shape; a symmetric shape is its own image.

        Parameters
        ----------
        axis
            Local axis, 0 or 1, that changes its sign.

        Returns
        -------
        'Shape'
            The shape.

        Raises
        ------
        InputError
            For a shape from a file, which cannot be mirrored.
        """
        return self if self.primitive is self else self.primitive.reflected(axis)


class ShapeOfFile(Shape):
    """A shape that another program wrote. `scale` turns the file's length unit into metres."""

    program: ClassVar[str]
    """The kind of file, in a word."""
    instead_of_mirror: ClassVar[str]
    """The remedy in the error of `reflected`."""

    path: Path
    scale: float

    def reflected(self, axis: int) -> Shape:
        """Raises InputError."""
        must_hold, received = "a shape that can be mirrored", f"a {self.program} file"
        raise InputError.of("mirrored", must_hold, received, self.instead_of_mirror)
