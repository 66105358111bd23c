"""Bodies of iron: one shape inline, or several parts that are added and cut."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias, Union

from pydantic import Field, Tag, ValidationInfo, field_validator

from fieldmap.device import parts as model
from fieldmap.device.placement import PlacementKeys
from fieldmap.inputs.declared import choice_of, record_of, table_of
from fieldmap.inputs.tables import MILLI, Length, Name, Table, broken, chosen_with

SEVERAL_PARTS = "several parts"


class PartKeys(PlacementKeys):
    """What every part of a body has besides its shape."""

    operation: Literal["add", "cut"] = Field(
        default="add", description="add this shape to the body, or cut it out of the parts before it"
    )

    def to_model(self: Any, folder: Path) -> model.Part:
        """In SI."""
        return _part(self, folder, self.operation)


def _part(keys: Any, folder: Path, operation: str) -> model.Part:
    return model.Part(record_of(keys, folder), keys.placement(), operation)


SHAPE_KEYS: dict[type[model.Shape], Any] = {shape: table_of(shape, "shape") for shape in model.SHAPES}
_TO_BE_MESHED = [shape for shape in model.SHAPES if shape not in model.OWN_MESHES]

if TYPE_CHECKING:
    AnyPart: TypeAlias = PartKeys
else:
    AnyPart = choice_of(
        (table_of(shape, "shape", f"{shape.__name__}Part", (PartKeys,)) for shape in _TO_BE_MESHED), "shape"
    )


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


class OwnMeshBody(NamedBodyKeys, PlacementKeys):
    """A body that is a mesh, its keys beside the name."""

    def to_model(self: Any, folder: Path) -> model.Body:
        """In SI."""
        return model.Body(self.name, self.material, (_part(self, folder, "add"),))


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


if TYPE_CHECKING:
    AnyBody: TypeAlias = InlineBody | OwnMeshBody | CompositeBody
else:
    _INLINE = {
        shape.kind: table_of(
            shape,
            "shape",
            f"{shape.__name__}Body",
            (OwnMeshBody if shape in model.OWN_MESHES else InlineBody,),
        )
        for shape in model.SHAPES
    }
    AnyBody = Annotated[
        Union[  # noqa: UP007
            tuple(
                Annotated[keys, Tag(kind)]
                for kind, keys in (_INLINE | {SEVERAL_PARTS: CompositeBody}).items()
            )
        ],
        chosen_with(_kind_of_body, "shape"),
    ]
