"""Closed surfaces of triangles: a reader of STL files, and the faults of a surface that bounds no solid."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import LARGEST_NUMBER
from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array, Index

_SIDES = ((0, 1), (1, 2), (2, 0))
# Rounding of coordinates as a share of the surface's size.
_FLAT = 1e-12
# Pairs of triangles whose bounding boxes are compared at a time.
_PAIRS = 200_000
# Corners of a shell that are tested for lying in another shell; more than half of them must.
_LOOKED_AT = 9


def surface_fault(points: Array, triangles: Index) -> tuple[str, str, str] | None:
    """What must hold, what was received and the remedy, for a surface that bounds no solid; None for one that does.

    points (n, 3) in any unit, triangles (m, 3): numbers of points. Faults are numbers out of range, repeated corners,
    open edges, triangles of the wrong sense, a negative enclosed volume (the surface is inside out), and shells that
    face the wrong way: a shell must face outward, or inward if it is a cavity in another shell. `crossing_triangles`
    finds surfaces that cut themselves.

    >>> corners = np.vstack([np.zeros(3), np.eye(3)])
    >>> surface_fault(corners, np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])) is None
    True
    >>> surface_fault(corners, np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3]]))[1]
    'an open edge between points 0 and 1 (3 in all)'
    """
    if triangles.min() < 0 or triangles.max() >= len(points):
        wrong = triangles[((triangles < 0) | (triangles >= len(points))).any(axis=1)][0].tolist()
        return f"triangles are numbers of points, 0 to {len(points) - 1}", f"{wrong}", "number them from 0"
    sides = np.concatenate([triangles[:, pair] for pair in _SIDES])
    alike = sides[sides[:, 0] == sides[:, 1]]
    if len(alike):
        return (
            "three different corners in each triangle",
            f"point {alike[0, 0]} twice",
            "remove that triangle",
        )
    seen, count = np.unique(sides, axis=0, return_counts=True)
    edges = set(map(tuple, seen.tolist()))
    lonely = sorted(edge for edge in edges if edge[::-1] not in edges)
    doubled = seen[count > 1]
    closed = "a closed surface: each edge belongs to two triangles, which run along it in opposite ways"
    if len(doubled):
        one, two = doubled[0].tolist()
        received = f"two triangles that run the same way from point {one} to {two} ({len(doubled)} in all)"
        return closed, received, "turn the triangles so that all are counter-clockwise seen from outside"
    if lonely:
        one, two = min(tuple(sorted(edge)) for edge in lonely)
        return (
            closed,
            f"an open edge between points {one} and {two} ({len(lonely)} in all)",
            "close the surface",
        )
    volume = enclosed_volume(points, triangles)
    if volume <= 0:
        received = f"an enclosed volume of {volume:.4g}"
        must_hold = "triangles must turn counter-clockwise seen from outside"
        return must_hold, received, "the surface is inside out: reverse the corners of each triangle"
    return _shell_fault(points, triangles)


def shells_of(triangles: Index) -> list[Index]:
    """Numbers of the triangles of each shell, in order; a shell is a set of triangles connected through edges."""
    ends = np.sort(np.concatenate([triangles[:, pair] for pair in _SIDES]), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    order = np.argsort(edge.ravel(), kind="stable")
    beside = order % len(triangles)
    same = np.flatnonzero(np.diff(edge.ravel()[order]) == 0)
    label = np.arange(len(triangles))
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, beside[same], label[beside[same + 1]])
        np.minimum.at(lowest, beside[same + 1], label[beside[same]])
        lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            return [np.flatnonzero(label == first) for first in np.unique(label)]
        label = lowest


def shell_words(points: Array, triangles: Index, shells: list[Index], number: int) -> str:
    """A shell by its number from 1, its first triangle, and its extent."""
    corners = points[triangles[shells[number]]].reshape(-1, 3)
    low, high = (", ".join(f"{x:.4g}" for x in end) for end in (corners.min(axis=0), corners.max(axis=0)))
    count = len(shells[number])
    return f"shell {number + 1} of {len(shells)} ({count} triangles from {shells[number][0]}, ({low}) to ({high}))"


def _shell_fault(points: Array, triangles: Index) -> tuple[str, str, str] | None:
    """The fault of a shell that faces the wrong way, given the shells that it lies in."""
    shells = shells_of(triangles)
    if len(shells) == 1:
        return None
    around = [
        [other for other in range(len(shells)) if other != k and _holds(points, triangles, shells, other, k)]
        for k in range(len(shells))
    ]
    for k, outer in enumerate(around):
        outward = enclosed_volume(points, triangles[shells[k]]) > 0
        if outward == (len(outer) % 2 == 0):
            continue
        words = shell_words(points, triangles, shells, k)
        if outer:
            words += f" in shell {outer[0] + 1}"
        faces = "outward" if outward else "inward"
        remedy = "turn the triangles of that shell" + (", or remove it if it is no cavity" if outward else "")
        return (
            "shells face outward, and inward where they are cavities of another",
            f"{words} faces {faces}",
            remedy,
        )
    return None


def _holds(points: Array, triangles: Index, shells: list[Index], outer: int, inner: int) -> bool:
    """Whether shell `inner` lies in shell `outer`, by the solid angle of the outer shell at corners of the inner one
    (van Oosterom and Strackee 1983)."""
    corners = points[np.unique(triangles[shells[inner]])]
    hull = points[triangles[shells[outer]]]
    low, high = hull.min(axis=(0, 1)), hull.max(axis=(0, 1))
    if not ((corners > low) & (corners < high)).all():
        return False
    places = corners[:: max(1, len(corners) // _LOOKED_AT)]
    a, b, c = np.moveaxis(hull[None] - places[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    ab, bc, ca = (np.einsum("pkd,pkd->pk", *pair) for pair in ((a, b), (b, c), (c, a)))
    volume = np.einsum("pkd,pkd->pk", a, np.cross(b, c))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return bool(np.median(np.abs(angle.sum(axis=1))) > 2 * np.pi)


def enclosed_volume(points: Array, triangles: Index) -> float:
    """Volume inside a closed surface; negative if the surface is inside out."""
    centred = points - points.mean(axis=0)
    a, b, c = np.moveaxis(centred[triangles], 1, 0)
    return float(np.einsum("kd,kd->", a, np.cross(b, c)) / 6)


def crossing_triangles(points: Array, triangles: Index) -> tuple[int, int] | None:
    """Two triangles of a surface that cut each other and share no corner; None if there are none.

    An edge of one goes through the inside of the other. Candidates are pairs with overlapping bounding boxes.
    """
    corners = points[triangles]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    order = np.argsort(lower[:, 0], kind="stable")
    size = float(np.ptp(points, axis=0).max())
    place = np.arange(len(order))
    # For each triangle, ordered by the lower x of the boxes: the later ones whose box begins before its box ends.
    begin, end = place + 1, np.searchsorted(lower[order, 0], upper[order, 0], side="right")
    many = np.maximum(end - begin, 0)
    for part in np.split(place, np.flatnonzero(np.diff(np.cumsum(many) // _PAIRS)) + 1):
        count = many[part]
        start = np.repeat(begin[part] - (np.cumsum(count) - count), count)
        one, other = order[np.repeat(part, count)], order[start + np.arange(len(start))]
        near = (lower[other] <= upper[one]).all(axis=1) & (upper[other] >= lower[one]).all(axis=1)
        one, other = one[near], other[near]
        apart = ~(triangles[other][:, :, None] == triangles[one][:, None]).any(axis=(1, 2))
        one, other = one[apart], other[apart]
        cut = _edges_cross(corners[one], corners[other], size)
        cut |= _edges_cross(corners[other], corners[one], size)
        if cut.any():
            first = np.argmax(cut)
            return int(one[first]), int(other[first])
    return None


def crossing_fault(points: Array, triangles: Index) -> tuple[str, str, str] | None:
    """What must hold, what was received and the remedy, for a surface that cuts itself; None for one that does not."""
    found = crossing_triangles(points, triangles)
    if found is None:
        return None
    received = f"triangles {found[0]} and {found[1]}, which cut each other"
    shells = shells_of(triangles)
    of = [next(k for k, shell in enumerate(shells) if triangle in shell) for triangle in found]
    if of[0] != of[1]:
        received += f", of {' and '.join(shell_words(points, triangles, shells, k) for k in sorted(of))}"
    return "the surface must not cut itself", received, "join the shells in the program that made them"


def _edges_cross(these: Array, those: Array, size: float) -> NDArray[np.bool_]:
    """Whether an edge of triangle these[k] (k, 3, 3) goes through the inside of triangle those[k]."""
    a, b, c = np.moveaxis(those, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    height = np.einsum("kid,kd->ki", these - a[:, None], normal)
    height[np.abs(height) < _FLAT * size] = 0.0
    crosses = np.zeros(len(these), bool)
    for i, j in _SIDES:
        through = height[:, i] * height[:, j] < 0
        share = np.where(through, height[:, i] / np.where(through, height[:, i] - height[:, j], 1.0), 0.0)
        x = these[:, i] + share[:, None] * (these[:, j] - these[:, i])
        inside = through
        for p, q in ((a, b), (b, c), (c, a)):
            inside = inside & (np.einsum("kd,kd->k", np.cross(q - p, x - p), normal) > _FLAT * size**2)
        crosses |= inside
    return crosses


_HEAD, _RECORD = 84, 50
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


def read_stl(path: Path) -> tuple[Array, Index]:
    """Corners (n, 3), in the unit of the file, and triangles (m, 3) of an STL file, binary or text.

    Equal corners are merged; triangles without area are left out. Raises InputError for a file that cannot be read or
    is no STL file.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        problem = Problem(str(path), "must be a file that can be read", str(error.strerror), "check the path")
        raise InputError(problem) from error
    count = int.from_bytes(data[80:_HEAD], "little") if len(data) >= _HEAD else -1
    if len(data) == _HEAD + _RECORD * count:
        records = np.frombuffer(data, np.uint8, offset=_HEAD).reshape(-1, _RECORD)
        numbers = np.ascontiguousarray(records[:, 12:48]).view("<f4").astype(float)
    else:
        numbers = _numbers_of_text(data)
    if not len(numbers) or numbers.size % 9 or not (np.abs(numbers) <= LARGEST_NUMBER).all():
        received = f"{len(data)} bytes, {numbers.size // 3} corners, or numbers beyond {LARGEST_NUMBER:g}"
        remedy = "write it again as STL, binary or text"
        raise InputError.of(str(path), "must be an STL file with whole triangles", received, remedy)
    points, index = np.unique(numbers.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    triangles = index.reshape(-1, 3).astype(np.int64)
    corners = points[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return points, triangles[area > 0]


def _numbers_of_text(data: bytes) -> Array:
    found = _VERTEX.findall(data) if data.lstrip()[:5].lower() == b"solid" else []
    try:
        return np.array(found, dtype="S").astype(float) if found else np.zeros((0, 3))
    except ValueError:
        return np.zeros((0, 3))
