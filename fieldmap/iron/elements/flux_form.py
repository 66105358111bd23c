"""The flux form: linear iron of any permeability, flux barriers too.

For bodies less permeable than air the surface flux is the unknown.

With stiffness K of the iron, air S and surface means M (`fieldmap.iron.elements.potential_form`), both forms solve
(K + M^T S M) l = r. Where mu_r >= 1, K outweighs S and its factor is a good preconditioner. Where mu_r << 1 the
air outweighs the iron, and the unknown is the outward flux x = S M l, with l = K^-1 (r - M^T x):

    x + S T x = S M K^-1 r + S const,      T = M K^-1 M^T,      sum of x over each magnetic body = 0.

A factor 1 / nu of the faces' own bodies brings this operator close to a multiple of the identity: for a mode of
magnetisation with demagnetising factor D the left side is 1 + nu (1 - D) / D. K is singular: a constant potential on
each magnetic body is left open, and follows from the body's zero net flux.

The elements are second-order flux elements on the iron's tetrahedra (Brezzi, Douglas and Marini), hybridised. The flux
density is linear in every element and free of divergence; its normal component is linear on every face. Linear
potentials on the faces make this component continuous between neighbours. They are the only unknowns, three per face.
The coil field comes from `fieldmap.iron.elements.nodal_elements`. It is free of curl by construction, so that the exact
circulation drives the flux around a closed circuit, however permeable the iron.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.nodal_elements import UNIT, Elements, FieldOfPoints, NodalElements
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.linear_systems import ElementSums, Elimination, block_gmres, nested_dissection
from fieldmap.iron.topology import TET_EDGES, Faces, distinct_rows
from fieldmap.kernels.iron import linear_flux
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# Shape functions (4, 3, 4) by face, potential of the face, and point.
_SHAPE = linear_flux.SHAPE.reshape(4, 3, 4)
# Takes normal flows at each face and point (16,) to their moments (12,).
_MOMENTS = np.einsum("fiq,fa->aqfi", _SHAPE, np.eye(4)).reshape(16, 12)


@dataclass(frozen=True, eq=False, repr=False)
class FluxElements(Elements):
    """Unknown 3 f + i is the potential of face f at its corner i.

    unknowns (e, 12): numbers of each element's unknowns, see `fieldmap.kernels.iron.linear_flux`; area (e, 4, 3):
    outward area vectors; volume (e,); count: number of unknowns; face_mean (s, n): takes the unknowns to their means
    over the surface faces; nodal: the elements that carry the coil field.
    """

    work = 80.0

    unknowns: Index
    area: Array
    volume: Array
    count: int
    face_mean: csr_matrix
    nodal: NodalElements

    @classmethod
    def from_mesh(cls, nodal: NodalElements, topology: Faces) -> "FluxElements":
        """Elements on the same tetrahedra as the nodal ones."""
        tets = nodal.nodes[:, :4]
        corners = tets[:, linear_flux.CORNERS]
        place = (topology.nodes[topology.tet_faces][:, :, None, :] == corners[..., None]).argmax(axis=-1)
        dofs = (3 * topology.tet_faces[:, :, None] + place).reshape(-1, 12)
        area = -3 * nodal.volume[:, None, None] * nodal.gradients
        count, faces = 3 * len(topology.nodes), topology.surface
        mean = _means(faces, count)
        return cls(dofs, np.ascontiguousarray(area), nodal.volume, count, mean, nodal)

    def mean_over(self, triangles: Index, topology: Faces) -> csr_matrix:
        """Takes the unknowns to their means (k, n) over faces with these nodes (k, 3)."""
        both = np.sort(np.concatenate([topology.nodes, triangles]), axis=1)
        number = distinct_rows(both).number
        face = np.empty(number.max() + 1, np.int64)
        face[number[: len(topology.nodes)]] = np.arange(len(topology.nodes))
        return _means(face[number[len(topology.nodes) :]], self.count)

    @property
    def node_points(self) -> Array:
        """See `NodalElements`."""
        return self.nodal.node_points

    def elimination_order(self) -> Index:
        """Order (n,) in which the unknowns are eliminated: faces by nested dissection, the three unknowns of a face
        together."""
        faces = ElementSums(self.unknowns[:, ::3] // 3, self.count // 3)
        return (3 * nested_dissection(faces.pattern)[:, None] + np.arange(3)).ravel()

    def coil_field_at_points(self, field: Array) -> Array:
        """t itself: these elements keep it at the points."""
        return field

    def no_field(self) -> Array:
        """One source that is zero."""
        return np.zeros((1, len(self.volume), 4, 3))

    def coil_field(self, field: FieldOfPoints, symmetry: MeshSymmetry | None = None) -> Array:
        """t (c, e, 4, 3) of flux densities field(points (n, 3)) -> (c, n, 3), in T; free of curl in the iron."""
        return self.nodal.coil_field_at_points(self.nodal.coil_field(field, symmetry))

    def from_nodal(self, potential: Array) -> Array:
        """Face potentials (n, c) closest to nodal potentials (k, c): on each face the linear function that is closest
        to the second-order one in the mean square."""
        values = potential[self.nodal.nodes]
        out = np.zeros((self.count, potential.shape[1]))
        for face, corners in enumerate(linear_flux.CORNERS):
            at = values[:, corners]
            for a, b, opposite in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
                middle = 4 + TET_EDGES.tolist().index([corners[a], corners[b]])
                bubble = values[:, middle] - 0.5 * (values[:, corners[a]] + values[:, corners[b]])
                # 4 l_a l_b is closest to 0.6 (l_a + l_b) - 0.2 l_c.
                for corner, share in ((a, 0.6), (b, 0.6), (opposite, -0.2)):
                    at[:, corner] = at[:, corner] + share * bubble
            out[self.unknowns[:, 3 * face : 3 * face + 3]] = at
        return out

    def joined(self, field: Array, more: Array) -> Array:
        """The same sources, then `more`."""
        return np.concatenate([field, more])

    def residual(self, potential: Array, field: Array, source: int, material: Magnetisation) -> Array:
        """Element vectors (e, 12): outward moments of the flux density, less the moments of the coil field in air."""
        h = self._strength(potential, field, source, material)
        flow = self.area @ np.swapaxes(
            h + material.polarisation(h, source) - self._in_air(field[source]), 1, 2
        )
        return (flow.reshape(-1, 16) @ _MOMENTS).reshape(-1, 12)

    def _in_air(self, field: Array) -> Array:
        """Flux density (e, 4, 3) if the iron is air: the divergence-free part of a field (e, 4, 3)."""
        spread = _SHAPE.sum(axis=1).T @ self.area
        share = np.einsum("eqk,eqk->e", spread, field) / np.einsum("eqk,eqk->e", spread, spread)
        return field - share[:, None, None] * spread

    def tangent(self, potential: Array, field: Array, source: int, material: Magnetisation) -> Array:
        """Element matrices (e, 12, 12): minus the derivative of the residual by the potentials. They are symmetric,
        and positive but for equal potentials on all faces."""
        permeability = material.susceptibility(self._strength(potential, field, source, material)) + UNIT
        out = np.zeros((*self.unknowns.shape, 12))
        given = (permeability, linear_flux.SHAPE, self.area, self.volume, out)
        over_rows(linear_flux.moment_matrices, len(out), *given, work=self.work)
        return out

    def strength_at_points(self, potential: Array, field: Array, material: Magnetisation) -> Array:
        """mu0 H (c, e, 4, 3) at the four points of every element, for potentials (n, c)."""
        sources = range(potential.shape[1])
        return np.stack([self._strength(potential[:, c], field, c, material) for c in sources])

    def _strength(self, potential: Array, field: Array, source: int, material: Magnetisation) -> Array:
        """mu0 H (e, 4, 3) for potentials (n,). The kernel is compiled for contiguous arrays only."""
        out = np.empty((len(self.volume), 4, 3))
        values, coils = np.ascontiguousarray(potential), np.ascontiguousarray(field[source])
        elements = (linear_flux.SHAPE, self.area, self.volume, self.unknowns)
        given = (values, coils, *elements, material.law, material.tables.arrays, out)
        over_rows(linear_flux.strength, len(out), *given, work=self.work)
        return out


def _means(faces: Index, count: int) -> csr_matrix:
    """Takes unknowns (count,) to their means over faces (k,)."""
    columns = (3 * faces[:, None] + np.arange(3)).ravel()
    rows = np.repeat(np.arange(len(faces)), 3)
    return csr_matrix((np.full(rows.size, 1 / 3), (rows, columns)), shape=(len(faces), count))


class SurfaceFluxSystem:
    """K and S of one mesh and material. unknowns (n,): the magnetic body (a connected piece) of each unknown;
    reluctivity (s,): 1 / mu_r of the elements at the surface faces."""

    def __init__(self, stiffness: csr_matrix, form: "FluxForm", unknowns: Index, reluctivity: Array) -> None:
        self._mean, self._exterior, self._body = form.elements.face_mean, form.exterior, unknowns
        self._stiffness = stiffness
        # One unknown of each magnetic body is fixed at zero; its equation follows from the others.
        fixed = np.unique(unknowns, return_index=True)[1]
        self._free = np.setdiff1d(np.arange(len(unknowns)), fixed)
        inner = stiffness[self._free][:, self._free]
        self._factor = Elimination.of(inner).factor(inner.data)
        self._scale = 1 / np.maximum(1.0, reluctivity)[:, None]
        surface = form.iron.topology.group_of_surface
        self._sums = (surface[:, None] == np.arange(len(fixed))).astype(float)
        self._flux_of_constants = self._exterior.flux(self._sums)
        self._net = np.linalg.inv(self._sums.T @ (self._scale * self._flux_of_constants))

    def solve(self, right: Array, tolerance: float, max_steps: int) -> tuple[Array, list[Array]]:
        """l (n, c) for r (n, c), whose sum over each body is zero; and the residual norms (c,) after each step.

        An error of x enters l multiplied by 1 / mu_r, so a second pass solves for the residual of the first.
        """
        potential, history = self._pass(right, tolerance, max_steps)
        air = self._mean.T @ self._exterior.flux(self._mean @ potential)
        correction, more = self._pass(right - self._stiffness @ potential - air, tolerance, max_steps)
        return potential + correction, history + more

    def _pass(self, right: Array, tolerance: float, max_steps: int) -> tuple[Array, list[Array]]:
        def operator(flux: Array) -> Array:
            means = self._mean @ self._inside(self._mean.T @ flux)
            return self._without_net_flux(flux + self._exterior.flux(means))

        inside = self._inside(right)
        drive = self._without_net_flux(self._exterior.flux(self._mean @ inside))
        flux, history = block_gmres(operator, drive, tolerance, max_steps)
        potential = inside - self._inside(self._mean.T @ flux)
        net = self._sums.T @ self._exterior.flux(self._mean @ potential)
        constants = np.linalg.solve(self._sums.T @ self._flux_of_constants, -net)
        return potential + constants[self._body], history

    def _inside(self, right: Array) -> Array:
        potential = np.zeros_like(right)
        potential[self._free] = self._factor.solve(right[self._free])
        return potential

    def _without_net_flux(self, flux: Array) -> Array:
        """Scale, and remove the flux of constant potentials: the sum over each body is zero, to rounding."""
        value = self._scale * flux
        return value - self._scale * self._flux_of_constants @ (self._net @ (self._sums.T @ value))


# Largest number of Krylov steps. Plates have modes of very small demagnetising factors: one of 60 : 1 takes 85 steps.
_MAX_STEPS_OF_WEAK_BODIES = 250


class FluxForm(ConvexForm):
    """One mesh in the flux form."""

    name = "flux"
    elements: FluxElements

    def __init__(self, iron: AssembledIron) -> None:
        nodal = NodalElements.from_mesh(iron.mesh, iron.topology)
        super().__init__(iron, FluxElements.from_mesh(nodal, iron.topology))

    def _drive(self, tangent: csr_matrix, material: Magnetisation) -> Callable[[Array], Array]:
        none = np.zeros(self.elements.count)

        def drive(values: Array) -> Array:
            fields = self.elements.nodal.point_gradients(-values)
            return np.column_stack([self._residual(none, one[None], 0, material) for one in fields])

        return drive

    def _linear_solver(
        self, stiffness: csr_matrix, material: Magnetisation, tolerance: float, rough: bool = False
    ) -> Callable[[Array], tuple[Array, list[Array]]]:
        slope = material.tables.coefficients[material.tables.offset[material.law], 2]
        if slope.min() >= 1:
            return super()._linear_solver(stiffness, material, tolerance, rough)
        faces, unknowns = self.iron.topology, np.zeros(self.elements.count, np.int64)
        unknowns[self.elements.unknowns] = faces.group_of_tet[:, None]
        below = slope[faces.owner[faces.surface, 0]]
        system = SurfaceFluxSystem(stiffness, self, unknowns, 1 / below)
        return lambda right: system.solve(right, tolerance, _MAX_STEPS_OF_WEAK_BODIES)
