"""The iron by the flux through its faces, lowest order, linear: for any permeability from barriers to magnets.

Unknown is the outward flux x through every surface face. The charge of a face is (1 - nu) x / mu0, where nu = 1/mu_r
of its element; between elements of different nu it is (nu_2 - nu_1) times the flux. With W the mutual potential of
the faces, T x the surface potential that the interior needs to carry x (`fieldmap.iron.operators.interior`), and g
that of the sources alone,

    W (1 - nu) x + W_i c phi_i(x) + T x = g + const per magnetic body,     sum of x = 0 over each body.

Left-preconditioned by the Cholesky factor of W the spectrum gathers around 1 + nu, so GMRES needs 5 to 20 steps at
any permeability. The net flux is kept at zero exactly: a defect of 3e-3 would cost 50-200 % at mu_r >= 1000.
"""

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.forms.flux_elements import FluxElements
from fieldmap.iron.forms.krylov import block_gmres, require_convergence
from fieldmap.iron.forms.state import IronState
from fieldmap.iron.operators.assembled import AssembledIron
from fieldmap.iron.operators.interior import Interior
from fieldmap.iron.operators.mutual import MutualPotential
from fieldmap.iron.operators.surface import ChargedFaces

Array = NDArray[np.float64]
_MAX_ITERATIONS = 120


class SurfacePreconditioner:
    """Inverse of W restricted to zero net flux through every magnetic body; `column_scale` (s,) is applied to W^-1."""

    def __init__(self, mutual: MutualPotential, group: NDArray[np.int64], column_scale: Array) -> None:
        self._mutual = mutual
        self._column_scale = column_scale[:, None]
        self._sums = (group[:, None] == np.arange(group.max() + 1)).astype(float)
        # With the scale: bodies of different scale that touch must not leak into each other.
        self._to_sums = mutual.solve(self._sums) * self._column_scale
        self._schur = np.linalg.inv(self._sums.T @ self._to_sums)

    def __call__(self, right: Array) -> Array:
        """Apply to (s, c). The result has zero sum over each body, to rounding."""
        value = self._mutual.solve(right) * self._column_scale
        return value - self._to_sums @ (self._schur @ (self._sums.T @ value))


class FluxForm:
    """One mesh in the flux form; solves for any permeabilities and sources."""

    def __init__(self, iron: AssembledIron) -> None:
        self.iron = iron
        self.elements = FluxElements.from_mesh(iron.mesh)

    def solve(
        self, mu_r: Array, load: Array, remanence: Array | None = None, tolerance: float = 1e-7
    ) -> IronState:
        """Solve for relative permeabilities (e,) of the elements and loads (c, e, 4), see `FluxElements.load`.

        remanence (e, 3) in T is a source of its own and is appended as the last column when given. Raises
        NotConverged with the residual history.
        """
        reluctivity = 1 / mu_r
        fixed = None
        if remanence is not None:
            fixed = reluctivity[:, None] * remanence
            load = np.concatenate([load, self.elements.uniform_load(fixed)[None]])
        charges = _ChargeMap(self.iron, reluctivity, fixed)
        interior = Interior(self.iron.topology, self.elements.mass(), reluctivity)
        flux, residuals = self._surface_flux(charges, interior, load, tolerance)
        element_flux = interior.element_flux(load, interior.face_potential(load, flux))
        density = charges.density(flux, element_flux)
        mean = self.elements.flux_density(element_flux)
        return IronState(charges.faces, density, mean, len(residuals), residuals)

    def _surface_flux(self, charges: "_ChargeMap", interior: Interior, load: Array, tolerance: float):
        """Flux (s, c) through the surface faces, and the residuals."""
        surface = self.iron.topology.surface
        outer = 1 / np.maximum(1.0, charges.surface_reluctivity)
        precondition = SurfacePreconditioner(self.iron.mutual, self.iron.topology.group_of_surface, outer)

        def potential_of(flux: Array, face_potential: Array, inner_load: Array | None, source: bool) -> Array:
            value = self.iron.mutual @ charges.surface_charge(flux, source)
            if charges.has_interfaces:
                inside = interior.element_flux(inner_load, face_potential)
                value += charges.interface_potential @ charges.interface_charge(inside, source)
            return value

        def operator(flux: Array) -> Array:
            inside = interior.face_potential(None, flux)
            return precondition(potential_of(flux, inside, None, False) - inside[surface])

        inside = interior.face_potential(load, None)
        nothing = np.zeros((len(surface), load.shape[0]))
        right = precondition(inside[surface] - potential_of(nothing, inside, load, True))
        flux, history = block_gmres(operator, right, tolerance, _MAX_ITERATIONS)
        residuals = tuple(float(step.max()) for step in history)
        require_convergence("flux form", residuals, tolerance)
        return flux, residuals


class _ChargeMap:
    """From fluxes to charges for one distribution of reluctivity and remanence."""

    def __init__(self, iron: AssembledIron, reluctivity: Array, fixed: Array | None) -> None:
        self._surface = iron.surface
        faces = iron.topology
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
        self._interface_faces = ChargedFaces.from_nodes(iron.mesh.points, faces.nodes[self._interface])
        if self.has_interfaces:
            self.interface_potential = iron.surface.potential_of(self._interface_faces)
        self._fixed_surface = self._fixed_interface = None
        if fixed is not None:
            surface, inside = iron.surface, self._interface_faces
            normal = surface.normals * surface.areas[:, None]
            self._fixed_surface = np.einsum("sd,sd->s", normal, fixed[owner[faces.surface, 0]])
            normal = inside.normals * inside.areas[:, None]
            self._fixed_interface = np.einsum("sd,sd->s", normal, fixed[both[:, 0]] - fixed[both[:, 1]])
        charged = np.concatenate([faces.nodes[faces.surface], faces.nodes[self._interface]])
        self.faces = ChargedFaces.from_nodes(iron.mesh.points, charged)
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

    def density(self, flux: Array, element_flux: Array) -> Array:
        """Density (c, m) on `faces` for surface fluxes (s, c) and element fluxes (c, e, 4)."""
        surface, inside = self._surface, self._interface_faces
        on_surface = self.surface_charge(flux, True) / surface.areas[:, None]
        on_interface = self.interface_charge(element_flux, True) / inside.areas[:, None]
        return np.ascontiguousarray(np.concatenate([on_surface, on_interface]).T)
