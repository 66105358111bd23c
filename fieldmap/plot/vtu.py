"""Solved iron as a VTK unstructured grid (.vtu), for ParaView, pyvista and meshio: fields in every element."""

from os import PathLike
from pathlib import Path

import numpy as np
import pyvista as pv
from scipy.constants import mu_0

from fieldmap.errors import InputError, Problem
from fieldmap.iron import SolvedState
from fieldmap.store.whole_files import whole_file


def write_vtu(state: SolvedState, path: str | PathLike[str]) -> Path:
    """Write the iron and magnets of a solved state as .vtu; lengths in m.

    Cell data, means of every tetrahedron: `B_T`, `J_T` (polarisation B - mu0 H) and `H_A_per_m`, (e, 3); `mu_r`,
    |B| over mu0 |H|, where saturation is seen (of a magnet it is no permeability); `body`, its number. Field data:
    `body_names` and `currents_A`. Raises InputError for a solution without iron or one that was read back from a file,
    and for a path that does not end in .vtu or cannot be written. The file appears complete or not at all.
    """
    target = Path(path)
    if target.suffix != ".vtu":
        must_hold = "must be a file name that ends in .vtu"
        raise InputError(Problem(str(target), must_hold, target.name, "programs know the format by it"))
    grid = iron_grid(state)
    with whole_file(target) as partial:
        target.parent.stat()
        grid.save(partial)
    return target


def iron_grid(state: SolvedState) -> pv.UnstructuredGrid:
    """The same as pyvista.UnstructuredGrid. Raises InputError as `write_vtu`."""
    mesh, iron = state.mesh, state.iron
    if mesh is None or iron is None:
        remedy = "solve a device with iron"
        raise InputError(Problem("write_vtu, state", "a solution with its mesh", "no mesh", remedy))
    cells = np.column_stack([np.full(len(mesh.tets), 4), mesh.tets])
    kinds = np.full(len(mesh.tets), pv.CellType.TETRA, dtype=np.uint8)
    grid = pv.UnstructuredGrid(cells.ravel(), kinds, mesh.points)
    flux = state.element_flux_density
    polarisation = iron.mean_polarisation(np.arange(len(mesh.tets)), state.weights)
    strength = (flux - polarisation) / mu_0
    size = mu_0 * np.linalg.norm(strength, axis=1)
    grid.cell_data["B_T"] = flux
    grid.cell_data["J_T"] = polarisation
    grid.cell_data["H_A_per_m"] = strength
    grid.cell_data["mu_r"] = np.linalg.norm(flux, axis=1) / np.maximum(size, 1e-300)
    grid.cell_data["body"] = mesh.body
    grid.field_data["body_names"] = list(mesh.body_names)
    grid.field_data["currents_A"] = state.currents
    return grid
