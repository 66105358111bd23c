"""The field of a map as a function of changing currents, for compiled loops.

Linear iron: a superposition of the coils' fields. Saturating iron: its model, solved whenever the currents change, a
table over a current parametrisation, or a linearisation about currents.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_positive
from fieldmap.core import CoreMap
from fieldmap.core.current_table import CoreTable
from fieldmap.core.iron import CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.core.machine import BodyNumbers, CoupledCoils, Plant
from fieldmap.field import Field, require_affine, require_bounds
from fieldmap.lookup import (
    FieldMap,
    MapSensors,
    interpolate,
    saturates,
    table_of_currents,
    tangent_block,
    unit_block,
)
from fieldmap.lookup.current_solver import COMPILED_TOLERANCE
from fieldmap.lookup.evaluation import MapReaction, core_of
from fieldmap.lookup.iron_response import compiled_currents, inductance_at_zero, tangent_mix
from fieldmap.reaction import IN_WORDS
from fieldmap.records import Record
from fieldmap.store import Grid, MapData, Provenance, StoredLinkage
from fieldmap.typing import Array

SPACING = 5e-3
"""Default distance of the nodes at which a field that is not a map is sampled, m."""
FEWEST_CELLS = 4
EXACT = 1e-9
"""Tolerance of the model of the iron in searches and for slopes by differences."""


@dataclass(frozen=True, eq=False, repr=False)
class FieldOfCurrents(Record):
    """block: coefficients of the fields. Their weights, times the calibration `scale`, follow the currents by the
    `model` of saturating iron, by a `table`, or, without both, in proportion. tolerance: relative error of the
    model's solves, in the energy norm; constant: whether there is a field that no current drives; iron: "linear",
    "linearised", "table" or "model"; remembered: memory of iron with hysteresis at the start of a run, for the C
    core; empty for other iron; loop: size of the loops, A, whose slopes linear models use (`linearise`), None for
    slopes of small changes; reaction: of the iron to magnets; largest: largest current of the model's domain, A;
    sensors: readings of field sensors in these fields, None for a map without sensors; linkage: of the coils, without
    saturating iron, or None if unknown; field_map: the map of this field."""

    block: Array
    assumptions: tuple[str, ...]
    field_map: FieldMap
    scale: float = 1.0
    model: CoreIron | None = None
    table: CoreTable | None = None
    tolerance: float = COMPILED_TOLERANCE
    constant: bool = False
    iron: str = "linear"
    remembered: Array = field(default_factory=lambda: np.zeros(0))
    loop: float | None = None
    largest: float = 0.0
    reaction: MapReaction | None = None
    sensors: MapSensors | None = None
    linkage: StoredLinkage | None = None

    @cached_property
    def map(self) -> CoreMap:
        """The fields for the C core. Every field has a weight."""
        return CoreMap(self.block, 3, False, *core_of(self.reaction))

    def plant(
        self,
        body: BodyNumbers,
        seen_at: Array,
        windings: Array,
        drives: Array,
        search: bool = False,
        coils: Array | None = None,
    ) -> Plant:
        """Body and coils in this field, with a new state of the model of the iron.

        Parameters
        ----------
        body
            Numbers of the body.
        seen_at
            Sensed point in the body (3,), m.
        windings
            Numbers of the windings, from `CoilDrive.numbers`.
        drives
            Numbers of the drives.
        search
            Whether currents are trials of a search or of slopes by differences. The model of the iron is then solved
            to `EXACT`, and iron with hysteresis does not remember the currents.
        coils
            Numbers of coils that linkages couple (n, 15), which replace the windings.

        Returns
        -------
        Plant
            The plant for the C core.
        """
        state = None if self.model is None else self.model.state()
        if state is not None and self.remembered.size:
            state.recall(self.remembered)
        return Plant(
            map=self.map.map,
            body=body,
            seen_at=seen_at,
            scale=self.scale,
            iron=None if state is None else state.state,
            tolerance=EXACT if search else self.tolerance,
            table=None if self.table is None else self.table.table,
            windings=windings,
            drives=drives,
            on_path=int(not search),
            coupled=None if coils is None else CoupledCoils(coils, *self._coupled),
        )

    @property
    def _coupled(self) -> tuple[Array, Array, float]:
        assert self.linkage is not None
        return self.linkage.inductance, self.linkage.constant, self.largest

    def inductance(self) -> Array:
        """Incremental inductances (n, n), H, at zero currents."""
        assert self.linkage is not None
        return self.linkage.inductance if self.model is None else inductance_at_zero(self.field_map)


def sampled_field(field: Field, spacing: float = SPACING) -> FieldMap:
    """A field as a map in memory, which compiled loops can evaluate; a map is returned unchanged.

    The fields and gradients of the coils, and those that no current drives, are computed once at the nodes of a grid
    over the field's box, and interpolated as in a map file.

    Parameters
    ----------
    field
        A sum of the coils' fields and a field that no current drives, with a box.
    spacing
        Largest distance of the nodes, m.

    Returns
    -------
    FieldMap
        The map.

    Raises
    ------
    InputError
        For a field without a box, and for one that is not such a sum, as with saturating iron: make a map of it.
    """
    if isinstance(field, FieldMap):
        return field
    check_positive("sampled_field", spacing=spacing)
    must = "must be the sum of its coils' fields and of one that no current drives, or a map"
    remedy = "make a map of the device with its saturating iron (fieldmap map) and give that"
    check(field.affine, "field", must, f"{type(field).__name__}, which does not superpose", remedy)
    lower, upper = require_bounds(field)
    # The grid is the same as in a map file; the factor allows for rounding.
    cells = np.maximum(np.ceil((upper - lower) / spacing * (1.0 - 1e-9)), FEWEST_CELLS)
    nx, ny, nz = (int(count) + 1 for count in cells)
    grid = Grid(lower, (upper - lower) / cells, (nx, ny, nz))
    points, unit = grid.points(), np.eye(len(field.coil_names))
    if field.proportional:
        flux = [field.field(points, one) for one in unit]
        slope = [field.gradient(points, one) for one in unit]
    else:
        flux = [*np.moveaxis(field.unit_field(points), 1, 0), field.constant_field(points)]
        slope = [*np.moveaxis(field.unit_gradient(points), 1, 0), field.constant_gradient(points)]
    about = f"sampled every {', '.join(f'{1e3 * step:.3g}' for step in grid.spacing)} mm and interpolated"
    data = MapData(
        grid,
        tuple(field.coil_names),
        np.ones(len(unit)),
        Provenance(assumptions=(*field.assumptions, about)),
        fixed_sources=() if field.proportional else ("the field",),
        constant_field=not field.proportional,
        flux_density=np.reshape(flux, (-1, *grid.shape, 3)),
        gradient=np.reshape(slope, (-1, *grid.shape, 3, 3)),
    )
    return interpolate(data, outside_currents="evaluate")


def superposed(field_map: FieldMap, scale: float = 1.0) -> FieldOfCurrents:
    """The field of a map of linear iron.

    Parameters
    ----------
    field_map
        Opened map of linear iron.
    scale
        Calibration factor of the whole field.

    Returns
    -------
    FieldOfCurrents
        The field for simulations.

    Raises
    ------
    InputError
        For a map of saturating iron.
    """
    require_affine(field_map, "superposed")
    return _following(field_map, scale, "linear")


def linearised(
    field_map: FieldMap, currents: ArrayLike, scale: float = 1.0, loop: float | None = None
) -> FieldOfCurrents:
    """The field of a map of saturating iron, linearised about currents: fast, but accurate only near them.

    Parameters
    ----------
    field_map
        Opened map. A map of linear iron is used without change.
    currents
        Currents (n,), A, about which the field is linear.
    scale
        Calibration factor of the whole field.
    loop
        Size of loops, A, whose slopes replace derivatives, as for `FieldMap.by_currents`.

    Returns
    -------
    FieldOfCurrents
        The field for simulations.
    """
    if not saturates(field_map):
        return superposed(field_map, scale)
    amperes = np.asarray(currents, float)
    about = ", ".join(f"{value:.3g}" for value in amperes)
    note = f"saturating iron, linearised about the currents {about} A"
    note += "" if loop is None else f", with slopes of loops of {loop:g} A"
    found = _following(field_map, scale, "linearised", note, tangent_block(field_map, amperes, loop))
    if field_map.sensors is not None:
        found = replace(found, sensors=field_map.sensors.mixed(tangent_mix(field_map, amperes, loop)))
    if found.linkage is None:
        return found
    inductance = field_map.inductance(amperes)
    about_currents = StoredLinkage(inductance, field_map.flux_linkage(amperes) - inductance @ amperes)
    return replace(found, linkage=about_currents)


def modelled(field_map: FieldMap, scale: float = 1.0, loop: float | None = None) -> FieldOfCurrents:
    """The field of a map of saturating iron at any currents, by its model.

    The model is solved at every step at which currents change, starting from the last solves. Solves at currents
    outside the map's domain are allowed and counted.

    Parameters
    ----------
    field_map
        Opened map. A map of linear iron is used without change.
    scale
        Calibration factor of the whole field.
    loop
        Size of loops, A, whose slopes replace derivatives in linear models.

    Returns
    -------
    FieldOfCurrents
        The field for simulations.

    Raises
    ------
    NotConverged
        If the model has no solution in the domain.
    InputError
        For a loop that is not positive.
    """
    if loop is not None:
        check_positive("modelled", loop=loop)
    if not saturates(field_map):
        return superposed(field_map, scale)
    model = CoreIron(core_numbers(compiled_currents(field_map)))
    remembered, which = np.zeros(0), "saturating iron"
    if field_map.remembers:
        remembered = field_map.remembered
        begin = ", ".join(f"{value:.3g}" for value in field_map.last_currents)
        which = f"iron with hysteresis, which remembers what made its state at {begin} A,"
    note = f"{which} by the map's model, solved at every step at which currents change, to "
    note += f"{COMPILED_TOLERANCE:g} of its state"
    found = _following(field_map, scale, "model", note, model=model)
    reduced = field_map.info.reduced_model
    largest = 0.0 if reduced is None else float(np.max(reduced.domain.largest))
    return replace(found, remembered=remembered, loop=loop, largest=largest)


def tabled(
    field_map: FieldMap,
    nodes: tuple[int, int, int] | None = None,
    scale: float = 1.0,
    loop: float | None = None,
) -> FieldOfCurrents:
    """The field of a map of saturating iron over its division (u, x, y), by a table.

    For currents off the division or outside the table, the field is extrapolated with the table's slopes.

    Parameters
    ----------
    field_map
        Opened map of saturating iron over a division.
    nodes
        Numbers of nodes for u, x and y of a new table; by default the table of `open_map(...,
        tabulate_currents=True)` is used.
    scale
        Calibration factor of the whole field.
    loop
        Size of loops, A, whose slopes replace derivatives in linear models.

    Returns
    -------
    FieldOfCurrents
        The field for simulations.

    Raises
    ------
    InputError
        For a map of another domain, or a loop that is not positive.
    """
    if loop is not None:
        check_positive("tabled", loop=loop)
    table = table_of_currents(field_map, nodes)
    states = " x ".join(map(str, table.nodes))
    off = f"{1e6 * table.error.flux_density:.2g} uT and {1e3 * table.error.gradient:.2g} mT/m"
    note = f"saturating iron by a table of {states} states of the division, within {off} of the map's model"
    return replace(_following(field_map, scale, "table", note, table=table.core), loop=loop)


def _following(
    field_map: FieldMap,
    scale: float,
    iron: str,
    note: str = "",
    block: Array | None = None,
    model: CoreIron | None = None,
    table: CoreTable | None = None,
) -> FieldOfCurrents:
    """The field of a map. block: coefficients, by default those of the map; note: assumption about the iron."""
    check_positive("FieldOfCurrents", scale=scale)
    calibration = "" if scale == 1.0 else f"field of the map times {scale:g}, a calibration"
    reaction = (
        f"{IN_WORDS}: {'left out' if field_map.reaction is None else 'in'}" if field_map.has_iron else ""
    )
    return FieldOfCurrents(
        unit_block(field_map) if block is None else block,
        tuple(text for text in (note, calibration, reaction) if text),
        field_map,
        scale,
        model,
        table,
        constant=bool(field_map.fixed_sources),
        iron=iron,
        reaction=field_map.reaction,
        sensors=field_map.sensors,
        linkage=None if table is not None else field_map.linkage,
    )
