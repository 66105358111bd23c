"""Lowest-order flux elements (Raviart-Thomas) on tetrahedra: the flux density from the fluxes through the faces.

In tetrahedron e with outward fluxes phi_k through its faces (face k opposite corner X_k) and volume V,

    B(x) = sum_k phi_k (x - X_k) / (3 V),

so div B = 0 when the four fluxes sum to zero, and B is then constant. Le-Van, Meunier, Chadebec and Guichon, IEEE
Trans. Magn. 51 (2015) use the same elements for the volume integral method.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.meshing.mesh import IronMesh, volumes
from fieldmap.kernels.simplex_rules import tetrahedron_rule

Array = NDArray[np.float64]
# Elements smaller than this fraction of their body's largest see a field that varies little: 4 points do.
_SMALL = 0.25
# Points handed to a field function at once, to bound memory.
_BATCH = 200_000


@dataclass(frozen=True, eq=False)
class FluxElements:
    """Geometry of the elements: volume (e,), centre (e, 3), arms (e, 4, 3) = centre - corner, spread (e,)."""

    mesh: IronMesh
    volume: Array
    arms: Array
    spread: Array

    @classmethod
    def from_mesh(cls, mesh: IronMesh) -> "FluxElements":
        """Elements of a mesh with positive volumes."""
        corners = mesh.points[mesh.tets]
        arms = corners.mean(axis=1)[:, None, :] - corners
        return cls(mesh, volumes(mesh.points, mesh.tets), arms, (arms**2).sum(axis=(1, 2)) / 20)

    def mass(self) -> Array:
        """int w_i . w_j dV, (e, 4, 4), for w_k = (x - X_k)/(3 V)."""
        inner = np.einsum("eik,ejk->eij", self.arms, self.arms) + self.spread[:, None, None]
        return inner / (9 * self.volume[:, None, None])

    def load(self, field: Callable[[Array], Array]) -> Array:
        """int w_k . B dV, (c, e, 4), of flux densities field(points (n, 3)) -> (c, n, 3)."""
        size = np.cbrt(self.volume)
        large = size > _SMALL * size.max()
        parts = [(np.flatnonzero(~large), 2), (np.flatnonzero(large), 4)]
        out = None
        for elements, degree in parts:
            for batch in np.array_split(elements, max(1, len(elements) * 27 // _BATCH)):
                if len(batch) == 0:
                    continue
                value = self._load_of(batch, degree, field)
                if out is None:
                    out = np.zeros((value.shape[0], len(self.volume), 4))
                out[:, batch] = value
        assert out is not None
        return out

    def _load_of(self, elements, degree, field):
        barycentric, weights = tetrahedron_rule(degree)
        corners = self.mesh.points[self.mesh.tets[elements]]
        x = np.einsum("qk,ekd->qed", barycentric, corners)
        b = field(x.reshape(-1, 3)).reshape(-1, *x.shape)
        mean = np.einsum("q,cqed->ced", weights, b)
        moment = np.einsum("q,cqed,qed->ce", weights, b, x)
        return (moment[:, :, None] - np.einsum("ced,ekd->cek", mean, corners)) / 3

    def uniform_load(self, vector: Array) -> Array:
        """int w_k . v dV, (e, 4), of a vector (e, 3) constant in each element."""
        return np.einsum("ekd,ed->ek", self.arms, vector) / 3

    def flux_density(self, flux: Array) -> Array:
        """Mean flux density (c, e, 3) of outward face fluxes (c, e, 4)."""
        return np.einsum("cek,ekd->ced", flux, self.arms) / (3 * self.volume[:, None])
