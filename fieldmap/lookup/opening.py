"""From a map file, or a map in memory, to something that can be asked for a field."""

from os import PathLike

from fieldmap.lookup.choices import check_choices
from fieldmap.lookup.field_map import FieldMap
from fieldmap.store import MapData, read_map


def open_map(
    path: str | PathLike[str],
    kind: str = "harmonic",
    outside: str = "raise",
    threads: int | None = None,
    outside_currents: str = "raise",
    follow_currents: bool = False,
    tabulate_currents: bool = False,
) -> FieldMap:
    """Read and check the map file at `path` and make it ready for lookups.

    kind: "harmonic", one harmonic polynomial per cell; "hermite", the tricubic Hermite interpolant, continuous
    from cell to cell; "global", one polynomial for the whole box (docs/lookup.md: which to take when). outside: what
    a point outside the map's box gives, "raise" (OutsideMapError), "nan", or "clamp" (the nearest point of the box).
    threads: for large batches, by default one per processor. outside_currents: what currents beyond the domain of a
    map of saturating iron give, "raise" (OutsideMapError), "nan", or "evaluate", without a statement of the error
    there. follow_currents: of such a map, begin each change of the currents from the last, which is quicker along a
    trajectory; results then depend on earlier calls, by 1e-6 at most. tabulate_currents: of such a map over a current
    division, tabulate the model once, which takes seconds; any change of the currents then costs microseconds, also
    from compiled code, and `current_table.error` says how far the table is from the model. Raises MapFileError if the
    file is no complete, undamaged map and InputError for an unknown kind or outside rule, if no single polynomial
    holds the map ("global"), or if there is nothing to tabulate.

    >>> m = open_map("maps/out/workspace.h5")                                     # doctest: +SKIP
    >>> m.field([0, 0, -0.09], currents=[1, 1, 1, 1, 1, 1])                       # doctest: +SKIP
    """
    check_choices(kind, outside, outside_currents)
    rules = outside_currents, follow_currents, tabulate_currents
    return interpolate(read_map(path), kind, outside, threads, *rules)


def interpolate(
    data: MapData,
    kind: str = "harmonic",
    outside: str = "raise",
    threads: int | None = None,
    outside_currents: str = "raise",
    follow_currents: bool = False,
    tabulate_currents: bool = False,
) -> FieldMap:
    """A map in memory made ready for lookups; arguments as in `open_map`."""
    return FieldMap(data, outside, kind, threads, outside_currents, follow_currents, tabulate_currents)
