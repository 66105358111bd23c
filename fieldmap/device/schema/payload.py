"""What is levitated, [payload]: a magnet, a moment alone, or pieces."""

from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from pydantic import Field, Tag

from fieldmap.device import payload as model
from fieldmap.device.placement import PlacementKeys
from fieldmap.inputs.declared import choice_of, record_of, table_of
from fieldmap.inputs.tables import Positive, Table, chosen_with

MAGNETS = (model.MagnetCylinder, model.MagnetSphere, model.MagnetBlock)
PIECES = (*MAGNETS, model.SoftSphere, model.SoftEllipsoid)
MAGNET_KEYS: dict[type, Any] = {magnet: table_of(magnet, "shape") for magnet in MAGNETS}
PIECE_KEYS: dict[type, Any] = {piece: table_of(piece, "shape") for piece in PIECES}

if TYPE_CHECKING:
    AnyMagnet: TypeAlias = Table
    AnyPiece: TypeAlias = PlacementKeys
else:
    AnyMagnet = choice_of(MAGNET_KEYS.values(), "shape")
    AnyPiece = choice_of(
        (table_of(piece, "shape", f"{piece.__name__}Piece", (PlacementKeys,)) for piece in PIECES), "shape"
    )

_PAYLOAD: Any = table_of(model.Payload)


class PayloadWithMagnet(_PAYLOAD):
    """Payload whose moment follows from its magnet: volume times remanence over mu0."""

    magnet: AnyMagnet = Field(
        description="[payload.magnet] table: shape, dimensions, remanence_T; or give moment_A_m2 instead, or "
        "[[payload.piece]] tables"
    )

    def to_model(self) -> model.Payload:
        """In SI."""
        return _payload(self, magnet=record_of(self.magnet))


class PayloadWithMoment(_PAYLOAD):
    """Payload that is only a dipole."""

    moment_A_m2: Positive = Field(description="magnitude of the dipole moment")

    def to_model(self) -> model.Payload:
        """In SI."""
        return _payload(self, moment=float(self.moment_A_m2))


class PayloadWithPieces(_PAYLOAD):
    """Payload of several magnets, or of soft iron, or of both."""

    piece: Annotated[list[AnyPiece], Field(min_length=1)] = Field(
        description="[[payload.piece]] tables: magnets and soft iron, and where they stand"
    )

    def to_model(self) -> model.Payload:
        """In SI; materials by their names."""
        pieces = tuple(model.PayloadPiece(record_of(piece), piece.placement()) for piece in self.piece)
        return _payload(self, pieces=pieces)


def _payload(keys: Table, **others: Any) -> model.Payload:
    payload: model.Payload = record_of(keys, **others)
    return payload


def _kind_of_payload(table: dict[str, Any]) -> str:
    if "piece" in table:
        return "with pieces"
    return "with a moment" if "moment_A_m2" in table else "with a magnet"


AnyPayload = Annotated[
    Annotated[PayloadWithMagnet, Tag("with a magnet")]
    | Annotated[PayloadWithMoment, Tag("with a moment")]
    | Annotated[PayloadWithPieces, Tag("with pieces")],
    chosen_with(_kind_of_payload),
]
