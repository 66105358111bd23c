"""Linear iron by potentials on its surface: no elements inside, no mesh of the volume.

With h = t - grad phi as everywhere (`docs/theory/iron.md`), the field t of the sources is curl-free at the iron's
surface, t = -grad psi there, and iron of constant permeability has a total potential u = phi + psi that is harmonic in
it. With the operators of `fieldmap.iron.operators.closed_surface`, S_b inside each region b of one material and S_e
outside all iron, the continuity of the normal flux density, tested with the functions v of the nodes, is

    sum_b mu_b S_b u + S_e (u - psi) = sum_b S_b psi + sum_b int b_r . n v dS.

The right side holds psi alone, and S_b psi stands for the source's own flux: what iron of mu_r = 1 lets through as well
cancels exactly, so that u keeps its digits however permeable the iron is. Where the iron links currents, psi has jumps
along cuts; its nodal part takes their place in the equation, and what it lacks is a field of its own (`Potentials`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from fieldmap.iron.mesh.distinct_rows import distinct_rows
from fieldmap.iron.mesh.surface_mesh import AIR, IronSurface, connected_solids
from fieldmap.iron.operators.closed_surface import ClosedSurface, Potentials, Side, corner_curls
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index

FieldOfPoints = Callable[[Array], Array]
# Points on every edge for the circulations of the sources, and exactness of the rule on faces for their flux.
_POINTS_PER_EDGE = 8
_FLUX_DEGREE = 6
# Points at which the sources are evaluated at a time.
_BATCH = 200_000
# A mismatch of circulations that is larger than this part of the largest potential difference is a linked current.
_LINKED = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Region(Record):
    """Solids of one material that touch: their numbers (k,), relative permeability and remanence (3,) in T."""

    solids: Index
    mu_r: float
    remanence: Array


def regions_of(surface: IronSurface, mu_r: Array, remanence: Array) -> tuple[Region, ...]:
    """Join solids that touch and have one permeability and remanence; these are given of each body, (b,) and (b, 3)."""
    mu_r, remanence = mu_r[surface.body], remanence[surface.body]
    touching = surface.sides[surface.sides[:, 1] != AIR]
    one, other = touching.T
    alike = (mu_r[one] == mu_r[other]) & (remanence[one] == remanence[other]).all(axis=1)
    number = connected_solids(touching[alike], len(surface.body))
    members = (np.flatnonzero(number == k) for k in range(number.max() + 1))
    return tuple(Region(solids, float(mu_r[solids[0]]), remanence[solids[0]]) for solids in members)


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSources(Record):
    """Fields (c) that act on the iron, T: nodal potential (p, c) at all points of the mesh, without cuts; circulations
    (m, c) that it lacks along the edges (m, 2), zero where the iron links no current; linked (c,): where it does."""

    nodal: Array
    edges: Index
    missing: Array
    linked: NDArray[np.bool_]
    field: FieldOfPoints


def surface_sources(points: Array, triangles: Index, field: FieldOfPoints) -> SurfaceSources:
    """Of fields field(points (n, 3)) -> (c, n, 3) that are free of curl at the triangles (n, 3)."""
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = distinct_rows(np.sort(sides, axis=1)).rows
    x, weights = np.polynomial.legendre.leggauss(_POINTS_PER_EDGE)
    difference = -_integrated(
        field, points[edges], np.column_stack([0.5 - 0.5 * x, 0.5 + 0.5 * x]), 0.5 * weights
    )
    step = points[edges[:, 1]] - points[edges[:, 0]]
    difference = np.einsum("cmd,md->mc", difference, step)
    gradient = _differences(edges, len(points))
    nodal = _least_squares(gradient, difference)
    missing = difference - gradient @ nodal
    scale = np.abs(difference).max(axis=0)
    linked = np.abs(missing).max(axis=0) > _LINKED * np.where(scale > 0, scale, 1.0)
    missing[:, ~linked] = 0.0
    return SurfaceSources(nodal, edges, missing, linked, field)


def _integrated(field: FieldOfPoints, corners: Array, rule: Array, weights: Array) -> Array:
    """Means (c, m, 3) of a field over simplices with corners (m, k, 3), by a rule (q, k) with weights (q,)."""
    parts = []
    for batch in np.array_split(corners, 1 + len(corners) * len(weights) // _BATCH):
        x = np.einsum("qk,mkd->qmd", rule, batch)
        value = field(x.reshape(-1, 3)).reshape(-1, *x.shape)
        parts.append(np.einsum("q,cqmd->cmd", weights, value))
    return np.concatenate(parts, axis=1)


def _differences(edges: Index, count: int) -> csr_matrix:
    """Differences (m, n) of nodal values along edges."""
    rows = np.arange(len(edges))
    values = np.concatenate([-np.ones(len(edges)), np.ones(len(edges))])
    return csr_matrix((values, (np.tile(rows, 2), edges.T.ravel())), shape=(len(edges), count))


def _least_squares(gradient: csr_matrix, difference: Array) -> Array:
    """Nodal values (n, c) whose differences come closest to those wanted; the mean of each connected part is zero."""
    laplacian = (gradient.T @ gradient).tocsc()
    part = connected_components(laplacian, directed=False)[1]
    first = np.zeros(laplacian.shape[0])
    first[np.unique(part, return_index=True)[1]] = 1.0
    values = splu(laplacian + diags(first).tocsc()).solve(gradient.T @ difference)
    count = np.bincount(part)
    for c in range(values.shape[1]):
        values[:, c] -= (np.bincount(part, values[:, c]) / count)[part]
    return values


@dataclass(frozen=True, eq=False, repr=False)
class RegionPotential(Record):
    """What a region needs: its boundary and inside, total potential u and the sources' own psi, both with cuts."""

    region: Region
    side: Side
    total: Potentials
    applied: Potentials


@dataclass(frozen=True, eq=False, repr=False)
class SurfacePotential(Record):
    """Solved surface form: nodal potentials (p, c) of the iron's own field, phi, and the total, u; the surface towards
    the air with charges (n, c) that make phi there; the regions; residual: largest, relative."""

    reduced: Array
    total: Array
    outside: Side
    charges: Array
    regions: tuple[RegionPotential, ...]
    linked: NDArray[np.bool_]
    magnets: Array
    residual: float


class SurfaceForm:
    """Operators of one surface mesh, divided into regions."""

    name = "surface"

    def __init__(self, surface: IronSurface, regions: tuple[Region, ...]) -> None:
        self.surface, self.regions = surface, regions
        everything = surface.around(surface.all_solids)
        outside = ClosedSurface.of(surface.points, everything)
        boundaries = [surface.around(region.solids) for region in regions]
        self.triangles = np.unique(np.sort(np.vstack(boundaries), axis=1), axis=0)
        own = [self._own(outside, k, boundaries) for k in range(len(regions))]
        self.outside = Side(outside, inside=False)
        self.sides = tuple(Side(boundary, inside=True) for boundary in own)

    def _own(self, outside: ClosedSurface, k: int, boundaries: list[Index]) -> ClosedSurface:
        """The boundary of a region: part of that towards the air where it touches no other region."""
        mine, others = boundaries[k], [b for j, b in enumerate(boundaries) if j != k]
        if not any(np.isin(mine, other).any() for other in others):
            chosen = np.flatnonzero(np.isin(outside.nodes[outside.triangles[:, 0]], mine))
            outside.correct_constants(chosen)
            return outside.part(chosen)
        boundary = ClosedSurface.of(self.surface.points, mine)
        boundary.correct_constants(np.arange(len(mine)))
        return boundary

    @property
    def unknowns(self) -> int:
        """Nodes in use."""
        return len(np.unique(self.triangles))

    def solve(self, field: FieldOfPoints, magnets: Array) -> SurfacePotential:
        """Potentials in fields field(points (n, 3)) -> (c, n, 3) in T; magnets (c,): 1 for the sources to which
        the remanence of magnets belongs, else 0."""
        sources = surface_sources(self.surface.points, self.triangles, field)
        nodal = sources.nodal
        lacking = [self._lacking(side, sources) for side in self.sides]
        count = len(self.surface.points)
        inner, matrix, loops = np.zeros((count, count)), np.zeros((count, count)), np.zeros_like(nodal)
        inner_loops = np.zeros_like(nodal)
        right = np.zeros_like(nodal)
        for region, side, more in zip(self.regions, self.sides, lacking, strict=True):
            place, own = side.surface.nodes, side.matrix()
            inner[np.ix_(place, place)] += own
            matrix[np.ix_(place, place)] += region.mu_r * own
            if sources.linked.any():
                flux = side.apply(more)
                inner_loops[place] += flux
                loops[place] += (region.mu_r - 1) * flux
            normal = side.surface.faces.normals @ region.remanence * side.surface.faces.areas
            remanent = side.surface.means.T @ normal
            right[place] += np.outer(remanent, magnets)
        nodal = nodal + self._constants(inner, nodal, inner_loops)
        place = self.outside.surface.nodes
        outer = self.outside.matrix()
        right += inner @ nodal - loops
        right[place] += outer @ nodal[place]
        matrix[np.ix_(place, place)] += outer
        used = np.unique(self.triangles)
        square = matrix[np.ix_(used, used)]
        total = np.zeros_like(nodal)
        total[used] = cho_solve(cho_factor(square, lower=True, check_finite=False), right[used])
        left = right[used] - square @ total[used]
        residual = float(np.linalg.norm(left) / (np.linalg.norm(right[used]) or 1.0))
        reduced = total - nodal
        charges = self.outside.surface.charge(self.outside.surface.means @ reduced[place])
        solved = tuple(
            RegionPotential(region, side, side.potentials(total[side.surface.nodes]) + more, applied + more)
            for region, side, more in zip(self.regions, self.sides, lacking, strict=True)
            for applied in (side.potentials(nodal[side.surface.nodes]),)
        )
        return SurfacePotential(
            reduced, total, self.outside, charges, solved, sources.linked, magnets, residual
        )

    def _constants(self, inner: Array, nodal: Array, loops: Array) -> Array:
        """What to add to the nodal potential of each closed surface, so that the sources' flux into it is zero."""
        count = len(nodal)
        links = coo_matrix(
            (np.ones(2 * len(self.triangles)), self.triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T),
            shape=(count, count),
        )
        part = connected_components(links, directed=False)[1]
        numbers = np.unique(part[np.unique(self.triangles)])
        if len(numbers) == 1:
            return np.zeros_like(nodal)
        indicator = (part[:, None] == numbers).astype(float)
        flux = indicator.T @ (inner @ nodal + loops)
        value = np.linalg.lstsq(indicator.T @ inner @ indicator, -flux, rcond=1e-6)[0]
        return indicator @ value

    def _lacking(self, side: Side, sources: SurfaceSources) -> Potentials:
        """What the nodal potentials lack of the sources' field where the iron links their currents."""
        own, count = side.surface, sources.nodal.shape[1]
        curl, means = np.zeros((len(own.triangles), 3, count)), np.zeros((len(own.triangles), count))
        if not sources.linked.any():
            return Potentials(curl, means)
        nodes = own.nodes[own.triangles]
        key = sources.edges[:, 0] * len(self.surface.points) + sources.edges[:, 1]
        # The potential of one corner is zero; those of the others follow along the edges that leave it.
        shape = corner_curls(own.faces)
        for k in (1, 2):
            low, high = np.minimum(nodes[:, 0], nodes[:, k]), np.maximum(nodes[:, 0], nodes[:, k])
            edge = np.searchsorted(key, low * len(self.surface.points) + high)
            sign = np.where(nodes[:, 0] < nodes[:, k], 1.0, -1.0)
            curl += np.einsum("nd,nc->ndc", shape[:, k], sign[:, None] * sources.missing[edge])
        rule, weights = triangle_rule(_FLUX_DEGREE)
        field = _integrated(sources.field, own.faces.corners, rule, weights)
        flux = -np.einsum("cnd,nd->nc", field, own.faces.normals) * own.faces.areas[:, None]
        flux -= np.outer(own.faces.areas / own.faces.areas.sum(), flux.sum(axis=0))
        nodal = side.potentials(sources.nodal[own.nodes])
        means[:, sources.linked] = (own.mutual @ flux - nodal.means)[:, sources.linked]
        return Potentials(curl, means)
