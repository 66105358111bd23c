"""What is levitated, [payload], and what drives the coils, [driver]."""

from typing import Annotated, Any, Literal, Protocol

from pydantic import Field, Tag, ValidationInfo, field_validator

from fieldmap.constants import MU0
from fieldmap.device import payload as model
from fieldmap.device.parts import Driver
from fieldmap.device.placement import Placement, PlacementKeys
from fieldmap.inputs.tables import (
    MILLI,
    Coordinate,
    Length,
    Name,
    NotNegative,
    Positive,
    Size,
    Table,
    broken,
    chosen_by,
    chosen_with,
)

GRAM_SQUARE_MILLIMETRE = 1e-9
Inertia = Annotated[list[Positive], Field(min_length=3, max_length=3)]


class MagnetCylinderKeys(Table):
    """Axially magnetised cylinder."""

    shape: Literal["cylinder"] = Field(description="axially magnetised cylinder")
    diameter_mm: Length = Field(description="diameter")
    height_mm: Length = Field(description="height")
    remanence_T: Positive = Field(description="remanence")

    def to_model(self) -> model.MagnetCylinder:
        """In SI."""
        return model.MagnetCylinder(self.diameter_mm * MILLI, self.height_mm * MILLI, self.remanence_T)


class MagnetSphereKeys(Table):
    """Uniformly magnetised sphere."""

    shape: Literal["sphere"] = Field(description="uniformly magnetised sphere")
    diameter_mm: Length = Field(description="diameter")
    remanence_T: Positive = Field(description="remanence")

    def to_model(self) -> model.MagnetSphere:
        """In SI."""
        return model.MagnetSphere(self.diameter_mm * MILLI, self.remanence_T)


class MagnetBlockKeys(Table):
    """Block magnetised along its z edge."""

    shape: Literal["block"] = Field(description="block magnetised along its z edge")
    size_mm: Size = Field(description="[x, y, z] edge lengths")
    remanence_T: Positive = Field(description="remanence")

    def to_model(self) -> model.MagnetBlock:
        """In SI."""
        x, y, z = (edge * MILLI for edge in self.size_mm)
        return model.MagnetBlock((x, y, z), self.remanence_T)


MAGNET_KEYS: dict[type, type[Table]] = {
    model.MagnetCylinder: MagnetCylinderKeys,
    model.MagnetSphere: MagnetSphereKeys,
    model.MagnetBlock: MagnetBlockKeys,
}

AnyMagnet = Annotated[
    Annotated[MagnetCylinderKeys, Tag("cylinder")]
    | Annotated[MagnetSphereKeys, Tag("sphere")]
    | Annotated[MagnetBlockKeys, Tag("block")],
    chosen_by("shape"),
]


class _SoftKeys(Table):
    material: Name | None = Field(
        default=None, description="name of a [material.NAME] table of this file; or give mu_r instead"
    )
    mu_r: Annotated[float, Field(gt=1, le=1e9)] | None = Field(
        default=None,
        validate_default=True,
        description="constant relative permeability, instead of a material",
    )

    @field_validator("mu_r")
    @classmethod
    def _one_law(cls, value: float | None, info: ValidationInfo) -> float | None:
        if "material" in info.data and (info.data["material"] is None) == (value is None):
            received = "neither" if value is None else "both"
            raise broken("soft iron has a material or a mu_r", received, "give one of them")
        return value


class SoftSphereKeys(_SoftKeys):
    """Sphere of soft iron."""

    shape: Literal["soft_sphere"] = Field(description="sphere of soft iron")
    diameter_mm: Length = Field(description="diameter")

    def to_model(self) -> model.SoftSphere:
        """In SI; the material by its name."""
        return model.SoftSphere(self.diameter_mm * MILLI, self.material, self.mu_r)


class SoftEllipsoidKeys(_SoftKeys):
    """Ellipsoid of soft iron."""

    shape: Literal["soft_ellipsoid"] = Field(description="ellipsoid of soft iron")
    size_mm: Size = Field(description="[x, y, z] lengths of its axes")

    def to_model(self) -> model.SoftEllipsoid:
        """In SI; the material by its name."""
        x, y, z = (axis * MILLI for axis in self.size_mm)
        return model.SoftEllipsoid((x, y, z), self.material, self.mu_r)


class _PieceOfPayload(Protocol):
    def to_model(self) -> model.Magnet | model.SoftBody: ...

    def placement(self) -> Placement: ...


class PieceKeys(PlacementKeys):
    """What every piece of a payload has besides its shape."""

    def to_piece(self: _PieceOfPayload) -> model.PayloadPiece:
        """In SI; the material by its name."""
        return model.PayloadPiece(self.to_model(), self.placement())


class MagnetCylinderPiece(PieceKeys, MagnetCylinderKeys):
    """Axially magnetised cylinder."""


class MagnetSpherePiece(PieceKeys, MagnetSphereKeys):
    """Uniformly magnetised sphere."""


class MagnetBlockPiece(PieceKeys, MagnetBlockKeys):
    """Block magnetised along its z edge."""


class SoftSpherePiece(PieceKeys, SoftSphereKeys):
    """Sphere of soft iron."""


class SoftEllipsoidPiece(PieceKeys, SoftEllipsoidKeys):
    """Ellipsoid of soft iron."""


PIECE_KEYS: dict[type, type[Table]] = {
    **MAGNET_KEYS,
    model.SoftSphere: SoftSphereKeys,
    model.SoftEllipsoid: SoftEllipsoidKeys,
}

AnyPiece = Annotated[
    Annotated[MagnetCylinderPiece, Tag("cylinder")]
    | Annotated[MagnetSpherePiece, Tag("sphere")]
    | Annotated[MagnetBlockPiece, Tag("block")]
    | Annotated[SoftSpherePiece, Tag("soft_sphere")]
    | Annotated[SoftEllipsoidPiece, Tag("soft_ellipsoid")],
    chosen_by("shape"),
]


class _PayloadKeys(Table):
    mass_g: Positive = Field(description="mass of everything that is levitated")
    magnet_offset_mm: Coordinate = Field(
        default=0.0, description="depth of the magnet's centre below the point that the sensor reads"
    )
    inertia_g_mm2: Inertia | None = Field(
        default=None,
        description="[Ixx, Iyy, Izz] about the centre of mass, principal axes; left out, that of a uniform body "
        "of this mass in the shape of the magnet or of the pieces",
    )
    drag_N_s_per_m: NotNegative = Field(default=0.0, description="linear drag")

    @field_validator("inertia_g_mm2")
    @classmethod
    def _of_a_real_body(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and 2 * max(value) > sum(value) * (1 + 1e-9):
            raise broken(
                "no principal moment of inertia can be larger than the sum of the other two",
                str(value),
                "check the numbers and their unit, g mm^2 (1e-9 kg m^2)",
            )
        return value

    def _payload(
        self, moment: float, magnet: Any = None, pieces: tuple[model.PayloadPiece, ...] = ()
    ) -> model.Payload:
        inertia = None
        if self.inertia_g_mm2 is not None:
            xx, yy, zz = (entry * GRAM_SQUARE_MILLIMETRE for entry in self.inertia_g_mm2)
            inertia = (xx, yy, zz)
        return model.Payload(
            mass=self.mass_g * MILLI,
            moment=moment,
            magnet=magnet,
            magnet_offset=self.magnet_offset_mm * MILLI,
            inertia=inertia,
            drag=float(self.drag_N_s_per_m),
            pieces=pieces,
        )


class PayloadWithMagnet(_PayloadKeys):
    """Payload whose moment follows from its magnet: volume times remanence over mu0."""

    magnet: AnyMagnet = Field(
        description="[payload.magnet] table: shape, dimensions, remanence_T; or give moment_A_m2 instead, or "
        "[[payload.piece]] tables"
    )

    def to_model(self) -> model.Payload:
        """In SI."""
        magnet = self.magnet.to_model()
        return self._payload(magnet.volume * magnet.remanence / MU0, magnet)


class PayloadWithMoment(_PayloadKeys):
    """Payload that is only a dipole."""

    moment_A_m2: Positive = Field(description="magnitude of the dipole moment")

    def to_model(self) -> model.Payload:
        """In SI."""
        return self._payload(float(self.moment_A_m2))


class PayloadWithPieces(_PayloadKeys):
    """Payload of several magnets, or of soft iron, or of both."""

    piece: Annotated[list[AnyPiece], Field(min_length=1)] = Field(
        description="[[payload.piece]] tables: magnets and soft iron, and where they stand"
    )

    def to_model(self) -> model.Payload:
        """In SI; materials by their names."""
        return self._payload(0.0, pieces=tuple(piece.to_piece() for piece in self.piece))


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


class DriverKeys(Table):
    """The current amplifier of every coil."""

    gain_A_per_V: Positive = Field(description="current per volt at the amplifier's input")
    current_limit_A: Positive = Field(description="largest current of one coil")
    supply_voltage_V: Positive | None = Field(default=None, description="voltage of the supply")

    def to_model(self) -> Driver:
        """In SI."""
        return Driver(self.gain_A_per_V, self.current_limit_A, self.supply_voltage_V)
