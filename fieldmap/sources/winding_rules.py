"""Quadrature over windings: current elements for forces, flux elements for flux linkages.

A winding is arcs and bars (`fieldmap.device.coils.winding`); a circular coil is one arc of a full turn. All rules are
products of Gauss-Legendre rules, along the current, across the winding and along its axis; round a full turn the
points are equally spaced.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fieldmap.device.air_fields import segments_of, sheet_of
from fieldmap.device.air_sources import OTHER, AirSource
from fieldmap.device.coils import Coil
from fieldmap.device.placement import Placement
from fieldmap.errors import InputError
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.typing import Array

# Number of current elements along the shorter side of a winding's section; the other directions have the same density.
_PER_SIDE = 4
# Limits of the number along any direction: fewest; most across and along the axis; most along the current.
_FEWEST, _MOST_ACROSS, _MOST_ALONG = 4, 48, 200
# Current elements of filaments: points round a loop, and Gauss points along a segment.
_ROUND_A_LOOP, _ALONG_A_LINE = 720, 12
# Flux elements: Gauss points across the winding, along an arc, and on each panel of a graded interval.
_ACROSS, _ALONG_ARC, _PER_PANEL = 10, 12, 8
# Panels shrink by this factor towards the winding and its ends, where the field varies over the size of its section.
_PANEL_RATIO = 0.25


@dataclass(frozen=True, eq=False, repr=False)
class WindingRule(Record):
    """points (n, 3) in m and vectors (n, 3), global frame.

    Current elements: vectors in m, with sum f(points) x vectors the integral of J f over the winding for one ampere.
    Flux elements: vectors in m^2, with sum B(points) . vectors the flux linkage. Turns and polarity are included.
    """

    points: Array
    vectors: Array


def current_elements(coil: Coil) -> WindingRule:
    """Points in a winding, or on a coil's filaments and sheets, with their current elements J dV per ampere."""
    if not coil.has_winding:
        return rule_of_parts(coil, map(current_elements_of, coil.filaments))
    path = coil.winding()
    spacing = min(path.thickness, path.height) / _PER_SIDE
    across, axial = (_count(side, spacing, _MOST_ACROSS) for side in (path.thickness, path.height))
    parts = [_arc_currents(arc, across, spacing) for arc in path.arcs]
    parts += [_bar_currents(bar, path.thickness, across, spacing) for bar in path.bars]
    flat, tangent = (np.concatenate([part[k] for part in parts]) for k in range(2))
    vectors = np.column_stack([tangent, np.zeros(len(tangent))]) / path.thickness
    return _stacked(coil, _gauss(axial, -path.height / 2, path.height / 2), flat, vectors)


def current_elements_of(source: AirSource) -> tuple[Array, Array]:
    """Points (n, 3), m, and current elements (n, 3), A m, of a current at its place: the force is sum of elements x B.

    Raises InputError for a source that is no current of magpylib's kinds.
    """
    if source.kind == "Circle":
        points, elements = loop_elements(source, _ROUND_A_LOOP)
    elif source.kind == "Polyline":
        start, end = segments_of(source)
        share, weights = _gauss(_ALONG_A_LINE, 0.0, 1.0)
        points = (start[:, None] + share[:, None] * (end - start)[:, None]).reshape(-1, 3)
        elements = (source.amperes * weights[:, None] * (end - start)[:, None]).reshape(-1, 3)
    elif source.kind in ("TriangleSheet", "TriangleStrip"):
        corners, density = sheet_of(source)
        rule, weights = triangle_rule(4)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = 0.5 * np.linalg.norm(across, axis=1)
        points = np.einsum("qk,mkd->mqd", rule, corners).reshape(-1, 3)
        elements = (weights[:, None] * (area[:, None] * density)[:, None]).reshape(-1, 3)
    else:
        name = type(source.live).__name__ if source.kind == OTHER else source.kind
        remedy = "ask for the force on the other bodies and coils"
        raise InputError.of("force, name", "currents whose places are known", f"a {name}", remedy)
    return placed(source.placement, points, elements)


def loop_elements(source: AirSource, count: int) -> tuple[Array, Array]:
    """Points (n, 3) round a Circle and current elements (n, 3), A m, in its own frame."""
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    radius = 0.5 * source.diameter  # type: ignore[operator]
    points = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    return points, source.amperes * 2 * np.pi / count * np.cross([0.0, 0.0, 1.0], points)


def placed(placement: Placement, points: Array, vectors: Array) -> tuple[Array, Array]:
    """Points and vectors (n, 3), given in a placed frame, in the frame around it."""
    turn = np.asarray(placement.rotation, dtype=float).T
    return np.ascontiguousarray(points @ turn + placement.position), np.ascontiguousarray(vectors @ turn)


def rule_of_parts(coil: Coil, parts: Iterable[tuple[Array, Array]]) -> WindingRule:
    """Points and vectors (n, 3) of one turn in the frame of the coil, all together in the global frame."""
    points, vectors = (np.concatenate(several) for several in zip(*parts, strict=True))
    return WindingRule(*placed(coil.placement, points, coil.turns * coil.polarity * vectors))


def flux_elements(coil: Coil) -> WindingRule:
    """Points in the coil with the area, as a vector, that its turns span there: linkage = sum B . vectors.

    The mean over the winding's section of the flux through a turn is an integral over the plane of the coil. The weight
    of a point is the share of turns around it: 1 inside, falling to 0 across the winding.
    """
    path = coil.winding()
    turning = path.turning
    middle = np.concatenate([path.arcs[:, :2], path.bars[:, :2]]).mean(axis=0)
    size = min(path.thickness, path.height)
    parts = []
    for arc in path.arcs:
        parts += [_arc_strip(arc, path.thickness, turning), _fan(*_arc_edge(arc, turning), middle, size)]
    for bar in path.bars:
        along = graded(bar[4], size)
        parts += [
            _bar_strip(bar, along, path.thickness, turning),
            _fan(*_bar_edge(bar, along, turning * path.thickness / 2), middle, size),
        ]
    flat, area = (np.concatenate([part[k] for part in parts]) for k in range(2))
    vectors = np.zeros((len(area), 3))
    vectors[:, 2] = area
    return _stacked(coil, graded(path.height / 2, size), flat, vectors)


def _count(length: float, spacing: float, most: int) -> int:
    return int(min(max(math.ceil(length / spacing), _FEWEST), most))


def _gauss(count: int, low: float, high: float) -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (high - low) * (x + 1), 0.5 * (high - low) * w


def _panels(smallest: float) -> tuple[Array, Array]:
    """Rule on [0, 1] in panels that shrink towards 1, the last about as long as `smallest`."""
    ends = [0.0]
    while 1 - ends[-1] > 2 * smallest:
        ends.append(1 - _PANEL_RATIO * (1 - ends[-1]))
    pieces = [_gauss(_PER_PANEL, low, high) for low, high in zip(ends, [*ends[1:], 1.0], strict=True)]
    return np.concatenate([x for x, _ in pieces]), np.concatenate([w for _, w in pieces])


def graded(half: float, smallest: float) -> tuple[Array, Array]:
    """Rule on [-half, half] in panels that shrink towards both ends."""
    x, w = _panels(smallest / half)
    return half * np.concatenate([-x[::-1], x]), half * np.concatenate([w[::-1], w])


def _angles(arc: Array, count: int) -> tuple[Array, Array]:
    """Angles over an arc and weights; equally spaced on a full circle."""
    middle, half = math.atan2(arc[3], arc[2]), arc[4]
    if half > math.pi * (1 - 1e-12):
        turn = math.pi / count
        angles = np.asarray(middle + turn * (np.arange(2 * count) + 0.5), np.float64)
        return angles, np.full(2 * count, turn, np.float64)
    return _gauss(count, middle - half, middle + half)


def _arc_currents(arc: Array, across: int, spacing: float) -> tuple[Array, Array]:
    """Points (n, 2) of one arc and the tangents times area (n, 2)."""
    r, wr = _gauss(across, arc[5], arc[6])
    angle, wa = _angles(arc, _count(arc[6] * arc[4] * (1 if arc[4] > 3 else 2), spacing, _MOST_ALONG))
    r, angle = (grid.ravel() for grid in np.meshgrid(r, angle, indexing="ij"))
    weight = arc[7] * r * np.outer(wr, wa).ravel()
    cos, sin = np.cos(angle), np.sin(angle)
    flat = arc[:2] + r[:, None] * np.column_stack([cos, sin])
    return flat, weight[:, None] * np.column_stack([-sin, cos])


def _bar_currents(bar: Array, thickness: float, across: int, spacing: float) -> tuple[Array, Array]:
    along, wa = _gauss(_count(2 * bar[4], spacing, _MOST_ALONG), -bar[4], bar[4])
    side, ws = _gauss(across, -thickness / 2, thickness / 2)
    flat = _bar_points(bar, along, side)
    return flat, np.outer(wa, ws).reshape(-1, 1) * bar[2:4]


def _bar_points(bar: Array, along: Array, side: Array) -> Array:
    """Points (n, 2) at distances along the bar and to its left, the latter running fastest."""
    a, s = (grid.ravel() for grid in np.meshgrid(along, side, indexing="ij"))
    return bar[:2] + a[:, None] * bar[2:4] + s[:, None] * np.array([-bar[3], bar[2]])


def _arc_strip(arc: Array, thickness: float, turning: float) -> tuple[Array, Array]:
    """Points (n, 2) within the winding, and their areas (n,) times the share of net turns around them, which falls with
    the distance to the left of the middle line."""
    r, wr = _gauss(_ACROSS, arc[5], arc[6])
    angle, wa = _angles(arc, _ALONG_ARC)
    share = arc[7] * (0.5 * (arc[5] + arc[6]) - r) / thickness + 0.5 * turning
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    flat = (arc[:2] + r[:, None, None] * unit).reshape(-1, 2)
    return flat, np.outer(share * r * wr, wa).ravel()


def _bar_strip(bar: Array, way: tuple[Array, Array], thickness: float, turning: float) -> tuple[Array, Array]:
    along, wa = way
    side, ws = _gauss(_ACROSS, -thickness / 2, thickness / 2)
    return _bar_points(bar, along, side), np.outer(wa, ws * (side / thickness + 0.5 * turning)).ravel()


def _arc_edge(arc: Array, turning: float) -> tuple[Array, Array]:
    """Points (n, 2) on the winding's inner edge and their line elements (n, 2) along the current."""
    radius = arc[5] if arc[7] == turning else arc[6]
    angle, weight = _angles(arc, _ALONG_ARC)
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    tangent = arc[7] * np.column_stack([-unit[:, 1], unit[:, 0]])
    return arc[:2] + radius * unit, (radius * weight)[:, None] * tangent


def _bar_edge(bar: Array, way: tuple[Array, Array], left: float) -> tuple[Array, Array]:
    """As `_arc_edge`, at a distance to the left of the bar's middle line."""
    along, weight = way
    return _bar_points(bar, along, np.array([left])), weight[:, None] * bar[2:4]


def _fan(edge: Array, step: Array, middle: Array, size: float) -> tuple[Array, Array]:
    """Points (n, 2) and signed areas (n,) of the triangles from `middle` to line elements of an edge."""
    reach = edge - middle
    twice = reach[:, 0] * step[:, 1] - reach[:, 1] * step[:, 0]
    s, w = _panels(size / max(np.linalg.norm(reach, axis=1).max(), size))
    flat = (middle + s[:, None, None] * reach).reshape(-1, 2)
    return flat, np.outer(s * w, twice).ravel()


def _stacked(coil: Coil, levels: tuple[Array, Array], flat: Array, vectors: Array) -> WindingRule:
    """The rule of a plane (n, 2) repeated at levels along the axis, turned and moved to the coil's place."""
    z, wz = levels
    local = np.concatenate([np.column_stack([flat, np.full(len(flat), level)]) for level in z])
    return rule_of_parts(coil, [(local, np.concatenate([vectors * w for w in wz / wz.sum()]))])
