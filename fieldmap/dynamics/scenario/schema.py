"""The keys of a scenario file, table by table, and its reader."""

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo

from fieldmap.device import Device, Payload
from fieldmap.device.drives import DriveChoice
from fieldmap.dynamics.field_of_currents import FieldOfCurrents, linearised, modelled, tabled
from fieldmap.dynamics.machine import Bits, ChainKeys, CoilDrive, Sensors, drive_of_device
from fieldmap.dynamics.rigid_body import Drag, Plate, RigidBody, Three, Walls, body_of_payload
from fieldmap.dynamics.scenario.controllers import (
    AxisController,
    AxisKeys,
    Constant,
    CoupledController,
    CoupledKeys,
    FeedbackLinearisation,
    Feedforward,
    Own,
)
from fieldmap.dynamics.scenario.field_sensors import FieldSensorSettings
from fieldmap.dynamics.scenario.references import (
    MOST_PERIODS,
    Compensator,
    Disturbance,
    Reference,
    ReferenceKeys,
    Signal,
)
from fieldmap.errors import InputError, ScenarioError
from fieldmap.inputs.declared import Key, record_of, table_of
from fieldmap.inputs.document import AtKey, Document, schema_findings
from fieldmap.inputs.findings import changed_in_words
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import NotNegative, Positive, Table, Text, Vector, Versioned, broken
from fieldmap.instruments import Converter
from fieldmap.instruments.converter import USUAL_RANGE
from fieldmap.lookup import FieldMap, magnetic_body, saturates
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

MOST_STEPS = 1_000_000
"""Most steps of the mechanics in one control period."""
_Nodes = Annotated[list[Annotated[int, Field(ge=4)]], Field(min_length=3, max_length=3)]
_ZERO: Three = (0.0, 0.0, 0.0)
_NO_DRAG, _IDEAL = Drag(), Sensors()


@dataclass(frozen=True, repr=False)
class FieldSettings(Record):
    """How the map's field follows the currents."""

    scale: Annotated[Positive, Key(..., "calibration: the map's field is multiplied by it")] = 1.0
    iron: Annotated[
        Literal["auto", "linearised", "model", "table"],
        Key(
            ...,
            "how saturating iron is treated; model: solved whenever currents change; table: over lift and "
            "directions, which takes seconds to make and pays in hundreds of runs; linearised: about the currents "
            "of the operating point; auto: the model, or the table if its nodes are given",
        ),
    ] = "auto"
    table: Annotated[
        tuple[int, int, int] | None,
        Key(
            _Nodes | None,
            "numbers of nodes of that table for u, x and y, each at least 4; as many as it needs unless given",
        ),
    ] = None
    loop: Annotated[
        Positive | None,
        Key(
            ...,
            "size of loops of the currents, to either side; linear models and regulators take their slopes, for "
            "hysteresis; slopes of small changes unless given",
            "A",
        ),
    ] = None

    def field(self, opened: FieldMap, currents: Array) -> FieldOfCurrents:
        """The field as a function of the currents; "linearised" iron is linearised about currents (n,), A."""
        if self.iron == "linearised":
            return linearised(opened, currents, self.scale, self.loop)
        wanted = self.iron == "table" or (self.iron == "auto" and self.table is not None)
        if wanted and saturates(opened):
            return tabled(opened, self.table, self.scale, self.loop)
        return modelled(opened, self.scale, self.loop)


@dataclass(frozen=True, repr=False)
class BodySettings(Record):
    """The body around the device's magnet."""

    turning: Annotated[
        Literal["free", "upright"] | None,
        Key(
            ...,
            "free: six degrees of freedom; upright: it does not turn; unless given, as the device's payload.turning "
            "says, otherwise free",
        ),
    ] = None
    radius: Annotated[
        Positive | None, Key(..., "radius of the cylinder; the magnet's unless given", "mm")
    ] = None
    height: Annotated[
        Positive | None, Key(..., "height of the cylinder; the magnet's unless given", "mm")
    ] = None
    below: Annotated[
        Positive | None, Key(..., "height of the magnet's centre above the lower face", "mm")
    ] = None
    centre_of_mass: Annotated[float, Key(..., "height above the magnet's centre", "mm")] = 0.0
    magnet_offset: Annotated[
        NotNegative | None,
        Key(..., "depth of the magnet's centre below the sensed point; the device's unless given", "mm"),
    ] = None
    finite_magnet: Annotated[bool, Key(..., "the magnet's volume instead of a point dipole")] = False

    def payload(self, payload: Payload) -> Payload:
        """The payload with the magnets that the body has: point dipoles unless they are to be of finite size."""
        return payload if self.finite_magnet else replace(payload, volume_level=1)

    def body(self, payload: Payload, opened: FieldMap) -> RigidBody:
        """The body of a payload, in the field of a map."""
        if self.magnet_offset is not None:
            payload = replace(payload, magnet_offset=self.magnet_offset)
        magnet = None
        if self.finite_magnet:
            if payload.magnet is None and not payload.pieces:
                key, remedy = "body.finite_magnet", "add payload.magnet"
                raise ScenarioError(AtKey(key, "needs a magnet", "a moment only", remedy))
            unit = opened.at(np.ones(len(opened.coil_names)))
            magnet = magnetic_body(payload, field=unit, tolerance=1e-4)
        sizes = {name: getattr(self, name) for name in ("radius", "height", "below", "centre_of_mass")}
        upright = None if self.turning is None else self.turning == "upright"
        return body_of_payload(payload, magnet=magnet, upright=upright, **sizes)


@dataclass(frozen=True, repr=False)
class CoilSettings(DriveChoice):
    """Windings and amplifiers."""

    dynamics: Annotated[bool, Key(..., "R and L of the device's coils; false: currents follow at once")] = (
        True
    )
    lowest_voltage: Annotated[
        float | None, Key(..., "lowest voltage at a winding; minus the supply's unless given", "V")
    ] = None
    time_constant: Annotated[NotNegative, Key(..., "time constant of the amplifier", "ms")] = 0.0
    noise: Annotated[NotNegative, Key(..., "standard deviation of the current", "A")] = 0.0
    output_bits: Annotated[Bits | None, Key(..., "bits of the output converter")] = None
    output_range: Annotated[
        Positive, Key(..., "range of the output converter, plus and minus; assumed unless given", "V")
    ] = USUAL_RANGE
    end_beyond_table: Annotated[
        bool, Key(..., "currents beyond the table of the iron, or its model's domain, end the run")
    ] = False
    longest_saturation: Annotated[
        NotNegative,
        Key(
            ...,
            "a limit that is active for so long, in whole periods rounded up, ends the run; 0 for never",
            "s",
        ),
    ] = 0.0

    def drive(self, device: Device) -> CoilDrive:
        """The drive of a device's coils. Raises ScenarioError if the device lacks numbers for it."""
        converter = None if self.output_bits is None else Converter(self.output_range, self.output_bits)
        more = {"time_constant": self.time_constant, "converter": converter}
        try:
            drive = drive_of_device(device, self.lowest_voltage, self, self.noise, **more)
        except InputError as error:
            (problem,) = error.problems
            if not isinstance(problem, AtKey):
                raise
            raise ScenarioError(replace(problem, where=problem.where.replace("driver", "coils"))) from None
        plain = self.dynamics or drive.coupled
        return drive if plain else replace(drive, resistance=None, inductance=None)


class WallEndKeys(Table):
    """Keys of walls that a scenario adds to those of `Walls`."""

    end: list[Literal["floor", "ceiling", "tube"]] = Field(
        default=["floor", "ceiling", "tube"], description="contacts that end the run"
    )


def _of_bounded_number(step: float, info: ValidationInfo) -> None:
    period = info.data.get("period_ms", 0.0)
    if period / step > MOST_STEPS:
        must = f"step_ms must be at least a part of {MOST_STEPS} of period_ms"
        raise broken(must, f"{step:g} of {period:g}", "take a larger step")


def _axes_or_coupled(coupled: Any, info: ValidationInfo) -> None:
    if not {"z", "x", "y"} <= info.data.keys():
        return
    given = [axis for axis in "zxy" if info.data[axis] is not None]
    if len(given) != (0 if coupled is not None else 3):
        received = ", ".join(given + (["coupled"] if coupled is not None else [])) or "none"
        must = "must have either z, x and y, or coupled"
        raise broken(must, received, "give every axis a controller, or one for all")


@dataclass(frozen=True, eq=False, repr=False)
class ControlSettings(Record):
    """The controllers and their clock."""

    period: Annotated[Positive, Key(..., "period of the control task", "ms")] = 2e-3
    delay: Annotated[NotNegative, Key(..., "delay from sample to command, at most one period", "ms")] = 0.0
    step: Annotated[Positive, Key(..., "time step of the mechanics", "ms", check=_of_bounded_number)] = 1e-4
    allocation: Annotated[
        Literal["lift_and_directions", "least_power"] | None,
        Key(
            ...,
            "how lift, x and y become currents; lift_and_directions: of six coils in two rows of three; least_power: "
            "of any coils, linear about the start; unless given lift_and_directions if the map was made for it, "
            "otherwise least_power",
        ),
    ] = None
    allocation_n: Annotated[
        Positive | None,
        Key(
            ...,
            "n of lift_and_directions: how much more the two coils in the middles of the rows follow x; that of the "
            "map unless given",
        ),
    ] = None
    z: Annotated[
        AxisController | None, Key(AxisKeys | None, "controller from depth in mm to lift voltage")
    ] = None
    x: Annotated[AxisController | None, Key(AxisKeys | None, "controller from x in mm to x signal")] = None
    y: Annotated[AxisController | None, Key(AxisKeys | None, "controller from y in mm to y signal")] = None
    coupled: Annotated[
        CoupledController | Own | None,
        Key(CoupledKeys | None, "one controller of all axes, instead of x, y and z", check=_axes_or_coupled),
    ] = None
    feedforward: Annotated[
        Feedforward | None,
        Key(table_of(Feedforward) | None, "feed-forward along the reference, by the inverse map"),
    ] = None
    compensator: Annotated[
        Compensator | None,
        Key(table_of(Compensator) | None, "push of the vertical reference when x or y moves"),
    ] = None


@dataclass(frozen=True, repr=False)
class Start(Record):
    """Where the run begins; in equilibrium unless `shift`, `velocity` or `lean` is given."""

    depth: Annotated[
        float | None,
        Key(
            ...,
            "reading of the vertical sensor; unless given, as near to the middle of the map as the coils carry the "
            "body easily",
            "mm",
        ),
    ] = None
    x: Annotated[
        float | None,
        Key(
            ...,
            "unless given, where the body floats with a constant controller's x signal, or with 0: the search begins "
            "in the middle of the map, and may end far from it",
            "mm",
        ),
    ] = None
    y: Annotated[
        float | None,
        Key(
            ...,
            "unless given, where the body floats with a constant controller's y signal, or with 0: as of x",
            "mm",
        ),
    ] = None
    shift: Annotated[Three, Key(Vector, "distance from equilibrium along x, y, depth", "mm")] = _ZERO
    velocity: Annotated[Three, Key(Vector, "velocity along x, y, z", "mm_per_s")] = _ZERO
    lean: Annotated[float, Key(..., "angle about x from equilibrium", "deg", make=np.deg2rad)] = 0.0


@dataclass(frozen=True, repr=False)
class Noise(Record):
    """Noise of the run."""

    seed: Annotated[Annotated[int, Field(ge=0)] | None, Key(..., "equal seeds give equal runs")] = 0
    off: Annotated[bool, Key(..., "true: no noise at all")] = False


@dataclass(frozen=True, repr=False)
class RecordSettings(Record):
    """The recorded samples of a run."""

    every: Annotated[
        Annotated[int, Field(ge=1, le=MOST_PERIODS)], Key(..., "control periods for each recorded row")
    ] = 1


def _of_bounded_length(duration: float, info: ValidationInfo) -> None:
    control = info.data.get("control")
    periods = 0.0 if control is None else 1e3 * duration / control.period_ms
    if periods > MOST_PERIODS:
        must = f"a run has at most {MOST_PERIODS} control periods: duration_s over control.period_ms"
        raise broken(must, f"{periods:.4g}", "shorten the run")


@dataclass(frozen=True, eq=False, repr=False)
class Settings(Record):
    """A scenario."""

    title: Annotated[Text, Key(..., "one line about the run")]
    map: Annotated[Text, Key(..., "map file, relative to the scenario; or its name in maps/out")]
    control: Annotated[ControlSettings, Key(table_of(ControlSettings), "controllers and their clock")]
    duration: Annotated[Positive, Key(..., "length of the run", "s", check=_of_bounded_length)]
    device: Annotated[
        Text | None,
        Key(
            ...,
            "device file, relative to the scenario, or name of a shipped device; the map's own unless given",
        ),
    ] = None
    start: Annotated[Start, Key(table_of(Start), "where the run begins")] = Start()
    field: Annotated[FieldSettings, Key(table_of(FieldSettings), "how the field follows the currents")] = (
        FieldSettings()
    )
    body: Annotated[BodySettings, Key(table_of(BodySettings), "the body around the magnet")] = BodySettings()
    drag: Annotated[Drag, Key(table_of(Drag), "resistance of the air, beside the drag of the payload")] = (
        _NO_DRAG
    )
    plate: Annotated[Plate | None, Key(table_of(Plate) | None, "a conducting plate")] = None
    walls: Annotated[
        Walls | None, Key(table_of(Walls, bases=(WallEndKeys,)) | None, "walls that the body can touch")
    ] = None
    coils: Annotated[CoilSettings, Key(table_of(CoilSettings), "windings and amplifiers")] = CoilSettings()
    sensors: Annotated[Sensors, Key(table_of(Sensors, bases=(ChainKeys,)), "position sensors")] = _IDEAL
    field_sensors: Annotated[
        FieldSensorSettings | None,
        Key(
            table_of(FieldSensorSettings) | None,
            "field sensors of the device, in the place of position sensors",
        ),
    ] = None
    reference: Annotated[tuple[Reference, ...], Key(list[ReferenceKeys], "changes of the references")] = ()
    signal: Annotated[
        tuple[Signal, ...], Key(list[table_of(Signal)], "steps of outputs in open loop")  # type: ignore[misc]
    ] = ()
    disturbance: Annotated[
        tuple[Disturbance, ...], Key(list[table_of(Disturbance)], "forces on the body")  # type: ignore[misc]
    ] = ()
    noise: Annotated[Noise, Key(table_of(Noise), "noise of the run")] = Noise()
    record: Annotated[RecordSettings, Key(table_of(RecordSettings), "the recorded samples")] = (
        RecordSettings()
    )

    def held(self) -> tuple[Array, Array]:
        """The held components of the sensed point (3,), m, and of the outputs (3,) at rest; NaN for free components.

        Along x and y either the position is held or the output. The height is held if the start states a depth.
        """
        place, outputs = np.full(3, np.nan), np.full(3, np.nan)
        for k, axis in enumerate("xy"):
            given, controller = getattr(self.start, axis), getattr(self.control, axis)
            if given is not None:
                place[k] = given
            else:
                outputs[1 + k] = (isinstance(controller, Constant) and controller.output) or 0.0
        if self.start.depth is not None:
            place[2] = self.height(self.start.depth)
        return place, outputs

    @property
    def start_for_messages(self) -> str:
        """The key of the start, or words where the scenario leaves the start to the program."""
        return "the start" if self.start == Start() else "start"

    def height(self, depth: float) -> float:
        """z of the sensed point, m, at which the vertical sensor reads this, m."""
        return -(self.zero_depth + depth)

    @property
    def zero_depth(self) -> float:
        """Depth below the map's origin at which the vertical sensor reads 0, m."""
        return self.sensors.zero_depth

    def refuse_idle(self, idle: tuple[str, ...]) -> None:
        """Raise ScenarioError if a key asks for control along an axis of `idle`, along which the coils do not push."""
        control = self.control
        for axis in idle:
            why = f"the coils do not push along {axis} by themselves at the start"
            controller, given = getattr(control, axis), getattr(self.start, axis)
            key, must, received, remedy = "", "", why, "leave it out, or add coils"
            if controller is not None and not isinstance(controller, Constant):
                key, must = f"control.{axis}", f'must be of kind "constant": {why}'
                received, remedy = controller.kind, "change it, or add coils"
            elif given is not None:
                key, must, received = f"start.{axis}_mm", f"must be left out: {why}", f"{1e3 * given:g} mm"
                remedy = "leave it out: the magnet floats where the field lets it"
            elif (
                number := next((k for k, one in enumerate(self.reference) if one.moves(axis)), None)
            ) is not None:
                key, must = f"reference.{number}", "must be along an axis that is held"
            elif isinstance(control.coupled, FeedbackLinearisation) or control.feedforward is not None:
                key = "control.coupled" if control.feedforward is None else "control.feedforward"
                must = "needs coils that push along x, y and z"
            if key:
                raise ScenarioError(AtKey(key, must, received, remedy))


ScenarioFile = table_of(Settings, name="ScenarioFile", bases=(Versioned,))
SCENARIO = FileKind("scenario", ScenarioFile, ScenarioError, "maps", "scenarios")


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Record):
    """A scenario as written.

    Attributes
    ----------
    path, text : of the file.
    contents : the table of the file, in the units of the file.
    changes : values that the caller changed, by dotted key; the contents include them.
    """

    path: Path
    text: str
    contents: Any
    changes: Mapping[str, Any]

    @cached_property
    def settings(self) -> Settings:
        """The contents as a record in SI units."""
        settings: Settings = record_of(self.contents, self.path.parent)
        return settings

    @property
    def zero_depth_mm(self) -> float:
        """Depth below the map's origin at which the vertical sensor reads 0."""
        return 1e3 * self.settings.zero_depth

    def changed(self, but: Collection[str] = ()) -> tuple[str, ...]:
        """The keys that the caller changed, but those in `but`, and what the file states: one sentence, or none."""
        data = tomllib.loads(self.text)
        changes = {key: value for key, value in self.changes.items() if key not in but}
        words = changed_in_words(self.path.name, changes, {key: _stated(data, key) for key in changes})
        return (words,) if words else ()

    @property
    def document(self) -> Document:
        """The file, so that errors name the line of a key."""
        return Document(self.path, self.text, {})

    def __reduce__(self) -> tuple[Any, ...]:
        # The classes of the tables are made while this module is imported. A pickle looks for classes by name and would
        # not find them, so it takes the values.
        data = self.contents.model_dump(exclude_unset=True, warnings=False)
        return _scenario_of, (self.path, self.text, data, self.changes)


def _scenario_of(path: Path, text: str, data: dict[str, Any], changes: Mapping[str, Any]) -> Scenario:
    return Scenario(path, text, ScenarioFile.model_validate(data), changes)


def read_scenario(path_or_name: PathLike, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Read and check a scenario file. docs/dynamics.md describes the format.

    Parameters
    ----------
    path_or_name
        Path of the file, or the name of a shipped scenario ("vertical_step").
    changes
        Values that replace those of the file, by dotted key, such as {"control.z.Kc": 0.2}.

    Returns
    -------
    Scenario
        The scenario as written, whose `settings` are in SI.

    Raises
    ------
    ScenarioError
        With one Problem for every error of the file: file, line and key path; what must hold; what was received; the
        remedy.
    """
    if Path(path_or_name).suffix.lower() in (".h5", ".hdf5"):
        remedy = f"a scenario says what happens in it: fieldmap simulate hold --map {path_or_name}"
        raise ScenarioError.of(str(path_or_name), "must be a scenario file", "the name of a map", remedy)
    path = SCENARIO.find(path_or_name)
    document = SCENARIO.load(path)
    data = tomllib.loads(document.text)
    for key, value in (changes or {}).items():
        _change(data, path, key, value)
    findings = schema_findings(ScenarioFile, data)
    if findings:
        raise ScenarioError(*Document(path, document.text, data).problems(findings))
    return Scenario(path, document.text, ScenarioFile.model_validate(data), dict(changes or {}))


def _stated(data: Any, key: str) -> tuple[Any, ...]:
    """The value at a dotted key, if there is one."""
    for step in key.split("."):
        if isinstance(data, list) and step.isdigit() and int(step) < len(data):
            data = data[int(step)]
        elif isinstance(data, dict) and step in data:
            data = data[step]
        else:
            return ()
    return (data,)


def _change(data: dict[str, Any], path: Path, key: str, value: Any) -> None:
    """Set a value by its dotted key. A number in the key is an index of a list."""
    *steps, last = key.split(".")
    here: Any = data
    for step in steps:
        if isinstance(here, list) and step.isdigit() and int(step) < len(here):
            here = here[int(step)]
        elif isinstance(here, dict):
            here = here.setdefault(step, {})
        else:
            here = None
    if isinstance(here, list) and last.isdigit() and int(last) < len(here):
        here[int(last)] = value
    elif isinstance(here, dict):
        here[last] = value
    else:
        where, received = f"{path}: {key}", "a step that is no table"
        raise ScenarioError.of(where, "must be a key of the scenario", received, "write table.key")
