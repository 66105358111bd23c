"""Field sensors, calibration curves and controllers for C programs: constants for the headers of the C core."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fieldmap.errors import InputError
from fieldmap.instruments import CalibrationCurve
from fieldmap.interop.c_map import c_identifier, check_harmonic, header_beside, map_bytes
from fieldmap.lookup import FieldMap
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array, PathLike

if TYPE_CHECKING:
    from fieldmap.control import ControllerBlock
    from fieldmap.dynamics.coupled import ScheduledController


def write_c_curve(curve: CalibrationCurve, path: PathLike) -> tuple[Path, Path]:
    """Write a calibration curve as a C header of constants, with calibration_curve.h, which evaluates it.

    The constant has the name of the file. It is double, or float if the program is compiled with
    -DFIELDMAP_REAL=float. Neither header calls a library.

    Parameters
    ----------
    curve
        The curve.
    path
        Path of the header.

    Returns
    -------
    tuple[Path, Path]
        Paths of both headers.

    Examples
    --------
    >>> write_c_curve(calibrate(m, magnet), "hall.h")                                       # doctest: +SKIP
    """
    target = Path(path)
    name = c_identifier(target.stem, "curve")
    arrays = {each: getattr(curve, each) for each in ("per_ampere", "readings", "heights", "slopes")}
    text = "".join(_array(f"{name}_{each}", values) for each, values in arrays.items())
    names = ", ".join(f"{name}_{each}" for each in arrays)
    write_whole(
        target,
        f"""/* The height of a magnet from field sensor "{curve.sensor}", written by fieldmap:
 * fieldmap_height_of_reading(&{name}, reading, currents). */
#include "calibration_curve.h"

{text}static const fieldmap_calibration_curve {name} = {{
    {len(curve.readings)}, {len(curve.per_ampere)}, {_number(curve.constant)}, {names}
}};
""",
        "C header",
    )
    return target, header_beside(target, "calibration_curve.h")


def write_c_controller(
    controller: ControllerBlock | ScheduledController, path: PathLike
) -> tuple[Path, Path]:
    """Write a controller as a C header of constants, with controller.h, which runs it.

    The constants are NAME, a fieldmap_controller, and NAME_memory, its initial memory, with the name of the file.
    They are double, or float if the program is compiled with -DFIELDMAP_REAL=float.

    Parameters
    ----------
    controller
        A block, for example from `pid_block` or `lqg_block`, or scheduled blocks.
    path
        Path of the header.

    Returns
    -------
    tuple[Path, Path]
        Paths of both headers.

    Examples
    --------
    >>> write_c_controller(pid_block(pid, AxisReading("z")), "pid.h")                       # doctest: +SKIP
    """
    target, block = Path(path), controller.arrays
    name, (first, step, signal) = c_identifier(target.stem, "controller"), block.nodes
    arrays = {each: np.ravel(getattr(block, each)) for each in (*"ABCDEF", "lower", "upper")}
    text = "".join(_array(f"{name}_{each}", values) for each, values in arrays.items())
    count, states, _ = block.A.shape
    numbers = f"{count}, {states}, {controller.outputs}, {int(signal)}, {_number(first)}, {_number(step)}"
    names = ", ".join(f"{name}_{each}" for each in (*arrays, "hold"))
    text += _array(f"{name}_memory", controller.memory)
    text += f"static const int64_t {name}_hold[] = {{{', '.join(map(str, block.hold))}}};\n"
    write_whole(
        target,
        f"""/* A controller, written by fieldmap: fieldmap_control(&{name}, ...) runs it from {name}_memory on. */
#include "controller.h"

{text}static const fieldmap_controller {name} = {{
    {numbers},
    {names}
}};
""",
        "C header",
    )
    return target, header_beside(target, "controller.h")


def write_c_sensors(field_map: FieldMap, path: PathLike) -> tuple[Path, ...]:
    """Write the field sensors of a map as a C header of constants, and the iron's reaction to them as a map for C.

    A program reads them by field_sensors.h of the C core (docs/c.md). The constants have the name of the file.

    Parameters
    ----------
    field_map
        A harmonic map with field sensors.
    path
        Path of the header; the map of the reaction has the same name with the suffix .fmap.

    Returns
    -------
    tuple[Path, ...]
        Paths of the header, and of the map if the device has iron.

    Raises
    ------
    InputError
        For a map without field sensors, and for a Hermite form.

    Examples
    --------
    >>> write_c_sensors(m, "sensors.h")                                                     # doctest: +SKIP
    """
    sensors = field_map.sensors
    if sensors is None:
        remedy = "give the device [[sensor]] tables and make the map with this version"
        raise InputError.of("write_c_sensors, field_map", "a map with field sensors", "a map without", remedy)
    target, core, written = Path(path), sensors.core, []
    name, count = c_identifier(target.stem, "sensors"), len(sensors.names)
    if sensors.answers is not None:
        block = sensors.answers.core.block
        check_harmonic(block, "write_c_sensors, field_map")
        written.append(
            write_whole(target.with_suffix(".fmap"), map_bytes(block, sensors.names, False), "map for C")
        )
    rows = ",\n".join(f"    {{{{{_row(row[:3])}}}, {{{_row(row[3:])}}}}}" for row in core.places)
    text = f"""/* Field sensors, written by fieldmap: {", ".join(sensors.names)}.
 * Set .answers of a copy to the map beside this file. */
#include "field_sensors.h"

static const fieldmap_field_sensor {name}_places[{count}] = {{
{rows}
}};
{_array(f"{name}_shares", core.shares.ravel())}
static const fieldmap_field_sensors {name} = {{{count}, {name}_places, {name}_shares, NULL}};
"""
    return write_whole(target, text, "C header"), *written


def _array(name: str, values: Array) -> str:
    return f"static const fm_real {name}[{len(values)}] = {{{_row(values)}}};\n"


def _row(values: Array) -> str:
    return ", ".join(map(_number, values))


def _number(value: float) -> str:
    """A constant that reads back to the same bits in double precision, and is rounded in float."""
    if np.isinf(value):
        return "FM(INFINITY)" if value > 0.0 else "FM(-INFINITY)"
    return f"FM({np.format_float_scientific(value, unique=True, trim='0')})"
