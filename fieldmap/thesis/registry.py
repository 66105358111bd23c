"""Which rows there are, and the function that computes each part of them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from fieldmap.errors import InputError, Problem

PARTS = {
    "S3": "fieldmap.thesis.magnets:sphere_and_microrobot",
    "S4_windings": "fieldmap.thesis.single_electromagnet:windings",
    "S4_levitation": "fieldmap.thesis.single_electromagnet:levitation",
    "S5_current_ratio": "fieldmap.thesis.planar_unit:current_ratio",
    "S5_depth": "fieldmap.thesis.planar_unit:depth",
    "S5_gradients": "fieldmap.thesis.planar_unit:gradients",
    "S5_zeros": "fieldmap.thesis.planar_unit:zeros",
    "S6": "fieldmap.thesis.lumped:lumped_model",
    "S7": "fieldmap.thesis.sensing:sensor_frames",
    "S8_converter": "fieldmap.thesis.sensing:converter",
    "S8_error_budget": "fieldmap.thesis.sensing:readings",
    "S8_sensor_and_amplifier": "fieldmap.thesis.sensing:sensor_and_amplifier",
    "S9_constants": "fieldmap.thesis.planar_force:constants",
    "S9_superposition": "fieldmap.thesis.planar_force:superposition",
    "S10": "fieldmap.thesis.spatial_force:constants",
    "S16_controller": "fieldmap.thesis.vertical:controller",
    "S16_closed_loop": "fieldmap.thesis.vertical:closed_loop",
    "S16_recovery": "fieldmap.thesis.identification:recovery",
    "S16_root_locus": "fieldmap.thesis.identification:locus",
    "S16_times_in_minutes": "fieldmap.thesis.identification:minutes",
    "S16_map_plant": "fieldmap.thesis.map_plants:vertical",
    "S17_arithmetic": "fieldmap.thesis.horizontal:arithmetic",
    "S17_recovery": "fieldmap.thesis.identification:horizontal_recovery",
    "S17_map_plant": "fieldmap.thesis.map_plants:horizontal",
    "S20_models": "fieldmap.thesis.optimal:models",
    "S20_closed_loop": "fieldmap.thesis.optimal:closed_loop",
}
"""Part -> module:function. A part is a row, or a row and what of it: "S16_controller". Its data is thesis/PART.toml.

The function takes the inputs of the data file, name -> number or array in the units of the file, and returns the
name of every printed number -> our number (an array for a table), or `Ours` where something is assumed.
"""


@dataclass(frozen=True)
class Ours:
    """Our number or array, and what it rests on."""

    value: Any
    assumptions: tuple[str, ...] = ()


def row_of(part: str) -> str:
    """The row of a part.

    >>> row_of("S16_controller")
    'S16'
    """
    return part.partition("_")[0]


def row_names() -> list[str]:
    """The rows that can be asked for, in the order of their numbers."""
    return sorted({row_of(part) for part in PARTS}, key=lambda row: int(row[1:]))


def parts_of(rows: Iterable[str]) -> list[str]:
    """The parts of these rows, in order; of all rows if none is given. Raises InputError for unknown rows."""
    wanted = [row.upper() for row in rows]
    known = row_names()
    problems = [
        Problem(
            "thesis", f"must be a row of {', '.join(known)}", row, "leave the rows out to see all of them"
        )
        for row in wanted
        if row not in known
    ]
    if problems:
        raise InputError(*problems)
    return [part for row in known for part in PARTS if row_of(part) == row and (not wanted or row in wanted)]


def function_of(part: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """The function that computes a part."""
    module, _, name = PARTS[part].partition(":")
    return getattr(import_module(module), name)
