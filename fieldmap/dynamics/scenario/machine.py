"""Map, device and machine of a scenario: field, body, coils, sensors, surroundings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldmap.device import Device, read_device, recorded_device
from fieldmap.dynamics.allocation import ControlAllocation
from fieldmap.dynamics.drives import drive_of_device
from fieldmap.dynamics.field_of_currents import FieldOfCurrents, sampled_field
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.rigid_body import RigidBody, body_of_payload
from fieldmap.dynamics.scenario.reading import Scenario
from fieldmap.dynamics.sensors import Sensors
from fieldmap.dynamics.surroundings import Drag, Plate, Walls
from fieldmap.field import Field
from fieldmap.instruments import Amplifier, Converter, Micrometer, Rig, SensorFrame
from fieldmap.lookup import FieldMap, magnetic_body, open_map
from fieldmap.shipped import is_file, shipped_file

MILLI = 1e-3


def device_and_map(
    scenario: Scenario, field: Field | None, device: Device | None = None
) -> tuple[Device, FieldMap]:
    """The device, the map's own unless one is given or named, and the opened map, or one of the given field. Raises
    ScenarioError, MapFileError, InputError."""
    named = scenario.contents.device
    if device is None and named is not None:
        device = read_device(_beside(scenario, named))
    opened = (
        sampled_field(field)
        if field is not None
        else open_map(_map_path(scenario), outside_currents="evaluate")
    )
    if device is None:
        text = opened.info.provenance.device_text
        if not text:
            must = "must be named where the map does not record one"
            raise scenario.error("device", must, "none", 'add device = "FILE.toml"')
        device = recorded_device(text)
    for table, there in (("payload", device.payload), ("driver", device.driver)):
        if there is None:
            remedy = f"add [{table}] to the device file"
            if named is None:
                remedy += ", which the map recorded as it was, and name the file: --set device=FILE.toml"
            raise scenario.error("device", f"must have a [{table}]", "none", remedy)
    if len(opened.coil_names) != len(device.coils):
        must = f"must be a map of the device's {len(device.coils)} coils"
        received = f"{len(opened.coil_names)} coils"
        raise scenario.error("map", must, received, "name the device that the map was made of, or none")
    return device, opened


def _beside(scenario: Scenario, name: str) -> str | Path:
    beside = scenario.path.parent / name
    if is_file(beside):
        return beside
    shipped = shipped_file("geometry", name)
    if shipped is not None:
        return shipped
    # Of a shipped scenario, given on the command line.
    if is_file(name):
        return Path(name)
    must = "a file relative to the scenario, or the name of a shipped one"
    raise scenario.error("device", must, f'"{name}"', "correct the name")


def _map_path(scenario: Scenario) -> Path:
    """The map: relative to the scenario, as given, or by its name in maps/out."""
    name = scenario.contents.map
    folder = Path("maps") / "out"
    for path in (scenario.path.parent / name, Path(name), folder / name, folder / f"{name}.h5"):
        if is_file(path):
            return path
    must = "must be a map file relative to the scenario, or the name of one in maps/out"
    raise scenario.error("map", must, f'"{name}"', f"make it: fieldmap map {Path(name).stem}, or give --map")


def body_of(scenario: Scenario, device: Device, opened: FieldMap) -> RigidBody:
    """The body of [body] around the device's magnet."""
    keys, payload = scenario.contents.body, device.payload
    assert payload is not None
    if keys.magnet_offset_mm is not None:
        payload = replace(payload, magnet_offset=MILLI * keys.magnet_offset_mm)
    magnet = None
    if keys.finite_magnet:
        if payload.magnet is None and not payload.pieces:
            raise scenario.error(
                "body.finite_magnet", "needs a magnet", "a moment only", "add payload.magnet"
            )
        magnet = magnetic_body(payload, field=opened.at(np.ones(len(opened.coil_names))), tolerance=1e-4)
    lengths = (keys.radius_mm, keys.height_mm, keys.below_mm)
    radius, height, below = (None if value is None else MILLI * value for value in lengths)
    return body_of_payload(
        payload,
        radius=radius,
        height=height,
        below=below,
        centre_of_mass=MILLI * keys.centre_of_mass_mm,
        magnet=magnet,
        upright=keys.turning == "upright",
    )


def machine_of(
    scenario: Scenario,
    device: Device,
    body: RigidBody,
    field: FieldOfCurrents,
    allocation: ControlAllocation,
) -> Machine:
    """Everything but the controllers."""
    contents = scenario.contents
    keys, walls = contents.coils, contents.walls
    converter = None if keys.output_bits is None else Converter(keys.output_range_V, keys.output_bits)
    drive = drive_of_device(
        device, keys.lowest_voltage_V, time_constant=MILLI * keys.time_constant_ms, converter=converter
    )
    drive = replace(drive, amplifier=replace(drive.amplifier, deviation=keys.noise_A))
    if not keys.dynamics:
        drive = replace(drive, resistance=None, inductance=None)
    drag, plate = contents.drag, contents.plate
    return Machine(
        field,
        body,
        drive,
        _sensors(scenario),
        allocation,
        Drag(
            tuple(drag.linear_N_s_per_m),  # type: ignore[arg-type]
            tuple(drag.body_linear_N_s_per_m),  # type: ignore[arg-type]
            tuple(drag.body_quadratic_N_s2_per_m2),  # type: ignore[arg-type]
            tuple(drag.turning_N_m_s),  # type: ignore[arg-type]
        ),
        None
        if plate is None
        else Plate(
            plate.conductivity_S_per_m,
            MILLI * plate.thickness_mm,
            tuple(MILLI * v for v in plate.face_mm),  # type: ignore[arg-type]
            tuple(plate.normal),  # type: ignore[arg-type]
        ),
        None if walls is None else _walls(scenario),
        (*(() if walls is None else walls.end), *(("currents",) if keys.end_beyond_table else ())),
        keys.longest_saturation_s,
    )


def _walls(scenario: Scenario) -> Walls:
    keys = scenario.contents.walls
    assert keys is not None
    floor, ceiling, radius = (
        None if value is None else MILLI * value
        for value in (keys.floor_mm, keys.ceiling_mm, keys.tube_radius_mm)
    )
    return Walls(floor, ceiling, radius, restitution=keys.restitution, friction=keys.friction)


def _sensors(scenario: Scenario) -> Sensors:
    keys = scenario.contents.sensors
    frame = SensorFrame(np.deg2rad(keys.angle_deg), offset=0.0) if keys.angle_deg else None
    rig = None
    if keys.input_bits is not None or keys.step_mm:
        converter = Converter(keys.input_range_V, keys.input_bits or 48, keys.input_noise_V)
        scale = MILLI * keys.mm_per_V
        micrometer = Micrometer(0.0, scale, voltage_step=keys.step_mm / keys.mm_per_V, lower=-1e3, upper=1e3)
        rig = Rig(micrometer, converter, converter, Amplifier(1.0))
    deviations = tuple(MILLI * value for value in keys.deviation_mm)
    return Sensors(
        frame,
        MILLI * scenario.zero_depth_mm,
        deviations,  # type: ignore[arg-type]
        (rig, rig, rig),
        keys.input_noise_V,
        keys.scan_rate_Hz,
        keys.averages
        if isinstance(keys.averages, int)
        else (keys.averages[0], keys.averages[1], keys.averages[2]),
        keys.latency_scans,
        keys.deviation_averages,
    )
