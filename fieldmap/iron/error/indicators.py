"""The iron magnetised by unit dipoles in the workspace: how much every face and element counts for the field there.

The field of the iron at a point, in one direction, is a linear functional of its charges. The operator is symmetric, so
that the dual solution of this functional is the same iron in the field of a dipole at that point, in that direction.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.elements.bh_law import Magnetisation, straight_laws
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.materials import BodyProperties
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from fieldmap.typing import Array, Index

_COUNT = 3
# Indicators need no more digits than these.
_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class WorkspaceDipoles:
    """Dipoles at points (p, 3) in the air, along x, y and z at each; mu0 times their moment is 1 T m^3."""

    points: Array

    @classmethod
    def near_iron(cls, candidates: Array, iron: ChargedFaces) -> "WorkspaceDipoles":
        """At three of the candidates (n, 3): the one nearest to the iron, and others of the nearest third that lie
        far from it and from each other."""
        distance = np.array([np.linalg.norm(iron.centres - x, axis=1).min() for x in candidates])
        near = candidates[np.argsort(distance, kind="stable")[: max(_COUNT, len(candidates) // 3)]]
        chosen = near[:1]
        for _ in range(_COUNT - 1):
            apart = np.linalg.norm(near[:, None] - chosen, axis=2).min(axis=1)
            chosen = np.vstack([chosen, near[apart.argmax()]])
        return cls(chosen)

    def flux_densities(self, x: Array) -> Array:
        """Fields (3 p, n, 3) of all dipoles at points x (n, 3), T; not at the dipoles themselves."""
        offset = x - self.points[:, None]
        r = np.linalg.norm(offset, axis=2)[:, :, None, None]
        # (p, n, i, j): component j of the field of the moment along i; symmetric.
        tensor = 3 * offset[:, :, :, None] * offset[:, :, None, :] / r**2 - np.eye(3)
        return np.moveaxis(tensor / (4 * np.pi * r**3), 2, 1).reshape(-1, len(x), 3)

    def magnetise(self, problem: ConvexForm[Any], properties: BodyProperties) -> IronState:
        """The iron in the field of every dipole alone."""
        elements, body = problem.elements, problem.iron.mesh.body
        field = elements.coil_field(self.flux_densities)
        remanence = np.zeros((3 * len(self.points), len(body), 3))
        material = Magnetisation(body, straight_laws(properties.mu_r), remanence)
        return problem.solve_linear(material, field, _TOLERANCE).iron


# Energy per area of a sawtooth of charge, slope g and standard deviation l g: zeta(3) 12^1.5 / (8 pi^3) g^2 l^3.
_SAWTOOTH = 0.2015
# What that gives for a polygon of n sides, over (1/2 pi) times its excess logarithmic capacity, 2.40 / n^3.
_BEND = 3.7
# Energy per area and height of a strip at an edge whose charge, of mean 1, is r^(-1/3), over that of the mean alone.
_TIP = 0.0156
# Faces that meet at more than this angle (radians) have charges of their own; coarse polygons are kinked by less.
_SHARP_ANGLE = 1.0
_SIDES = np.array([[0, 1], [1, 2], [2, 0]])


@dataclass(frozen=True, eq=False)
class FaceShares:
    """Shares of the surface faces (s,) for the worst source and dipole: `across` their shorter axis, for want of layers
    at sharp edges, and the rest. total: of all faces, for the source and dipole with the largest sum.

    at_edge (s,): whether the face touches a sharp edge.
    """

    across: Array
    rest: Array
    at_edge: NDArray[np.bool_]
    total: float


def face_indicators(
    surface: ChargedFaces, triangles: Index, charge: Array, dual_charge: Array, size: Array
) -> FaceShares:
    """Shares of the surface faces, relative to the largest fields size (c,) of the sources, for the worst of them and
    of the dipoles. charge (c, s), dual_charge (k, s): densities, T; triangles (s, 3): the nodes of the faces."""
    neighbours = smooth_neighbours(triangles, surface.normals)
    slopes = _slopes(surface, neighbours)
    deviation, axes = _principal_axes(surface.corners)
    weight = _SAWTOOTH * surface.areas[:, None] * deviation**3

    def slopes_of(values: Array) -> Array:
        """Along the axes of the faces (c, s, 2), of values (c, s)."""
        return np.einsum("csd,sda->csa", _gradients(slopes, neighbours, values), axes)

    # A charge on a face that should be curved errs as one with the slope charge / radius does, but more.
    bend = _BEND * ((slopes_of(surface.normals.T) ** 2).sum(axis=0) * weight).sum(axis=1)
    edge = np.zeros(int(triangles.max()) + 1, bool)
    edge[triangles[:, _SIDES][neighbours < 0]] = True
    at_edge = np.asarray(edge[triangles].any(axis=1), bool)
    tip = np.where(at_edge, _TIP * surface.areas * heights(surface.corners), 0.0)
    dual_slopes, across, rest = slopes_of(dual_charge), np.zeros(len(weight)), np.zeros(len(weight))
    total = 0.0
    for values in charge / size[:, None]:
        shares, level = np.abs(slopes_of(values[None]) * dual_slopes) * weight, np.abs(values * dual_charge)
        short, other = np.maximum(shares[:, :, 0], level * tip), shares[:, :, 1] + level * bend
        total = max(total, float((short + other).sum(axis=1).max()))
        across, rest = np.maximum(across, short.max(axis=0)), np.maximum(rest, other.max(axis=0))
    return FaceShares(across, rest, at_edge, total)


def element_indicators(
    volume: Array,
    mu_r: Array,
    forms: tuple[IronState, ...],
    dual_forms: tuple[IronState, ...],
    size: Array,
) -> Array:
    """Shares (e,) of the elements of relative permeability mu_r (e,), for the worst source and dipole.

    forms, dual_forms: potential and flux form of the sources (the first of the columns) and of the dipoles.
    """
    element, total = np.arange(len(volume)), np.zeros(len(volume))
    product = np.zeros((len(size), len(dual_forms[0].density), len(volume)))
    for point, weight in zip(*tetrahedron_rule(2), strict=True):
        barycentric = np.broadcast_to(point, (len(volume), 4))
        apart = [
            one.flux_density_at(element, barycentric) - other.flux_density_at(element, barycentric)
            for one, other in (forms, dual_forms)
        ]
        product += weight * np.einsum("ced,ked->cke", apart[0][: len(size)] / size[:, None, None], apart[1])
    total = np.abs(product).max(axis=(0, 1))
    return total * volume / mu_r


def smooth_neighbours(triangles: Index, normals: Array) -> Index:
    """Faces (s, 3) across the three sides of each of a closed surface; -1 where the surface is kinked."""
    sides = np.sort(triangles[:, _SIDES], axis=2).reshape(-1, 2)
    order = np.lexsort(sides.T)
    same = np.flatnonzero((sides[order[1:]] == sides[order[:-1]]).all(axis=1))
    one, other = order[same], order[same + 1]
    out = np.full(len(sides), -1)
    cosine = np.einsum("id,id->i", normals[one // 3], normals[other // 3])
    smooth = cosine > np.cos(_SHARP_ANGLE)
    out[one[smooth]], out[other[smooth]] = other[smooth] // 3, one[smooth] // 3
    return out.reshape(-1, 3)


def heights(corners: Array) -> Array:
    """Of triangles (n, 3, 3), over their longest sides."""
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / longest, np.float64)


def _slopes(surface: ChargedFaces, neighbours: Index) -> Array:
    """Matrices (s, 3, 3) that take differences to the three neighbours to the surface gradient, by least squares."""
    offset = surface.centres[neighbours] - surface.centres[:, None]
    offset -= np.einsum("sjd,sd->sj", offset, surface.normals)[:, :, None] * surface.normals[:, None]
    offset[neighbours < 0] = 0.0
    return np.asarray(np.linalg.pinv(offset, rcond=1e-2), np.float64)


def _gradients(slopes: Array, neighbours: Index, values: Array) -> Array:
    """Surface gradients (c, s, 3) of values (c, s)."""
    differences = np.where(neighbours < 0, 0.0, values[:, neighbours] - values[:, :, None])
    return np.einsum("sdj,csj->csd", slopes, differences)


def _principal_axes(corners: Array) -> tuple[Array, Array]:
    """Standard deviations (s, 2) of triangles along their principal axes, the shorter first, and the axes (s, 3, 2)."""
    centred = corners - corners.mean(axis=1, keepdims=True)
    variance, axes = np.linalg.eigh(np.einsum("skd,ske->sde", centred, centred) / 12)
    return np.sqrt(np.maximum(variance[:, 1:], 0.0)), axes[:, :, 1:]
