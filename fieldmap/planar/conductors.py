"""Conductors without iron: complex potential and its derivatives, docs/theory/planar.md (1)-(6)."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.constants import MU0_OVER_2PI
from fieldmap.kernels.iron.plane import polygon_derivatives
from fieldmap.planar.model import PlanarCoil, RectangularWire, RoundWire
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
_POINTS = 12


def complex_points(points: Array) -> Complex:
    """Points (n, 2) of (x, z) as complex numbers x + i z."""
    return points[:, 0] + 1j * points[:, 1]


def wires(coil: PlanarCoil) -> tuple[Complex, Array]:
    """Centres (n,) and signs (n,) of a coil's conductors, +1 into the page."""
    centres = np.concatenate([complex_points(coil.into_page), complex_points(coil.out_of_page)])
    return centres, np.repeat([1.0, -1.0], [len(coil.into_page), len(coil.out_of_page)])


def coil_derivatives(coil: PlanarCoil, points: Complex) -> Complex:
    """First three derivatives (3, n) of the coil's complex potential at 1 A, outside its conductors."""
    total = np.zeros((3, len(points)), dtype=complex)
    for centre, sign in zip(*wires(coil), strict=True):
        if isinstance(coil.wire, RoundWire):
            inverse = 1 / (points - centre)
            part = np.array([inverse, -(inverse**2), 2 * inverse**3])
        else:
            part = polygon_derivatives(points, rectangle(centre, coil.wire))
            part = part / (coil.wire.width * coil.wire.height)
        total -= sign * MU0_OVER_2PI * part
    return total


def coil_vector_potential(coil: PlanarCoil, points: Complex, scale: float) -> Array:
    """A_y (n,) at 1 A, T m/A, outside the conductors; 0 at the distance `scale` from a line current."""
    total = np.zeros(len(points))
    for centre, sign in zip(*wires(coil), strict=True):
        for offset, weight in _line_currents(coil):
            total -= sign * weight * MU0_OVER_2PI * np.log(np.abs(points - centre - offset) / scale)
    return total


def rectangle(centre: complex, wire: RectangularWire) -> Complex:
    """Corners of a rectangular conductor, counter-clockwise."""
    half = 0.5 * (wire.width + 1j * wire.height)
    return centre + np.array([-half, half.conjugate(), half, -half.conjugate()])


def _line_currents(coil: PlanarCoil) -> list[tuple[complex, float]]:
    """Offsets and shares of line currents with the same field: exact for a round wire, Gauss points otherwise."""
    if isinstance(coil.wire, RoundWire):
        return [(0j, 1.0)]
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    half = 0.5 * coil.wire.width, 0.5 * coil.wire.height
    return [
        (half[0] * x + 1j * half[1] * z, 0.25 * a * b)
        for x, a in zip(nodes, weights, strict=True)
        for z, b in zip(nodes, weights, strict=True)
    ]
