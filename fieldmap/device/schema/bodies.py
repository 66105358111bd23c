"""Bodies of iron: one shape inline, or several parts that are added and cut."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol

from pydantic import Field, Tag, ValidationInfo, field_validator

from fieldmap.device import parts as model
from fieldmap.device.placement import PlacementKeys
from fieldmap.device.schema.shapes import (
    BoxKeys,
    CylinderKeys,
    ExtrudedPolygonKeys,
    MeshFileKeys,
    RevolvedProfileKeys,
    RingKeys,
    SphereKeys,
    StepFileKeys,
    TriangleSurfaceKeys,
    VolumeMeshKeys,
)
from fieldmap.inputs.tables import MILLI, Length, Name, Table, broken, chosen_by, chosen_with

SEVERAL_PARTS = "several parts"


class _PlacedShape(Protocol):
    def to_shape(self, folder: Path) -> model.Shape: ...

    def placement(self) -> model.Placement: ...


class PartKeys(PlacementKeys):
    """What every part of a body has besides its shape."""

    operation: Literal["add", "cut"] = Field(
        default="add", description="add this shape to the body, or cut it out of what came before"
    )

    def to_model(self: Any, folder: Path) -> model.Part:
        """In SI."""
        return _part(self, folder, self.operation)


def _part(keys: _PlacedShape, folder: Path, operation: str) -> model.Part:
    return model.Part(keys.to_shape(folder), keys.placement(), operation)


class CylinderPart(PartKeys, CylinderKeys):
    """Solid cylinder."""


class RingPart(PartKeys, RingKeys):
    """Hollow cylinder."""


class BoxPart(PartKeys, BoxKeys):
    """Block."""


class SpherePart(PartKeys, SphereKeys):
    """Ball."""


class ExtrudedPolygonPart(PartKeys, ExtrudedPolygonKeys):
    """Prism."""


class RevolvedProfilePart(PartKeys, RevolvedProfileKeys):
    """Body of revolution."""


class StepFilePart(PartKeys, StepFileKeys):
    """Solids of a STEP file."""


class TriangleSurfacePart(PartKeys, TriangleSurfaceKeys):
    """Solid inside a closed surface of triangles."""


SHAPE_KEYS: dict[type[model.Shape], type[Table]] = {
    model.Cylinder: CylinderKeys,
    model.Ring: RingKeys,
    model.Box: BoxKeys,
    model.Sphere: SphereKeys,
    model.ExtrudedPolygon: ExtrudedPolygonKeys,
    model.RevolvedProfile: RevolvedProfileKeys,
    model.StepFile: StepFileKeys,
    model.TriangleSurface: TriangleSurfaceKeys,
    model.VolumeMesh: VolumeMeshKeys,
    model.MeshFile: MeshFileKeys,
}

AnyPart = Annotated[
    Annotated[CylinderPart, Tag("cylinder")]
    | Annotated[RingPart, Tag("ring")]
    | Annotated[BoxPart, Tag("box")]
    | Annotated[SpherePart, Tag("sphere")]
    | Annotated[ExtrudedPolygonPart, Tag("extruded_polygon")]
    | Annotated[RevolvedProfilePart, Tag("revolved_profile")]
    | Annotated[StepFilePart, Tag("step_file")]
    | Annotated[TriangleSurfacePart, Tag("triangle_surface")],
    chosen_by("shape"),
]


class NamedBodyKeys(Table):
    """What every body has, whatever its shape."""

    name: Name = Field(description="the body's name: letters, digits, spaces, _ + -")
    material: Name = Field(description="name of a [material.NAME] table of this file")


class BodyKeys(NamedBodyKeys):
    """What every body has that is to be meshed."""

    mesh_size_mm: Length = Field(description="largest element edge")
    edge_size_mm: Length | None = Field(
        default=None, description="size of the first element layer at sharp edges; leave out for no grading"
    )

    @field_validator("edge_size_mm")
    @classmethod
    def _finer_than_the_mesh(cls, value: float | None, info: ValidationInfo) -> float | None:
        mesh_size = info.data.get("mesh_size_mm")
        if value is not None and mesh_size is not None and value > mesh_size:
            raise broken(
                f"edge_size_mm must not be larger than mesh_size_mm = {mesh_size:g}",
                f"{value:g}",
                "give the size of the fine layer at the edges (0.25 to 1 mm is usual), or leave the key out",
            )
        return value

    def body(self, parts: tuple[model.Part, ...]) -> model.Body:
        """In SI."""
        edge_size = None if self.edge_size_mm is None else self.edge_size_mm * MILLI
        return model.Body(self.name, self.material, parts, self.mesh_size_mm * MILLI, edge_size)


class InlineBody(BodyKeys, PlacementKeys):
    """A body of one shape, its keys beside the name."""

    def to_model(self: Any, folder: Path) -> model.Body:
        """In SI."""
        return self.body((_part(self, folder, "add"),))


class CylinderBody(InlineBody, CylinderKeys):
    """Solid cylinder."""


class RingBody(InlineBody, RingKeys):
    """Hollow cylinder."""


class BoxBody(InlineBody, BoxKeys):
    """Block."""


class SphereBody(InlineBody, SphereKeys):
    """Ball."""


class ExtrudedPolygonBody(InlineBody, ExtrudedPolygonKeys):
    """Prism."""


class RevolvedProfileBody(InlineBody, RevolvedProfileKeys):
    """Body of revolution."""


class StepFileBody(InlineBody, StepFileKeys):
    """Solids of a STEP file."""


class TriangleSurfaceBody(InlineBody, TriangleSurfaceKeys):
    """Solid inside a closed surface of triangles."""


class OwnMeshBody(NamedBodyKeys, PlacementKeys):
    """A body that is a mesh, its keys beside the name."""

    def to_model(self: Any, folder: Path) -> model.Body:
        """In SI."""
        return model.Body(self.name, self.material, (_part(self, folder, "add"),))


class VolumeMeshBody(OwnMeshBody, VolumeMeshKeys):
    """A mesh of tetrahedra, used as it is."""


class MeshFileBody(OwnMeshBody, MeshFileKeys):
    """Tetrahedra of a mesh file, used as they are."""


class CompositeBody(BodyKeys):
    """A body of several parts, added and cut in order."""

    written_as: ClassVar[str | None] = "write [[body.part]] tables"

    part: list[AnyPart] = Field(min_length=1, description="[[body.part]] tables, applied in order")

    @field_validator("part")
    @classmethod
    def _begins_with_something(cls, value: list[Any]) -> list[Any]:
        if value and value[0].operation != "add":
            raise broken(
                "the first part of a body must be added",
                'operation = "cut" in part 1',
                'begin with an "add" part; later parts cut from it',
            )
        return value

    def to_model(self, folder: Path) -> model.Body:
        """In SI."""
        return self.body(tuple(part.to_model(folder) for part in self.part))


def _kind_of_body(table: dict[str, Any]) -> Any:
    return SEVERAL_PARTS if "part" in table else table.get("shape")


AnyBody = Annotated[
    Annotated[CylinderBody, Tag("cylinder")]
    | Annotated[RingBody, Tag("ring")]
    | Annotated[BoxBody, Tag("box")]
    | Annotated[SphereBody, Tag("sphere")]
    | Annotated[ExtrudedPolygonBody, Tag("extruded_polygon")]
    | Annotated[RevolvedProfileBody, Tag("revolved_profile")]
    | Annotated[StepFileBody, Tag("step_file")]
    | Annotated[TriangleSurfaceBody, Tag("triangle_surface")]
    | Annotated[VolumeMeshBody, Tag("volume_mesh")]
    | Annotated[MeshFileBody, Tag("mesh_file")]
    | Annotated[CompositeBody, Tag(SEVERAL_PARTS)],
    chosen_with(_kind_of_body, "shape"),
]
