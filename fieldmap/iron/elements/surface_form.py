"""Linear iron by potentials on its surface: no elements inside, no mesh of the volume.

With h = t - grad phi as everywhere (`docs/theory/iron.md`), the field t of the sources is curl-free at the iron's
surface, t = -grad psi there, and iron of constant permeability has a total potential u = phi + psi that is harmonic in
it. With the operators of `fieldmap.iron.operators.closed_surface`, S_b inside each region b of one material and S_e
outside all iron, the continuity of the normal flux density, tested with the functions v of the nodes, is

    sum_b mu_b S_b u + S_e (u - psi) = sum_b S_b psi + sum_b int b_r . n v dS.

The right side holds psi alone; S_b psi is the source's own flux. Flux that iron of mu_r = 1 would let through as well
cancels exactly, so that u keeps its digits however permeable the iron is. Where the iron links
currents, psi has jumps along cuts. The equation then holds a nodal psi without jumps, and the rest of the field is
added separately (`Potentials`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.sparse.linalg import splu

from fieldmap.iron.elements.nodal_elements import FieldOfPoints, field_means, half_circulations
from fieldmap.iron.mesh.surface_mesh import AIR, IronSurface
from fieldmap.iron.operators.closed_surface import ClosedSurface, Potentials, Side, corner_curls
from fieldmap.iron.operators.linear_systems import block_gmres, require_convergence
from fieldmap.iron.topology import TRIANGLE_SIDES, area_vectors, connected, distinct_parts, edge_keys
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Gauss points on every half edge for the circulations of the sources; degree of the rule on faces for their flux.
_POINTS_PER_HALF = 6
_FLUX_DEGREE = 6
# A loop links a current if the potential changes by more than this part of its range on the way round the loop.
# For a winding the jump is about the whole range; near a winding quadrature errors are a thousandth of the range.
_LINKED = 0.3
_MAX_STEPS = 200


@dataclass(frozen=True, eq=False, repr=False)
class Region(Record):
    """Solids of one material that touch: their numbers (k,), relative permeability and remanence (3,) in T."""

    solids: Index
    mu_r: float
    remanence: Array


def regions_of(surface: IronSurface, mu_r: Array, remanence: Array) -> tuple[Region, ...]:
    """Join solids that touch and have one permeability and remanence; mu_r (b,), remanence (b, 3): of each body."""
    mu_r, remanence = mu_r[surface.body], remanence[surface.body]
    touching = surface.sides[surface.sides[:, 1] != AIR]
    one, other = touching.T
    alike = (mu_r[one] == mu_r[other]) & (remanence[one] == remanence[other]).all(axis=1)
    number = connected(touching[alike], len(surface.body))
    members = (np.flatnonzero(number == k) for k in range(number.max() + 1))
    return tuple(Region(solids, float(mu_r[solids[0]]), remanence[solids[0]]) for solids in members)


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSources(Record):
    """Fields (c) that act on the iron, T.

    nodal: the linear function (p, c) without cuts that is closest in the mean square to their second-order potential
    psi (psi's own values at the points would make it too flat or too steep between them); linear: psi at the points;
    bubble (m, c): psi in the middle of the edges (m, 2) less the mean of their ends; missing (m, c): differences along
    the edges that `linear` lacks, zero where the iron links no current; linked (c,): whether it links the source's.
    """

    nodal: Array
    linear: Array
    bubble: Array
    edges: Index
    missing: Array
    linked: NDArray[np.bool_]
    field: FieldOfPoints

    def bubble_means(self, triangles: Index) -> Array:
        """Means (n, c) over triangles (n, 3) of psi less its linear interpolant."""
        return self.bubble[edge_numbers(self.edges, triangles, len(self.nodal))].mean(axis=1)


def edge_numbers(edges: Index, triangles: Index, count: int) -> Index:
    """Numbers (n, 3) of the edges opposite each corner of triangles (n, 3) of `count` points."""
    ends = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]], axis=2)
    return np.searchsorted(edge_keys(edges, count), edge_keys(ends, count))


def surface_sources(points: Array, triangles: Index, field: FieldOfPoints) -> SurfaceSources:
    """The sources of fields field(points (n, 3)) -> (c, n, 3) that are free of curl at the triangles (n, 3)."""
    count = len(points)
    edges = distinct_parts(triangles, TRIANGLE_SIDES).rows
    first, second = (-half.T for half in half_circulations(field, points, edges, _POINTS_PER_HALF))
    difference, bubble = first + second, 0.5 * (first - second)
    gradient = _differences(edges, count)
    linear = _least_squares(gradient, difference)
    # On a tree of edges all differences are met. On any other edge the difference that remains is the circulation round
    # a loop.
    numbered = csr_matrix((1.0 + np.arange(len(edges)), edges.T), shape=(count, count))
    tree = minimum_spanning_tree(numbered).data.astype(np.int64) - 1
    walked = _least_squares(gradient[tree], difference[tree])
    linked = np.abs(difference - gradient @ walked).max(axis=0) > _LINKED * np.ptp(walked, axis=0)
    missing = difference - gradient @ linear
    missing[:, ~linked] = 0.0
    nodal = linear + _projected(points, triangles, edges, bubble)
    return SurfaceSources(nodal, linear, bubble, edges, missing, linked, field)


def _projected(points: Array, triangles: Index, edges: Index, bubble: Array) -> Array:
    """Continuous linear function (p, c) closest to second-order bubbles (m, c) on the edges, in the mean square."""
    twice = np.linalg.norm(area_vectors(points[triangles]), axis=1)
    number = edge_numbers(edges, triangles, len(points))
    rows = np.repeat(triangles, 3, axis=1).ravel()
    # int l_i l_j = A/12, twice that for i = j; int 4 l_a l_b l_i = 2 A/15, half of that for the opposite corner i.
    mass = np.outer(twice / 24, (np.ones((3, 3)) + np.eye(3)).ravel()).ravel()
    load = np.outer(twice / 30, (2 * np.ones((3, 3)) - np.eye(3)).ravel()).ravel()
    matrix = csr_matrix((mass, (rows, np.tile(triangles, 3).ravel())), shape=(len(points),) * 2)
    right = csr_matrix((load, (rows, np.tile(number, 3).ravel())), shape=(len(points), len(edges))) @ bubble
    used = np.unique(triangles)
    out = np.zeros_like(right)
    out[used] = splu(matrix[used][:, used].tocsc()).solve(right[used])
    return out


def _differences(edges: Index, count: int) -> csr_matrix:
    """Differences (m, n) of nodal values along edges."""
    rows = np.arange(len(edges))
    values = np.concatenate([-np.ones(len(edges)), np.ones(len(edges))])
    return csr_matrix((values, (np.tile(rows, 2), edges.T.ravel())), shape=(len(edges), count))


def _least_squares(gradient: csr_matrix, difference: Array) -> Array:
    """Nodal values (n, c) with differences closest to the given ones; the mean of each connected part is zero."""
    laplacian = (gradient.T @ gradient).tocsc()
    part = connected_components(laplacian)[1]
    first = np.zeros(laplacian.shape[0])
    first[np.unique(part, return_index=True)[1]] = 1.0
    values = splu(laplacian + diags(first).tocsc()).solve(gradient.T @ difference)
    count = np.bincount(part)
    for c in range(values.shape[1]):
        values[:, c] -= (np.bincount(part, values[:, c]) / count)[part]
    return values


@dataclass(frozen=True, eq=False, repr=False)
class RegionPotential(Record):
    """A region, its boundary seen from inside, and two potentials there, both with cuts: the total u and the sources'
    own psi."""

    region: Region
    side: Side
    total: Potentials
    applied: Potentials


@dataclass(frozen=True, eq=False, repr=False)
class SurfacePotential(Record):
    """Solved surface form: nodal potentials (p, c) of the iron's own field, phi, and the total, u; the surface towards
    the air with charges (n, c) that make phi there; the regions; linked (c,): whether the iron links the source's
    currents; normal (n, c): mean B.n of linked sources on the triangles towards the air, computed on the side of the
    air, because an error inside is multiplied by mu_r; magnets (c,): 1 where the remanence of magnets belongs to the
    source, else 0; residuals of all steps, relative."""

    reduced: Array
    total: Array
    outside: Side
    charges: Array
    regions: tuple[RegionPotential, ...]
    linked: NDArray[np.bool_]
    normal: Array
    magnets: Array
    residuals: tuple[float, ...]


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
        """The boundary of a region. For a region that touches no other it is a part of the surface towards the air."""
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
        """Number of nodes in use."""
        return len(np.unique(self.triangles))

    def solve(self, field: FieldOfPoints, magnets: Array, tolerance: float) -> SurfacePotential:
        """Potentials in fields field(points (n, 3)) -> (c, n, 3) in T; magnets (c,): 1 for the sources to which
        the remanence of magnets belongs, else 0. Raises NotConverged."""
        sources = surface_sources(self.surface.points, self.triangles, field)
        lacking = [self._lacking(side, sources) for side in self.sides]
        # Flux of the field that the nodal potentials lack, and the same times the susceptibility mu_r - 1.
        loops = np.zeros((2, *sources.nodal.shape))
        remanent = np.zeros_like(sources.nodal)
        for region, side, more in zip(self.regions, self.sides, lacking, strict=True):
            own = side.surface
            if sources.linked.any():
                flux = side.flux(more)
                loops[0, own.nodes] += flux
                loops[1, own.nodes] += (region.mu_r - 1) * flux
            normal = own.faces.normals @ region.remanence * own.faces.areas
            remanent[own.nodes] += np.outer(own.means.T @ normal, magnets)
        nodal = sources.nodal + self._constants(sources.nodal, loops[0])
        right = self._through(nodal, np.ones(len(self.regions))) + remanent - loops[1]
        total, residuals = self._solved(right, tolerance)
        reduced = total - nodal
        outer = self.outside.surface
        # Face means of phi with psi itself in place of its projection: outside, phi alone is the iron's field, even
        # where it nearly cancels psi.
        own = outer.means @ (reduced + sources.nodal - sources.linear)[outer.nodes]
        own -= sources.bubble_means(outer.nodes[outer.triangles])
        charges = outer.charge(own)
        normal = np.zeros_like(charges)
        if sources.linked.any():
            around = self.outside.potentials(reduced[outer.nodes])
            normal = _normal_field(outer, sources) - self.outside.normal_derivative(around)
        solved = tuple(
            RegionPotential(region, side, side.potentials(total[side.surface.nodes]) + more, applied + more)
            for region, side, more in zip(self.regions, self.sides, lacking, strict=True)
            for applied in (side.potentials(nodal[side.surface.nodes]),)
        )
        return SurfacePotential(
            reduced, total, self.outside, charges, solved, sources.linked, normal, magnets, residuals
        )

    def _through(self, nodal: Array, weights: Array, outside: bool = True) -> Array:
        """Sum over the regions of weight (r,) times S u, and S_e u, (p, c) for nodal values (p, c)."""
        out = np.zeros_like(nodal)
        for weight, side in zip(weights, self.sides, strict=True):
            out[side.surface.nodes] += weight * side.apply(nodal[side.surface.nodes])
        if outside:
            place = self.outside.surface.nodes
            out[place] += self.outside.apply(nodal[place])
        return out

    def _solved(self, right: Array, tolerance: float) -> tuple[Array, tuple[float, ...]]:
        """Total potentials (p, c) for right sides (p, c), and the residuals of all steps.

        The preconditioner is 2 D. On a sphere S is 2 D times a factor between 3/4 and 3/2, and close to that on other
        surfaces, whatever the mesh. D maps constants on closed surfaces to zero. They are solved for first; at large
        mu_r they are nearly all of u.
        """
        mu_r = np.array([region.mu_r for region in self.regions])
        ones = self._closed_surfaces
        coarse = ones.T @ self._through(ones, mu_r)
        constants = ones @ np.linalg.solve(coarse, ones.T @ right)
        factor = self._preconditioner(mu_r, coarse)
        used = np.unique(self.triangles)

        def preconditioned(values: Array) -> Array:
            out = np.zeros_like(values)
            out[used] = cho_solve(factor, values[used], check_finite=False)
            return out

        def operator(values: Array) -> Array:
            return preconditioned(self._through(values, mu_r))

        left = preconditioned(right - self._through(constants, mu_r))
        total, history = block_gmres(operator, left, tolerance, _MAX_STEPS)
        return total + constants, require_convergence("surface form", history, tolerance)

    def _preconditioner(self, mu_r: Array, coarse: Array) -> tuple[Array, bool]:
        """Cholesky factor of twice the sum of all D, each times its mu_r, plus the matrix `coarse` (k, k) for the
        constants on closed surfaces."""
        count = len(self.surface.points)
        matrix = np.zeros((count, count))
        for weight, side in zip((*mu_r, 1.0), (*self.sides, self.outside), strict=True):
            place = np.ix_(side.surface.nodes, side.surface.nodes)
            matrix[place] += 2 * weight * side.surface.hypersingular
        weights = self._closed_surfaces / self._closed_surfaces.sum(axis=0)
        matrix += weights @ coarse @ weights.T
        used = np.unique(self.triangles)
        return cho_factor(matrix[np.ix_(used, used)], lower=True, check_finite=False)

    @cached_property
    def _closed_surfaces(self) -> Array:
        """Indicators (p, k) of the points on each connected surface."""
        count = len(self.surface.points)
        part = connected(self.triangles[:, [0, 1, 1, 2]].reshape(-1, 2), count)
        numbers = np.unique(part[np.unique(self.triangles)])
        return (part[:, None] == numbers).astype(float)

    def _constants(self, nodal: Array, loops: Array) -> Array:
        """Constants (p, c) on the closed surfaces: added to the nodal potential, they make the sources' flux zero."""
        ones = self._closed_surfaces
        if ones.shape[1] == 1:
            return np.zeros_like(nodal)
        alike = np.ones(len(self.regions))
        flux = ones.T @ (self._through(nodal, alike, outside=False) + loops)
        coarse = ones.T @ self._through(ones, alike, outside=False)
        return ones @ np.linalg.lstsq(coarse, -flux, rcond=1e-6)[0]

    def _lacking(self, side: Side, sources: SurfaceSources) -> Potentials:
        """The part of the sources' field without a nodal potential, for sources whose currents the iron links."""
        own, count = side.surface, sources.nodal.shape[1]
        curl, means = np.zeros((len(own.triangles), 3, count)), np.zeros((len(own.triangles), count))
        if not sources.linked.any():
            return Potentials(curl, means)
        nodes = own.nodes[own.triangles]
        number = edge_numbers(sources.edges, nodes, len(self.surface.points))
        # The potential is zero at one corner; the edges that leave it give the potential at the others.
        shape = corner_curls(own.faces)
        for k, opposite in ((1, 2), (2, 1)):
            sign = np.where(nodes[:, 0] < nodes[:, k], 1.0, -1.0)[:, None]
            curl += np.einsum("nd,nc->ndc", shape[:, k], sign * sources.missing[number[:, opposite]])
        flux = -_normal_field(own, sources) * own.faces.areas[:, None]
        flux -= np.outer(own.faces.areas / own.faces.areas.sum(), flux.sum(axis=0))
        nodal = side.potentials(sources.nodal[own.nodes])
        means[:, sources.linked] = (own.mutual @ flux - nodal.means)[:, sources.linked]
        return Potentials(curl, means)


def _normal_field(surface: ClosedSurface, sources: SurfaceSources) -> Array:
    """Mean normal component (n, c) of the sources' field on triangles."""
    rule, weights = triangle_rule(_FLUX_DEGREE)
    (field,) = field_means(sources.field, surface.faces.corners, rule, weights[None])
    return np.einsum("cnd,nd->nc", field, surface.faces.normals)
