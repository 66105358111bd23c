"""What a command's first argument means: a device (file or shipped name) or a map file."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.cli.assumptions import beyond_saturation_warnings
from fieldmap.cli.iron import IronChoice, States, require_iron, solve_device
from fieldmap.device.model import Device, Driver, Payload
from fieldmap.errors import InputError, MapFileError, Problem
from fieldmap.typing import Array

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MAP_SUFFIXES = {".h5", ".hdf5"}


@dataclass(frozen=True, eq=False)
class Source:
    """A device or a map, read and checked, before any long work: what arguments can be held against.

    corners: the box in which the field may be searched, or None. open(currents): the field, and what it assumes;
    it holds for any currents unless the iron is nonlinear. states: a device's nonlinear states, one by one.
    warnings(field, currents): what is wrong with an opened field at currents; `open` appends it where it has currents.
    """

    name: str
    device_name: str
    kind: str
    coil_names: tuple[str, ...]
    payload: Payload | None
    driver: Driver | None
    corners: tuple[Array, Array] | None
    open: Callable[[Array | None], tuple[Any, tuple[str, ...]]]
    states: States | None = None
    warnings: Callable[[Any, Array], tuple[str, ...]] = lambda field, currents: ()


def refuse_directory(name: str) -> None:
    """A file may be missing (the reader says so), but a directory is a slip of the hand."""
    if Path(name).is_dir():
        raise InputError(Problem(name, "must be a file", "a directory", "name the file inside it"))


def is_map(name: str) -> bool:
    """Whether the argument names a map file rather than a device."""
    refuse_directory(name)
    path = Path(name)
    if path.suffix.lower() in _MAP_SUFFIXES:
        return True
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(_HDF5_SIGNATURE)) == _HDF5_SIGNATURE


def check_map_path(name: str) -> Path:
    """The path of an existing file that claims to be a map."""
    path = Path(name)
    if not is_map(name):
        received = "no such file" if not path.exists() else "a file that is not HDF5"
        raise MapFileError(
            Problem(
                name, "must be a map file made by `fieldmap map`", received, "make one: fieldmap map RECIPE"
            )
        )
    if not path.is_file():
        remedy = "check the name, or make the map: fieldmap map RECIPE"
        raise MapFileError(Problem(name, "must be an existing file", "no such file", remedy))
    return path


def open_device(name: str) -> Device:
    """The device of a file or a shipped name."""
    from fieldmap.device import read_device

    if is_map(name):
        raise InputError(
            Problem(name, "must be a device file or the name of a shipped device", "a map", "name its device")
        )
    return read_device(name)


def workspace_corners(device: Device) -> tuple[Array, Array] | None:
    """Corners (3,) of the axis-parallel box around the workspace, m, or None where the device names none."""
    return device.bounds


def recorded_payload(text: str) -> Payload | None:
    """The payload in the text of a device file, as a map records it; None where there is none."""
    if not text:
        return None
    from fieldmap.device.schema import DeviceFile

    keys = DeviceFile.model_validate(tomllib.loads(text)).payload
    return None if keys is None else keys.to_model()


def recorded_driver(text: str) -> Driver | None:
    """The driver in the text of a device file; None where there is none."""
    if not text:
        return None
    from fieldmap.device.schema import DeviceFile

    keys = DeviceFile.model_validate(tomllib.loads(text)).driver
    return None if keys is None else keys.to_model()


def find_source(name: str, choice: IronChoice) -> Source:
    """The map or device of this name. `open` solves a device; a map's iron is what it was made with."""
    if is_map(name):
        return _map_source(name, choice)
    device = open_device(name)
    corners = workspace_corners(device)
    about = (device.coil_names, device.payload, device.driver, corners)
    if choice.nonlinear:
        require_iron(device)
        states = States(device, choice)
        return Source(
            device.name,
            device.name,
            "device, nonlinear iron",
            *about,
            lambda i: _state(device, states, i),
            states,
        )

    def solved(currents: Array | None) -> tuple[Any, tuple[str, ...]]:
        solution = solve_device(device, choice)
        assumptions = tuple(solution.report.assumptions)
        return solution, assumptions if currents is None else (*assumptions, *warnings(solution, currents))

    def warnings(solution: Any, currents: Array) -> tuple[str, ...]:
        return beyond_saturation_warnings(solution, device, currents)

    return Source(device.name, device.name, "device, linear iron", *about, solved, warnings=warnings)


def _state(device: Device, states: States, currents: Array | None) -> tuple[Any, tuple[str, ...]]:
    from fieldmap.cli.report_text import state_notes
    from fieldmap.field import as_field

    state = states(np.asarray(currents, dtype=float))
    return as_field(state), state_notes(state.report, device)


def _map_source(name: str, choice: IronChoice) -> Source:
    from fieldmap.lookup import open_map

    path = check_map_path(name)
    if choice.given:
        remedy = "leave it out, or name a device"
        where = ", ".join(choice.given)
        raise InputError(Problem(where, "must go with a device", "a map, whose iron is fixed", remedy))
    opened = open_map(path)
    record = opened.info.provenance
    assumptions = tuple(record.assumptions)
    corners = (np.asarray(opened.lower), np.asarray(opened.upper))
    payload = recorded_payload(record.device_text)
    about = (opened.coil_names, payload, recorded_driver(record.device_text), corners)
    return Source(path.name, record.device_name, "map", *about, lambda currents: (opened, assumptions))
