"""An independent Biot-Savart quadrature, thesis eq. (2-6), and coils that the tests share."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.device.model import CircularCoil, PathCoil, Placement, RoundedRectangleCoil

MU0 = 1.25663706127e-6


def graded_rule(low, high, near, scale, order):
    """Gauss-Legendre points on panels that double in size away from `near`."""
    steps = scale * 2.0 ** np.arange(40)
    cuts = np.concatenate([[near], near - steps, near + steps])
    edges = np.unique(np.concatenate([[low, high], cuts[(cuts > low) & (cuts < high)]]))
    nodes, weights = np.polynomial.legendre.leggauss(order)
    half = np.diff(edges)[:, None] / 2
    middle = (edges[:-1] + edges[1:])[:, None] / 2
    return (middle + half * nodes).ravel(), (half * weights).ravel()


def middle_line(coil):
    """Pieces (length, function of arc length -> position, tangent; curvature) of the winding's middle line.

    Written from the definition of the shapes, not from the package's own arcs and bars.
    """
    if isinstance(coil, CircularCoil):
        radius = (coil.inner_radius + coil.outer_radius) / 2
        seams = 2.5 + np.arange(4) * 2 * np.pi / 3  # away from the points of the tests
        return [round_piece(np.zeros(2), a, b, radius) for a, b in pairwise(seams)]
    x, y = coil.half_width_x - coil.corner_radius, coil.half_width_y - coil.corner_radius
    radius = coil.corner_radius
    pieces = []
    for k, centre in enumerate([(x, y), (-x, y), (-x, -y), (x, -y)]):
        pieces.append(round_piece(np.array(centre), k * np.pi / 2, (k + 1) * np.pi / 2, radius))
    for start, stop in [
        ((x, y + radius), (-x, y + radius)),
        ((-x - radius, y), (-x - radius, -y)),
        ((-x, -y - radius), (x, -y - radius)),
        ((x + radius, -y), (x + radius, y)),
    ]:
        pieces.append(straight_piece(np.array(start), np.array(stop)))
    return pieces


def round_piece(centre, first, last, radius):
    def place(s):
        angle = first + s / radius
        outward = np.stack([np.cos(angle), np.sin(angle)], -1)
        return centre + radius * outward, np.stack([-outward[:, 1], outward[:, 0]], -1)

    return radius * (last - first), place, 1 / radius


def straight_piece(start, stop):
    length = np.linalg.norm(stop - start)
    direction = (stop - start) / max(length, 1e-300)

    def place(s):
        return start + s[:, None] * direction, np.broadcast_to(direction, (len(s), 2))

    return length, place, 0.0


def section_of(coil):
    if isinstance(coil, CircularCoil):
        return coil.outer_radius - coil.inner_radius, coil.height
    return coil.thickness, coil.height


def quadrature(coil, point, order=12):
    """B of the coil at one point outside its winding, T/A, by the triple integral of (2-6)."""
    local = (np.asarray(point) - coil.placement.position) @ coil.placement.rotation
    thickness, height = section_of(coil)
    density = coil.turns * coil.polarity / (thickness * height)
    total = np.zeros(3)
    for length, place, curvature in middle_line(coil):
        if length == 0:
            continue
        s, ws, o, wo, z, wz = rules_for(local, length, place, thickness, height, order)
        positions, tangents = place(s)
        outward = np.stack([tangents[:, 1], -tangents[:, 0]], -1)
        for offset, weight in zip(o, wo, strict=True):
            line = positions + offset * outward
            rx = local[0] - line[:, 0, None]
            ry = local[1] - line[:, 1, None]
            rz = local[2] - z[None, :]
            element = weight * (1 + curvature * offset) * ws[:, None] * wz[None, :]
            element = element / (rx**2 + ry**2 + rz**2) ** 1.5
            tx, ty = tangents[:, 0, None], tangents[:, 1, None]
            total += [
                np.sum(element * ty * rz),
                np.sum(-element * tx * rz),
                np.sum(element * (tx * ry - ty * rx)),
            ]
    return MU0 / (4 * np.pi) * density * total @ coil.placement.rotation.T


def rules_for(local, length, place, thickness, height, order):
    """Rules along the piece, across it and along z, graded towards the nearest point of the winding."""
    trial = np.linspace(0, length, 2001)
    positions, tangents = place(trial)
    away = local[:2] - positions
    nearest = np.argmin(np.hypot(*away.T))
    outward = np.array([tangents[nearest, 1], -tangents[nearest, 0]])
    across = np.clip(away[nearest] @ outward, -thickness / 2, thickness / 2)
    level = np.clip(local[2], -height / 2, height / 2)
    gap = np.linalg.norm(np.append(away[nearest] - across * outward, local[2] - level))
    scale = max(gap, 1e-4)
    s, ws = graded_rule(0, length, trial[nearest], scale, order)
    o, wo = graded_rule(-thickness / 2, thickness / 2, across, scale, order)
    z, wz = graded_rule(-height / 2, height / 2, level, scale, order)
    return s, ws, o, wo, z, wz


@pytest.fixture
def biot_savart():
    """Function (coil, points) -> B (n, 3) by quadrature."""

    def field(coil, points, order=12):
        return np.array([quadrature(coil, point, order) for point in np.atleast_2d(points)])

    return field


def tilted():
    rotation = Rotation.from_euler("xyz", [0.3, 0.5, -0.7]).as_matrix()
    return Placement(np.array([0.01, -0.02, 0.03]), rotation)


CIRCULAR = CircularCoil("circular", 0.011, 0.021, 0.039, 840.0)
ROUNDED = RoundedRectangleCoil("rounded square", 0.016, 0.016, 0.015, 0.010, 0.039, 840.0)
OBLONG = RoundedRectangleCoil("oblong", 0.03, 0.02, 0.006, 0.008, 0.02, 100.0, -1, tilted())
ANGLE = PathCoil(
    "angle",
    np.array([[0, 0], [0.06, 0], [0.06, 0.03], [0.03, 0.03], [0.03, 0.07], [0, 0.07]]),
    0.006,
    0.008,
    0.01,
    50.0,
)
TRIANGLE = PathCoil("triangle", np.array([[0, 0], [0.06, 0], [0.03, 0.05]]), 0.006, 0.008, 0.01, 50.0)


@pytest.fixture(params=[CIRCULAR, ROUNDED, OBLONG, ANGLE, TRIANGLE], ids=lambda coil: coil.name)
def coil(request):
    """Every kind of coil, one of them tilted and reversed, one with a corner to the right."""
    return request.param


@pytest.fixture(params=[CIRCULAR, ROUNDED, OBLONG], ids=lambda coil: coil.name)
def simple_coil(request):
    """The coils whose middle line the quadrature can integrate."""
    return request.param


@pytest.fixture
def near_and_far():
    """Function coil -> points (n, 3): 1 mm from the winding on all sides, in the hole, and up to 0.2 m away."""

    def points(coil):
        if isinstance(coil, PathCoil):
            inner = coil.corners.min(axis=0) - coil.thickness / 2 - 0.001
            low = np.array([[inner[0], 0.03, 0.001], [0.02, inner[1], 0.0]])
            height = coil.height / 2 + 0.001
            return np.vstack([low, [[0.001, 0.02, height], [0.05, 0.001, -height]], far_points()])
        inner, outer = reaches(coil)
        top = coil.height / 2 + 0.001
        middle = (inner + outer) / 2
        local = [
            [inner - 0.001, 0.0, 0.001],
            [-outer - 0.001, 0.002, coil.height / 2],
            [middle, 0.001, top],
            [0.0, 0.0, 0.3 * coil.height],
            [0.3 * inner, -0.4 * inner, -0.6 * coil.height],
        ]
        return np.vstack(
            [np.array(local) @ coil.placement.rotation.T + coil.placement.position, far_points()]
        )

    return points


def reaches(coil):
    if isinstance(coil, CircularCoil):
        return coil.inner_radius, coil.outer_radius
    return coil.half_width_x - coil.thickness / 2, coil.half_width_x + coil.thickness / 2


def far_points():
    return np.random.default_rng(7).uniform(-0.1, 0.1, (4, 3)) + [0, 0, -0.15]
