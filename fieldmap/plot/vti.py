"""A field as VTK image data (.vti), for ParaView and pyvista: flux density and gradient on a grid of nodes."""

from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.arguments import raise_all
from fieldmap.field import AnyField
from fieldmap.interop.sampling import FRAME, sample
from fieldmap.store.output_formats import output_problems
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import PathLike


def write_vti(
    field: AnyField,
    path: PathLike,
    currents: ArrayLike | None = None,
    spacing: float | None = None,
    device: str = "",
) -> Path:
    """Write a field as .vti: at fixed currents, or coil by coil per ampere.

    At fixed currents the arrays are `B_T` (n, 3) and `gradB_T_per_m` (n, 9), otherwise `B_COIL_T_per_A` and
    `gradB_COIL_T_per_m_A` of every coil, and `B_no_current_T` and `gradB_no_current_T_per_m` of a constant field, if
    there is one. Lengths in m. The field data have the device, the frame and the currents.
    The file is written completely or not at all.

    Parameters
    ----------
    field
        An opened map, on its nodes, or any field with a box.
    path
        Ends in .vti.
    currents
        (n_coils,), A; coil by coil unless given.
    spacing
        Largest distance of nodes, m; required for a field without nodes.
    device
        Name of the device, if the field is not a map that records it.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For currents that do not fit, for saturating iron without any, and for a path that does not end in .vti or
        cannot be written.
    """
    # Checked before the field is sampled.
    raise_all(output_problems(str(path), path, ["VTK image data"]))
    return save_grid(map_image(field, currents, spacing, device), path, "VTK image data")


def save_grid(grid: pv.DataSet, path: PathLike, kind: str) -> Path:
    """Write a grid as VTK's XML of this format, completely or not at all."""
    with whole_file(path, kind) as partial:
        grid.save(partial)
    return Path(path)


def map_image(
    field: AnyField, currents: ArrayLike | None = None, spacing: float | None = None, device: str = ""
) -> pv.ImageData:
    """The data of `write_vti` as pyvista.ImageData.

    Parameters
    ----------
    field
        A field with a box.
    currents
        As for `write_vti`.
    spacing
        As for `write_vti`.
    device
        As for `write_vti`.

    Returns
    -------
    pv.ImageData
        The image.
    """
    samples = sample(field, currents, spacing, device)
    grid = samples.grid
    image = pv.ImageData(dimensions=grid.shape, spacing=tuple(grid.spacing), origin=tuple(grid.lower))
    # The fastest index is z here and x in VTK.
    order = np.arange(grid.size).reshape(grid.shape).ravel(order="F")
    flux, slope = samples.flux_density, samples.gradient
    if samples.currents is None:
        for k, name in enumerate(samples.coil_names):
            image.point_data[f"B_{name}_T_per_A"] = flux[order, k]
            image.point_data[f"gradB_{name}_T_per_m_A"] = slope[order, k].reshape(-1, 9)
        if samples.constant is not None:
            image.point_data["B_no_current_T"] = samples.constant[0][order]
            image.point_data["gradB_no_current_T_per_m"] = samples.constant[1][order].reshape(-1, 9)
    else:
        image.point_data["B_T"] = flux[order]
        image.point_data["gradB_T_per_m"] = slope[order].reshape(-1, 9)
    image.field_data["currents"] = [samples.currents_in_words]
    image.field_data["frame"] = [f"{FRAME}; gradient component 3 i + j is dB_i/dx_j"]
    image.field_data["device"] = [samples.device or "not recorded"]
    return image
