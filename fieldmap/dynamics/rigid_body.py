"""A rigid body with a magnet, and its surroundings: air, a conducting plate, walls."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.arguments import check, check_not_negative, check_positive, check_signal
from fieldmap.constants import GRAVITY, MU0
from fieldmap.core.body import CoreBody
from fieldmap.core.machine import BodyNumbers, plate_force
from fieldmap.device.payload import (
    Magnet,
    MagnetBlock,
    MagnetCylinder,
    MagnetSphere,
    Payload,
    SoftBody,
    moment_held,
    shape_text,
)
from fieldmap.errors import InputError
from fieldmap.inputs.declared import Key, check_fields
from fieldmap.inputs.tables import NotNegative, PlanePoint, Point, Positive, Vector, broken
from fieldmap.lookup import MagneticBody, magnetic_body
from fieldmap.records import Record, count_of
from fieldmap.typing import Array

_RIM = 8
_RIGID = 1e12  # kg m^2
Three = tuple[float, float, float]
NotNegatives = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
"""Rule for three numbers of 0 or more, along the axes or for three sensors."""

_ZERO: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True, repr=False)
class Drag(Record):
    """Resistance of the air, by axes: docs/theory/dynamics.md (9), (10).

    linear: N s/m along the axes of the map. body_linear: N s/m, body_quadratic: N s^2/m^2, along the axes of the
    body. turning: N m s, turning_quadratic: N m s^2, about the axes of the body.
    """

    linear: Annotated[Three, Key(NotNegatives, "drag along the map's x, y, z", "N_s_per_m")] = _ZERO
    body_linear: Annotated[Three, Key(NotNegatives, "drag along the body's axes", "N_s_per_m")] = _ZERO
    body_quadratic: Annotated[
        Three, Key(NotNegatives, "quadratic drag along the body's axes", "N_s2_per_m2")
    ] = _ZERO
    turning: Annotated[Three, Key(NotNegatives, "drag about the body's axes", "N_m_s")] = _ZERO
    turning_quadratic: Annotated[
        Three, Key(NotNegatives, "quadratic drag about the body's axes", "N_m_s2")
    ] = _ZERO

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def numbers(self) -> Array:
        """Numbers (5, 3), in the order of fieldmap_drag (fieldmap/core/losses.h)."""
        return np.array(
            [self.linear, self.body_linear, self.body_quadratic, self.turning, self.turning_quadratic], float
        )

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The drag that is not zero, in words."""
        units = {
            "linear": "N s/m",
            "body_linear": "N s/m along the body's axes",
            "body_quadratic": "N s^2/m^2 along the body's axes",
            "turning": "N m s about the body's axes",
            "turning_quadratic": "N m s^2 about the body's axes",
        }
        return tuple(
            f"drag {', '.join(f'{value:g}' for value in values)} {units[name]}"
            for name, values in vars(self).items()
            if np.any(values)
        )


def _has_a_length(normal: list[float], info: ValidationInfo) -> None:
    if not any(normal):
        raise broken("must have a length", "zeros", "[0, 0, 1] for a plate below")


@dataclass(frozen=True, repr=False)
class Plate(Record):
    """A conducting plate that extends to infinity sideways. Its face separates it from the magnet.

    conductivity: S/m; thickness: m (infinite: a half space); face: a point of its face, m; normal: of the face, to
    the side of the magnet, any length. Eddy currents are computed for slow motion: their own field is neglected, with
    a relative error of order (speed / critical_speed)^2. docs/theory/dynamics.md (11)..(18).
    """

    conductivity: Annotated[Positive, Key(..., "conductivity, 3.5e7 for aluminium", "S_per_m")]
    thickness: Annotated[
        Annotated[float, Field(gt=0, allow_inf_nan=True)], Key(..., "thickness; inf for a half space", "mm")
    ]
    face: Annotated[Three, Key(Point, "[x, y, z] of a point of the face that the magnet sees", "mm")]
    normal: Annotated[
        Three, Key(Vector, "normal of that face, to the side of the magnet", check=_has_a_length)
    ] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def critical_speed(self) -> float:
        """Speed 2 / (mu0 conductivity thickness), m/s, at which images of eddy currents recede (Maxwell; Saslow
        1992)."""
        return 2.0 / (MU0 * self.conductivity * self.thickness)

    @property
    def numbers(self) -> Array:
        """Numbers (8,), in the order of fieldmap_plate (fieldmap/core/losses.h)."""
        n = np.asarray(self.normal, float)
        return np.array([self.conductivity, self.thickness, *self.face, *(n / np.linalg.norm(n))])

    def damping(self, position: Three, moment: Three) -> Array:
        """Damping of a dipole that moves without turning, (16): the force on it is -damping @ velocity.

        Parameters
        ----------
        position
            Position of the dipole (3,), m.
        moment
            (3,), A m^2.

        Returns
        -------
        Array
            (3, 3), N s/m.

        Raises
        ------
        InputError
            For a position on or behind the face.

        Examples
        --------
        >>> plate = Plate(conductivity=3.5e7, thickness=np.inf, face=(0, 0, 0))
        >>> (1e3 * plate.damping((0, 0, 0.02), (0, 0, 0.813)).diagonal()).round(3).tolist()
        [11.356, 11.356, 22.712]
        """
        numbers = self.numbers
        where = np.array(check_signal("Plate.damping(position)", position, columns=3))
        dipole = np.array(check_signal("Plate.damping(moment)", moment, columns=3))
        ahead, must = bool((where - self.face) @ numbers[5:] > 0.0), "must lie in front of the face"
        check(ahead, "Plate.damping(position)", must, position, "turn the normal")
        columns = [plate_force(numbers, where, dipole, v, np.zeros(3))[0] for v in np.eye(3)]
        return -np.array(columns).T

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the damping."""
        return (
            f"plate: {1e3 * self.thickness:g} mm of {self.conductivity:.3g} S/m without end to the sides; the magnet "
            "acts on it as a point dipole; slow motion",
        )


@dataclass(frozen=True, repr=False)
class Walls(Record):
    """Walls that the body can touch, with penalty forces: docs/theory/dynamics.md (19), (20).

    floor, ceiling: heights, m; radius of the tube and its axis (x, y), m; None for no wall. contact_time: s, half a
    period of the body bouncing on one point, which sets the stiffness. restitution: speed after a bounce over the
    speed before, 0 < restitution <= 1, which sets the damping. friction: Coulomb's coefficient, viscous below slip,
    m/s.
    """

    floor: Annotated[float | None, Key(..., "z of a floor", "mm")] = None
    ceiling: Annotated[float | None, Key(..., "z of a ceiling", "mm")] = None
    radius: Annotated[Positive | None, Key(..., "radius of an upright tube", "mm", name="tube_radius")] = None
    axis: Annotated[
        tuple[float, float], Key(PlanePoint, "[x, y] of the axis of that tube", "mm", name="tube_axis")
    ] = (0.0, 0.0)
    contact_time: Annotated[
        Positive, Key(..., "half a period of the body bouncing on one point: the stiffness", "ms")
    ] = 5e-3
    restitution: Annotated[
        Annotated[float, Field(gt=0, le=1)], Key(..., "speed after a bounce over the speed before")
    ] = 0.3
    friction: Annotated[NotNegative, Key(..., "Coulomb's coefficient of friction")] = 0.3
    slip: Annotated[Positive, Key(..., "speed below which friction is viscous", "mm_per_s")] = 1e-3

    def __post_init__(self) -> None:
        check_fields(self)

    def numbers(self, mass: float) -> Array:
        """The walls for the C core, in the order of fieldmap_walls (fieldmap/core/contact.h).

        Parameters
        ----------
        mass
            Mass of the body, kg.

        Returns
        -------
        Array
            The numbers.
        """
        share = -np.log(self.restitution) / np.pi
        stiffness = mass * (np.pi / self.contact_time) ** 2 * (1.0 + share**2)
        damping = 2.0 * mass * share * np.pi / self.contact_time
        floor = -np.inf if self.floor is None else self.floor
        ceiling = np.inf if self.ceiling is None else self.ceiling
        radius = np.inf if self.radius is None else self.radius
        return np.array(
            [stiffness, damping, self.friction, self.slip, floor, ceiling, radius, *map(float, self.axis)]
        )


@dataclass(frozen=True, eq=False, repr=False)
class RigidBody(Record):
    """A rigid body in SI units. The origin of its frame is the centre of mass, and its axes are principal axes of
    inertia.

    mass: kg. inertia (3,): principal moments, kg m^2. magnet: dipoles and soft iron about the magnet's own centre,
    with the axes of the body. magnet_at (3,): the magnet's centre in the body. seen_at (3,): the sensed point. skin
    (k, 3): points of the surface that can touch walls. gravity: m/s^2, downward. upright: the body does not turn, as
    with infinite inertia. assumptions: of the numbers.
    """

    mass: float
    inertia: Array
    magnet: MagneticBody
    magnet_at: Array = field(default_factory=lambda: np.zeros(3))
    seen_at: Array = field(default_factory=lambda: np.zeros(3))
    skin: Array = field(default_factory=lambda: np.zeros((0, 3)))
    gravity: float = GRAVITY
    upright: bool = False
    assumptions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_positive("RigidBody", mass=self.mass)
        check_not_negative("RigidBody", gravity=self.gravity)
        object.__setattr__(self, "skin", np.reshape(np.array(self.skin, float), (-1, 3)))
        for name in ("inertia", "magnet_at", "seen_at"):
            given = np.array(check_signal(f"RigidBody({name})", getattr(self, name), columns=3))
            object.__setattr__(self, name, given)
        check_positive("RigidBody(inertia)", **dict(zip("xyz", self.inertia, strict=True)))
        a, b, c = np.sort(self.inertia)
        must, remedy = (
            "must fulfil I1 + I2 >= I3, as those of every body do",
            "give principal moments of inertia",
        )
        fits = bool(c <= (a + b) * (1.0 + 1e-9))
        check(fits, "RigidBody(inertia)", must, self.inertia.tolist(), remedy)

    def numbers(
        self, drag: Drag | None = None, plate: Plate | None = None, walls: Walls | None = None
    ) -> BodyNumbers:
        """The body and its surroundings for the C core.

        Parameters
        ----------
        drag
            Drag of the air; none unless given.
        plate
            Conducting plate below; none unless given.
        walls
            Walls that stop the body; none unless given.

        Returns
        -------
        BodyNumbers
            The numbers.
        """
        return BodyNumbers(
            mass=float(self.mass),
            inertia=np.full(3, _RIGID) if self.upright else self.inertia,
            gravity=np.array([0.0, 0.0, -self.gravity]),
            force=np.zeros(3),
            torque=np.zeros(3),
            drag=(drag or Drag()).numbers,
            plate=np.zeros(8) if plate is None else plate.numbers,
            seen_by_plate=np.concatenate([self.magnet_at, self.magnet.moments.sum(axis=0)]),
            walls=(walls or Walls()).numbers(self.mass),
            skin=np.zeros((0, 3)) if walls is None else self.skin,
            magnetic=self.placed_magnet.body,
        )

    @cached_property
    def placed_magnet(self) -> CoreBody:
        """The magnet at its place in the body, for the C core."""
        magnet, at = self.magnet, self.magnet_at
        soft = tuple(replace(piece, centre=piece.centre + at) for piece in magnet.soft)
        return replace(magnet, points=magnet.points + at, soft=soft).core


def body_of_payload(
    payload: Payload,
    *,
    radius: float | None = None,
    height: float | None = None,
    below: float | None = None,
    centre_of_mass: float = 0.0,
    magnet: MagneticBody | None = None,
    upright: bool | None = None,
) -> RigidBody:
    """The upright body of a device's payload, with z along the magnet's axis. The payload has the moment and the
    sensed point.

    A payload without an inertia gets that of a uniform body with its mass: of the given cylinder, or else of the
    shape of the magnet or the pieces.

    Parameters
    ----------
    payload
        Payload of a device.
    radius, height
        Size of the cylinder that replaces the body, m; by default that of the magnet.
    below
        Height of the magnet's centre above the body's lower face, m; by default half of the magnet's height.
    centre_of_mass
        Height of the centre of mass above the magnet's centre, m.
    magnet
        Its dipoles and soft iron; by default a point dipole for each magnet.
    upright
        Whether the body does not turn; by default as the payload's key `turning` states.

    Returns
    -------
    RigidBody
        The body, with its assumptions.

    Raises
    ------
    InputError
        If the inertia is unknown.

    Examples
    --------
    >>> from fieldmap.device import read_device
    >>> body = body_of_payload(read_device("drive_unit").payload, radius=5.9e-3, height=0.025)
    >>> (1e7 * body.inertia).round(3).tolist()
    [6.802, 6.802, 1.948]
    """
    upright = payload.turning == "fixed" if upright is None else upright
    r, h, low = _cylinder(payload, radius, height, below)
    inertia, notes = _inertia(payload, r, h, own_size=radius is None)
    if upright:
        notes = ("the body stays upright: it does not turn",)
    carried, shift = magnetic_body(payload, 1) if magnet is None else magnet, -centre_of_mass
    return RigidBody(
        payload.mass,
        inertia,
        carried,
        np.array([0.0, 0.0, shift]),
        np.array([0.0, 0.0, shift + payload.magnet_offset]),
        _skin(payload, shift) if r is None or h is None else _rims(r, shift - low, shift - low + h),
        upright=upright,
        assumptions=(
            *notes,
            moment_held(carried.moments.sum(axis=0), not upright),
            f"centre of mass {1e3 * centre_of_mass:g} mm above the magnet's centre",
            f"sensed point {1e3 * payload.magnet_offset:g} mm above the magnet's centre",
            *_magnetism(carried),
            *carried.assumptions,
        ),
    )


def _magnetism(body: MagneticBody) -> tuple[str, ...]:
    """Models of its magnets and its soft iron, in words."""
    count = len(body.points)
    magnets = ("point dipole" if count == 1 else f"magnet of {count} dipoles",) if count else ()
    if not body.soft:
        return magnets
    return (*magnets, f"soft iron: {count_of(len(body.soft), 'induced dipole', 'induced dipoles')}")


def _cylinder(
    payload: Payload, radius: float | None, height: float | None, below: float | None
) -> tuple[float | None, float | None, float]:
    """Radius and height of the body, and the magnet's height in it; by default those of a cylindrical magnet."""
    own = payload.magnet
    if not isinstance(own, MagnetCylinder):
        return radius, height, below or 0.0
    low = own.height / 2 if below is None else below
    return own.diameter / 2 if radius is None else radius, own.height if height is None else height, low


def _inertia(
    payload: Payload, r: float | None, h: float | None, own_size: bool
) -> tuple[Array, tuple[str, ...]]:
    """Inertia of the payload, or of a uniform body, and the assumption."""
    if payload.inertia is not None:
        return np.array(payload.inertia, float), ()
    if r is None or h is None:
        uniform = payload.principal_moments if r is None and h is None else None
        remedy = "give radius and height of the body, or payload.inertia or payload.magnet in the device file"
        if uniform is None:
            raise InputError.of("body_of_payload(payload)", "must have an inertia", "none", remedy)
        shape = "body of its pieces"
        if payload.magnet is not None and not payload.pieces:
            shape = f"{shape_text(payload.magnet).removeprefix('magnet ')}, the magnet's"
        return np.array(uniform, float), (f"inertia of a uniform {shape}",)
    size = f"{2e3 * r:g} x {1e3 * h:g} mm" + (", the magnet's" if own_size else "")
    inertia = MagnetCylinder(2 * r, h, 0.0).uniform_inertia(payload.mass)
    return np.array(inertia, float), (f"inertia of a uniform cylinder of {size}",)


def _skin(payload: Payload, centre: float) -> Array:
    """Points that can touch walls, of every piece: poles and equator of a sphere or ellipsoid, corners of a block,
    rims of a cylinder. A dipole has none."""
    each = [np.zeros((0, 3))]
    for piece in payload.pieces:
        each.append(_surface(piece.shape) @ piece.placement.rotation.T + piece.placement.position)
    if not payload.pieces and isinstance(payload.magnet, MagnetSphere | MagnetBlock):
        each.append(_surface(payload.magnet))
    return np.concatenate(each) + [0.0, 0.0, centre]


def _surface(shape: Magnet | SoftBody) -> Array:
    """Points of the surface of a shape about its centre."""
    if isinstance(shape, MagnetCylinder):
        return _rims(shape.diameter / 2, -shape.height / 2, shape.height / 2)
    if isinstance(shape, MagnetBlock):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * np.asarray(shape.size) / 2
    half = np.asarray(shape.axes) / 2
    poles = [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    return np.concatenate([_rims(1.0, 0.0, 0.0)[:_RIM], poles]) * half


def _rims(radius: float, low: float, high: float) -> Array:
    """Points on both rims of an upright cylinder, (2 _RIM, 3)."""
    angle = 2 * np.pi * np.arange(_RIM) / _RIM
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return np.concatenate([np.column_stack([ring, np.full(_RIM, z)]) for z in (low, high)])
