"""What a moving body meets beside the field: air, a conducting plate, walls."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.arguments import check, check_signal
from fieldmap.constants import MU0
from fieldmap.core.machine import plate_force
from fieldmap.inputs.declared import Key, check_fields
from fieldmap.inputs.tables import NotNegative, PlanePoint, Point, Positive, Vector, broken
from fieldmap.records import Record
from fieldmap.typing import Array

Three = tuple[float, float, float]
NotNegatives = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
"""Rule of three numbers, along the axes or of three sensors."""

_ZERO: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True, repr=False)
class Drag(Record):
    """Resistance of the air, by axes: docs/theory/dynamics.md (9), (10).

    linear: N s/m along the axes of the map. body_linear: N s/m, body_quadratic: N s^2/m^2, along those of the body.
    turning: N m s, turning_quadratic: N m s^2, about those of the body.
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
        """(5, 3), in the order of fieldmap_drag (fieldmap/core/losses.h)."""
        return np.array(
            [self.linear, self.body_linear, self.body_quadratic, self.turning, self.turning_quadratic], float
        )

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is not zero, in words."""
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
    """A conducting plate without end to the sides, on the other side of its face than the magnet.

    conductivity: S/m; thickness: m (infinite: a half space); face: a point of its face, m; normal: of the face, to the
    side of the magnet, any length. Eddy currents are those of slow motion: their own field is left out, which is wrong
    by the order of (speed / critical_speed)^2. docs/theory/dynamics.md (11)..(18).
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
        """Maxwell's w = 2 / (mu0 conductivity thickness), m/s: images of eddies recede with it (Saslow 1992)."""
        return 2.0 / (MU0 * self.conductivity * self.thickness)

    @property
    def numbers(self) -> Array:
        """(8,), in the order of fieldmap_plate (fieldmap/core/losses.h)."""
        n = np.asarray(self.normal, float)
        return np.array([self.conductivity, self.thickness, *self.face, *(n / np.linalg.norm(n))])

    def damping(self, position: Three, moment: Three) -> Array:
        """Damping of a dipole that moves without turning, (16): the force on it is -damping @ velocity.

        Parameters
        ----------
        position
            Of the dipole (3,), m.
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
        """What its damping rests on."""
        return (
            f"plate: {1e3 * self.thickness:g} mm of {self.conductivity:.3g} S/m without end to the sides; the magnet "
            "acts on it as a point dipole; slow motion",
        )


@dataclass(frozen=True, repr=False)
class Walls(Record):
    """What the body can touch: a penalty, docs/theory/dynamics.md (19), (20).

    floor, ceiling: heights, m; radius of the tube and its axis (x, y), m; None where there is none. contact_time: s,
    half a period of the body bouncing on one point, which sets the stiffness. restitution: speed after a bounce over
    that before, 0 < restitution <= 1, which sets the damping. friction: Coulomb's coefficient, viscous below slip, m/s.
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
        """The walls as the C core takes them, in the order of fieldmap_walls (fieldmap/core/contact.h).

        Parameters
        ----------
        mass
            Of the body, kg.

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
