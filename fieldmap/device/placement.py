"""Placements of shapes and coils: frozen data, the keys position_mm and rotation_deg, and patterns of copies.

Bodies and coils made in Python are moved, turned and mirrored by these keys, too, so that their numbers agree to the
last bit with those of a file.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from fieldmap.device.made import Made
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.document import schema_findings
from fieldmap.inputs.findings import shown
from fieldmap.inputs.tables import MILLI, Point, broken, in_unit
from fieldmap.typing import Array

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
MOST_COPIES = 1000


def cosine_and_sine(angle_deg: float) -> tuple[float, float]:
    """Cosine and sine: values 0, 1/2 and 1 are exact, and the symmetry of the circle holds to the last bit.

    >>> cosine_and_sine(60.0)[0], cosine_and_sine(120.0)[1] == cosine_and_sine(60.0)[1]
    (0.5, True)
    """
    quarter, rest = divmod(angle_deg, 90.0)
    if rest <= 45.0:
        cos, sin = _of_half_quarter(rest)
    else:
        sin, cos = _of_half_quarter(90.0 - rest)
    turned = ((cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos))[int(quarter) % 4]
    return turned[0] + 0.0, turned[1] + 0.0


def _of_half_quarter(angle_deg: float) -> tuple[float, float]:
    if angle_deg == 45.0:
        return float(np.sqrt(0.5)), float(np.sqrt(0.5))
    sine = 0.5 if angle_deg == 30.0 else float(np.sin(np.deg2rad(angle_deg)))
    return float(np.cos(np.deg2rad(angle_deg))), sine


def rotation_matrix(rotation_deg: Sequence[float]) -> Array:
    """Turn about the fixed x axis, then the fixed y axis, then the fixed z axis: Rz @ Ry @ Rx, (3, 3).

    >>> rotation_matrix([0, 0, 90]) @ [1.0, 0.0, 0.0]
    array([0., 1., 0.])
    """
    (cx, sx), (cy, sy), (cz, sz) = (cosine_and_sine(angle) for angle in rotation_deg)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x + 0.0  # + 0.0 turns -0.0 into 0.0


def rotation_angles(rotation: Array) -> list[float]:
    """Angles (3,), deg, of a `rotation_matrix`, rounded to 1e-9 deg where that is as accurate.

    >>> rotation_angles(rotation_matrix([0, 135, 45]))
    [0.0, 135.0, 45.0]
    """
    y = np.degrees(np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0)))
    if abs(rotation[2, 0]) > 1.0 - 1e-12:
        x, z = 0.0, np.degrees(np.arctan2(-rotation[0, 1], rotation[1, 1]))
    else:
        x = np.degrees(np.arctan2(rotation[2, 1], rotation[2, 2]))
        z = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
    near = [np.array([x, y, z]), np.array([x + 180.0, 180.0 - y, z + 180.0])]
    near = [(angles + 180.0) % 360.0 - 180.0 for angles in near]
    short = [np.round(angles, 9) % 360.0 + 0.0 for angles in near]
    short.sort(key=np.count_nonzero)
    # Among equally accurate angles the first one wins: rounded, with the most zeros.
    best = min((*short, *near), key=lambda a: np.abs(rotation_matrix(a.tolist()) - rotation).max())
    return [float(angle) for angle in best]


_ROTATION = "must be a rotation matrix (3, 3): orthonormal, with determinant 1"


def _angles_of(rotation: Any) -> list[float]:
    """The angles of a rotation; raises `broken` for anything else."""
    try:
        matrix = np.asarray(rotation, dtype=float)
        bounded = matrix.shape == (3, 3) and bool(np.abs(matrix).max() <= 2.0)
    except (TypeError, ValueError):
        bounded = False
    if not bounded or np.abs(matrix @ matrix.T - np.eye(3)).max() >= 1e-9 or np.linalg.det(matrix) <= 0.0:
        received = shown(np.asarray(rotation, dtype=object).tolist())
        remedy = "use fieldmap.placed(position, rotation_deg), or turned(axis, angle_deg)"
        raise broken(_ROTATION, received, remedy)
    return rotation_angles(matrix)


Angle = Annotated[float, Field(ge=-360, le=360)]
Angles = Annotated[list[Angle], Field(min_length=3, max_length=3)]


@dataclass(frozen=True, eq=False, repr=False)
class Placement(Made):
    """Position and orientation of the local frame in the device's frame.

    global = rotation @ local + position.

    position (3,) in m; rotation (3, 3), orthonormal, determinant +1.
    """

    position: Annotated[Array, Key(Point, "[x, y, z] of the local origin", "mm")] = field(
        default_factory=lambda: np.zeros(3)
    )
    rotation: Annotated[
        Array,
        Key(
            Angles,
            "[x, y, z] angles, turned about the fixed x, then the fixed y, then the fixed z axis",
            "deg",
            make=rotation_matrix,
            write=_angles_of,
        ),
    ] = field(default_factory=lambda: np.eye(3))

    def keys(self) -> Any:
        """The keys of a file that give this placement."""
        return PLACEMENT(
            position_mm=[in_unit(float(x), MILLI) for x in np.asarray(self.position)],
            rotation_deg=rotation_angles(np.asarray(self.rotation)),
        )

    def to_device(self, points: ArrayLike) -> Array:
        """Local points in the frame of the device.

        Parameters
        ----------
        points
            Local positions (n, 3), m.

        Returns
        -------
        Array
            Positions (n, 3), m.
        """
        turned: Array = np.asarray(points, dtype=float) @ np.asarray(self.rotation).T + self.position
        return turned


PLACEMENT: Any = table_of(Placement, name="PlacementKeys")
"""The keys position_mm and rotation_deg, which tables of bodies, parts and coils share."""


# ---- moving, turning and mirroring keys ----


def moved_keys(position_mm: Sequence[float], by_mm: Sequence[float]) -> list[float]:
    """position_mm after a translation."""
    return [float(x + dx) for x, dx in zip(position_mm, by_mm, strict=True)]


def turned_keys(
    position_mm: Sequence[float],
    rotation_deg: Sequence[float],
    axis: Axis,
    angle_deg: float,
    centre_mm: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[list[float], list[float]]:
    """position_mm and rotation_deg after a rotation about an axis through a centre.

    >>> position, rotation = turned_keys([44.0, 0.0, 6.0], [0.0, 90.0, 0.0], "z", 60.0)
    >>> [round(x, 9) for x in position], rotation
    ([22.0, 38.105117767, 6.0], [0.0, 90.0, 60.0])
    """
    k = AXES.index(axis)
    first, second = (k + 1) % 3, (k + 2) % 3
    position = [float(x) for x in position_mm]
    u, v = position[first] - centre_mm[first], position[second] - centre_mm[second]
    cos, sin = cosine_and_sine(angle_deg)
    position[first] = centre_mm[first] + (cos * u - sin * v) + 0.0
    position[second] = centre_mm[second] + (sin * u + cos * v) + 0.0
    angles = [float(angle) for angle in rotation_deg]
    if not any(angles[k + 1 :]):  # turned about this axis last
        angles[k] = (angles[k] + angle_deg) % 360.0
        return position, angles
    about = [0.0, 0.0, 0.0]
    about[k] = angle_deg
    return position, rotation_angles(rotation_matrix(about) @ rotation_matrix(angles))


def mirrored_keys(
    position_mm: Sequence[float], rotation_deg: Sequence[float], plane: Axis, at_mm: float = 0.0
) -> tuple[list[float], list[float], int]:
    """position_mm and rotation_deg of the mirror image in the plane x = at_mm (or y, or z), and the local axis of the
    shape, 0 or 1, that changes its sign.

    A mirror makes the local frame left-handed. The shape is reflected along that local axis to keep the frame
    right-handed: the axis of a cylinder or a coil is mirrored, and a positive current still runs counter-clockwise
    about it.
    """
    k = AXES.index(plane)
    position = [float(x) for x in position_mm]
    position[k] = 2.0 * at_mm - position[k] + 0.0
    axis = 1 if plane == "y" else 0
    x, y, z = (float(angle) for angle in rotation_deg)
    if k == axis:  # mirror @ R @ mirror: turns about the other two axes change their sense
        signs = [1.0 if j == k else -1.0 for j in range(3)]
        return position, [sign * angle % 360.0 for sign, angle in zip(signs, (x, y, z), strict=True)], axis
    mirrors = [np.diag([-1.0 if j == i else 1.0 for j in range(3)]) for i in (k, axis)]
    return position, rotation_angles(mirrors[0] @ rotation_matrix([x, y, z]) @ mirrors[1] + 0.0), axis


# ---- patterns of things made in Python ----


class Movable(Made):
    """A body or a coil, with methods that return moved, turned, mirrored and repeated copies."""

    name: str

    @abstractmethod
    def _placed(self, change: Callable[[Placement], Placement], mirror_axis: int | None = None) -> Self:
        """A copy with every placement changed, and its shapes mirrored along a local axis."""

    @abstractmethod
    def _pattern(self) -> str:
        """A name with {k}, for copies."""

    def _with_keys(
        self,
        change: Callable[[list[float], list[float]], tuple[Sequence[float], Sequence[float]]],
        mirror_axis: int | None = None,
    ) -> Self:
        """A copy with position_mm and rotation_deg of every placement changed."""

        def changed(place: Placement) -> Placement:
            keys = place.keys()
            return _placement(*change(keys.position_mm, keys.rotation_deg))

        return self._placed(changed, mirror_axis)

    def named(self, name: str) -> Self:
        """A copy with another name.

        Parameters
        ----------
        name
            The name.

        Returns
        -------
        Self
            The copy.
        """
        return replace(self, name=name)  # zuban: ignore[misc]

    def moved(self, by: ArrayLike) -> Self:
        """A copy at another place.

        Parameters
        ----------
        by
            Displacement (3,), m.

        Returns
        -------
        Self
            The copy.
        """
        by_mm = [in_unit(x, MILLI) for x in _vector("moved, by", by)]
        return self._with_keys(lambda at, turn: (moved_keys(at, by_mm), turn))

    def turned(self, axis: Axis, angle_deg: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """A copy, turned about an axis.

        Parameters
        ----------
        axis
            Direction of the axis: "x", "y" or "z".
        angle_deg
            Angle, deg.
        centre
            Point (3,) of the axis, m.

        Returns
        -------
        Self
            The copy.
        """
        _check_axis("turned, axis", axis)
        (angle,) = _vector("turned, angle_deg", [angle_deg], 1)
        centre_mm = [in_unit(x, MILLI) for x in _vector("turned, centre", centre)]
        return self._with_keys(lambda at, turn: turned_keys(at, turn, axis, angle, centre_mm))

    def mirrored(self, plane: Axis, at: float = 0.0, name: str | None = None) -> Self:
        """The mirror image.

        A positive current still runs counter-clockwise about the mirrored axis.

        Parameters
        ----------
        plane
            "x" for the mirror x = at, or "y", or "z".
        at
            Position of the mirror, m.
        name
            Name of the copy; the same unless given.

        Returns
        -------
        Self
            The copy.
        """
        _check_axis("mirrored, plane", plane)
        (at_mm,) = (in_unit(x, MILLI) for x in _vector("mirrored, at", [at], 1))
        copy = self._with_keys(
            lambda at, turn: mirrored_keys(at, turn, plane, at_mm)[:2], 1 if plane == "y" else 0
        )
        return copy if name is None else copy.named(name)

    def around(
        self,
        axis: Axis,
        count: int,
        step_deg: float | None = None,
        names: Sequence[str] | str | None = None,
        centre: ArrayLike = (0.0, 0.0, 0.0),
    ) -> tuple[Self, ...]:
        """Copies about an axis; the first stays in place.

        Parameters
        ----------
        axis
            Direction of the axis: "x", "y" or "z".
        count
            Number of copies.
        step_deg
            Angle from each to the next, deg; a full turn divided by count unless given.
        names
            Names of the copies, or a pattern with {k}, which counts from 1; made from the original's name unless given.
        centre
            Point (3,) of the axis, m.

        Returns
        -------
        tuple[Self, ...]
            The copies.
        """
        named = self._names(count, names)
        step = 360.0 / len(named) if step_deg is None else step_deg
        return tuple(self.turned(axis, k * step, centre).named(name) for k, name in enumerate(named))

    def along(
        self, step: ArrayLike, count: int, names: Sequence[str] | str | None = None
    ) -> tuple[Self, ...]:
        """Copies in a row; the first stays in place.

        Parameters
        ----------
        step
            Displacement from each to the next (3,), m.
        count
            Number of copies.
        names
            As for `around`.

        Returns
        -------
        tuple[Self, ...]
            The copies.
        """
        named = self._names(count, names)
        shift = np.array(_vector("along, step", step))
        return tuple(self.moved(k * shift).named(name) for k, name in enumerate(named))

    def _names(self, count: int, names: Sequence[str] | str | None) -> list[str]:
        if not isinstance(count, int | np.integer) or not 1 <= count <= MOST_COPIES:
            must_hold = f"must be a whole number from 1 to {MOST_COPIES}"
            raise InputError.of("count", must_hold, repr(count), "give the number of copies")
        if names is None or isinstance(names, str):
            pattern = self._pattern() if names is None else names
            if "{k}" not in pattern and count > 1:
                remedy = 'write for instance "core {k}"'
                raise InputError.of("names", "a pattern has {k} in it", repr(pattern), remedy)
            return [pattern.replace("{k}", str(k + 1)) for k in range(count)]
        if len(names) != count:
            raise InputError.of("names", f"must be {count} names", f"{len(names)}", "name every copy")
        return list(names)


def placed(position: ArrayLike = (0.0, 0.0, 0.0), rotation_deg: ArrayLike = (0.0, 0.0, 0.0)) -> Placement:
    """A placement by position and angles.

    Parameters
    ----------
    position
        (3,), m.
    rotation_deg
        Angles (3,), deg, about the fixed x, then y, then z axis.

    Returns
    -------
    Placement
        The placement.
    """
    position_mm = [in_unit(x, MILLI) for x in _vector("placed, position", position)]
    return _placement(position_mm, _vector("placed, rotation_deg", rotation_deg))


def _placement(position_mm: Sequence[float], rotation_deg: Sequence[float]) -> Placement:
    keys: dict[str, Any] = {"position_mm": list(position_mm), "rotation_deg": list(rotation_deg)}
    findings = schema_findings(PLACEMENT, keys)
    if findings:
        where = [f"placement, {'.'.join(map(str, one.location))}" for one in findings]
        told = zip(where, findings, strict=True)
        raise InputError(*(Problem(at, one.must_hold, one.received, one.remedy) for at, one in told))
    made: Placement = record_of(PLACEMENT.model_validate(keys))
    return made


def _vector(where: str, values: ArrayLike, count: int = 3) -> list[float]:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        must_hold = f"must be {count} finite numbers" if count > 1 else "must be a finite number"
        raise InputError.of(where, must_hold, repr(values)[:80], "give lengths in m, angles in degrees")
    return [float(x) for x in array]


def _check_axis(where: str, axis: str) -> None:
    if not isinstance(axis, str) or axis not in AXES:
        raise InputError.of(where, 'must be "x", "y" or "z"', repr(axis)[:80], "choose one of these")
