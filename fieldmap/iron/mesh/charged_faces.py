"""The iron's charged faces as triangles: geometry for the kernels, and the field they make in the air."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.topology import area_vectors
from fieldmap.kernels.iron.charged_surface import surface_field, surface_gradient, surface_weights
from fieldmap.kernels.iron.containment import off_surface
from fieldmap.kernels.iron.mutual_potential import copy_lower, mutual_potential
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# Farther than this many radii from its centre a triangle is three point charges (measured error: 1e-6 of the field).
_FAR_RADII = 8.0
# In radii of a triangle: a point nearer than the first lies on it, and is moved into the air by the second. On edges
# between triangles the field of constant charges grows with the logarithm of the distance.
_ON_FACE, _OFF_FACE = 1e-6, 1e-4
# Pairs of triangles closer than this many summed radii are integrated in closed form on one side.
NEAR_RADII = 3.0
NEAR_DEGREE = 4
TOUCH_DEGREE = 8


def _for_kernels(points: Array) -> Array:
    """Points (n, 3), copied unless they are in C order and writable: the kernels are compiled for such arrays only."""
    return np.require(points, requirements=("C_CONTIGUOUS", "WRITEABLE"))


@dataclass(frozen=True, eq=False, repr=False)
class ChargedFaces(Record):
    """Triangles with their kernels' geometry: corners (n, 3, 3), normals (n, 3), areas, centres, radii."""

    corners: Array
    normals: Array
    areas: Array
    centres: Array
    radii: Array

    @classmethod
    def from_nodes(cls, points: Array, nodes: Index) -> "ChargedFaces":
        """Triangles `nodes` (n, 3) of `points`, normal by the right-hand rule."""
        corners = np.ascontiguousarray(points[nodes])
        cross = area_vectors(corners)
        twice = np.linalg.norm(cross, axis=1)
        centres = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centres[:, None, :], axis=2).max(axis=1)
        return cls(corners, cross / twice[:, None], 0.5 * twice, centres, radii)

    def rule_points(self, degree: int) -> tuple[Array, Array]:
        """Quadrature points (n, q, 3) and weights (q,) on every triangle."""
        barycentric, weights = triangle_rule(degree)
        return np.einsum("qk,nkd->nqd", barycentric, self.corners), weights

    def mutual_potential(self) -> Array:
        """W (n, n), see `fieldmap.kernels.iron.mutual_potential`."""
        return self.mutual_potential_with(self, symmetric=True)

    def part(self, chosen: Index | NDArray[np.bool_]) -> "ChargedFaces":
        """Some of the triangles, in this order."""
        more = (one[chosen] for one in (self.normals, self.areas, self.centres, self.radii))
        return ChargedFaces(np.ascontiguousarray(self.corners[chosen]), *more)

    def mutual_potential_with(
        self, others: "ChargedFaces", symmetric: bool, out: Array | None = None
    ) -> Array:
        """Block (n, n) of W: mean potentials on these n triangles of unit charges on n others.

        symmetric: the block is known to be symmetric, and half of it is computed. out: memory for the result.
        """
        one = (self.kernel_geometry(), self._far())
        other = one if others is self else (others.kernel_geometry(), others._far())
        # NumPy asks for large pages, numba does not.
        block = np.empty((len(self.areas),) * 2) if out is None else out
        given = (*one, *other, NEAR_RADII, symmetric, block)
        over_rows(mutual_potential, (len(block) + 1) // 2, *given, work=20.0 * len(block))
        if symmetric:
            over_rows(copy_lower, len(block), block, work=len(block))
        return block

    def kernel_geometry(self) -> tuple[Array, ...]:
        """Arguments of the kernels of mutual potentials for one set of triangles. The last are points and weights of
        the outer rules for close pairs: for pairs apart, then for pairs with overlapping circles."""
        near, touch = self.rule_points(NEAR_DEGREE), self.rule_points(TOUCH_DEGREE)
        return (self.corners, self.normals, self.areas, self.centres, self.radii, *near, *touch)

    def far_points(self) -> Array:
        """x, y and z (3, 3 n) of the points of the degree-2 rule, triangle by triangle."""
        far, _ = self.rule_points(2)
        return np.ascontiguousarray(far.reshape(-1, 3).T)

    def _far(self) -> tuple[Array, Array]:
        """Points of the degree-2 rule, centres and radii, as rows (`fieldmap.kernels.iron.mutual_potential`)."""
        return self.far_points(), self.spheres()

    def spheres(self) -> Array:
        """Centres and radii as rows (4, n)."""
        # In C order: numba would compile anew for another order.
        return np.ascontiguousarray(np.vstack([self.centres.T, self.radii]))

    def off_surface(self, points: Array) -> Array:
        """The points (n, 3). A point on a triangle, an edge or a corner is moved a little along the normals, for the
        limit of the field from that side."""
        at = _for_kernels(points)
        out = np.empty_like(at)
        geometry = (self.corners, self.normals, self.centres, self.radii)
        over_rows(off_surface, len(at), at, *geometry, _ON_FACE, _OFF_FACE, out, work=len(self.areas))
        return out

    def field(self, points: Array, density: Array) -> Array:
        """Field (c, n, 3) at points (n, 3) for densities (c, m); in the unit of the density."""
        return self._filled(points, density, 0)[0]

    def field_and_gradient(self, points: Array, density: Array) -> tuple[Array, Array]:
        """Field (c, n, 3) and gradient (c, n, 3, 3) at points (n, 3) for densities (c, m)."""
        return self._filled(points, density, len(points))

    def _filled(self, points: Array, density: Array, gradients: int) -> tuple[Array, Array]:
        at = _for_kernels(points)
        field, gradient = np.empty((len(density), len(at), 3)), np.empty((len(density), gradients, 3, 3))
        given = (at, self.corners, self.normals, self._as_charges, density, field, gradient)
        over_rows(surface_field, len(at), *given, work=len(self.areas))
        return field, gradient

    def weights(self, points: Array, by_field: Array, by_gradient: Array) -> Array:
        """Weights (k, m) of a unit density on each face in k sums over points (n, 3): by_field (k, n, 3) times the
        field plus by_gradient (k, n, 3, 3) times the gradient. The transpose of `field_and_gradient`."""
        entries = _entries(by_field, by_gradient)
        out = np.zeros((len(entries), len(self.areas)))
        given = (points, self.corners, self.normals, self._as_charges, entries, out)
        over_rows(surface_weights, len(self.areas), *given, work=2.0 * len(points))
        return out

    def gradient(
        self, points: Array, by_field: Array, by_gradient: Array, charge: Array, moving: NDArray[np.bool_]
    ) -> Array:
        """Derivatives (n, k, 3, 3) of the sums of `weights` for charges (n,) by the corners of the triangles that are
        marked as moving (n,)."""
        entries, (shapes, _) = _entries(by_field, by_gradient), triangle_rule(2)
        out = np.zeros((len(self.areas), len(entries), 3, 3))
        given = (points, self.corners, self._as_charges, shapes, charge, moving, entries, out)
        over_rows(surface_gradient, len(self.areas), *given, work=10.0 * len(points))
        return out

    @cached_property
    def _as_charges(self) -> Array:
        """For every triangle (14, n) the points that replace it, a third of its area, its centre and the squared
        distance beyond which they replace it. Kept: for a single point it takes longer than the field."""
        charges, _ = self.rule_points(2)
        limit = (_FAR_RADII * self.radii) ** 2
        rows = [charges.reshape(-1, 9).T, self.areas / 3, self.centres.T, limit]
        return np.ascontiguousarray(np.vstack(rows))


def _entries(by_field: Array, by_gradient: Array) -> Array:
    """Weights (k, n, 8) of field and gradient as the kernels take them."""
    g = by_gradient
    # The gradient is symmetric and free of trace: five entries are independent.
    five = [g[..., 0, 0] - g[..., 2, 2], g[..., 0, 1] + g[..., 1, 0], g[..., 0, 2] + g[..., 2, 0]]
    five += [g[..., 1, 1] - g[..., 2, 2], g[..., 1, 2] + g[..., 2, 1]]
    return np.ascontiguousarray(np.concatenate([by_field, np.stack(five, axis=-1)], axis=-1))
