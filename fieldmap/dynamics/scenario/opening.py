"""Map and device of a scenario, and where in the map it begins."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldmap.device import Device, read_device, recorded_device
from fieldmap.dynamics.drives import drive_of_device
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.scenario.allocation import starting_currents
from fieldmap.dynamics.scenario.reader import Scenario
from fieldmap.errors import Infeasible
from fieldmap.lookup import FieldMap, open_map
from fieldmap.shipped import shipped_file
from fieldmap.typing import Array

MILLI = 1e-3

# Share of what amplifiers and supply give for long that a start chosen by the program takes; the rest is for control.
_EASY = 0.5
# Heights of the map at which that is tried.
_HEIGHTS = 21


def device_and_map(scenario: Scenario, field_map: FieldMap | None) -> tuple[Device, FieldMap]:
    """The device, the map's own unless one is named, and the opened map. Raises ScenarioError, MapFileError."""
    named = scenario.contents.device
    device = None if named is None else read_device(_beside(scenario, named))
    opened = (
        field_map if field_map is not None else open_map(_map_path(scenario), outside_currents="evaluate")
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


def magnet_at(scenario: Scenario, opened: FieldMap, body: RigidBody) -> Array:
    """The magnet's centre (3,) of the upright body at the start, m."""
    contents = scenario.contents
    z = -MILLI * (contents.sensors.zero_depth_mm + scenario.start_depth_mm) - _above(body)
    point = np.array([MILLI * (contents.start.x_mm or 0.0), MILLI * (contents.start.y_mm or 0.0), z])
    if not (opened.lower <= point).all() or not (point <= opened.upper).all():
        received = f"the magnet at {[round(1e3 * float(p), 3) for p in point]} mm"
        corners = " to ".join(
            str([round(1e3 * float(v), 3) for v in c]) for c in (opened.lower, opened.upper)
        )
        must = f"must be inside the map, {corners} mm"
        raise scenario.error("start", must, received, "begin elsewhere, or make a larger map")
    return point


def with_depth(scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody) -> Scenario:
    """The scenario with the depth of its start: the given one, or that of the middle of the map, or of the place next
    to it at which half of what amplifiers and supply give carries the body, with its moment along the field if it may
    turn; where there is none, of the place that takes the least, and the middle where nothing lifts."""
    if scenario.contents.start.depth_mm is not None:
        return scenario
    middle = 0.5 * float(opened.lower[2] + opened.upper[2])
    room = 0.05 * (opened.upper[2] - opened.lower[2])
    heights = np.linspace(opened.lower[2] + room, opened.upper[2] - room, _HEIGHTS)
    low, high = drive_of_device(device, scenario.contents.coils.lowest_voltage_V).steady
    chosen, least = _begun(scenario, middle, body), np.inf
    for height in sorted(heights, key=lambda z: abs(z - middle)):
        there = _begun(scenario, float(height), body)
        point = magnet_at(there, opened, body)
        try:
            currents, _ = starting_currents(there, device, opened, body, point)
        except Infeasible:
            continue
        along = float(opened.field(point, currents) @ body.magnet.moments.sum(axis=0)) > 0.0
        limit = np.where(currents > 0.0, high, -low)
        share = float(np.max(np.abs(currents) / np.maximum(limit, 1e-12)))
        if share < least and (along or body.upright):
            chosen, least = there, share
        if least <= _EASY:
            break
    return chosen


def _begun(scenario: Scenario, height: float, body: RigidBody) -> Scenario:
    """The scenario that begins with its magnet at a height, m."""
    contents = scenario.contents
    depth = -1e3 * (height + _above(body)) - contents.sensors.zero_depth_mm
    start = contents.start.model_copy(update={"depth_mm": round(depth, 6)})
    return replace(scenario, contents=contents.model_copy(update={"start": start}))


def _above(body: RigidBody) -> float:
    """Height of the sensed point above the magnet's centre, m."""
    return float((body.seen_at - body.magnet_at)[2])


def _beside(scenario: Scenario, name: str) -> str | Path:
    beside = scenario.path.parent / name
    if beside.is_file():
        return beside
    shipped = shipped_file("geometry", name)
    if shipped is not None:
        return shipped
    # Of a shipped scenario, given on the command line.
    if Path(name).is_file():
        return Path(name)
    must = "a file relative to the scenario, or the name of a shipped one"
    raise scenario.error("device", must, f'"{name}"', "correct the name")


def _map_path(scenario: Scenario) -> Path:
    """The map: relative to the scenario, as given, or by its name in maps/out."""
    name = scenario.contents.map
    folder = Path("maps") / "out"
    for path in (scenario.path.parent / name, Path(name), folder / name, folder / f"{name}.h5"):
        if path.is_file():
            return path
    must = "must be a map file relative to the scenario, or the name of one in maps/out"
    raise scenario.error("map", must, f'"{name}"', f"make it: fieldmap map {Path(name).stem}, or give --map")
