"""Preparation and run of a scenario: machine, controller, schedule, state at the start."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.control.blocks import AxisReading, Controller, stacked
from fieldmap.control.function_controller import FunctionController, as_controller
from fieldmap.core.machine import POSITION, TURN, VELOCITY
from fieldmap.currents import LiftAndDirections
from fieldmap.device import Device, read_device, recorded_device
from fieldmap.dynamics.allocation import ControlAllocation, lift_and_directions
from fieldmap.dynamics.closed_loop import (
    RunningMachine,
    Schedule,
    given_outputs,
    machine_for,
    measured_by,
    simulate_closed_loop,
)
from fieldmap.dynamics.field_of_currents import sampled_field
from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.machine import Machine, drive_of_device
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.dynamics.scenario.controllers import AxisController
from fieldmap.dynamics.scenario.metrics import RunMetrics, run_metrics
from fieldmap.dynamics.scenario.references import control_times, disturbances, open_loop_signals, references
from fieldmap.dynamics.scenario.schema import Scenario, Start, read_scenario
from fieldmap.dynamics.scenario.start import allocation_about, carrying, easy_height, floating, floating_at
from fieldmap.dynamics.weight_balance import WeightBalance
from fieldmap.errors import NoEquilibrium, ScenarioError
from fieldmap.field import Field
from fieldmap.inputs.document import AtKey
from fieldmap.lookup import FieldMap, open_map, saturates
from fieldmap.records import Record
from fieldmap.shipped import is_file, shipped_file
from fieldmap.typing import Array, PathLike

_ROUNDS = 12
"""Most iterations that find the operating point with saturating iron linearised about its currents."""


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Record):
    """A scenario that is ready to run.

    Attributes
    ----------
    scenario : as read.
    machine : the simulated machine.
    controller : None for a scenario that leaves it to the caller.
    schedule : references, disturbances and the clock.
    state : (13,), at the start.
    currents : (n,), at the start, A.
    operating_point : at the start.
    device : of the machine.
    """

    scenario: Scenario
    machine: Machine
    controller: Controller | FunctionController | None
    schedule: Schedule
    state: Array
    currents: Array
    operating_point: OperatingPoint
    device: Device

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the machine, and of a controller that is a function."""
        own = self.controller
        return (*self.machine.assumptions, *([own.assumption] if isinstance(own, FunctionController) else []))

    def warm(self) -> None:
        """Compile a controller that is a function, so that the time of later runs does not include it."""
        if isinstance(self.controller, FunctionController):
            names = machine_for(self.machine, self.controller.gives).allocation.output_names
            self.controller.bound(names, measured_by(self.machine))

    def run(self, seed: int | np.random.SeedSequence | None = None) -> LevitationRun:
        """Simulate one run, with the seed of the scenario unless one is given."""
        if self.controller is None:
            key, must = "control.coupled", "needs a controller that the caller gives"
            remedy = "give one: controller=, or --controller FILE.py:NAME"
            raise ScenarioError(self.scenario.document.problem(key, must, "none", remedy))
        driven, start = (self.machine, self.controller, self.schedule), (self.state, self.currents)
        return simulate_closed_loop(*driven, *start, self.noise(seed))

    def judged(self, run: LevitationRun) -> "ScenarioRun":
        """A run of this experiment with its scenario and its metrics."""
        known = {field.name: getattr(run, field.name) for field in fields(LevitationRun)}
        scenario, names = self.scenario, self.device.coil_names
        return ScenarioRun(
            **known, scenario=scenario, coil_names=tuple(names), metrics=run_metrics(scenario, run)
        )

    def noise(self, seed: int | np.random.SeedSequence | None) -> int | np.random.SeedSequence | None:
        """The given seed, or that of the scenario; None for a scenario without noise."""
        noise = self.scenario.settings.noise
        return None if noise.off else noise.seed if seed is None else seed


def prepare(
    scenario: Scenario,
    field_map: Field | None = None,
    device: Device | None = None,
    controller: Controller | FunctionController | Callable[..., Any] | None = None,
) -> Experiment:
    """Open the map, find the operating point at the start, make the controllers.

    Parameters
    ----------
    scenario
        As read.
    field_map
        Replaces the scenario's map. A field that is not a map is sampled: `sampled_field`.
    device
        Replaces the device of the scenario or the map.
    controller
        Replaces the scenario's controller; a function, or any controller.

    Returns
    -------
    Experiment
        The experiment, ready to run.

    Raises
    ------
    ScenarioError, MapFileError, InputError
        For an invalid scenario, map or argument.
    NoEquilibrium
        If the machine has no equilibrium at the start.
    """
    own = None if controller is None else as_controller(controller)
    with scenario.document.placing():
        return _prepared(scenario, field_map, device, own)


def _prepared(scenario: Scenario, field: Field | None, device: Device | None, own: Any) -> Experiment:
    settings = scenario.settings
    control, start, period = settings.control, settings.start, settings.control.period
    if isinstance(own, FunctionController):
        _refuse_beside(own, control.feedforward is not None, bool(settings.signal))
        period = own.period or period
    device, opened = _device_and_map(scenario.path.parent, settings.map, settings.device, field, device)
    assert device.payload is not None
    assert device.driver is not None
    body = settings.body.body(device.payload, opened)

    # The place at the start, approximate currents that carry the body there, and the allocation.
    drive = settings.coils.drive(device)
    limits = (
        drive if drive.coupled else drive_of_device(device, settings.coils.lowest_voltage, settings.coils)
    ).steady
    signals = _lift_and_directions(opened, control.allocation, control.allocation_n)
    balance = WeightBalance(opened, body, limits, settings.field.scale)
    held, where = settings.held(), settings.start_for_messages
    middle = 0.5 * (opened.lower + opened.upper)
    x = middle[0] if start.x is None else start.x
    y = middle[1] if start.y is None else start.y
    above = float((body.seen_at - body.magnet_at)[2])
    if start.depth is None:
        held[0][2] = round(easy_height(balance, x, y, where) + above, 9)
    magnet = np.array([x, y, held[0][2] - above])
    currents = carrying(balance, magnet, where)
    allocation = signals or allocation_about(balance, magnet, currents, device.driver.gain, where)
    settings.refuse_idle(allocation.idle)

    x_drag, y_drag, z_drag = (value + device.payload.drag for value in settings.drag.linear)
    drag = replace(settings.drag, linear=(x_drag, y_drag, z_drag))

    # The machine in equilibrium. Saturating iron can be linearised about the currents of the equilibrium, which depend
    # on the linearisation; hence the iteration.
    walls, beyond = scenario.contents.walls, settings.coils.end_beyond_table
    about_currents = settings.field.iron == "linearised" and saturates(opened)
    for _ in range(_ROUNDS if about_currents else 1):
        machine = Machine(
            settings.field.field(opened, currents),
            body,
            drive,
            settings.sensors,
            allocation,
            drag,
            settings.plate,
            settings.walls,
            (*(() if walls is None else walls.end), *(("currents",) if beyond else ())),
            settings.coils.longest_saturation,
        )
        guess = allocation.nearest(currents / device.driver.gain)
        point = floating(machine, held, guess, magnet + [0.0, 0.0, above], where)
        change, currents = float(np.abs(point.currents - currents).max()), point.currents
        if not about_currents or change < 1e-6:
            break
    else:
        must, remedy = "currents of the operating point must settle", 'take field.iron = "model"'
        raise NoEquilibrium(AtKey(where, must, f"a change of {change:.1e} A", remedy))

    if settings.field_sensors is not None:
        sensors = settings.field_sensors.sensors(machine, opened, point, period)
        machine = replace(machine, sensors=sensors)

    # References and disturbances, and the controllers.
    time, zero = control_times(settings.duration, period), np.array([0.0, 0.0, settings.zero_depth])
    down = np.array([1.0, 1.0, -1.0])
    wanted = references(settings.reference, control.compensator, point.sensed * down - zero, time, period)
    schedule = Schedule(
        (wanted + zero) * down,
        period,
        control.step,
        control.delay,
        open_loop_signals(settings.signal, time),
        disturbances(settings.disturbance, time),
        settings.record.every,
    )
    coupled, points_at = control.coupled, partial(floating_at, machine, held, point)
    if own is None and coupled is not None:
        own = coupled.controller(machine, point, points_at, period, control.delay)
    elif own is None:
        own = _of_axes((control.z, control.x, control.y), point, period, settings.zero_depth)
    _refuse_unseen(machine, own)
    if own is not None and control.feedforward is not None:
        schedule = control.feedforward.added(machine, own, point, schedule)
    return Experiment(scenario, machine, own, schedule, _begin(start, point), currents, point, device)


def _refuse_beside(controller: FunctionController, feedforward: bool, signals: bool) -> None:
    """Raise ScenarioError for keys that do not go with a controller that is a function."""
    if feedforward:
        must, remedy = "must be left out beside a controller that is a function", "add it in the function"
        raise ScenarioError(AtKey("control.feedforward", must, "both", remedy))
    if signals and controller.gives != "signals":
        must, remedy = "must be left out: the outputs are no signals", 'take gives="signals", or leave it out'
        raise ScenarioError(AtKey("signal", must, controller.gives, remedy))


def _refuse_unseen(machine: Machine, controller: Any) -> None:
    """Raise ScenarioError for field sensors without an estimator in front of a controller that needs a position."""
    seen = machine.sensors.numbers.measured == slice(3, 6)
    if not (seen or controller is None or isinstance(controller, FunctionController)):
        must, remedy = (
            "must estimate the position for this controller",
            "take one, or a controller of kind own",
        )
        raise ScenarioError(AtKey("field_sensors.estimator", must, '"none"', remedy))


def _device_and_map(
    folder: Path, map_name: str, device_name: str | None, field: Field | None, device: Device | None
) -> tuple[Device, FieldMap]:
    """The device and the map. Raises ScenarioError, MapFileError, InputError.

    The device is the given one, the one that the scenario names, or the one that the map records. The map is that of
    the scenario, or one that is sampled from the given field.
    """
    if device is None and device_name is not None:
        # The last place is for a shipped scenario with a device file that the command line names.
        places = (folder / device_name, shipped_file("geometry", device_name), Path(device_name))
        found = next((path for path in places if path is not None and is_file(path)), None)
        if found is None:
            must = "a file relative to the scenario, or the name of a shipped one"
            raise ScenarioError(AtKey("device", must, f'"{device_name}"', "correct the name"))
        device = read_device(found)
    opened = sampled_field(field) if field is not None else _open_map(folder, map_name)
    if device is None:
        text = opened.info.provenance.device_text
        if not text:
            must, remedy = "must be named where the map does not record one", 'add device = "FILE.toml"'
            raise ScenarioError(AtKey("device", must, "none", remedy))
        device = recorded_device(text)
    for table in ("payload", "driver"):
        if getattr(device, table) is None:
            remedy = f"add [{table}] to the device file"
            if device_name is None:
                remedy += ", which the map recorded as it was, and name the file: --set device=FILE.toml"
            raise ScenarioError(AtKey("device", f"must have a [{table}]", "none", remedy))
    if len(opened.coil_names) != len(device.coils):
        must = f"must be a map of the device's {len(device.coils)} coils"
        remedy = "name the device that the map was made of, or none"
        raise ScenarioError(AtKey("map", must, f"{len(opened.coil_names)} coils", remedy))
    return device, opened


def _open_map(folder: Path, name: str) -> FieldMap:
    """Open the map: a path relative to the scenario or to the working directory, or a name in maps/out."""
    out = Path("maps") / "out"
    for path in (folder / name, Path(name), out / name, out / f"{name}.h5"):
        if is_file(path):
            return open_map(path, outside_currents="evaluate")
    must = "must be a map file relative to the scenario, or the name of one in maps/out"
    remedy = f"make it: fieldmap map {Path(name).stem}, or give --map"
    raise ScenarioError(AtKey("map", must, f'"{name}"', remedy))


def _lift_and_directions(
    opened: FieldMap, allocation: str | None, n: float | None
) -> ControlAllocation | None:
    """The allocation by lift and directions for six coils in two rows. Raises ScenarioError.

    None unless the scenario names it, or names no allocation and the map was made for this one.
    """
    coils, own = len(opened.coil_names), opened.parametrisation
    if allocation == "least_power" or (allocation is None and not isinstance(own, LiftAndDirections)):
        return None
    if coils != 6:
        must, remedy = "must be least_power: lift_and_directions is for six coils", "change or leave it out"
        raise ScenarioError(AtKey("control.allocation", must, f"a map of {coils} coils", remedy))
    if n is None:
        if not isinstance(own, LiftAndDirections):
            must = "must be given for a map that was not made for lift_and_directions"
            raise ScenarioError(AtKey("control.allocation_n", must, "none", "write allocation_n"))
        n = own.n
    return lift_and_directions(n)


def _of_axes(
    controllers: Sequence[AxisController | None], point: OperatingPoint, period: float, zero_depth: float
) -> Controller:
    """The controllers of depth, x and y as one controller."""
    at = np.concatenate([point.sensed, point.sensed, [1.0]])
    depth = AxisReading("z", -1e3, -1e3 * zero_depth)
    readings = (depth, AxisReading("x", 1e3), AxisReading("y", 1e3))
    each = zip(controllers, readings, point.outputs, strict=True)
    return stacked(*(one.block(axis, period, float(out), at) for one, axis, out in each if one is not None))


def _begin(start: Start, point: OperatingPoint) -> Array:
    """The state at the start: the operating point with the shift, lean and velocity of the scenario."""
    state = point.state.copy()
    x, y, depth = start.shift
    state[POSITION : POSITION + 3] += x, y, -depth
    state[VELOCITY : VELOCITY + 3] = start.velocity
    half = 0.5 * start.lean
    w, a, b, c = state[TURN : TURN + 4]
    turned = [w * np.cos(half) - a * np.sin(half), a * np.cos(half) + w * np.sin(half)]
    turned += [b * np.cos(half) - c * np.sin(half), c * np.cos(half) + b * np.sin(half)]
    return state_of(state[:3], state[3:6], turned, state[10:])


@dataclass(frozen=True, eq=False, repr=False)
class ScenarioRun(LevitationRun):
    """A run (`LevitationRun`) with its scenario, the names of its coils and its metrics. `print(run)` shows the
    metrics."""

    scenario: Scenario
    coil_names: tuple[str, ...]
    metrics: RunMetrics

    def __str__(self) -> str:
        return f"{self.scenario.contents.title}\n{self.metrics}"


def simulate(
    path_or_name: PathLike,
    changes: Mapping[str, Any] | None = None,
    *,
    field_map: Field | None = None,
    device: Device | None = None,
    seed: int | None = None,
    controller: Controller | FunctionController | Callable[..., Any] | None = None,
) -> ScenarioRun:
    """Run a scenario.

    A run in which the body falls or leaves the map does not raise an error: `event` of the run says what happened.

    Parameters
    ----------
    path_or_name
        Path of the scenario file, or the name of a shipped scenario.
    changes
        Values by dotted key that replace those of the file, such as {"control.z.Kc": 0.2}.
    field_map
        Replaces the scenario's map: an opened map, or any field that is the sum of its coils' fields, such as
        a solution, which is sampled (`sampled_field`).
    device
        Replaces the device of the scenario or the map.
    seed
        Replaces the seed of the scenario.
    controller
        Replaces the scenario's controller: a function `outputs = f(time, measured, reference, state)` in
        Python or jitted by numba, a C function, or a `fieldmap.control.FunctionController`, which also states
        limits, period and outputs.

    Returns
    -------
    ScenarioRun
        The run with its metrics.

    Raises
    ------
    ScenarioError
        With every error of the file.
    MapFileError
        For a map that cannot be read.
    NoEquilibrium
        If the machine has no equilibrium at the start.
    ControllerError
        If the function fails.

    Examples
    --------
    >>> run = simulate("vertical_step")                                               # doctest: +SKIP
    >>> run.metrics.axes[2].step.overshoot                                            # doctest: +SKIP
    0.387
    """
    experiment = prepare(read_scenario(path_or_name, changes), field_map, device, controller)
    return experiment.judged(experiment.run(seed))


def open_machine(
    path_or_name: PathLike,
    changes: Mapping[str, Any] | None = None,
    *,
    field_map: Field | None = None,
    device: Device | None = None,
    seed: int | None = None,
    gives: str = "signals",
    lower: float | Sequence[float] = -np.inf,
    upper: float | Sequence[float] = np.inf,
) -> RunningMachine:
    """The machine of a scenario at its start, for a loop written by hand: `RunningMachine.step(outputs)`.

    The controllers of the scenario are not used. `simulate` with the same control law as `controller` gives the same
    bits.

    Parameters
    ----------
    path_or_name, changes, field_map, device, seed
        As in `simulate`.
    gives
        Kind of the outputs that `step` takes: "signals", "currents" of the coils, A, or "voltages" of their
        amplifiers.
    lower, upper
        Limits of the outputs.

    Returns
    -------
    RunningMachine
        The machine.

    Examples
    --------
    >>> machine = open_machine("hold", gives="currents")                              # doctest: +SKIP
    >>> while machine.time < 1.0 and machine.event is None:                           # doctest: +SKIP
    ...     measured = machine.step(machine.operating_point.currents)
    """
    hand = prepare(read_scenario(path_or_name, changes), field_map, device, given_outputs(gives))
    start, limits = (hand.state, hand.currents, hand.noise(seed)), (lower, upper)
    return RunningMachine(hand.machine, hand.schedule, *start, gives, *limits, hand.operating_point)
