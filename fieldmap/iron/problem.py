"""The linear volume integral problem: flux through the iron's surface, for any number of sources at once.

Unknown is the outward flux x through every surface face. The charge of a face is (1 - nu) x / mu0, where nu = 1/mu_r
of its element; between elements of different nu it is (nu_2 - nu_1) times the flux. With W the mutual potential of
the faces, T x the surface potential that the interior needs to carry x (`fieldmap.iron.interior`), and g that of the
sources alone,

    W (1 - nu) x + W_i c phi_i(x) + T x = g + const per magnetic body,     sum of x = 0 over each body.

Left-preconditioned by the Cholesky factor of W the spectrum gathers around 1 + nu, so GMRES needs 5 to 20 steps at
any permeability. The net flux is kept at zero exactly: a defect of 3e-3 would cost 50-200 % at mu_r >= 1000.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from fieldmap.errors import NotConverged, Problem
from fieldmap.iron.flux_elements import FluxElements
from fieldmap.iron.interior import Interior
from fieldmap.iron.krylov import block_gmres
from fieldmap.iron.mesh import IronMesh
from fieldmap.iron.surface import ChargedFaces
from fieldmap.iron.topology import Faces, build_faces

Array = NDArray[np.float64]
_MAX_ITERATIONS = 120


@dataclass(frozen=True, eq=False)
class LinearState:
    """What a solve leaves: charged faces, their densities (c, m) in T, and the fluxes (c, e, 4) of all elements.

    The densities are mu0 times magnetic charge per area; `faces` are the surface faces, then the faces between
    bodies of different permeability. iterations: GMRES steps; residuals: its history, relative, worst column.
    """

    faces: ChargedFaces
    density: Array
    flux: Array
    iterations: int
    residuals: tuple[float, ...]


class SurfacePreconditioner:
    """Inverse of W restricted to zero net flux through every magnetic body."""

    def __init__(self, potential: Array, group: NDArray[np.int64], column_scale: Array) -> None:
        self._scale = 1 / np.sqrt(np.diag(potential))
        self._column_scale = column_scale[:, None]
        scaled = potential * self._scale[:, None] * self._scale
        try:
            # Single precision halves the time; the preconditioner need not be exact.
            self._factor = cho_factor(scaled.astype(np.float32), lower=True, overwrite_a=True)
        except LinAlgError:
            self._factor = cho_factor(scaled, lower=True, overwrite_a=True)
        self._sums = (group[:, None] == np.arange(group.max() + 1)).astype(float)
        self._to_sums = self._inverse(self._sums)
        self._schur = np.linalg.inv(self._sums.T @ self._to_sums)

    def _inverse(self, right: Array) -> Array:
        factor = self._factor[0]
        return self._scale[:, None] * cho_solve(
            self._factor, (self._scale[:, None] * right).astype(factor.dtype)
        )

    def __call__(self, right: Array) -> Array:
        """Apply to (s, c). The result has zero sum over each body, to rounding."""
        value = self._inverse(right)
        value = value - self._to_sums @ (self._schur @ (self._sums.T @ value))
        return value * self._column_scale


class LinearProblem:
    """Geometry and dense matrix of one mesh; solves for any permeabilities and sources.

    mesh: the iron. Costs 8 bytes times the square of the number of surface faces.
    """

    def __init__(self, mesh: IronMesh, potential: Array | None = None) -> None:
        self.mesh = mesh
        self.topology: Faces = build_faces(mesh)
        self.elements = FluxElements.from_mesh(mesh)
        self.surface = ChargedFaces.from_nodes(mesh.points, self.topology.nodes[self.topology.surface])
        self.potential = self.surface.mutual_potential() if potential is None else potential

    def solve(
        self, mu_r: Array, load: Array, remanence: Array | None = None, tolerance: float = 1e-7
    ) -> LinearState:
        """Solve for relative permeabilities (e,) of the elements and loads (c, e, 4), see `FluxElements.load`.

        remanence (e, 3) in T is a source of its own and is appended as the last column when given. Raises
        NotConverged with the residual history.
        """
        reluctivity = 1 / mu_r
        fixed = None
        if remanence is not None:
            fixed = reluctivity[:, None] * remanence
            load = np.concatenate([load, self.elements.uniform_load(fixed)[None]])
        charges = _ChargeMap(self, reluctivity, fixed)
        interior = Interior(self.topology, self.elements.mass(), reluctivity)
        surface = self.topology.surface
        outer = 1 / np.maximum(1.0, charges.surface_reluctivity)
        precondition = SurfacePreconditioner(self.potential, self.topology.group_of_surface, outer)

        def potential_of(flux: Array, face_potential: Array, inner_load: Array | None, source: bool) -> Array:
            value = self.potential @ charges.surface_charge(flux, source)
            if charges.has_interfaces:
                inside = interior.element_flux(inner_load, face_potential)
                value += charges.interface_potential @ charges.interface_charge(inside, source)
            return value

        def residual_operator(flux: Array) -> Array:
            inside = interior.face_potential(None, flux)
            return precondition(potential_of(flux, inside, None, False) - inside[surface])

        inside = interior.face_potential(load, None)
        nothing = np.zeros((len(surface), load.shape[0]))
        right = precondition(inside[surface] - potential_of(nothing, inside, load, True))
        flux, history = block_gmres(residual_operator, right, tolerance, _MAX_ITERATIONS)
        residuals = tuple(float(step.max()) for step in history)
        if residuals[-1] > tolerance:
            raise NotConverged(
                Problem(
                    "iron solver",
                    f"the residual must fall to {tolerance:g} within {_MAX_ITERATIONS} steps",
                    f"{residuals[-1]:.2e}",
                    "loosen the tolerance, or look for slivers: bodies that nearly touch, very thin parts",
                ),
                residuals=residuals,
            )
        element_flux = interior.element_flux(load, interior.face_potential(load, flux))
        return charges.state(flux, element_flux, residuals)


class _ChargeMap:
    """From fluxes to charges for one distribution of reluctivity and remanence."""

    def __init__(self, problem: LinearProblem, reluctivity: Array, fixed: Array | None) -> None:
        self._problem = problem
        faces = problem.topology
        owner = faces.owner
        self.surface_reluctivity = reluctivity[owner[faces.surface, 0]]
        inner = np.flatnonzero((owner >= 0).all(axis=1))
        differs = reluctivity[owner[inner, 0]] != reluctivity[owner[inner, 1]]
        if fixed is not None:
            differs |= (fixed[owner[inner, 0]] != fixed[owner[inner, 1]]).any(axis=1)
        self._interface = inner[differs]
        self.has_interfaces = len(self._interface) > 0
        both = owner[self._interface]
        self._jump = reluctivity[both[:, 1]] - reluctivity[both[:, 0]]
        self._interface_faces = ChargedFaces.from_nodes(problem.mesh.points, faces.nodes[self._interface])
        if self.has_interfaces:
            self.interface_potential = problem.surface.potential_of(self._interface_faces)
        self._fixed_surface = self._fixed_interface = None
        if fixed is not None:
            surface, inside = problem.surface, self._interface_faces
            normal = surface.normals * surface.areas[:, None]
            self._fixed_surface = np.einsum("sd,sd->s", normal, fixed[owner[faces.surface, 0]])
            normal = inside.normals * inside.areas[:, None]
            self._fixed_interface = np.einsum("sd,sd->s", normal, fixed[both[:, 0]] - fixed[both[:, 1]])
        # Where the flux of an interface face is found: its first owner and the face's number there.
        self._element = both[:, 0]
        match = faces.tet_faces[self._element] == self._interface[:, None]
        self._local = match.argmax(axis=1)

    def surface_charge(self, flux: Array, source: bool) -> Array:
        """Charge (s, c) of the surface faces; `source` adds the remanence to the last column."""
        charge = (1 - self.surface_reluctivity)[:, None] * flux
        if source and self._fixed_surface is not None:
            charge[:, -1] += self._fixed_surface
        return charge

    def interface_charge(self, element_flux: Array, source: bool) -> Array:
        """Charge (i, c) of faces between different permeabilities, from element fluxes (c, e, 4)."""
        charge = self._jump[:, None] * element_flux[:, self._element, self._local].T
        if source and self._fixed_interface is not None:
            charge[:, -1] += self._fixed_interface
        return charge

    def state(self, flux: Array, element_flux: Array, residuals: tuple[float, ...]) -> LinearState:
        """Everything the fields need."""
        surface, inside = self._problem.surface, self._interface_faces
        density = np.concatenate(
            [
                self.surface_charge(flux, True) / surface.areas[:, None],
                self.interface_charge(element_flux, True) / inside.areas[:, None],
            ]
        )
        nodes = self._problem.topology.nodes
        charged = np.concatenate([nodes[self._problem.topology.surface], nodes[self._interface]])
        faces = ChargedFaces.from_nodes(self._problem.mesh.points, charged)
        return LinearState(faces, np.ascontiguousarray(density.T), element_flux, len(residuals), residuals)
