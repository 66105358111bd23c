"""A field as a CSV table with units in its header, for spreadsheets and `fieldmap.interop.read_measurements`.

    # frame: right-handed, z up, lengths in m; gradient dBi_dxj is dB_i/dx_j
    x_m,y_m,z_m,I_left_A,I_right_A,Bx_T,By_T,Bz_T,dBx_dx_T_per_m,...,dBz_dz_T_per_m

Lines that begin with # are remarks. Numbers read back to the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.field import AnyField
from fieldmap.interop.sampling import FRAME, Samples, sample
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array, PathLike

FIXED = "fixed"
"""Name of the only coil of a table at fixed currents; its current of 1 A stands for these currents."""

_AXES = "xyz"


def write_csv(
    field: AnyField,
    path: PathLike,
    currents: ArrayLike | None = None,
    spacing: float | None = None,
    device: str = "",
) -> Path:
    """Write a field as a table: coil by coil, or at fixed currents.

    Coil by coil there is a row for every node and coil, with the map's reference current (1 A for other fields) in
    that coil and no other currents. A field that no current drives is in all of these rows, and rows without currents
    have it alone. At fixed currents there is a row for every node, and its `I_fixed_A` = 1 stands for the currents in
    a remark. The file appears complete or not at all.

    Parameters
    ----------
    field
        An opened map, written on its nodes, or any field with a box.
    path
        Path of the file.
    currents
        Currents (n_coils,), A; by default coil by coil.
    spacing
        Largest distance of nodes, m; required for a field without nodes of its own.
    device
        Name of the device, for a field that does not record it.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For invalid currents, and for saturating iron without currents.

    Examples
    --------
    >>> from fieldmap.lookup import open_map                                               # doctest: +SKIP
    >>> write_csv(open_map("workspace.h5"), "workspace.csv", currents=[1.5] * 6)           # doctest: +SKIP
    """
    samples = sample(field, currents, spacing, device)
    points = samples.points
    if samples.currents is None:
        names, sets = samples.coil_names, list(_coil_by_coil(samples))
    else:
        names, sets = (FIXED,), [(np.ones(1), samples.flux_density, samples.gradient)]
    header = [f"{axis}_m" for axis in _AXES] + [f"I_{name}_A" for name in names]
    header += [f"B{axis}_T" for axis in _AXES] + [f"dB{i}_d{j}_T_per_m" for i in _AXES for j in _AXES]
    lines = [*_remarks(samples), ",".join(header)]
    for amperes, flux, slope in sets:
        given = np.broadcast_to(amperes, (len(points), len(names)))
        table = np.hstack([points, given, flux, slope.reshape(-1, 9)])
        lines += [",".join(map(repr, row)) for row in table.tolist()]
    return write_whole(path, "\n".join(lines) + "\n", "table of a field")


def _coil_by_coil(samples: Samples) -> Iterator[tuple[Array, Array, Array]]:
    """Currents (n_coils,), B (n, 3) and gradient (n, 3, 3) of every coil alone at its reference current."""
    coils = np.eye(len(samples.coil_names))
    for k, ampere in enumerate(samples.reference):
        flux, slope = ampere * samples.flux_density[:, k], ampere * samples.gradient[:, k]
        if samples.constant is not None:
            flux, slope = flux + samples.constant[0], slope + samples.constant[1]
        yield ampere * coils[k], flux, slope
    if samples.constant is not None:
        yield np.zeros(len(coils)), *samples.constant


def _remarks(samples: Samples) -> list[str]:
    nx, ny, nz = samples.grid.shape
    lines = [
        f"# {_line(samples.title or 'fieldmap')}",
        f"# device: {_line(samples.device or 'not recorded')}",
        f"# frame: {FRAME}; gradient dBi_dxj is dB_i/dx_j",
        f"# nodes: {nx} x {ny} x {nz}, z fastest",
    ]
    if samples.constant is not None:
        of = ", ".join(samples.fixed_sources) or "the field"
        lines.append(
            f"# every row has the field that no current drives, of {of}: rows without currents have it alone"
        )
    if samples.currents is None:
        return lines
    return [*lines, f"# I_{FIXED}_A = 1 stands for {samples.currents_in_words}"]


def _line(text: str) -> str:
    return " ".join(text.split())
