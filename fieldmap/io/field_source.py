"""From a name to a field: the file is read and checked before anything is solved."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fieldmap.device import read_device, recorded_device
from fieldmap.device.model import Device, Driver, Payload
from fieldmap.errors import InputError, MapFileError
from fieldmap.field import AnyField, Bounds, Currents, Field, as_field, coil_currents
from fieldmap.records import Record
from fieldmap.shipped import is_file, shipped_alone
from fieldmap.store import map_path
from fieldmap.store.field_mesh import is_hdf5
from fieldmap.typing import Array, PathLike, Progress

if TYPE_CHECKING:
    from fieldmap.iron import LinearSolution, NonlinearSolver

_MAP_SUFFIXES = {".h5", ".hdf5"}


@dataclass(frozen=True, repr=False)
class IronOptions(Record):
    """How the iron of a device is solved.

    mu_r: one relative permeability for all iron; None for the permeabilities of the file. nonlinear: iron that
    saturates, with one state for each set of currents. refinement divides the mesh sizes of the file. form:
    "potential", "flux", "surface", or "auto". tolerance: refine until the estimated error of B in the workspace is
    below this (linear iron only).
    """

    mu_r: float | None = None
    nonlinear: bool = False
    refinement: float = 1.0
    form: str = "auto"
    tolerance: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class FieldSource(Record):
    """A device or a map, read and checked. A device is solved at the first access to `field`.

    name: of the device, or of the map file. kind: "map", "device, linear iron" or "device, nonlinear iron". device:
    None for a map. payload, driver: of the device, or of the device text in the map. bounds: box of the map, or box
    around the device's workspace; None without a workspace. make: opens or solves the field.
    """

    name: str
    device_name: str
    kind: str
    coil_names: tuple[str, ...]
    bounds: Bounds | None
    payload: Payload | None
    driver: Driver | None
    device: Device | None
    make: Callable[[], Field]

    @cached_property
    def field(self) -> Field:
        """The opened map, or the solution of the device."""
        return self.make()

    @property
    def is_map(self) -> bool:
        """Whether the field is a map."""
        return self.device is None

    @property
    def nonlinear(self) -> bool:
        """Whether every set of currents needs its own solution."""
        return self.kind.endswith("nonlinear iron")

    def currents(self, currents: Currents) -> Array:
        """Currents in the order of the coils, as `coil_currents` takes them.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            Currents (n_coils,), A.

        Raises
        ------
        InputError
            For currents that do not fit.
        """
        return coil_currents(currents, self.coil_names)

    def assumptions(self, currents: Currents | None = None) -> tuple[str, ...]:
        """Assumptions of the field.

        Parameters
        ----------
        currents
            If given, notes on the field at these currents are included, such as iron beyond saturation.

        Returns
        -------
        tuple[str, ...]
            One sentence each.
        """
        if self.device is None or currents is None:
            return self.field.assumptions
        from fieldmap.iron.notes import state_notes

        return state_notes(self.device, self.field.at(currents))


def open_field(
    name: PathLike | Device | AnyField,
    options: IronOptions | None = None,
    progress: Progress | None = None,
    changes: Mapping[str, Any] | None = None,
) -> Field:
    """Open the map, or solve the device, of a name.

    The field of a device is a `LinearSolution`, or with `options.nonlinear` a `NonlinearSolver`, which solves a state
    for each set of currents.

    Parameters
    ----------
    name
        A map file, a device file, or the name of a shipped device; a device made in Python; or an object that
        `fieldmap.field.as_field` takes.
    options
        How the iron of a device is solved.
    progress
        Called as progress(message, fraction) between steps.
    changes
        Changed keys of the device file: see `read_device`.

    Returns
    -------
    Field
        The field.

    Raises
    ------
    InputError and MapFileError
        As the readers and solvers raise them.

    Examples
    --------
    >>> field = open_field("loop_and_sphere")
    >>> print(f"{1e3 * field.at(1.0).field([0.0, 0.0, -0.014])[2]:.2f} mT")
    1.01 mT
    """
    if isinstance(name, Device):
        return solve_device(name, options or IronOptions(), progress)
    if not isinstance(name, str | os.PathLike):
        return as_field(name)
    return find_source(name, options, progress, changes).field


def find_source(
    name: PathLike,
    options: IronOptions | None = None,
    progress: Progress | None = None,
    changes: Mapping[str, Any] | None = None,
) -> FieldSource:
    """Read and check the map or device of a name. Nothing is solved yet.

    Parameters
    ----------
    name
        A map file, a device file, or the name of a shipped device.
    options
        How the iron of a device is solved.
    progress
        Called as progress(message, fraction) between steps.
    changes
        Changed keys of the device file: see `read_device`.

    Returns
    -------
    FieldSource
        The source.

    Raises
    ------
    InputError and MapFileError
        As the readers raise them.
    """
    if is_map_file(name):
        if changes:
            must_hold, remedy = "must be a device where keys are changed", "name the device of the map"
            raise InputError.of(os.fspath(name), must_hold, "a map", remedy)
        return _map_source(existing_map(name))
    device, chosen = named_device(name, changes), options or IronOptions()
    if chosen.nonlinear:
        from fieldmap.iron.materials import require_soft_bodies

        require_soft_bodies(device)
    return FieldSource(
        name=device.name,
        device_name=device.name,
        kind="device, nonlinear iron" if chosen.nonlinear else "device, linear iron",
        coil_names=device.coil_names,
        bounds=device.bounds,
        payload=device.payload,
        driver=device.driver,
        device=device,
        make=partial(solve_device, device, chosen, progress),
    )


def solve_device(
    device: Device, options: IronOptions, progress: Progress | None = None
) -> LinearSolution | NonlinearSolver:
    """The field of a device: its linear solution, or a solver of states.

    Parameters
    ----------
    device
        The device.
    options
        How the iron is solved.
    progress
        Called as progress(message, fraction) between steps.

    Returns
    -------
    LinearSolution | NonlinearSolver
        The field.

    Raises
    ------
    InputError and GeometryError
        As the solvers raise them.
    """
    # The functions are attributes of the package, so that a test or a program may replace them.
    from fieldmap import iron

    if options.nonlinear:
        return iron.NonlinearSolver(device, options.refinement, progress and _until_assembled(progress))
    if options.tolerance is not None:
        return iron.solve_to_tolerance(device, options.tolerance, mu_r=options.mu_r, progress=progress)
    return iron.solve_linear(
        device, mu_r=options.mu_r, progress=progress, refinement=options.refinement, form=options.form
    )


def _until_assembled(progress: Progress) -> Progress:
    """Progress without the message that the solver is assembled: the first state is still to be solved."""

    def tell(message: str, fraction: float) -> None:
        if message != "assembled":
            progress(message, fraction)

    return tell


def _map_source(path: Path) -> FieldSource:
    from fieldmap.lookup import open_map

    opened = open_map(path)
    record = opened.info.provenance
    made_of = recorded_device(record.device_text) if record.device_text else None
    return FieldSource(
        name=path.name,
        device_name=record.device_name,
        kind="map",
        coil_names=tuple(opened.coil_names),
        bounds=(opened.lower, opened.upper),
        payload=None if made_of is None else made_of.payload,
        driver=None if made_of is None else made_of.driver,
        device=None,
        make=partial(as_field, opened),
    )


def refuse_directory(name: PathLike) -> None:
    """Refuse a directory; a missing file is reported by its reader.

    Parameters
    ----------
    name
        A path.

    Raises
    ------
    InputError
        For a directory.
    """
    if os.path.isdir(name):
        raise InputError.of(os.fspath(name), "must be a file", "a directory", "name the file inside it")


def is_map_file(name: PathLike) -> bool:
    """Whether a name is the name of a map file (or of recorded runs) and not of a device.

    Parameters
    ----------
    name
        A path or the name of a device.

    Returns
    -------
    bool
        True for a map file.

    Raises
    ------
    InputError
        For a directory that does not have the name of a shipped device or map.
    """
    if shipped_alone("geometry", name) is None and shipped_alone("maps", name, ending=".h5") is None:
        refuse_directory(name)
    path = map_path(name)
    return path.suffix.lower() in _MAP_SUFFIXES or (is_file(path) and is_hdf5(path))


def existing_map(name: PathLike) -> Path:
    """The path of an existing HDF5 file.

    Parameters
    ----------
    name
        The path.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    MapFileError
        For a missing file, and for one that is not HDF5.
    """
    path = map_path(name)
    if not is_map_file(name):
        received = "no such file" if not os.path.exists(path) else "a file that is not HDF5"
        must_hold, remedy = "must be a map file made by `fieldmap map`", "make one: fieldmap map RECIPE"
        raise MapFileError.of(os.fspath(name), must_hold, received, remedy)
    if not is_file(path):
        remedy = "check the name, or make the map: fieldmap map RECIPE"
        raise MapFileError.of(os.fspath(name), "must be an existing file", "no such file", remedy)
    return path


def named_device(name: PathLike, changes: Mapping[str, Any] | None = None) -> Device:
    """The device of a file or a shipped name.

    Parameters
    ----------
    name
        A path or a name.
    changes
        Changed keys of the device file: see `read_device`.

    Returns
    -------
    Device
        The device.

    Raises
    ------
    InputError
        For a map.
    DeviceFileError
        As for `read_device`.
    """
    if is_map_file(name):
        must_hold = "must be a device file or the name of a shipped device"
        raise InputError.of(os.fspath(name), must_hold, "a map", "name its device")
    return read_device(os.fspath(name), changes)
