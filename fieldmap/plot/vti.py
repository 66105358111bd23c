"""A map as VTK image data (.vti), for ParaView and pyvista: the field and its gradient on the map's nodes."""

from os import PathLike
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.interop.csv_map import current_words, map_nodes
from fieldmap.lookup import FieldMap
from fieldmap.store.whole_files import whole_file

FRAME = "right-handed, z up, lengths in m; gradient component 3 i + j is dB_i/dx_j"


def write_vti(field: FieldMap, path: str | PathLike[str], currents: ArrayLike | None = None) -> Path:
    """Write an opened map as .vti: at fixed currents (n_coils,), A, or coil by coil per ampere.

    At fixed currents the arrays are `B_T` (n, 3) and `gradB_T_per_m` (n, 9), otherwise `B_COIL_T_per_A` and
    `gradB_COIL_T_per_m_A` of every coil. Lengths in m. The field data say which device, frame and currents it is.
    Raises InputError for currents that do not fit, for a map of saturating iron without any, and for a path that does
    not end in .vti or cannot be written. The file appears complete or not at all.
    """
    target = Path(path)
    if target.suffix != ".vti":
        must_hold = "must be a file name that ends in .vti"
        raise InputError(Problem(str(target), must_hold, target.name, "programs know the format by it"))
    image = map_image(field, currents)
    with whole_file(target) as partial:
        target.parent.stat()
        image.save(partial)
    return target


def map_image(field: FieldMap, currents: ArrayLike | None = None) -> pv.ImageData:
    """The same as pyvista.ImageData."""
    grid, points = field.info.grid, map_nodes(field)
    spacing = (field.upper - field.lower) / (np.array(grid.shape) - 1)
    image = pv.ImageData(dimensions=grid.shape, spacing=tuple(spacing), origin=tuple(field.lower))
    # Ours counts z fastest, VTK x.
    order = np.arange(len(points)).reshape(grid.shape).ravel(order="F")
    if currents is None:
        flux, slope = field.unit_field(points), field.unit_gradient(points)
        for k, name in enumerate(field.coil_names):
            image.point_data[f"B_{name}_T_per_A"] = flux[order, k]
            image.point_data[f"gradB_{name}_T_per_m_A"] = slope[order, k].reshape(-1, 9)
        image.field_data["currents"] = ["1 A in each coil alone"]
    else:
        total, slope = field.field_and_gradient(points, currents)
        image.point_data["B_T"] = total[order]
        image.point_data["gradB_T_per_m"] = slope[order].reshape(-1, 9)
        image.field_data["currents"] = [current_words(field, currents)]
    image.field_data["frame"] = [FRAME]
    image.field_data["device"] = [field.info.provenance.device_name or "not recorded"]
    return image
