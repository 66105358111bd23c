"""Which rows there are, and the function that computes each part of them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from fieldmap.curves import Curves
from fieldmap.errors import InputError, Problem

PARTS = {
    "S3": "fieldmap.thesis.magnet:sphere_and_microrobot",
    "S4_windings": "fieldmap.thesis.single_electromagnet:windings",
    "S4_levitation": "fieldmap.thesis.single_electromagnet:levitation",
    "S5_current_ratio": "fieldmap.thesis.planar_unit:current_ratio",
    "S5_depth": "fieldmap.thesis.planar_unit:depth",
    "S5_gradients": "fieldmap.thesis.planar_unit:gradients",
    "S5_zeros": "fieldmap.thesis.planar_unit:zeros",
    "S6": "fieldmap.thesis.magnet:lumped_model",
    "S7": "fieldmap.thesis.instruments:sensor_frames",
    "S8_converter": "fieldmap.thesis.instruments:converter",
    "S8_error_budget": "fieldmap.thesis.instruments:readings",
    "S8_sensor_and_amplifier": "fieldmap.thesis.instruments:sensor_and_amplifier",
    "S9_constants": "fieldmap.thesis.planar_force:constants",
    "S9_superposition": "fieldmap.thesis.planar_force:superposition",
    "S10": "fieldmap.thesis.spatial_force:constants",
    "S11": "fieldmap.thesis.statics:coils",
    "S12": "fieldmap.thesis.statics:levitation_current",
    "S13": "fieldmap.thesis.statics:division",
    "S13_field": "fieldmap.thesis.statics:directions",
    "S14_table_6_2": "fieldmap.thesis.equilibrium_shift:n_table",
    "S14_table_6_3": "fieldmap.thesis.equilibrium_shift:height_table",
    "S14_x_branches": "fieldmap.thesis.equilibrium_shift:x_branches",
    "S14_y_branches": "fieldmap.thesis.equilibrium_shift:y_branches",
    "S14_x_remanence": "fieldmap.thesis.hysteresis:x_remanence",
    "S14_y_remanence": "fieldmap.thesis.hysteresis:y_remanence",
    "S14_fits": "fieldmap.thesis.shift_studies:fits",
    "S14_limits": "fieldmap.thesis.shift_studies:limits",
    "S14_convergence": "fieldmap.thesis.shift_studies:convergence",
    "S14_magnet_models": "fieldmap.thesis.shift_studies:magnet_models",
    "S14_own_current": "fieldmap.thesis.shift_studies:own_current",
    "S14_noise": "fieldmap.thesis.shift_studies:noise",
    "S14_calibration": "fieldmap.thesis.calibration:calibrations",
    "S15": "fieldmap.thesis.workspace:ranges",
    "S16_controller": "fieldmap.thesis.vertical:controller",
    "S16_closed_loop": "fieldmap.thesis.vertical:step_response",
    "S16_recovery": "fieldmap.thesis.vertical:recovery",
    "S16_root_locus": "fieldmap.thesis.vertical:locus",
    "S16_times_in_minutes": "fieldmap.thesis.vertical:minutes",
    "S16_records": "fieldmap.thesis.vertical_records:records",
    "S16_map_plant": "fieldmap.thesis.map_plants:vertical",
    "S17_arithmetic": "fieldmap.thesis.horizontal:arithmetic",
    "S17_recovery": "fieldmap.thesis.horizontal:recovery",
    "S17_records": "fieldmap.thesis.horizontal:records",
    "S17_map_plant": "fieldmap.thesis.map_plants:horizontal",
    "S18_vertical": "fieldmap.thesis.coupled_loop:vertical",
    "S18_horizontal": "fieldmap.thesis.coupled_loop:horizontal",
    "S18_combined": "fieldmap.thesis.coupled_loop:combined",
    "S18_spikes": "fieldmap.thesis.coupled_loop:spikes",
    "S18_sway": "fieldmap.thesis.coupled_sideways:sway",
    "S18_proportional": "fieldmap.thesis.coupled_sideways:proportional",
    "S18_range": "fieldmap.thesis.coupled_sideways:ranges",
    "S18_regulator": "fieldmap.thesis.coupled_regulator:regulator",
    "S18_heights": "fieldmap.thesis.coupled_regulator:heights",
    "S19": "fieldmap.thesis.trajectories:circles",
    "S20_models": "fieldmap.thesis.regulator:models",
    "S20_closed_loop": "fieldmap.thesis.regulator:closed_loop",
}
"""Part -> module:function. A part is a row, or a row and what of it: "S16_controller". Its data is thesis/PART.toml.

The function takes the inputs of the data file, name -> number or array in the units of the file, and returns the
name of every printed number -> our number (an array for a table), or `Ours` where something is assumed; or `Answers`,
which hold that and figures and explanations besides. Where the data file says `map = "division"`, inputs["map"] is
that recipe's map, opened.
"""
ROWS = {
    "S1": "field of a loop, a solenoid and a thick coil",
    "S2": "force and torque on a dipole and on a finite magnet",
    "S3": "dipole moment; data of the sphere and of the microrobot",
    "S4": "single electromagnet with an iron core",
    "S5": "drive unit in two dimensions",
    "S6": "lumped levitation model",
    "S7": "frames and transform of the position sensors",
    "S8": "measuring and driving chain",
    "S9": "analytic force formulas in two dimensions",
    "S10": "analytic force formulas in three dimensions",
    "S11": "drive unit in three dimensions: field and gradient of its coils",
    "S12": "levitation current over depth",
    "S13": "current division",
    "S14": "equilibrium shift in three dimensions",
    "S15": "workspace and saturation of the amplifiers",
    "S16": "vertical plant and its controller, identified",
    "S17": "horizontal plants and their controllers, identified",
    "S18": "closed loop of three axes on the map",
    "S19": "trajectories",
    "S20": "linear-quadratic regulator and Kalman estimator",
    "S21": "what the thesis recommends next",
}
"""Every system of the thesis, whether or not it has parts yet."""
WITHOUT_PRINTED_NUMBERS = {
    "S1": "formulas (2-1) to (2-6) only; tests/sources holds ours against closed forms, quadrature and magpylib",
    "S2": "formulas (2-7) to (2-11) only; tests/lookup and tests/levitation hold ours against closed forms",
}
"""Rows in which the thesis prints nothing to compare, and where they are judged."""


@dataclass(frozen=True)
class Ours:
    """Our number or array, and what it rests on."""

    value: Any
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Answers:
    """What a part computes, where it is more than numbers.

    numbers: name of every printed number -> our number or `Ours`. curves: figures. explanations: name of a printed
    number, or "" for the whole part -> why ours differs, in words; added to what the data file explains.
    """

    numbers: Mapping[str, Any]
    curves: tuple[Curves, ...] = ()
    explanations: Mapping[str, str] = field(default_factory=dict)


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


def function_of(part: str) -> Callable[[dict[str, Any]], Answers | Mapping[str, Any]]:
    """The function that computes a part."""
    module, _, name = PARTS[part].partition(":")
    return getattr(import_module(module), name)
