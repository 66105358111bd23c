"""Solids inside closed surfaces of triangles."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.device.polygons import FourPoints
from fieldmap.device.shapes.base import Shape
from fieldmap.device.surfaces import crossing_fault, read_stl, surface_fault
from fieldmap.errors import InputError
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import broken
from fieldmap.typing import Array, Index, PathLike

Triangles = Annotated[list[Annotated[list[int], Field(min_length=3, max_length=3)]], Field(min_length=4)]


def _require_closed(triangles: list[list[int]], info: ValidationInfo) -> None:
    """Raise unless the triangles bound a solid."""
    points = info.data.get("points_mm")
    fault = None if points is None else surface_fault(np.array(points), np.array(triangles))
    if fault is not None:
        raise broken(*fault)


@dataclass(frozen=True, eq=False, repr=False)
class TriangleSurface(Shape):
    """Solid inside a closed surface of triangles.

    triangles (m, 3) are numbers of `points` (n, 3), in m, from 0. Each edge belongs to two triangles, which run along
    it in opposite ways; seen from outside, corners run counter-clockwise.
    """

    kind: ClassVar[str] = "triangle_surface"

    points: Annotated[Array, Key(FourPoints, "[[x, y, z], ...] corners", "mm")]
    triangles: Annotated[
        Index,
        Key(
            Triangles,
            "[[i, j, k], ...] numbers of corners from 0, counter-clockwise from outside",
            check=_require_closed,
        ),
    ]

    @classmethod
    def from_stl(cls, path: PathLike, unit: float = 1e-3) -> Self:
        """The surface of an STL file, binary or text.

        The surface must bound a solid: closed, with shells that face the right way, and not cutting itself.

        Parameters
        ----------
        path
            Path of the file.
        unit
            Length of the file's unit, m, which STL does not state.

        Returns
        -------
        Self
            The shape.

        Raises
        ------
        InputError
            For a file that is not STL, and for a surface that bounds no solid.
        """
        points, triangles = read_stl(Path(path))
        fault = surface_fault(points, triangles) or crossing_fault(points, triangles)
        if fault is not None:
            raise InputError.of(str(path), *fault)
        return cls(unit * points, triangles)

    def hull(self) -> Array:
        """See `Shape.hull`."""
        return np.asarray(self.points, dtype=float)

    def reflected(self, axis: int) -> Self:
        """See `Shape.reflected`."""
        points = np.array(self.points, dtype=float)
        points[:, axis] *= -1
        return replace(self, points=points, triangles=np.asarray(self.triangles)[:, ::-1])
