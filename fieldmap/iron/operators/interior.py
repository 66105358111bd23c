"""The sparse half of the solver: given the flux through the iron's surface, the field inside.

The condition that fluxes of neighbours agree is imposed by one potential per face (hybridisation). With the local
mass matrix M_e, nu_e = 1/mu_r, load h_e and face potentials l_e, the fluxes of an element are

    phi_e = S_e (h_e - l_e),     S_e = N_e - N_e 1 1^T N_e / (1^T N_e 1),   N_e = (nu_e M_e)^-1,

which sum to zero by construction, and the face potentials solve the sparse symmetric system

    sum_e S_e l = sum_e S_e h_e - x      (x: flux through surface faces).

It fixes the potentials of each magnetic body up to a constant; one face of each is held at zero.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from fieldmap.iron.meshing.topology import Faces

Array = NDArray[np.float64]


class Interior:
    """Factored interior problem for one distribution of reluctivity."""

    def __init__(self, faces: Faces, mass: Array, reluctivity: Array) -> None:
        self._faces = faces
        inverse = np.linalg.inv(reluctivity[:, None, None] * mass)
        row = inverse.sum(axis=2)
        self._condensed = inverse - row[:, :, None] * row[:, None, :] / row.sum(axis=1)[:, None, None]
        n = len(faces.nodes)
        i = np.repeat(faces.tet_faces, 4, axis=1).ravel()
        j = np.tile(faces.tet_faces, (1, 4)).ravel()
        matrix = csc_matrix((self._condensed.ravel(), (i, j)), shape=(n, n))
        # One surface face per magnetic body is held at zero.
        held = faces.surface[np.unique(faces.group_of_surface, return_index=True)[1]]
        self._free = np.setdiff1d(np.arange(n), held)
        self._factor = splu(
            matrix[self._free][:, self._free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def face_potential(self, load: Array | None, surface_flux: Array | None) -> Array:
        """Potentials (f, c) of all faces for loads (c, e, 4) and outward surface fluxes (s, c); either may be None."""
        faces = self._faces
        right = np.zeros((len(faces.nodes), 1))
        if load is not None:
            value = np.einsum("eij,cej->eic", self._condensed, load)
            right = np.zeros((len(faces.nodes), load.shape[0]))
            for k in range(4):
                np.add.at(right, faces.tet_faces[:, k], value[:, k])
        if surface_flux is not None:
            right = np.zeros((len(faces.nodes), surface_flux.shape[1])) if load is None else right
            right[faces.surface] -= surface_flux
        potential = np.zeros_like(right)
        potential[self._free] = self._factor.solve(right[self._free])
        return potential

    def element_flux(self, load: Array | None, potential: Array) -> Array:
        """Outward fluxes (c, e, 4) of every element for loads (c, e, 4) or None and face potentials (f, c)."""
        drive = -np.moveaxis(potential[self._faces.tet_faces], 2, 0)
        if load is not None:
            drive = load + drive
        return np.einsum("eij,cej->cei", self._condensed, drive)
