"""Solved iron for ParaView, pyvista and meshio: fields in elements (.vtu, .xdmf), charges on the surface (.vtu)."""

from pathlib import Path

import numpy as np
import pyvista as pv

from fieldmap.constants import MU0
from fieldmap.device.model import Device
from fieldmap.errors import InputError
from fieldmap.extras import require
from fieldmap.iron import IronMesh, SolvedState
from fieldmap.iron.elements.state import IronState
from fieldmap.plot.vti import save_grid
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import Array, PathLike


def write_vtu(state: SolvedState, path: PathLike, device: Device | None = None) -> Path:
    """Write the iron and magnets of a solved state as .vtu; lengths in m.

    Cell data, means of every tetrahedron: `B_T`, `J_T` (polarisation B - mu0 H) and `H_A_per_m`, (e, 3);
    `mu_r`, |B| over mu0 |H|, which shows saturation (not a permeability in magnets); `body`, its number. With the
    device of the state also `permeability_loss`, 1 - mu_r / mu_r(H = 0): 0 for the initial permeability, 1 for
    complete saturation, negative at the foot of curves where the permeability first rises, NaN in magnets and flux
    barriers. Field data: `body NAME`, the number of each body, and `currents_A`. The file is written completely or
    not at all.

    Parameters
    ----------
    state
        The solved state.
    path
        Of the file, which ends in .vtu.
    device
        The device of the state.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For a solution without iron or one that was read back from a file, for a device of other bodies, and
        for a path that does not end in .vtu or cannot be written.
    """
    return save_grid(iron_grid(state, device), path, "VTK mesh")


def write_charges_vtu(state: SolvedState, path: PathLike) -> Path:
    """Write the charged surface of solved iron and magnets as .vtu of triangles; lengths in m.

    Cell data of every face: `charge_T`, mu0 times magnetic charge per area (the jump of the normal component
    of B - mu0 M outwards, from which the field in the air follows), and `normal`, away from the iron. Field
    data: `currents_A`.

    Parameters
    ----------
    state
        The solved state.
    path
        Of the file, which ends in .vtu.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        As for `write_vtu`.
    """
    return save_grid(charges_grid(state), path, "VTK mesh")


def write_xdmf(state: SolvedState, path: PathLike, device: Device | None = None) -> Path:
    """Write what `write_vtu` writes as .xdmf, numbers in the file itself, by meshio.

    The format has no place for field data.

    Parameters
    ----------
    state
        The solved state.
    path
        Of the file.
    device
        The device of the state.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    FieldmapError
        Where meshio is not installed.
    InputError
        As for `write_vtu`.
    """
    meshio = require("meshio", "mesh", "write_xdmf")
    grid = iron_grid(state, device)
    cells = [("tetra", grid.cell_connectivity.reshape(-1, 4))]
    data = {name: [np.asarray(values)] for name, values in grid.cell_data.items()}
    with whole_file(path, "XDMF mesh") as partial:
        meshio.Mesh(grid.points, cells, cell_data=data).write(partial, "xdmf", data_format="XML")
    return Path(path)


def iron_grid(state: SolvedState, device: Device | None = None) -> pv.UnstructuredGrid:
    """The data of `write_vtu` as pyvista.UnstructuredGrid. Raises InputError as `write_vtu`."""
    mesh, iron = _solved(state, "write_vtu")
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.tets}, mesh.points)
    flux = state.element_flux_density
    polarisation = iron.mean_polarisation(np.arange(len(mesh.tets)), state.weights)
    strength = (flux - polarisation) / MU0
    size = MU0 * np.linalg.norm(strength, axis=1)
    mu_r = np.linalg.norm(flux, axis=1) / np.maximum(size, 1e-300)
    grid.cell_data["B_T"] = flux
    grid.cell_data["J_T"] = polarisation
    grid.cell_data["H_A_per_m"] = strength
    grid.cell_data["mu_r"] = mu_r
    if device is not None:
        grid.cell_data["permeability_loss"] = 1 - mu_r / _initial(device, mesh)[mesh.body]
    grid.cell_data["body"] = mesh.body
    # Numbers, because meshio cannot read texts.
    for number, name in enumerate(mesh.body_names):
        grid.field_data[f"body {name}"] = [number]
    grid.field_data["currents_A"] = state.currents
    return grid


def charges_grid(state: SolvedState) -> pv.UnstructuredGrid:
    """The charged surface as pyvista.UnstructuredGrid. Raises InputError as `write_charges_vtu`."""
    _, iron = _solved(state, "write_charges_vtu")
    points, number = np.unique(iron.faces.corners.reshape(-1, 3), axis=0, return_inverse=True)
    grid = pv.UnstructuredGrid({pv.CellType.TRIANGLE: number.reshape(-1, 3)}, points)
    grid.cell_data["charge_T"] = state.weights @ iron.density
    grid.cell_data["normal"] = iron.faces.normals
    grid.field_data["currents_A"] = state.currents
    return grid


def _solved(state: SolvedState, where: str) -> tuple[IronMesh, IronState]:
    mesh, iron = state.mesh, state.iron
    if mesh is None or iron is None:
        remedy = "solve a device with iron"
        raise InputError.of(f"{where}, state", "a solution with its mesh", "no mesh", remedy)
    return mesh, iron


def _initial(device: Device, mesh: IronMesh) -> Array:
    """mu_r at H = 0 of the bodies; NaN for bodies that are not iron."""
    names = mesh.iron_names
    materials = {body.name: device.materials[body.material] for body in device.bodies}
    if set(materials) != set(names):
        must_hold = f"must have the bodies of the state: {', '.join(names)}"
        received = ", ".join(materials) or "none"
        raise InputError.of("write_vtu, device", must_hold, received, "give the device that was solved")
    return np.array(
        [materials[name].initial_mu_r if materials[name].role == "iron" else np.nan for name in names]
        + [np.nan] * len(mesh.sheets)
    )
