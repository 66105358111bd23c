"""How the field of a map follows currents that change all the time: what a compiled loop superposes.

Linear iron: the coils' fields. Saturating iron: linearised about currents, or a table over the division of six.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_positive
from fieldmap.device.current_division import divide_currents
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.motion.weights import SUPERPOSED, TABLED
from fieldmap.lookup import (
    FieldMap,
    division_domain,
    iron_weights,
    saturates,
    tangent_block,
    unit_block,
)

Array = NDArray[np.float64]

_NO_GRID = np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class FieldOfCurrents:
    """block: coefficients of the fields; numbers: as fieldmap.kernels.motion.weights takes them; assumptions."""

    block: Array
    numbers: tuple[Any, ...]
    assumptions: tuple[str, ...]


def superposed(field_map: FieldMap, scale: float = 1.0) -> FieldOfCurrents:
    """The field of a map of linear iron. scale: a calibration, by which all of it is multiplied.

    Raises InputError for a map of saturating iron.
    """
    check_positive("superposed", scale=scale)
    _, block = field_map.compiled()
    return FieldOfCurrents(block, _superposed(scale), _words(scale))


def linearised(field_map: FieldMap, currents: ArrayLike, scale: float = 1.0) -> FieldOfCurrents:
    """The field of a map of saturating iron, linear in the currents about `currents` (n,), A: fast, and right near
    them only. A map of linear iron is taken as it is."""
    check_positive("linearised", scale=scale)
    if not saturates(field_map):
        return superposed(field_map, scale)
    amperes = np.asarray(currents, float)
    block = tangent_block(field_map, amperes)
    about = ", ".join(f"{value:.3g}" for value in amperes)
    words = f"saturating iron, linearised about the currents {about} A"
    return FieldOfCurrents(block, _superposed(scale), (words, *_words(scale)))


def tabled(
    field_map: FieldMap, nodes: tuple[int, int, int] = (7, 17, 17), scale: float = 1.0
) -> FieldOfCurrents:
    """The field of a map of saturating iron over its division (u, x, y): values and slopes of the reduced model at
    nodes, exact for quadratic dependence in between. Raises InputError for a map of another domain."""
    check_positive("tabled", scale=scale)
    domain = division_domain(field_map)
    if domain is None:
        problem = Problem(
            "tabled(field_map)",
            "must be a map of saturating iron over a division",
            repr(field_map),
            "take superposed or linearised",
        )
        raise InputError(problem)
    lower, upper, exponent = domain
    axes = [np.linspace(a, b, n) for a, b, n in zip(lower, upper, nodes, strict=True)]
    u, x, y = (part.ravel() for part in np.meshgrid(*axes, indexing="ij"))
    values, slopes = iron_weights(field_map, divide_currents(u, x, y, exponent))
    grid = np.array([[axis[0], axis[1] - axis[0], len(axis)] for axis in axes])
    words = f"saturating iron by a table of {' x '.join(map(str, nodes))} states of the division"
    numbers = (
        TABLED,
        float(scale),
        grid,
        np.ascontiguousarray(values),
        np.ascontiguousarray(np.swapaxes(slopes, 1, 2)),
        float(exponent),
    )
    return FieldOfCurrents(unit_block(field_map), numbers, (words, *_words(scale)))


def _superposed(scale: float) -> tuple[Any, ...]:
    return (SUPERPOSED, float(scale), _NO_GRID, np.zeros((0, 0)), np.zeros((0, 0, 0)), 1.0)


def _words(scale: float) -> tuple[str, ...]:
    return () if scale == 1.0 else (f"field of the map times {scale:g}, a calibration",)
