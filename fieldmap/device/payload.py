"""The levitated body: a magnet, or several magnets and pieces of soft iron. Frozen data in SI."""

from __future__ import annotations

import contextlib
import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.arguments import check, check_choice
from fieldmap.constants import MU0
from fieldmap.device.made import Made
from fieldmap.device.materials import Material
from fieldmap.device.materials.base import Polarisation as Remanence
from fieldmap.device.placement import PLACEMENT, Placement
from fieldmap.inputs.declared import Key, choice_of, choice_with, first_line, table_of
from fieldmap.inputs.tables import Coordinate, Length, Name, NotNegative, Positive, Size, broken
from fieldmap.typing import Array


class _Uniform(Made):
    """A shape of uniform density whose axes are its principal axes of inertia."""

    filling: ClassVar[float]
    """Volume as a share of the volume of its bounding box."""
    spread: ClassVar[tuple[float, float, float]]
    """Means of x^2, y^2 and z^2 over the body, as shares of the squares of its axes."""

    @property
    @abstractmethod
    def axes(self) -> tuple[float, float, float]:
        """Lengths of the three axes, m."""

    @property
    def volume(self) -> float:
        """Volume, m^3."""
        return self.filling * math.prod(self.axes)

    def uniform_inertia(self, mass: float) -> tuple[float, float, float]:
        """Principal moments of a uniform body of this shape about its centre.

        Parameters
        ----------
        mass
            Of the body, kg.

        Returns
        -------
        tuple of float
            About x, y and z, kg m^2.

        Examples
        --------
        >>> [round(1e7 * moment, 3) for moment in MagnetCylinder(0.01, 0.01, 1.3).uniform_inertia(6e-3)]
        [0.875, 0.875, 0.75]
        """
        x, y, z = (share * axis**2 for share, axis in zip(self.spread, self.axes, strict=True))
        return mass * (y + z), mass * (x + z), mass * (x + y)


class _Ball(_Uniform):
    """An ellipsoid."""

    filling = math.pi / 6
    spread = (1 / 20, 1 / 20, 1 / 20)


@dataclass(frozen=True, repr=False)
class MagnetCylinder(_Uniform):
    """Axially magnetised cylinder.

    remanence in T.
    """

    kind: ClassVar[str] = "cylinder"
    filling = math.pi / 4
    spread = (1 / 16, 1 / 16, 1 / 12)

    diameter: Annotated[float, Key(Length, "diameter", "mm")]
    height: Annotated[float, Key(Length, "height", "mm")]
    remanence: Annotated[float, Key(Remanence, "remanence", "T")]

    @property
    def axes(self) -> tuple[float, float, float]:
        """Diameter, diameter and height, m."""
        return self.diameter, self.diameter, self.height

    @property
    def bounding_radius(self) -> float:
        """Radius of the smallest sphere about its centre that contains it, m."""
        return math.hypot(self.diameter, self.height) / 2


@dataclass(frozen=True, repr=False)
class MagnetSphere(_Ball):
    """Uniformly magnetised sphere.

    remanence in T.
    """

    kind: ClassVar[str] = "sphere"

    diameter: Annotated[float, Key(Length, "diameter", "mm")]
    remanence: Annotated[float, Key(Remanence, "remanence", "T")]

    @property
    def axes(self) -> tuple[float, float, float]:
        """The diameter, three times, m."""
        return self.diameter, self.diameter, self.diameter

    @property
    def bounding_radius(self) -> float:
        """Its radius, m."""
        return self.diameter / 2


@dataclass(frozen=True, repr=False)
class MagnetBlock(_Uniform):
    """Block magnetised along its z edge.

    remanence in T.
    """

    kind: ClassVar[str] = "block"
    filling = 1.0
    spread = (1 / 12, 1 / 12, 1 / 12)

    size: Annotated[tuple[float, float, float], Key(Size, "[x, y, z] edge lengths", "mm")]
    remanence: Annotated[float, Key(Remanence, "remanence", "T")]

    @property
    def axes(self) -> tuple[float, float, float]:
        """Its edges, m."""
        return self.size

    @property
    def bounding_radius(self) -> float:
        """Radius of the smallest sphere about its centre that contains it, m."""
        return math.hypot(*self.size) / 2


def _one_law(mu_r: float | None, info: ValidationInfo) -> None:
    if "material" in info.data and (info.data["material"] is None) == (mu_r is None):
        received = "neither" if mu_r is None else "both"
        raise broken("soft iron has a material or a mu_r", received, "give one of them")


def _name_of(material: object) -> object:
    """The name that stands for a material in a file."""
    return material.name if isinstance(material, Material) else material


MaterialOfPiece = Annotated[
    Material | str | None,
    Key(Name | None, "name of a [material.NAME] table of this file; or give mu_r instead", write=_name_of),
]
PermeabilityOfPiece = Annotated[
    float | None,
    Key(
        Annotated[float, Field(gt=1, le=1e9)] | None,
        "constant relative permeability, instead of a material",
        check=_one_law,
    ),
]


@dataclass(frozen=True, repr=False)
class SoftSphere(_Ball):
    """Sphere of soft iron.

    material: its law, or the name of a material of the device; mu_r: instead, a constant relative permeability, which
    may be infinite.
    """

    kind: ClassVar[str] = "soft_sphere"

    diameter: Annotated[float, Key(Length, "diameter", "mm")]
    material: MaterialOfPiece = None
    mu_r: PermeabilityOfPiece = None

    @property
    def axes(self) -> tuple[float, float, float]:
        """Lengths of the three axes, m."""
        return self.diameter, self.diameter, self.diameter


@dataclass(frozen=True, repr=False)
class SoftEllipsoid(_Ball):
    """Ellipsoid of soft iron.

    size: its diameters along x, y and z, m; material and mu_r as in `SoftSphere`.

    >>> [round(1e9 * moment, 3) for moment in SoftEllipsoid((0.002, 0.002, 0.006)).uniform_inertia(1e-3)]
    [2.0, 2.0, 0.4]
    """

    kind: ClassVar[str] = "soft_ellipsoid"

    size: Annotated[tuple[float, float, float], Key(Size, "[x, y, z] lengths of its axes", "mm")]
    material: MaterialOfPiece = None
    mu_r: PermeabilityOfPiece = None

    @property
    def axes(self) -> tuple[float, float, float]:
        """Lengths of the three axes, m."""
        return self.size


Magnet = MagnetCylinder | MagnetSphere | MagnetBlock
SoftBody = SoftSphere | SoftEllipsoid
"""Soft iron: has a material or a permeability, the lengths of its axes, and a volume."""


@dataclass(frozen=True, eq=False, repr=False)
class PayloadPiece(Made):
    """A magnet or a piece of soft iron of a payload. placement: its centre and the axes of its shape, relative to the
    payload's centre, which lies `magnet_offset` below the sensed point."""

    shape: Magnet | SoftBody
    placement: Placement = field(default_factory=Placement)


AnyMagnet: Any = choice_of((table_of(magnet, "shape") for magnet in get_args(Magnet)), "shape")
AnyPiece: Any = choice_of(
    (
        table_of(
            PayloadPiece,
            name=f"{shape.__name__}Piece",
            beside={"shape": table_of(shape, "shape"), "placement": PLACEMENT},
            text=first_line(shape),
        )
        for shape in (*get_args(Magnet), *get_args(SoftBody))
    ),
    "shape",
)


Inertia = Annotated[list[Positive], Field(min_length=3, max_length=3)]


def _of_a_real_body(inertia: list[float] | None, info: ValidationInfo) -> None:
    if inertia is not None and 2 * max(inertia) > sum(inertia) * (1 + 1e-9):
        raise broken(
            "no principal moment of inertia can be larger than the sum of the other two",
            str(inertia),
            "check the numbers and their unit, g mm^2 (1e-9 kg m^2)",
        )


@dataclass(frozen=True, repr=False)
class Payload(Made):
    """The levitated body. moment: magnitude in A m^2; by default volume times remanence of its magnets over mu0.

    direction: sense of the moment along z, "up" or "down"; pieces have directions of their own (`moment_vector`).
    turning: "fixed" or "free"; None: fixed in an equilibrium, free in a simulation.

    magnet_offset: depth of the magnet's centre below the point that the sensor reads, m (an assumption, printed with
    every result that uses it). inertia (3,) kg m^2; None takes a uniform body of the shape and size of the magnet or
    the pieces (`uniform_inertia`). drag: N s/m. pieces: magnets and soft iron in place of one magnet; each is a
    `PayloadPiece`, or a shape at the payload's centre (`fieldmap.lookup.magnetic_body` computes their moments).
    volume_level: of the quadrature of the field over each magnet (`fieldmap.lookup.volume_rule`); 1 takes each as a
    point dipole in its centre. soft_level: of the dipoles of each piece of soft iron (`fieldmap.lookup.soft_rule`).

    >>> bead = Payload(mass=0.26e-3, pieces=[SoftSphere(4e-3, mu_r=1000.0)])
    >>> bead.soft, bead.moment, f"{bead.principal_moments[0]:.2e} kg m2"
    (True, 0.0, '4.16e-10 kg m2')
    """

    mass: Annotated[float, Key(Positive, "mass of everything that is levitated", "g")]
    moment: float = 0.0
    magnet: Annotated[
        Magnet | None,
        Key(
            AnyMagnet,
            "[payload.magnet] table: shape, dimensions, remanence_T; or give moment_A_m2 instead, or "
            "[[payload.piece]] tables",
        ),
    ] = None
    magnet_offset: Annotated[
        float, Key(Coordinate, "depth of the magnet's centre below the point that the sensor reads", "mm")
    ] = 0.0
    inertia: Annotated[
        tuple[float, float, float] | None,
        Key(
            Inertia | None,
            "[Ixx, Iyy, Izz] about the centre of mass, principal axes; left out, that of a uniform body of this mass "
            "in the shape of the magnet or of the pieces",
            "g_mm2",
            check=_of_a_real_body,
        ),
    ] = None
    drag: Annotated[float, Key(NotNegative, "linear drag", "N_s_per_m")] = 0.0
    pieces: Annotated[
        tuple[PayloadPiece, ...],
        Key(
            Annotated[list[AnyPiece], Field(min_length=1)],
            "[[payload.piece]] tables: magnets and soft iron, and where they stand",
            name="piece",
        ),
    ] = ()
    direction: Annotated[
        Literal["up", "down"],
        Key(
            ...,
            "which way the moment of the magnet points; a magnet that lies or leans is a [[payload.piece]] with a "
            "rotation",
        ),
    ] = "up"
    turning: Annotated[
        Literal["fixed", "free"] | None,
        Key(
            ...,
            "fixed: the payload does not turn; free: it turns with the field; unless given, an equilibrium holds it "
            "and a simulation lets it turn",
            examples=("fixed",),
        ),
    ] = None
    volume_level: Annotated[
        int,
        Key(
            Annotated[int, Field(ge=1, le=8)],
            "level n of the rule that integrates the field over each magnet, exact for polynomials of degree 2 n - 1; "
            "1 takes each magnet as a point dipole in its middle",
        ),
    ] = 3
    soft_level: Annotated[
        int,
        Key(
            Annotated[int, Field(ge=1, le=2)],
            "of soft iron: 1, one dipole that answers the field in the middle of a piece; 2, six that answer its "
            "gradient, too, for pieces whose size counts beside the distance of the nearest iron or coil",
        ),
    ] = 1

    def __post_init__(self) -> None:
        if isinstance(self.pieces, list | tuple):
            placed = [PayloadPiece(one) if isinstance(one, Magnet | SoftBody) else one for one in self.pieces]
            object.__setattr__(self, "pieces", tuple(placed))
        # Values that are no numbers are reported when a device is made of the payload.
        with contextlib.suppress(TypeError, ValueError, AttributeError, OverflowError):
            if self.moment == 0.0 and isinstance(self.magnet, Magnet):
                object.__setattr__(self, "moment", self.magnet.volume * self.magnet.remanence / MU0)
            elif self.moment == 0.0 and self.pieces:
                object.__setattr__(self, "moment", float(np.linalg.norm(_moment_of(self.pieces))))

    @property
    def moment_vector(self) -> Array:
        """Moment (3,) of its magnets, A m^2: along z in the sense of `direction`, or the sum of its pieces.

        Raises InputError for an unknown direction, and for "down" with pieces.
        """
        if self.pieces:
            check(self.direction == "up", "Payload(direction)", OF_PIECES, self.direction, "leave it out")
            return _moment_of(self.pieces)
        signs = {"up": 1.0, "down": -1.0}
        check_choice("Payload(direction)", self.direction, signs)
        return np.array([0.0, 0.0, signs[self.direction] * self.moment])

    def held(self) -> str:
        """Direction of its moment and whether it turns, in words; it counts as fixed unless `turning` is "free".

        >>> Payload(mass=0.01, moment=0.8, direction="down").held()
        'moment down, fixed'
        """
        return moment_held(self.moment_vector, self.turning == "free")

    @property
    def soft(self) -> bool:
        """Whether it has soft iron, whose moment depends on the field."""
        return any(isinstance(piece.shape, SoftBody) for piece in self.pieces)

    @property
    def sized(self) -> bool:
        """Whether the size of a magnet matters: a sphere is exactly a point dipole, other shapes are not."""
        shapes = (piece.shape for piece in self.pieces) if self.pieces else (self.magnet,)
        return any(isinstance(shape, MagnetCylinder | MagnetBlock) for shape in shapes)

    @property
    def extended(self) -> bool:
        """Whether it is more than one dipole in its centre: pieces, or a magnet of finite size."""
        return bool(self.pieces) or (self.sized and self.volume_level > 1)

    @property
    def rule(self) -> str:
        """Model of its magnets, in words; empty without magnets."""
        if self.pieces and not any(isinstance(piece.shape, Magnet) for piece in self.pieces):
            return ""
        if self.sized and self.volume_level > 1:
            return f"quadrature of level {self.volume_level}"
        return "point dipole"

    @property
    def soft_rule(self) -> str:
        """Model of its pieces of soft iron, in words; empty without soft iron."""
        if not self.soft:
            return ""
        if self.soft_level == 1:
            return "one dipole a piece for the field in its centre"
        return "six dipoles a piece for the field and its gradient"

    @property
    def principal_moments(self) -> tuple[float, float, float] | None:
        """Inertia, kg m^2: as given, or of a uniform body of this mass in the shape of the magnet, or of the pieces if
        the payload's axes are their principal axes; None otherwise."""
        if self.inertia is not None:
            return self.inertia
        if self.pieces:
            return _inertia_of_pieces(self.pieces, self.mass)
        return None if self.magnet is None else self.magnet.uniform_inertia(self.mass)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Models of its magnets and soft iron, and the depth of its centre, in words."""
        depth = f"magnet_offset {1e3 * self.magnet_offset:g} mm below the point that the sensor reads"
        what = [f"payload of {_pieces_text(self.pieces)}"] if self.pieces else []
        soft = f"soft iron of {self.soft_rule}" if self.soft else ""
        return (", ".join([*what, *(rule for rule in (self.rule, soft) if rule), depth]),)

    @property
    def description(self) -> str:
        """Its magnetism in a few words: the moment, or the pieces; and whether it turns, if that is stated."""
        shown = (
            _pieces_text(self.pieces) if self.pieces else f"moment {self.moment:.4g} A m2 {self.direction}"
        )
        return shown if self.turning is None else f"{shown}, {_TURNS[self.turning == 'free']}"

    def with_materials(self, materials: Mapping[str, Material]) -> Payload:
        """The payload with materials in place of their names.

        Parameters
        ----------
        materials
            Name -> material; other names stay.

        Returns
        -------
        Payload
            The payload.
        """

        def named(piece: PayloadPiece) -> PayloadPiece:
            shape = piece.shape if isinstance(piece, PayloadPiece) else None
            if not isinstance(shape, SoftBody) or not isinstance(shape.material, str):
                return piece
            material = materials.get(shape.material, shape.material)
            return replace(piece, shape=replace(shape, material=material))

        return replace(self, pieces=tuple(named(piece) for piece in self.pieces))


_TURNS = ("fixed", "free to turn")
OF_PIECES = "must not be given for pieces: the rotation of each says which way its moment points"
# Cosine of the angle to the vertical above which a moment is called "up" or "down".
_VERTICAL = math.cos(math.radians(0.1))


def moment_held(moment: Array, turns: bool) -> str:
    """Direction of a moment and whether it turns, in words.

    Parameters
    ----------
    moment
        Of the magnets (3,), A m^2; zero for soft iron alone, whose moment is induced.
    turns
        Whether it turns with the field.

    Returns
    -------
    str
        Such as "moment down, fixed".
    """
    length = float(np.linalg.norm(moment))
    unit = moment / (length or 1.0)
    way = "up" if unit[2] > 0 else "down"
    if length == 0.0:
        way = "induced"
    elif abs(unit[2]) < _VERTICAL:
        way = f"along ({', '.join(f'{part:.3g}' for part in np.round(unit, 3) + 0.0)})"
    return f"moment {way}, {_TURNS[turns]}"


def _alone(payload: Payload) -> bool:
    return isinstance(payload.pieces, tuple) and not payload.pieces


def _kind_of_payload(table: dict[str, Any]) -> str:
    if "piece" in table:
        return "with pieces"
    return "with a moment" if "moment_A_m2" in table else "with a magnet"


AnyPayload: Any = choice_with(
    {
        "with a magnet": table_of(
            Payload,
            name="PayloadWithMagnet",
            without=("pieces", "soft_level"),
            needed=("magnet",),
            takes=lambda payload: _alone(payload) and payload.magnet is not None,
            text="Payload whose moment follows from its magnet: volume times remanence over mu0.",
        ),
        "with a moment": table_of(
            Payload,
            name="PayloadWithMoment",
            without=("magnet", "pieces", "volume_level", "soft_level"),
            instead={"moment": Key(Positive, "magnitude of the dipole moment", "A_m2")},
            takes=lambda payload: _alone(payload) and payload.magnet is None,
            text="Payload that is only a dipole.",
        ),
        "with pieces": table_of(
            Payload,
            name="PayloadWithPieces",
            without=("magnet", "direction"),
            needed=("pieces",),
            text="Payload of several magnets, or of soft iron, or of both.",
        ),
    },
    _kind_of_payload,
)


def _moment_of(pieces: tuple[PayloadPiece, ...]) -> Array:
    """Moment (3,) of the magnets among the pieces, A m^2."""
    total = np.zeros(3)
    for piece in pieces:
        if isinstance(piece.shape, Magnet):
            along = np.asarray(piece.placement.rotation, dtype=float)[:, 2]
            total += piece.shape.volume * piece.shape.remanence / MU0 * along
    return total


def _inertia_of_pieces(pieces: tuple[PayloadPiece, ...], mass: float) -> tuple[float, float, float] | None:
    """Principal moments of pieces of one density about their common centre of mass; None where the payload's axes are
    not principal axes."""
    volumes = np.array([piece.shape.volume for piece in pieces])
    centres = np.array([piece.placement.position for piece in pieces], dtype=float)
    shares = mass * volumes / volumes.sum()
    arms = centres - shares @ centres / mass
    tensor = np.zeros((3, 3))
    for piece, share, arm in zip(pieces, shares, arms, strict=True):
        turn = np.asarray(piece.placement.rotation, dtype=float)
        tensor += turn @ np.diag(piece.shape.uniform_inertia(float(share))) @ turn.T
        tensor += share * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    if np.abs(tensor - np.diag(np.diag(tensor))).max() > 1e-9 * np.abs(tensor).max():
        return None
    x, y, z = (float(entry) for entry in np.diag(tensor))
    return x, y, z


def _pieces_text(pieces: tuple[PayloadPiece, ...]) -> str:
    """ "soft sphere of 4 mm, magnet cylinder of 10 x 10 mm"."""
    return ", ".join(shape_text(piece.shape) for piece in pieces)


def shape_text(shape: Magnet | SoftBody) -> str:
    """Kind and size of a piece, in words.

    Parameters
    ----------
    shape
        The piece.

    Returns
    -------
    str
        The words.
    """
    if isinstance(shape, MagnetCylinder):
        return f"magnet cylinder of {1e3 * shape.diameter:g} x {1e3 * shape.height:g} mm"
    kind = "soft" if isinstance(shape, SoftBody) else "magnet"
    if isinstance(shape, MagnetSphere | SoftSphere):
        return f"{kind} sphere of {1e3 * shape.diameter:g} mm"
    size = " x ".join(f"{1e3 * edge:g}" for edge in shape.size)
    return f"{kind} {'ellipsoid' if isinstance(shape, SoftBody) else 'block'} of {size} mm"
