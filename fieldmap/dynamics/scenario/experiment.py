"""From a scenario to a run: machine, controller, schedule, state at the start."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.control.blocks import Controller, stacked
from fieldmap.control.function_controller import FunctionController, as_controller
from fieldmap.core.machine import POSITION, TURN, VELOCITY
from fieldmap.device import Device
from fieldmap.dynamics.allocation import ParametrisedAllocation
from fieldmap.dynamics.closed_loop import Schedule, machine_for, simulate_closed_loop
from fieldmap.dynamics.field_of_currents import FieldOfCurrents, linearised, modelled, superposed, tabled
from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.running_machine import RunningMachine, given_outputs
from fieldmap.dynamics.scenario.controller_schema import OwnKeys
from fieldmap.dynamics.scenario.controllers import block_of, coupled_controller, fed_forward
from fieldmap.dynamics.scenario.machine import body_of, device_and_map, machine_of
from fieldmap.dynamics.scenario.metrics import RunMetrics, reading_mm, run_metrics
from fieldmap.dynamics.scenario.reading import Scenario, read_scenario
from fieldmap.dynamics.scenario.references import disturbances, open_loop_signals, references
from fieldmap.dynamics.scenario.start import magnet_at, operating_point_at, starting_currents, with_depth
from fieldmap.errors import NoEquilibrium
from fieldmap.field import Field
from fieldmap.lookup import FieldMap, saturates
from fieldmap.records import Record
from fieldmap.typing import Array

MILLI = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Record):
    """A scenario made ready: machine, controller, schedule, state (13,) and currents (n,) at the start; its
    operating point there; device: what it is made of. controller: None for a scenario that leaves it to the caller."""

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
        """What its runs rest on: the machine's, and a controller of the caller's own."""
        own = self.controller
        return (*self.machine.assumptions, *([own.assumption] if isinstance(own, FunctionController) else []))

    def warm(self) -> None:
        """One control period, so that what is timed after it is compiled."""
        first = replace(self.schedule, references=self.schedule.references[:1], feedforward=None, loads=None)
        if isinstance(self.controller, FunctionController):
            # Without a call of the function, which may remember it.
            names = machine_for(self.machine, self.controller.gives).allocation.output_names
            self.controller.bound(names)
            self.running(None, self.controller.gives).step(np.zeros(len(names)))
            return
        simulate_closed_loop(self.machine, self._given(), first, self.state, self.currents, None)

    def run(self, seed: int | np.random.SeedSequence | None = None) -> LevitationRun:
        """One run; the scenario's own seed unless one is given."""
        return simulate_closed_loop(
            self.machine, self._given(), self.schedule, self.state, self.currents, self._noise(seed)
        )

    def running(
        self,
        seed: int | None = None,
        gives: str = "signals",
        lower: float | Sequence[float] = -np.inf,
        upper: float | Sequence[float] = np.inf,
    ) -> RunningMachine:
        """The machine at its start, for a loop written by hand; arguments as of `open_machine`."""
        return RunningMachine(
            self.machine,
            self.schedule,
            self.state,
            self.currents,
            self._noise(seed),
            gives,
            lower,
            upper,
            self.operating_point,
        )

    def _given(self) -> Controller | FunctionController:
        if self.controller is None:
            must, remedy = (
                "needs a controller that the caller gives",
                "give one: controller=, or --controller",
            )
            raise self.scenario.error("control.coupled", must, "none", remedy)
        return self.controller

    def _noise(self, seed: int | np.random.SeedSequence | None) -> int | np.random.SeedSequence | None:
        noise = self.scenario.contents.noise
        return None if noise.off else noise.seed if seed is None else seed


def prepare(
    scenario: Scenario,
    field_map: Field | None = None,
    device: Device | None = None,
    controller: Controller | FunctionController | Callable[..., Any] | None = None,
) -> Experiment:
    """Open the map, find the operating point at the start, make the controllers.

    field_map: in the place of the scenario's map, a map or any field, which is sampled: `sampled_field`. device: in the
    place of the scenario's or the map's. controller: in the place of the scenario's, a function or any other. Raises
    ScenarioError, MapFileError, InputError, NoEquilibrium.
    """
    own = None if controller is None else as_controller(controller)
    if isinstance(own, FunctionController):
        scenario = _with_function(scenario, own)
    device, opened = device_and_map(scenario, field_map, device)
    body = body_of(scenario, device, opened)
    scenario = with_depth(scenario, device, opened, body)
    machine, operating_point = _machine_at_operating_point(scenario, device, opened, body)
    contents = scenario.contents
    start_mm = reading_mm(scenario, operating_point.sensed)
    wanted = references(scenario, start_mm)
    control = contents.control
    schedule = Schedule(
        _into_map(wanted, scenario.zero_depth_mm),
        MILLI * control.period_ms,
        MILLI * control.step_ms,
        MILLI * control.delay_ms,
        open_loop_signals(scenario) if contents.signal else None,
        disturbances(scenario),
        contents.record.every,
    )
    if own is None:
        own = _shipped(scenario, machine, operating_point)
    if own is not None:
        schedule = fed_forward(scenario, machine, own, operating_point, schedule)
    begin = _start(scenario, operating_point)
    return Experiment(
        scenario, machine, own, schedule, begin, operating_point.currents, operating_point, device
    )


def _shipped(scenario: Scenario, machine: Machine, operating_point: OperatingPoint) -> Controller | None:
    """The controller that a scenario describes; None where it leaves it to the caller."""
    if isinstance(scenario.contents.control.coupled, OwnKeys):
        return None
    if scenario.contents.control.coupled is not None:
        return coupled_controller(scenario, machine, operating_point)
    return stacked(*(block_of(scenario, axis, operating_point) for axis in "zxy"))


def _with_function(scenario: Scenario, controller: FunctionController) -> Scenario:
    """The scenario at the function's own period. Raises ScenarioError for keys that a function cannot follow."""
    contents = scenario.contents
    if contents.control.feedforward is not None:
        must, remedy = "must be left out beside a controller that is a function", "add it in the function"
        raise scenario.error("control.feedforward", must, "both", remedy)
    if contents.signal and controller.gives != "signals":
        must, remedy = "must be left out: the outputs are no signals", 'take gives="signals", or leave it out'
        raise scenario.error("signal", must, controller.gives, remedy)
    if controller.period is None:
        return scenario
    control = contents.control.model_copy(update={"period_ms": controller.period / MILLI})
    return replace(scenario, contents=contents.model_copy(update={"control": control}))


def _machine_at_operating_point(
    scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody
) -> tuple[Machine, OperatingPoint]:
    """The machine and its operating point, about whose currents saturating iron is linearised if that is asked for."""
    keys = scenario.contents.field
    guess, allocation = starting_currents(scenario, device, opened, body, magnet_at(scenario, opened, body))
    if not saturates(opened) or keys.iron != "linearised":
        machine = machine_of(scenario, device, body, _field_of(scenario, opened), allocation)
        return machine, _first_point(scenario, machine, opened, guess)
    currents, operating_point = guess, None
    for _ in range(12):
        field = linearised(opened, currents, keys.scale)
        machine = machine_of(scenario, device, body, field, allocation)
        operating_point = _first_point(scenario, machine, opened, currents)
        change = float(np.abs(operating_point.currents - currents).max())
        currents = operating_point.currents
        if change < 1e-6:
            return machine, operating_point
    raise NoEquilibrium(
        scenario.error(
            "start",
            "currents of the operating point must settle",
            f"a change of {change:.1e} A",
            'take field.iron = "model"',
        ).problems[0]
    )


def _field_of(scenario: Scenario, opened: FieldMap) -> FieldOfCurrents:
    """The field of the currents, at any of them that the map is for."""
    keys = scenario.contents.field
    if not saturates(opened):
        return superposed(opened, keys.scale)
    if keys.iron == "table" or (keys.iron == "auto" and keys.table is not None):
        nodes = None if keys.table is None else (keys.table[0], keys.table[1], keys.table[2])
        return tabled(opened, nodes, keys.scale)
    return modelled(opened, keys.scale)


def _first_point(scenario: Scenario, machine: Machine, opened: FieldMap, currents: Array) -> OperatingPoint:
    divided = isinstance(machine.allocation, ParametrisedAllocation)
    level = float(np.mean(currents) if divided else np.abs(currents).max())
    if not divided and opened.fixed_sources:
        lift = machine.allocation.voltages(np.array([1.0, 0.0, 0.0]))
        level = float(currents @ lift / (lift @ lift))
    guess = [level / machine.drive.amplifier.gain, 0.0, 0.0]
    return operating_point_at(scenario, machine, scenario.start_depth_mm, guess)


def _start(scenario: Scenario, operating_point: OperatingPoint) -> Array:
    """The state of the operating point, shifted, leaning and moving as asked for."""
    keys = scenario.contents.start
    state = operating_point.state.copy()
    x, y, depth = (MILLI * value for value in keys.shift_mm)
    state[POSITION : POSITION + 3] += x, y, -depth
    state[VELOCITY : VELOCITY + 3] = MILLI * np.asarray(keys.velocity_mm_per_s)
    half = np.deg2rad(keys.lean_deg) / 2
    w, a, b, c = state[TURN : TURN + 4]
    turned = [w * np.cos(half) - a * np.sin(half), a * np.cos(half) + w * np.sin(half)]
    turned += [b * np.cos(half) - c * np.sin(half), c * np.cos(half) + b * np.sin(half)]
    return state_of(state[:3], state[3:6], turned, state[10:])


def _into_map(reading: Array, zero_mm: float) -> Array:
    return (reading + [0.0, 0.0, zero_mm]) * [MILLI, MILLI, -MILLI]


@dataclass(frozen=True, eq=False, repr=False)
class ScenarioRun(LevitationRun):
    """A run (`LevitationRun`) with its scenario and its metrics. `print(run)` tells what became of it."""

    scenario: Scenario
    metrics: RunMetrics

    def __str__(self) -> str:
        return f"{self.scenario.contents.title}\n{self.metrics}"


def simulate(
    path_or_name: str | Path,
    changes: Mapping[str, Any] | None = None,
    *,
    field_map: Field | None = None,
    device: Device | None = None,
    seed: int | None = None,
    controller: Controller | FunctionController | Callable[..., Any] | None = None,
) -> ScenarioRun:
    """Run a scenario: its file, or the name of a shipped one.

    changes: values by dotted key in the place of the file's, such as {"control.z.Kc": 0.2}. field_map: in the place of
    the scenario's map, an opened map or any field that is the sum of its coils' fields, such as a solution; the latter
    is sampled, see `sampled_field`. device: in the place of the scenario's or the map's. seed: in the place of its own.
    controller: in the place of the scenario's, a function `outputs = f(time, measured, reference, state)` in Python or
    jitted by numba, a C function, or a `fieldmap.control.FunctionController` of one, which says more. Raises
    ScenarioError with every error of the file, MapFileError, NoEquilibrium where the machine has no equilibrium at the
    start, ControllerError where the function fails. A run that fails does not raise: `event` says what happened.

    >>> run = simulate("vertical_step")                                               # doctest: +SKIP
    >>> run.metrics.axes[2].step.overshoot                                            # doctest: +SKIP
    0.387
    """
    experiment = prepare(read_scenario(path_or_name, changes), field_map, device, controller)
    run, scenario = experiment.run(seed), experiment.scenario
    known = {field.name: getattr(run, field.name) for field in fields(LevitationRun)}
    return ScenarioRun(**known, scenario=scenario, metrics=run_metrics(scenario, run))


def open_machine(
    path_or_name: str | Path,
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

    gives: what is put in: "signals", "currents" of the coils, A, or "voltages" of their amplifiers. lower, upper:
    limits of these. The controllers of the scenario are not used; the rest as of `simulate`, whose runs with the same
    function as `controller` have the same bits.

    >>> machine = open_machine("hold", gives="currents")                              # doctest: +SKIP
    >>> while machine.time < 1.0 and machine.event is None:                           # doctest: +SKIP
    ...     measured = machine.step(machine.operating_point.currents)
    """
    scenario = read_scenario(path_or_name, changes)
    hand = prepare(scenario, field_map, device, given_outputs(gives))
    return hand.running(seed, gives, lower, upper)
