"""Sampling of a field for a table or an image, with the information that is written with the numbers."""

from dataclasses import dataclass
from math import prod

import numpy as np

from fieldmap.errors import InputError
from fieldmap.field import AnyField, Field, StateField, as_field, coil_currents, require_bounds
from fieldmap.lookup import FieldMap
from fieldmap.records import Record
from fieldmap.store import Grid
from fieldmap.typing import Array

MOST_NODES = 4_000_000
"""Largest number of nodes of a table or an image; with six coils their numbers take 2.3 GB."""
FRAME = "right-handed, z up, lengths in m"


@dataclass(frozen=True, eq=False, repr=False)
class Samples(Record):
    """A field on the nodes of a grid: at currents (n_coils,), A, or coil by coil if they are None.

    points (n, 3), m, z fastest; flux_density (n, 3), T, and gradient (n, 3, 3), T/m, at these currents; coil by coil
    (n, n_coils, 3) and (n, n_coils, 3, 3) per ampere. constant: B (n, 3) and gradient (n, 3, 3) of the field without
    currents, if there is one; fixed_sources: names of its sources. reference (n_coils,), A: reference currents of a
    map, 1 for any other field. title, device: as recorded in a map, or "".
    """

    coil_names: tuple[str, ...]
    grid: Grid
    points: Array
    currents: Array | None
    flux_density: Array
    gradient: Array
    reference: Array
    title: str
    device: str
    constant: tuple[Array, Array] | None = None
    fixed_sources: tuple[str, ...] = ()

    @property
    def currents_in_words(self) -> str:
        """Currents of all coils in words."""
        if self.currents is None:
            return "1 A in each coil alone"
        pairs = zip(self.coil_names, self.currents.tolist(), strict=True)
        return ", ".join(f"{value!r} A in coil {name}" for name, value in pairs)


def sample(
    field: AnyField, currents: object = None, spacing: float | None = None, device: str = ""
) -> Samples:
    """Sample a field with a box on the nodes of `sample_grid`.

    currents (n_coils,), A; by default those of a state, or coil by coil for other fields. device: its name, for a
    field that does not record it. Raises InputError for invalid currents, and without currents for a field that does
    not superpose.
    """
    source = as_field(field)
    if currents is None and isinstance(source, StateField):
        currents = source.currents
    lower, upper = require_bounds(source)
    grid = sample_grid(source, spacing)
    # The outermost nodes must not lie outside because of rounding.
    points = np.clip(grid.points(), lower, upper)
    amperes = None if currents is None else coil_currents(currents, source.coil_names)
    if amperes is None:
        flux, slope = source.unit_field(points), source.unit_gradient(points)
    else:
        flux, slope = source.field_and_gradient(points, amperes)
    constant = None
    if amperes is None and not source.proportional:
        constant = source.constant_field(points), source.constant_gradient(points)
    info = source.info if isinstance(source, FieldMap) else None
    return Samples(
        tuple(source.coil_names),
        grid,
        points,
        amperes,
        flux,
        slope,
        np.array(np.broadcast_to(1.0 if info is None else info.reference_current, len(source.coil_names))),
        "" if info is None else info.provenance.title,
        device if info is None else info.provenance.device_name,
        constant,
        () if info is None else info.fixed_sources,
    )


def sample_grid(field: Field, spacing: float | None = None) -> Grid:
    """Grid of nodes over the box of a field, at most `spacing` (m) apart; by default the nodes of a map.

    Raises InputError for a spacing that is not positive or gives more than `MOST_NODES`; a map alone needs no
    spacing.
    """
    lower, upper = require_bounds(field)
    if spacing is None:
        if not isinstance(field, FieldMap):
            must_hold, remedy = "must be given for a field that has no nodes of its own", "try 0.002 (2 mm)"
            raise InputError.of("spacing", must_hold, "none", remedy)
        shape = field.info.grid.shape
    elif spacing > 0:
        nx, ny, nz = (int(np.ceil(x / spacing - 1e-9)) + 1 for x in upper - lower)
        shape = (nx, ny, nz)
        if prod(shape) > MOST_NODES:
            wider = 1.1 * spacing * (prod(shape) / MOST_NODES) ** (1 / 3)
            must_hold, received = (
                f"must give at most {MOST_NODES} nodes",
                f"{spacing:.3g} m: {prod(shape)} nodes",
            )
            raise InputError.of("spacing", must_hold, received, f"take {1e3 * wider:.2g} mm or more")
    else:
        raise InputError.of("spacing", "must be greater than 0 m", repr(spacing), "correct it")
    return Grid(lower, (upper - lower) / (np.array(shape) - 1), shape)
