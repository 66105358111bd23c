"""Inductances of currents on lines: loops and polylines, by vector potentials in closed form.

The vector potential of a line is infinite on it. A round wire of radius a with uniform current density has the
self-inductance of a line whose distances are sqrt(r^2 + delta^2), delta = a exp(-1/4), the geometric mean distance of
its section from itself (Rosa, Bull. Bureau of Standards 4 (1908) 301), for a much less than the radius of curvature.
"""

import numpy as np
from scipy.special import ellipe, ellipk

from fieldmap.constants import MU0
from fieldmap.device.air_fields import segments_of
from fieldmap.device.air_sources import AirSource
from fieldmap.device.coils import Coil
from fieldmap.errors import InputError
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.sources.winding_rules import WindingRule, graded, loop_elements, placed, rule_of_parts
from fieldmap.typing import Array

LINES = ("Circle", "Polyline")
# Points round a loop; for the flux, points from its centre outwards, and degree of the rule on a polygon's triangles.
_ROUND, _OUTWARD, _DEGREE = 128, 12, 4
# Panels towards the corners of a polyline are no shorter than this part of a segment, if its wire is not thicker.
_SHORTEST = 1e-4


def is_lines(coil: Coil) -> bool:
    """Whether the coil consists of loops and polylines alone."""
    return bool(coil.filaments) and all(source.kind in LINES for source in coil.filaments)


def line_elements(coil: Coil) -> WindingRule:
    """Points on the lines of a coil with the current elements there, for a function that varies as their potential."""
    return rule_of_parts(coil, (placed(source.placement, *_elements(source)) for source in coil.filaments))


def vector_potential(coil: Coil, points: Array) -> Array:
    """A (n, 3) in T m at points (n, 3), global frame, for one ampere; turns and polarity are included."""
    turn = np.asarray(coil.placement.rotation, np.float64)
    local = (points - coil.placement.position) @ turn
    total = np.sum([_placed_potential(source, local, 0.0) for source in coil.filaments], axis=0)
    return np.asarray(coil.turns * coil.polarity * total @ turn.T, np.float64)


def self_inductance(coil: Coil) -> float:
    """Self-inductance, H, of a coil of lines with a wire diameter; its `turns` are taken to lie in one wire's place.

    Raises InputError without a wire, and for sheets and objects of other classes.
    """
    wire = getattr(coil, "wire_diameter", None)
    if not is_lines(coil) or wire is None:
        must_hold = "self-inductance needs a winding, or loops and polylines with a wire_diameter"
        kinds = ", ".join(sorted({source.kind for source in coil.filaments}))
        received = f"{kinds} without a wire_diameter" if is_lines(coil) else kinds
        raise InputError.of(f"coil {coil.name!r}", must_hold, received, "state wire_diameter of the coil")
    mean_distance = 0.5 * wire * np.exp(-0.25)
    total = 0.0
    for k, source in enumerate(coil.filaments):
        points, vectors = placed(source.placement, *_elements(source, mean_distance))
        for j, other in enumerate(coil.filaments):
            potential = _placed_potential(other, points, mean_distance if j == k else 0.0)
            total += float(np.sum(potential * vectors))
    return coil.turns**2 * total


def flux_elements_of_lines(coil: Coil) -> WindingRule:
    """Points on the surfaces that the lines of a coil span, with areas as vectors: linkage = sum B . vectors.

    A loop spans its disk, a polyline triangles from the mean of its corners. Raises InputError for a polyline that is
    not closed and for sheets.
    """
    return rule_of_parts(
        coil, (placed(source.placement, *_flux_elements(coil, source)) for source in coil.filaments)
    )


# ---- one source, in its own frame ----


def _elements(source: AirSource, shortest: float = 0.0) -> tuple[Array, Array]:
    """Points (n, 3) and current elements (n, 3), A m."""
    if source.kind == "Circle":
        return loop_elements(source, _ROUND)
    places_of, vectors_of = [], []
    for start, end in zip(*segments_of(source), strict=True):
        half = 0.5 * float(np.linalg.norm(end - start))
        places, weights = graded(half, max(shortest, _SHORTEST * half))
        along = (end - start) / (2 * half)
        places_of.append(0.5 * (start + end) + places[:, None] * along)
        vectors_of.append(source.amperes * weights[:, None] * along)
    return np.concatenate(places_of), np.concatenate(vectors_of)


def _potential(source: AirSource, points: Array, mean_distance: float) -> Array:
    if source.kind == "Circle":
        return _potential_of_loop(source, points, mean_distance)
    total = np.zeros(points.shape)
    for start, end in zip(*segments_of(source), strict=True):
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        place = (points - start) @ along
        across = np.linalg.norm(points - start - place[:, None] * along, axis=1)
        distance = np.maximum(np.hypot(across, mean_distance), 1e-12 * length)
        total += (np.arcsinh((length - place) / distance) + np.arcsinh(place / distance))[:, None] * along
    return MU0 / (4 * np.pi) * source.amperes * total


def _potential_of_loop(source: AirSource, points: Array, mean_distance: float) -> Array:
    """Jackson, Classical Electrodynamics, eq. (5.37); mean_distance^2 of the wire is added to the squared distance."""
    radius = 0.5 * source.diameter  # type: ignore[operator]
    rho = np.hypot(points[:, 0], points[:, 1])
    height = points[:, 2] ** 2 + mean_distance**2
    m = np.minimum(4 * radius * rho / ((radius + rho) ** 2 + height), 1 - 1e-15)
    near_axis = m < 1e-6
    safe = np.where(near_axis, 0.5, m)
    full = (2 - safe) * ellipk(safe) - 2 * ellipe(safe)
    full *= np.sqrt(radius / np.where(near_axis, 1.0, rho * safe))
    # Near the axis (2 - m) K - 2 E = pi m^2 / 16.
    small = np.pi / 16 * m * np.sqrt(4 * radius**2 / ((radius + rho) ** 2 + height))
    size = MU0 * source.amperes / (2 * np.pi) * np.where(near_axis, small, full)
    turn = np.divide(size, rho, out=np.zeros_like(rho), where=rho > 0)
    return np.column_stack([-turn * points[:, 1], turn * points[:, 0], np.zeros(len(rho))])


def _flux_elements(coil: Coil, source: AirSource) -> tuple[Array, Array]:
    if source.kind == "Circle":
        nodes, weights = np.polynomial.legendre.leggauss(_OUTWARD)
        radius = 0.25 * source.diameter * (1 + nodes)  # type: ignore[operator]
        angle = 2 * np.pi * (np.arange(_ROUND) + 0.5) / _ROUND
        r, phi = (grid.ravel() for grid in np.meshgrid(radius, angle, indexing="ij"))
        area = np.outer(0.25 * source.diameter * weights * radius, np.full(_ROUND, 2 * np.pi / _ROUND))  # type: ignore[operator]
        points = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.zeros(len(r))])
        return points, source.amperes * area.reshape(-1, 1) * [0.0, 0.0, 1.0]
    closed = source.kind == "Polyline" and np.allclose(source.vertices[0], source.vertices[-1], rtol=1e-9)  # type: ignore[index]
    if not closed:
        must_hold = "flux is linked with loops and closed polylines"
        received, remedy = f"a {source.kind}, not closed", "close the line at its first corner"
        raise InputError.of(f"coil {coil.name!r}", must_hold, received, remedy)
    start, end = segments_of(source)
    middle = start.mean(axis=0)
    rule, weights = triangle_rule(_DEGREE)
    corners = np.stack([np.broadcast_to(middle, start.shape), start, end], axis=1)
    area = 0.5 * np.cross(start - middle, end - middle)
    points = np.einsum("qk,mkd->mqd", rule, corners).reshape(-1, 3)
    return points, source.amperes * (weights[:, None] * area[:, None]).reshape(-1, 3)


# ---- places ----


def _placed_potential(source: AirSource, points: Array, mean_distance: float) -> Array:
    turn = np.asarray(source.placement.rotation, np.float64)
    return _potential(source, (points - source.placement.position) @ turn, mean_distance) @ turn.T
