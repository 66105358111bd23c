"""From a scenario to what runs: machine, controller, schedule, state at the start."""

from dataclasses import dataclass, replace

import numpy as np

from fieldmap.device import Device
from fieldmap.dynamics.blocks import Controller, stacked
from fieldmap.dynamics.closed_loop import Division, Machine, Schedule, simulate_closed_loop
from fieldmap.dynamics.iron import linearised, superposed, tabled
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.outcome import LoopRun
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.scenario.allocation import starting_currents
from fieldmap.dynamics.scenario.controllers import block_of
from fieldmap.dynamics.scenario.linked import fed_forward, linked_controller
from fieldmap.dynamics.scenario.opening import device_and_map, magnet_at, with_depth
from fieldmap.dynamics.scenario.parts import body_of, machine_of
from fieldmap.dynamics.scenario.reader import Scenario
from fieldmap.dynamics.scenario.references import disturbances, open_loop_signals, references
from fieldmap.dynamics.scenario.rests import rest_at
from fieldmap.dynamics.trim import Trim
from fieldmap.errors import NoEquilibrium
from fieldmap.kernels.motion.layout import POSITION, TURN, VELOCITY
from fieldmap.lookup import FieldMap, division_domain, saturates
from fieldmap.typing import Array

MILLI = 1e-3


@dataclass(frozen=True, eq=False)
class Experiment:
    """A scenario made ready: machine, controller, schedule, state (13,) and currents (n,) at the start; rest: where the
    machine is at rest; device: what it is made of."""

    scenario: Scenario
    machine: Machine
    controller: Controller
    schedule: Schedule
    state: Array
    currents: Array
    rest: Trim
    device: Device

    def warm(self) -> None:
        """One control period, so that what is timed after it is compiled."""
        first = replace(self.schedule, references=self.schedule.references[:1], feedforward=None, loads=None)
        simulate_closed_loop(self.machine, self.controller, first, self.state, self.currents, None)

    def run(self, seed: int | np.random.SeedSequence | None = None) -> LoopRun:
        """One run; the scenario's own seed unless one is given."""
        noise = self.scenario.contents.noise
        chosen = noise.seed if seed is None else seed
        return simulate_closed_loop(
            self.machine,
            self.controller,
            self.schedule,
            self.state,
            self.currents,
            None if noise.off else chosen,
        )


def prepare(scenario: Scenario, field_map: FieldMap | None = None) -> Experiment:
    """Open the map, find where the machine rests at the start, make the controllers.

    field_map: in the place of the scenario's map. Raises ScenarioError, MapFileError, NoEquilibrium.
    """
    device, opened = device_and_map(scenario, field_map)
    body = body_of(scenario, device, opened)
    scenario = with_depth(scenario, device, opened, body)
    machine, rest = _machine_at_rest(scenario, device, opened, body)
    contents = scenario.contents
    start_mm = _reading(rest.sensed, contents.sensors.zero_depth_mm)
    wanted = references(scenario, start_mm)
    control = contents.control
    schedule = Schedule(
        _into_map(wanted, contents.sensors.zero_depth_mm),
        MILLI * control.period_ms,
        MILLI * control.step_ms,
        MILLI * control.delay_ms,
        open_loop_signals(scenario),
        disturbances(scenario),
        contents.record.every,
    )
    controller: Controller
    if control.linked is not None:
        controller = linked_controller(scenario, machine, rest)
    else:
        controller = stacked(*(block_of(scenario, axis, rest) for axis in "zxy"))
    schedule = fed_forward(scenario, machine, controller, rest, schedule)
    begin = _start(scenario, rest)
    return Experiment(scenario, machine, controller, schedule, begin, rest.currents, rest, device)


def _machine_at_rest(
    scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody
) -> tuple[Machine, Trim]:
    """The machine, and where it rests. Saturating iron is linearised about the currents of that rest."""
    keys = scenario.contents.field
    guess, allocation = starting_currents(scenario, device, opened, body, magnet_at(scenario, opened, body))
    divided = division_domain(opened) is not None
    if not saturates(opened) or keys.iron == "table" or (keys.iron == "auto" and divided):
        nodes = None if keys.table is None else (keys.table[0], keys.table[1], keys.table[2])
        superposes = not saturates(opened)
        field = superposed(opened, keys.scale) if superposes else tabled(opened, nodes, keys.scale)
        machine = machine_of(scenario, device, body, field, allocation)
        return machine, _rest(scenario, machine, guess)
    currents, rest = guess, None
    for _ in range(12):
        field = linearised(opened, currents, keys.scale)
        machine = machine_of(scenario, device, body, field, allocation)
        rest = _rest(scenario, machine, currents)
        change = float(np.abs(rest.currents - currents).max())
        currents = rest.currents
        if change < 1e-6:
            return machine, rest
    raise NoEquilibrium(
        scenario.error(
            "start",
            "currents at rest must settle",
            f"a change of {change:.1e} A",
            'take field.iron = "table"',
        ).problems[0]
    )


def _rest(scenario: Scenario, machine: Machine, currents: Array) -> Trim:
    divided = isinstance(machine.allocation, Division)
    level = float(np.mean(currents) if divided else np.abs(currents).max())
    guess = [level / machine.drive.amplifier.gain, 0.0, 0.0]
    return rest_at(scenario, machine, scenario.start_depth_mm, guess)


def _start(scenario: Scenario, rest: Trim) -> Array:
    """The state at rest, shifted, leaning and moving as asked for."""
    keys = scenario.contents.start
    state = rest.state.copy()
    x, y, depth = (MILLI * value for value in keys.shift_mm)
    state[POSITION : POSITION + 3] += x, y, -depth
    state[VELOCITY : VELOCITY + 3] = MILLI * np.asarray(keys.velocity_mm_per_s)
    half = np.deg2rad(keys.lean_deg) / 2
    w, a, b, c = state[TURN : TURN + 4]
    turned = [w * np.cos(half) - a * np.sin(half), a * np.cos(half) + w * np.sin(half)]
    turned += [b * np.cos(half) - c * np.sin(half), c * np.cos(half) + b * np.sin(half)]
    return state_of(state[:3], state[3:6], turned, state[10:])


def _reading(sensed: Array, zero_mm: float) -> Array:
    """x, y and depth in mm of points (..., 3) of the map."""
    return np.asarray(sensed) * [1e3, 1e3, -1e3] - [0.0, 0.0, zero_mm]


def _into_map(reading: Array, zero_mm: float) -> Array:
    return (reading + [0.0, 0.0, zero_mm]) * [MILLI, MILLI, -MILLI]
