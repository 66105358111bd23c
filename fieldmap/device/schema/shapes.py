"""Shapes of iron: each class holds the keys of one shape and makes the SI shape of them.

Local frame of every shape: axis along z, base in the plane z = 0, centred in x and y (a sphere: centred).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device import parts as model
from fieldmap.device.dimensions import (
    Polygon,
    SimplePolygon,
    counter_clockwise,
    require_larger_radius,
    require_simple,
)
from fieldmap.device.surfaces import surface_fault
from fieldmap.device.tetrahedra import tetrahedra_fault
from fieldmap.inputs.tables import MILLI, Length, Point, Size, Table, Text, broken, read_only

Triple = Annotated[list[int], Field(min_length=3, max_length=3)]


class CylinderKeys(Table):
    """Solid cylinder."""

    shape: Literal["cylinder"] = Field(description="solid cylinder, 0 <= z <= height")
    radius_mm: Length = Field(description="radius")
    height_mm: Length = Field(description="height along the local z axis")

    def to_shape(self, folder: Path) -> model.Cylinder:
        """In SI."""
        return model.Cylinder(self.radius_mm * MILLI, self.height_mm * MILLI)


class RingKeys(Table):
    """Hollow cylinder."""

    shape: Literal["ring"] = Field(description="hollow cylinder, 0 <= z <= height")
    inner_radius_mm: Length = Field(description="radius of the bore")
    outer_radius_mm: Length = Field(description="outer radius")
    height_mm: Length = Field(description="height along the local z axis")

    @field_validator("outer_radius_mm")
    @classmethod
    def _outside_the_bore(cls, value: float, info: ValidationInfo) -> float:
        require_larger_radius(value, info)
        return value

    def to_shape(self, folder: Path) -> model.Ring:
        """In SI."""
        return model.Ring(self.inner_radius_mm * MILLI, self.outer_radius_mm * MILLI, self.height_mm * MILLI)


class BoxKeys(Table):
    """Axis-parallel block in its local frame."""

    shape: Literal["box"] = Field(description="block, centred in x and y, 0 <= z <= size[2]")
    size_mm: Size = Field(description="[x, y, z] edge lengths")

    def to_shape(self, folder: Path) -> model.Box:
        """In SI."""
        x, y, z = (edge * MILLI for edge in self.size_mm)
        return model.Box((x, y, z))


class SphereKeys(Table):
    """Ball, centred at the local origin."""

    shape: Literal["sphere"] = Field(description="ball, centred at the local origin")
    radius_mm: Length = Field(description="radius")

    def to_shape(self, folder: Path) -> model.Sphere:
        """In SI."""
        return model.Sphere(self.radius_mm * MILLI)


class ExtrudedPolygonKeys(Table):
    """Prism over a polygon in the local x-y plane."""

    shape: Literal["extruded_polygon"] = Field(description="polygon in the local x-y plane, 0 <= z <= height")
    points_mm: SimplePolygon = Field(description="[[x, y], ...] corners once round the outline")
    height_mm: Length = Field(description="height along the local z axis")

    def to_shape(self, folder: Path) -> model.ExtrudedPolygon:
        """In SI, corners counter-clockwise."""
        points = read_only(counter_clockwise(self.points_mm), MILLI)
        return model.ExtrudedPolygon(points, self.height_mm * MILLI)


class RevolvedProfileKeys(Table):
    """Body of revolution about the local z axis."""

    shape: Literal["revolved_profile"] = Field(description="profile turned fully about the local z axis")
    points_mm: Polygon = Field(description="[[r, z], ...] corners of the half section, r >= 0")

    @field_validator("points_mm")
    @classmethod
    def _simple_and_outside_the_axis(cls, value: list[list[float]]) -> list[list[float]]:
        wrong = [k + 1 for k, (r, _) in enumerate(value) if r < 0]
        if wrong:
            raise broken(
                "every r of the profile must be 0 or more",
                f"r = {value[wrong[0] - 1][0]:g} at corner {wrong[0]}",
                "give only the half of the section at r >= 0, as [r, z]; it is turned fully about the axis",
            )
        return require_simple(value)

    def to_shape(self, folder: Path) -> model.RevolvedProfile:
        """In SI, corners counter-clockwise in the r-z plane."""
        return model.RevolvedProfile(read_only(counter_clockwise(self.points_mm), MILLI))


class StepFileKeys(Table):
    """Solids from a CAD program."""

    attributes: ClassVar[Mapping[str, str]] = {"file": "path", "unit_mm": "scale"}

    shape: Literal["step_file"] = Field(description="solids of a STEP file")
    file: Text = Field(description="path of the STEP file, relative to the device file")
    unit_mm: Length = Field(default=1.0, description="length of the STEP file's unit")

    def to_shape(self, folder: Path) -> model.StepFile:
        """In SI, with the path made absolute."""
        return model.StepFile((folder / self.file).resolve(), self.unit_mm * MILLI)


class TriangleSurfaceKeys(Table):
    """Solid inside a closed surface of triangles."""

    shape: Literal["triangle_surface"] = Field(description="solid inside a closed surface of triangles")
    points_mm: list[Point] = Field(min_length=4, description="[[x, y, z], ...] corners")
    triangles: list[Triple] = Field(
        min_length=4, description="[[i, j, k], ...] numbers of corners from 0, counter-clockwise from outside"
    )

    @field_validator("triangles")
    @classmethod
    def _closed(cls, value: list[list[int]], info: ValidationInfo) -> list[list[int]]:
        points = info.data.get("points_mm")
        fault = None if points is None else surface_fault(np.array(points), np.array(value))
        if fault is not None:
            raise broken(*fault)
        return value

    def to_shape(self, folder: Path) -> model.TriangleSurface:
        """In SI."""
        return model.TriangleSurface(
            read_only(self.points_mm, MILLI), np.array(self.triangles, dtype=np.int64)
        )


Four = Annotated[list[int], Field(min_length=4, max_length=4)]


class VolumeMeshKeys(Table):
    """A mesh of tetrahedra."""

    shape: Literal["volume_mesh"] = Field(description="a mesh of tetrahedra, used as it is")
    points_mm: list[Point] = Field(min_length=4, description="[[x, y, z], ...] nodes")
    tetrahedra: list[Four] = Field(min_length=1, description="[[i, j, k, l], ...] numbers of nodes from 0")

    @field_validator("tetrahedra")
    @classmethod
    def _fill_a_solid(cls, value: list[list[int]], info: ValidationInfo) -> list[list[int]]:
        points = info.data.get("points_mm")
        fault = None if points is None else tetrahedra_fault(np.array(points), np.array(value))
        if fault is not None:
            raise broken(*fault)
        return value

    def to_shape(self, folder: Path) -> model.VolumeMesh:
        """In SI."""
        return model.VolumeMesh(read_only(self.points_mm, MILLI), np.array(self.tetrahedra, dtype=np.int64))


class MeshFileKeys(Table):
    """Tetrahedra of a mesh file."""

    attributes: ClassVar[Mapping[str, str]] = {"file": "path", "unit_mm": "scale"}

    shape: Literal["mesh_file"] = Field(description="tetrahedra of a mesh file, used as they are")
    file: Text = Field(description="path of the mesh file, relative to the device file")
    unit_mm: Length = Field(default=1.0, description="length of the mesh file's unit")
    region: Text | None = Field(
        default=None,
        description='name of the cells that are this body, or their number in quotes, "7"; all if left out',
    )

    def to_shape(self, folder: Path) -> model.MeshFile:
        """In SI, with the path made absolute."""
        return model.MeshFile((folder / self.file).resolve(), self.unit_mm * MILLI, self.region)
