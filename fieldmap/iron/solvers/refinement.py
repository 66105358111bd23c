"""Shares of faces and elements in the error of the field in the workspace, and element sizes of the next mesh.

The field of the iron at a point, in one direction, is a linear functional of its charges. The operator is symmetric, so
that the dual solution of this functional is the same iron in the field of a dipole at that point, in that direction:
the iron magnetised by unit dipoles in the workspace shows how much every face and element counts for the field there.

If shares fall like h^p on h^-d elements, equal shares need the fewest elements: h changes by the (p + d)th root of the
wanted share over the present one. The order p is measured by uniform refinement of devices with sharp edges; the first
layer at those edges has the order of the singularity r^(-1/3).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fieldmap.iron.elements.bh_law import Magnetisation, straight_laws
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.materials import BodyProperties
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import LAYER_RATIO
from fieldmap.iron.mesh.mesher import LocalSizes, MesherCells
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.mutual import face_images
from fieldmap.iron.topology import TRIANGLE_TURN, common_sides
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Number of places with dipoles.
_COUNT = 3
# Tolerance of the solves for dipoles: indicators need no more digits.
_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceDipoles(Record):
    """Dipoles at points (p, 3) in the air, along x, y and z at each; mu0 times their moment is 1 T m^3."""

    points: Array

    @classmethod
    def near_iron(cls, candidates: Array, iron: ChargedFaces) -> "WorkspaceDipoles":
        """Dipoles at three of the candidates (n, 3): the one nearest to the iron, and others of the nearest third that
        lie far from it and from each other."""
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

    def magnetise(self, problem: ConvexForm, properties: BodyProperties) -> IronState:
        """The iron in the field of every dipole alone."""
        elements, body = problem.elements, problem.iron.mesh.body
        properties = properties.on(problem.iron.mesh)
        field = elements.coil_field(self.flux_densities)
        remanence = np.zeros((3 * len(self.points), len(body), 3))
        material = Magnetisation(body, straight_laws(properties.mu_r), remanence)
        return problem.solve_linear(material, field, _TOLERANCE).iron


# Energy per area of a sawtooth of charge, slope g and standard deviation l g: zeta(3) 12^1.5 / (8 pi^3) g^2 l^3.
_SAWTOOTH = 0.2015
# Factor on this energy for the charge of faces that should be curved: a polygon of n sides has the excess energy
# (1/2 pi) 2.40 / n^3, by its logarithmic capacity.
_BEND = 3.7
# Excess energy, per area and height, of a strip at an edge with the charge r^(-1/3) of mean 1, over constant charge.
_TIP = 0.0156
# Standard deviation of a charge r^(-1/3) over a strip at an edge, over its mean.
_TIP_DEVIATION = 0.58
# Smaller values of `near_kernels` are left out: about twice its radius from a dipole a face resolves the field.
_NEAR = 0.015
# Faces that meet at more than this angle (radians) have charges of their own; coarse polygons are kinked by less.
_SHARP_ANGLE = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class FaceShares(Record):
    """Shares of the surface faces (s,) for the worst source and dipole. across: errors along the faces' shorter axis,
    which layers at sharp edges reduce; rest: all others. totals (c,): sums over all faces, for every source, with the
    dipole of the largest sum.

    at_edge (s,): whether the face touches a sharp edge.
    """

    across: Array
    rest: Array
    at_edge: NDArray[np.bool_]
    totals: Array

    @property
    def total(self) -> float:
        """The largest of `totals`."""
        return float(self.totals.max(initial=0.0))


def face_indicators(
    surface: ChargedFaces,
    triangles: Index,
    charge: Array,
    dual_charge: Array,
    size: Array,
    fixed: Array,
    places: Array | None = None,
) -> FaceShares:
    """Shares of the surface faces, relative to the largest fields size (c,) of the sources, for the worst of them and
    of the dipoles. charge (c, s), dual_charge (k, s): densities, T; triangles (s, 3): the nodes of the faces.

    fixed (c, k, s): remanence of each source times flux density of each dipole below the face, T^2. A magnet lacks the
    volume that flat faces cut off, although it has no charges in the field of a dipole at mu_r = 1.

    places (n, 3): of the air, where errors count. A face that is larger than its distance from a place does not resolve
    the charge of a dipole there; its error there is estimated from its own charge directly.
    """
    neighbours = smooth_neighbours(triangles, surface.normals)
    slopes = _slopes(surface, neighbours)
    deviation, axes = _principal_axes(surface.corners)
    weight = _SAWTOOTH * surface.areas[:, None] * deviation**3

    def slopes_of(values: Array) -> Array:
        """Slopes (c, s, 2) of values (c, s) along the axes of the faces."""
        return np.einsum("csd,sda->csa", _gradients(slopes, neighbours, values), axes)

    # A charge on a face that should be curved has _BEND times the error of a charge with the slope charge / radius.
    curvature = (slopes_of(surface.normals.T) ** 2).sum(axis=0)
    bend = _BEND * (curvature * weight).sum(axis=1)
    # Distance between a triangle and the surface through its corners: 1.5 x variance x curvature along each axis.
    cut_off = 1.5 * surface.areas * (np.sqrt(curvature) * deviation**2).sum(axis=1)
    edge = np.zeros(int(triangles.max()) + 1, bool)
    edge[triangles[:, TRIANGLE_TURN][neighbours < 0]] = True
    at_edge = np.asarray(edge[triangles].any(axis=1), bool)
    tip = np.where(at_edge, _TIP * surface.areas * heights(surface.corners), 0.0)
    dual_slopes, across, rest = slopes_of(dual_charge), np.zeros(len(weight)), np.zeros(len(weight))
    totals, worst_near, of_place = [], np.zeros(len(weight)), np.zeros((1, len(weight)))
    if places is not None:
        of_place = near_kernels(surface, places)
    for values, work in zip(charge / size[:, None], np.abs(fixed) / size[:, None, None], strict=True):
        own = (np.abs(slopes_of(values[None])[0]) * deviation).sum(axis=1)
        own = np.where(at_edge, np.maximum(own, _TIP_DEVIATION * np.abs(values)), own)
        near = of_place * own
        worst_near = np.maximum(worst_near, near.max(axis=0))
        shares, level = np.abs(slopes_of(values[None]) * dual_slopes) * weight, np.abs(values * dual_charge)
        short = np.maximum(shares[:, :, 0], level * tip)
        other = shares[:, :, 1] + level * bend + work * cut_off
        totals.append(float((short + other).sum(axis=1).max()) + float(near.sum(axis=1).max()))
        across, rest = np.maximum(across, short.max(axis=0)), np.maximum(rest, other.max(axis=0))
    return FaceShares(across, rest + worst_near, at_edge, np.array(totals))


def near_kernels(surface: ChargedFaces, places: Array) -> Array:
    """Bounds (n, s) of B at places (n, 3), T, by a charge of mean 0 and deviation 1 T on each face. They fall with the
    fourth power of the distance."""
    radius = np.sqrt(surface.areas / np.pi)
    out = np.zeros((len(places), len(radius)))
    for row, place in zip(out, places, strict=True):
        offset = surface.centres - place
        above = np.abs(np.einsum("sd,sd->s", offset, surface.normals))
        distance = np.maximum(np.maximum(np.linalg.norm(offset, axis=1) - radius, above), 1e-12)
        row[:] = np.minimum(0.5, 0.25 * (radius / distance) ** 2) * np.minimum(1.0, radius / distance) ** 2
    out[out < _NEAR] = 0.0
    return out


def element_indicators(
    volume: Array, mu_r: Array, forms: tuple[IronState, ...], dual_forms: tuple[IronState, ...], size: Array
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
    """Faces (s, 3) across the three sides of each face of a closed surface; -1 where the surface is kinked."""
    one, other = common_sides(triangles)
    out = np.full(triangles.size, -1)
    cosine = np.einsum("id,id->i", normals[one // 3], normals[other // 3])
    smooth = cosine > np.cos(_SHARP_ANGLE)
    out[one[smooth]], out[other[smooth]] = other[smooth] // 3, one[smooth] // 3
    return out.reshape(-1, 3)


def heights(corners: Array) -> Array:
    """Heights (n,) of triangles (n, 3, 3) over their longest sides."""
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


# Powers of the size with which the shares of layers, faces and elements fall.
_LAYER_ORDER, _FACE_ORDER, _ELEMENT_ORDER = 4 / 3, 2.5, 3.0
# Limits of the factor on an element's size in one step.
_SMALLEST, _LARGEST = 0.45, 1.3
# The share wanted at a layer is this multiple of the other shares, because a layer costs many faces.
_LAYER_COST = 4.0
# Smallest factor on a layer's thickness in one step.
_THINNEST = 0.16
# No layer is thinner than this part of the elements' size.
_FLATTEST = 0.02
# One step lowers the predicted error by no more than this factor.
_STEP = 4.0
_NEIGHBOURS = 6
# Faces, and tetrahedra, that one more layer adds to each face at an edge (measured on a disk with a core); and the same
# as counted towards the least growth of a mesh, so that layers alone do not pass for refinement everywhere.
_PER_LAYER, _LEAST_PER_LAYER = (2.8, 7.0), (1.0, 0.0)
# Steps of the logarithm of the common share towards a mesh that grows enough.
_TRY, _MOST_TRIES = 0.1, 300


@dataclass(frozen=True, eq=False)
class _Shares:
    """Shares (k,) that fall with the power `order` of their sizes; a wanted size changes by the `root`th root of weight
    times the common share over its own, within limits."""

    shares: Array
    order: float
    root: float
    weight: float = 1.0
    limits: tuple[float, float] = (_SMALLEST, _LARGEST)

    def factors(self, common: float) -> Array:
        """Factors (k,) of the sizes, for the logarithm of the common share."""
        ratio = common + np.log(self.weight) - np.log(np.maximum(self.shares, 1e-300))
        return np.exp(np.clip(ratio / self.root, *np.log(self.limits)))

    def predicted(self, common: float) -> float:
        """Sum of the shares once the sizes are changed by these factors."""
        return float(self.shares @ self.factors(common) ** self.order)


def next_sizes(
    iron: AssembledIron, faces: FaceShares, elements: Array, reduction: float, least_growth: float = 1.0
) -> LocalSizes:
    """Sizes and layers that divide the predicted error by `reduction`, at most 4, from the shares of faces and of
    elements (e,). They are made smaller until the surface faces are expected to grow `least_growth` times."""
    surface, cells, below = iron.surface, *_cells(iron)
    count = len(cells.sizes)
    tips = np.flatnonzero(faces.at_edge)
    # Copies of one chamber get the same sizes: the largest of their shares counts.
    across, rest, elements = _largest_of_images(iron, faces.across, faces.rest, elements)
    own = np.where(faces.at_edge, 0.0, across) + rest
    near, near_tips = _nearest(cells.centres), _nearest(surface.centres[tips])
    on_surface = np.bincount(below, own, count)[near].mean(axis=1)
    inside = np.bincount(cells.number, elements, count)[near].mean(axis=1)
    tip_limits = (_THINNEST, 1.0)
    parts = (
        _Shares(on_surface, _FACE_ORDER, _FACE_ORDER + 2),
        _Shares(inside, _ELEMENT_ORDER, _ELEMENT_ORDER + 3),
        _Shares(across[tips][near_tips].mean(axis=1), _LAYER_ORDER, _LAYER_ORDER, _LAYER_COST, tip_limits),
    )
    now = sum(float(part.shares.sum()) for part in parts)
    common = _common_share(parts, now / min(reduction, _STEP))
    old = np.exp(np.log(cells.sizes)[near].mean(axis=1))
    thickness = np.exp(np.log(heights(surface.corners[tips]))[near_tips].mean(axis=1))

    def sizes_at(common: float) -> LocalSizes:
        sizes = old * np.minimum(parts[0].factors(common), parts[1].factors(common))
        layers = np.maximum(thickness * parts[2].factors(common), _FLATTEST * sizes[below[tips]])
        return LocalSizes(cells.centres, sizes, surface.centres[tips], layers)

    found = sizes_at(common)
    for _ in range(_MOST_TRIES):
        if expected_growth(iron, faces.at_edge, found, _LEAST_PER_LAYER)[0] >= least_growth:
            break
        common -= _TRY
        found = sizes_at(common)
    return found


def _largest_of_images(
    iron: AssembledIron, across: Array, rest: Array, elements: Array
) -> tuple[Array, Array, Array]:
    """For every face (s,) and element (e,) the largest share among its images under the mesh's symmetry."""
    symmetry, topology = iron.mesh.symmetry, iron.topology
    if symmetry is None:
        return across, rest, elements
    images = face_images(symmetry, topology.nodes[topology.surface])
    # Elements are stored chamber by chamber, in the order of the operations.
    of_chamber = elements.reshape(symmetry.group.order, -1).max(axis=0)
    return across[images].max(axis=0), rest[images].max(axis=0), np.tile(of_chamber, symmetry.group.order)


def expected_growth(
    iron: AssembledIron,
    at_edge: NDArray[np.bool_],
    sizes: LocalSizes,
    per_layer: tuple[float, float] = _PER_LAYER,
) -> tuple[float, float]:
    """Expected ratios of surface faces and of tetrahedra, with the sizes of `next_sizes`, to the present numbers.

    at_edge (s,): whether faces touch a sharp edge; per_layer: faces, and tetrahedra, that one more layer adds to each
    of these.
    """
    cells, below = _cells(iron)
    factor = sizes.sizes / cells.sizes
    # Tetrahedra grow with the square of 1 / size in walls of one element, with the cube in thick iron: 2.5 between.
    faces, tets = factor[below] ** -2, factor[cells.number] ** -2.5
    layers = np.maximum(
        0.0, np.log(heights(iron.surface.corners[at_edge]) / sizes.layers) / np.log(1 / LAYER_RATIO)
    )
    along = factor[below[at_edge]] ** -1
    faces[at_edge] = along * (1 + per_layer[0] * layers)
    added = float((along * per_layer[1] * layers).sum())
    return float(faces.mean()), float(tets.sum() + added) / len(tets)


def _cells(iron: AssembledIron) -> tuple[MesherCells, Index]:
    """The mesher's cells, and the number (s,) of the cell below each surface face."""
    cells, topology = iron.mesh.cells, iron.topology
    if cells is None:
        raise ValueError("a mesh that is a body's own has no cells")
    return cells, cells.number[topology.owner[topology.surface, 0]]


def _common_share(parts: tuple[_Shares, ...], aim: float) -> float:
    """Logarithm of the largest common share for which the predicted error is `aim`, if the limits let it."""
    low, high = -90.0, 30.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        fine = sum(part.predicted(middle) for part in parts) < aim
        low, high = (middle, high) if fine else (low, middle)
    return low


def _nearest(places: Array) -> NDArray[np.int64]:
    """The nearest few (n, k) of places (n, 3) to each, itself included, for means: shares of single cells scatter."""
    if len(places) == 0:
        return np.zeros((0, 1), np.int64)
    _, nearest = cKDTree(places).query(places, min(_NEIGHBOURS, len(places)))
    return np.asarray(nearest, np.int64).reshape(len(places), -1)
