"""A map as a table: CSV with units in its header, that spreadsheets and `fieldmap.interop.read_measurements` read.

    # frame: right-handed, z up, lengths in m; gradient dBi_dxj is dB_i/dx_j
    x_m,y_m,z_m,I_left_A,I_right_A,Bx_T,By_T,Bz_T,dBx_dx_T_per_m,...,dBz_dz_T_per_m

Lines that begin with # are remarks. Numbers are written so that they read back the same, to the last bit.
"""

from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.lookup import FieldMap
from fieldmap.store import Grid
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array

FIXED = "fixed"
"""Name of the one coil of a map that was written at fixed currents: its 1 A stands for all of them."""

_AXES = "xyz"


def write_csv(field: FieldMap, path: str | PathLike[str], currents: ArrayLike | None = None) -> Path:
    """Write an opened map as a table on its nodes: coil by coil, or at fixed currents (n_coils,), A.

    Coil by coil there is a row for every node and coil, with the map's reference current in that coil and none in the
    others. At fixed currents there is a row for every node, and its `I_fixed_A` = 1 stands for the currents that a
    remark lists. Raises InputError for currents that do not fit, and for a map of saturating iron without any. The file
    appears complete or not at all.

    >>> from fieldmap.lookup import open_map                                               # doctest: +SKIP
    >>> write_csv(open_map("workspace.h5"), "workspace.csv", currents=[1.5] * 6)           # doctest: +SKIP
    """
    points = map_nodes(field)
    if currents is None:
        names, sets = field.coil_names, list(_coil_by_coil(field, points))
    else:
        names, sets = (FIXED,), [(np.ones(1), *field.field_and_gradient(points, currents))]
    header = [f"{axis}_m" for axis in _AXES] + [f"I_{name}_A" for name in names]
    header += [f"B{axis}_T" for axis in _AXES] + [f"dB{i}_d{j}_T_per_m" for i in _AXES for j in _AXES]
    lines = [*_remarks(field, currents), ",".join(header)]
    for amperes, flux, slope in sets:
        given = np.broadcast_to(amperes, (len(points), len(names)))
        table = np.hstack([points, given, flux, slope.reshape(-1, 9)])
        lines += [",".join(map(repr, row)) for row in table.tolist()]
    target = Path(path)
    write_whole(target, ("\n".join(lines) + "\n").encode())
    return target


def map_nodes(field: FieldMap) -> Array:
    """Nodes (n, 3) of a map, m, x slowest; rounding does not put the outermost ones outside."""
    grid = field.info.grid
    inside = Grid(grid.lower, (field.upper - field.lower) / (np.array(grid.shape) - 1), grid.shape)
    return np.clip(inside.points(), field.lower, field.upper)


def _coil_by_coil(field: FieldMap, points: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Currents (n_coils,), B (n, 3) and its gradient (n, 3, 3) of every coil alone, at its reference current."""
    flux, slope = field.unit_field(points), field.unit_gradient(points)
    for k, ampere in enumerate(np.broadcast_to(field.info.reference_current, len(field.coil_names))):
        yield ampere * np.eye(len(field.coil_names))[k], ampere * flux[:, k], ampere * slope[:, k]


def _remarks(field: FieldMap, currents: ArrayLike | None) -> list[str]:
    record = field.info.provenance
    nx, ny, nz = field.info.grid.shape
    lines = [
        f"# {_line(record.title or 'fieldmap')}",
        f"# device: {_line(record.device_name or 'not recorded')}",
        "# frame: right-handed, z up, lengths in m; gradient dBi_dxj is dB_i/dx_j",
        f"# nodes: {nx} x {ny} x {nz}, z fastest",
    ]
    return (
        lines
        if currents is None
        else [*lines, f"# I_{FIXED}_A = 1 stands for {current_words(field, currents)}"]
    )


def current_words(field: FieldMap, currents: ArrayLike) -> str:
    """Fixed currents in words: every coil with its amperes."""
    amperes = np.broadcast_to(np.asarray(currents, float), len(field.coil_names)).tolist()
    return ", ".join(
        f"{value!r} A in coil {name}" for name, value in zip(field.coil_names, amperes, strict=True)
    )


def _line(text: str) -> str:
    return " ".join(text.split())
