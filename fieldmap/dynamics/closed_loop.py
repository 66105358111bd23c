"""A levitated magnet in closed loop on a map: one run of the compiled loop, many runs, or a run sample by sample.

Controllers are those of `fieldmap.control`, whose `simulate_loop` runs the same controllers on a linear plant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_count, check_positive, check_signal
from fieldmap.control.blocks import Controller
from fieldmap.control.bound_function import BoundFunction, failure, guarded, written_beside
from fieldmap.control.function_controller import FunctionController
from fieldmap.core import closed_loop as compiled
from fieldmap.core.controller import SIGNALS, CoreController
from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import STATE, CoreMachine, sensed_point
from fieldmap.dynamics.allocation import MatrixAllocation
from fieldmap.dynamics.field_sensing import FieldSensors
from fieldmap.dynamics.loop_run import Event, IronUse, LevitationRun, PartsOfState, WindingUse, event_of
from fieldmap.dynamics.machine import CONTACTS, Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.errors import ControllerError, InputError, NotConverged
from fieldmap.records import Record
from fieldmap.typing import Array

_WHERE = "simulate_closed_loop"


@dataclass(frozen=True, eq=False, repr=False)
class Schedule(Record):
    """The two rates of a run, and its references, feed-forward and loads.

    references (p, 3): of the sensed point, m, frame of the map, one row per control period. period, step: of control
    and mechanics, s; period and delay are whole numbers of steps. delay: from sample to command, s, at most one period.
    feedforward (p, m) or None: added to the outputs before their limits. loads (p, 6) or (1, 6): disturbing force (N)
    and torque (N m) on the body. every: periods from one recorded row to the next.
    """

    references: Array
    period: float = 2e-3
    step: float = 1e-4
    delay: float = 0.0
    feedforward: Array | None = None
    loads: Array | None = None
    every: int = 1

    def __post_init__(self) -> None:
        check_positive("Schedule", period=self.period, step=self.step)
        check_count("Schedule", every=self.every)
        references = np.ascontiguousarray(check_signal("Schedule(references)", self.references, columns=3))
        object.__setattr__(self, "references", references)
        ratio, late = self.period / self.step, self.delay / self.step
        whole = abs(ratio - round(ratio)) < 1e-6 and abs(late - round(late)) < 1e-6
        fits = whole and ratio >= 0.5 and -1e-9 <= late <= ratio + 1e-6
        must = "step must go into period and delay a whole number of times, delay must be at most a period"
        received = f"period {self.period:g}, step {self.step:g}, delay {self.delay:g} s"
        check(fits, "Schedule(step)", must, received, "take for example 2e-3, 1e-4 and 5e-4")

    @property
    def clock(self) -> compiled.Timing:
        """The rates as the compiled loop takes them."""
        return compiled.Timing(
            float(self.step), round(self.period / self.step), round(self.delay / self.step), int(self.every)
        )

    @property
    def duration(self) -> float:
        """Length of a run, s."""
        return len(self.references) * self.period


@dataclass(frozen=True, eq=False, repr=False)
class Begun(Record):
    """A run at its beginning. loop: the loop of `machine` that the C core advances; search: the separate machine in
    which an inverse map searches, or None; event: the event that ended the run at once, or GOES_ON."""

    loop: compiled.Loop
    machine: CoreMachine
    search: CoreMachine | None
    event: int


def simulate_closed_loop(
    machine: Machine,
    controller: Controller | FunctionController,
    schedule: Schedule,
    state: ArrayLike,
    currents: ArrayLike,
    seed: int | np.random.SeedSequence | None = 0,
) -> LevitationRun:
    """One run from a state and currents.

    Parameters
    ----------
    machine
        Field, body, coils, amplifiers, sensors and allocation.
    controller
        A shipped controller, or a function as a `FunctionController`.
    schedule
        References, the two rates, feed-forward and loads.
    state
        (13,) at the start.
    currents
        (n,) at the start, A.
    seed
        Seed of all noise: equal seeds give runs that are equal to the bit; None for a run without noise.

    Returns
    -------
    LevitationRun
        The recorded run, and how it ended.

    Raises
    ------
    InputError
        For arguments that do not fit.
    NotConverged
        If the model of saturating iron has no solution at the initial currents.
    ControllerError
        If the function fails during the run. An exception outside `Exception`, such as KeyboardInterrupt, is not
        wrapped.
    """
    bound = None
    if isinstance(controller, FunctionController):
        machine = machine_for(machine, controller.gives)
        bound = controller.bound(machine.allocation.output_names, measured_by(machine))
        law = function_law(machine, bound.address, controller)
    else:
        count = len(machine.allocation.output_names)
        remedy = "stack one block for each output, such as lift, x and y"
        fits = controller.outputs == count
        check(fits, f"{_WHERE}(controller)", f"must have {count} outputs", controller.outputs, remedy)
        inverse = controller.inverse(np.array(check_signal(f"{_WHERE}(state)", state)))
        blocks, allocation = CoreController(controller.arrays).controller, machine.allocation.numbers()
        law = compiled.ControlLaw(compiled.NO_FUNCTION, blocks, allocation, inverse)
    begun = start_loop(machine, law, controller.memory, schedule, state, currents, seed)
    loop, event = begun.loop, begun.event
    if event == compiled.GOES_ON:
        event = loop.go_on()
    run = run_of(machine, schedule, begun, event)
    if isinstance(controller, FunctionController) and bound is not None:
        run = replace(run, assumptions=(*run.assumptions, controller.assumption))
        seen = loop.seen, loop.outputs, loop.sensing.measured
        problem = written_beside(loop.time, loop.memory, *seen)
        if problem is not None:
            raise ControllerError(problem, time=loop.time, run=run)
        if event in (LIBRARY.CONTROLLER_FAILED, LIBRARY.OUTPUTS_NOT_FINITE):
            raise controller_error(bound, machine.allocation.output_names, loop, run)
    return run


def machine_for(machine: Machine, gives: str) -> Machine:
    """The machine with the control allocation for the outputs of a function: "signals", "currents" or "voltages"."""
    if gives == "signals":
        return machine
    n, (slope, at_zero) = machine.drive.coils, machine.drive.steady_response
    unit, gain, offset = ("V", np.ones(n), np.zeros(n)) if gives == "voltages" else ("A", slope, at_zero)
    names = tuple(f"coil_{k + 1}_{unit}" for k in range(n))
    direct = MatrixAllocation(np.eye(n) / gain, -offset / gain, names)
    return replace(machine, allocation=direct)


def measured_by(machine: Machine) -> int:
    """Number of measured numbers that a controller function gets."""
    part = machine.sensors.numbers.measured
    return int(part.stop - part.start)


def function_law(machine: Machine, address: int, controller: FunctionController) -> compiled.ControlLaw:
    """The control law of a function at an address, or of outputs that the caller gives."""
    limits = CoreController(controller.limits(len(machine.allocation.output_names)))
    return compiled.ControlLaw(address, limits.controller, machine.allocation.numbers(), None)


def start_loop(
    machine: Machine,
    law: compiled.ControlLaw,
    memory: Array,
    schedule: Schedule,
    state: ArrayLike,
    currents: ArrayLike,
    seed: int | np.random.SeedSequence | np.random.Generator | None,
) -> Begun:
    """The loop at its beginning, with an event if the body is outside already. Raises InputError, NotConverged."""
    begin = np.array(check_signal(f"{_WHERE}(state)", state, columns=STATE))
    amperes = np.array(check_signal(f"{_WHERE}(currents)", currents))
    n, m, coils = machine.drive.coils, len(machine.allocation.output_names), machine.allocation.coils
    check(amperes.shape == (n,), f"{_WHERE}(currents)", f"must be ({n},)", amperes.shape, "one per coil")
    must = f"must have the {coils} coils of its allocation"
    check(coils == n, f"{_WHERE}(machine)", must, n, "take one for these coils")
    core, search, sensing = machine.core(schedule.step), None, machine.sensors.numbers
    if law.inverse is not None:
        # A search for outputs computes slopes by differences, for which the tolerance of a run is too large.
        search = machine.core(schedule.step, search=True)
        law = law._replace(inverse=law.inverse._replace(machine=search.machine))
    row = STATE + (4 if machine.drive.coupled else 2) * n + 3 + m
    loop = compiled.Loop(
        machine=core.machine,
        timing=schedule.clock,
        sensing=sensing,
        law=law,
        ending=machine.end_numbers(schedule.period),
        signals=draw_signals(machine, schedule, seed),
        state=begin,
        currents=amperes,
        # Functions write to the guarded arrays, and a compiled function may write outside them by mistake.
        memory=guarded(memory),
        load=np.zeros(6),
        progress=np.zeros(len(compiled.Progress._fields), np.int64),
        commands=machine.drive.holding(amperes),
        waiting=machine.drive.holding(amperes),
        late=machine.drive.holding(amperes),
        seen=guarded(np.ones(SIGNALS + sensing.shown)),
        outputs=guarded(np.zeros(m)),
        scratch=np.zeros(len(memory) + 2 * m),
        voltages=np.zeros(n),
        rows=np.empty((-(-len(schedule.references) // schedule.every), row)),
    )
    event = loop.begin()
    if core.solves.unsolved:
        where, must = f"{_WHERE}(currents)", "must be such that the model of the iron has a solution"
        raise NotConverged.of(where, must, f"{amperes.tolist()} A", "begin within the map's currents")
    return Begun(loop, core, search, event)


def run_of(machine: Machine, schedule: Schedule, begun: Begun, event: int) -> LevitationRun:
    """The run that a loop has recorded so far."""
    loop = begun.loop
    done = loop.done
    # Solves of the inverse map's search count too.
    solves = [each.solves for each in (begun.machine, begun.search) if each is not None]
    windings = _winding_use(machine, schedule, begun)
    return LevitationRun(
        time=np.asarray(schedule.period * schedule.every * np.arange(done.rows), np.float64),
        rows=loop.rows[: done.rows],
        coils=machine.drive.coils,
        seen_at=machine.body.seen_at,
        references=schedule.references[:: schedule.every][: done.rows],
        event=event_of(event, loop.time, loop.state, loop.currents),
        touched=tuple(name for name, bit in CONTACTS.items() if done.touched & bit),
        assumptions=machine.assumptions,
        forces=loop.law.inverse is not None,
        output_names=machine.allocation.output_names,
        iron=IronUse(machine.magnetic.iron, *map(sum, zip(*solves, strict=True))),
        windings=windings,
    )


def _winding_use(machine: Machine, schedule: Schedule, begun: Begun) -> WindingUse | None:
    state, n, heating = begun.machine.coil_state, machine.drive.coils, machine.drive.heating
    if state is None:
        return None
    rows = begun.loop.rows[: begun.loop.done.rows]
    too_hot = rows[:, rows.shape[1] - n :] > (np.inf if heating is None else heating.limit)
    first = np.where(too_hot.any(axis=0), too_hot.argmax(axis=0) if len(rows) else 0, np.nan)
    return WindingUse(state.heat, state.input, first * schedule.period * schedule.every)


def controller_error(
    bound: BoundFunction, names: Sequence[str], loop: compiled.Loop, run: LevitationRun
) -> BaseException:
    """The error of a function that failed at the present sample of the loop, with the run up to that sample."""
    state = loop.scratch[: len(loop.memory)].copy()
    given = loop.time, loop.seen[loop.sensing.measured].copy(), loop.seen[:3].copy(), state
    problem, cause = failure(bound, names, loop.done.answer, loop.outputs, given)
    if cause is not None and not isinstance(cause, Exception):
        return cause
    error = ControllerError(problem, time=loop.time, run=run)
    error.__cause__ = cause
    return error


def draw_signals(
    machine: Machine, schedule: Schedule, seed: int | np.random.SeedSequence | np.random.Generator | None
) -> compiled.Signals:
    """References, feed-forward, loads, and all noise of a run."""
    periods, sensors = len(schedule.references), machine.sensors
    n, m = machine.drive.coils, len(machine.allocation.output_names)
    forward = np.zeros((periods, m)) if schedule.feedforward is None else schedule.feedforward
    loads = np.zeros((1, 6)) if schedule.loads is None else schedule.loads
    deviations = sensors.field_deviations if isinstance(sensors, FieldSensors) else np.zeros(0)
    scans = sensors.scans(schedule.duration)
    shapes = ((periods, 3), (periods, 3), (periods, n), (scans, 3), (periods, len(deviations)))
    if seed is None:
        noise = [np.zeros(shape) for shape in shapes]
    else:
        generator = (
            seed if isinstance(seed, np.random.Generator) else np.random.Generator(np.random.PCG64(seed))
        )
        noise = [generator.standard_normal(shape) for shape in shapes]
        noise[0] *= sensors.deviations
        noise[1] *= sensors.voltage_noise
        noise[2] *= machine.drive.amplifier.deviation
        noise[3] *= sensors.scan_deviations
        noise[4] *= deviations
    return compiled.Signals(
        schedule.references,
        np.ascontiguousarray(check_signal("Schedule(feedforward)", forward, columns=m)),
        np.ascontiguousarray(check_signal("Schedule(loads)", loads, columns=6)),
        *noise,
    )


def simulate_many(
    runs: Sequence[Callable[[np.random.SeedSequence], LevitationRun]] | int,
    one: Callable[[np.random.SeedSequence], LevitationRun] | None = None,
    *,
    seed: int = 0,
    threads: int = 1,
    keep: Callable[[LevitationRun], Any] = lambda run: run,
    progress: Callable[[str, float], None] = lambda message, fraction: None,
) -> list[Any]:
    """Many runs on several threads. The noise of a run depends only on its number and on `seed`.

    Threads run at the same time, because the compiled loop releases the interpreter's lock.

    Parameters
    ----------
    runs
        How many calls of `one`, or a function for each. Each takes the run's seed and returns its
        LevitationRun.
    one
        Function that is called if `runs` is a number.
    seed
        Seed of all runs.
    threads
        Number of threads.
    keep
        Function that turns each run into its entry of the result.
    progress
        Called after each run, with a message and the finished fraction.

    Returns
    -------
    list[Any]
        Results of `keep`, in the order of the runs.
    """
    calls: list[Any] = [one] * runs if isinstance(runs, int) else list(runs)
    check(None not in calls, "simulate_many(one)", "must be a function", "None", "give what to run")
    seeds, found = np.random.SeedSequence(seed).spawn(len(calls)), []
    with ThreadPoolExecutor(threads, "fieldmap dynamics") if threads > 1 else nullcontext() as pool:
        each = map if pool is None else pool.map
        for result in each(lambda call, own: keep(call(own)), calls, seeds):
            found.append(result)
            progress(f"run {len(found)} of {len(calls)}", len(found) / len(calls))
    return found


class RunningMachine(PartsOfState):
    """A machine with its coils, amplifiers, sensors, delay and noise; each call of `step` advances it by one sample.

    Arguments are as in `simulate_closed_loop`; gives, lower and upper as in `FunctionController`. The compiled code
    is the same as in whole runs: a loop that passes a function's outputs to `step` equals a run with that function to
    the bit. Noise is drawn for the length of the schedule, and again for the same length whenever it is used up. From
    then on references, feed-forward and loads keep their last values.
    """

    def __init__(
        self,
        machine: Machine,
        schedule: Schedule,
        state: ArrayLike,
        currents: ArrayLike,
        seed: int | np.random.SeedSequence | None = 0,
        gives: str = "signals",
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        operating_point: OperatingPoint | None = None,
    ) -> None:
        limits = given_outputs(gives, lower, upper)
        self.machine = machine_for(machine, gives)
        self.schedule = schedule
        self.operating_point = operating_point
        self._law = function_law(self.machine, compiled.GIVEN, limits)
        self._start = (np.array(state, float), np.array(currents, float))
        self._seed = seed
        self._clock = schedule.clock
        self.reset()

    def reset(self, seed: int | np.random.SeedSequence | None = None) -> Array:
        """Go back to the start.

        Parameters
        ----------
        seed
            Seed of the noise; by default the last seed.

        Returns
        -------
        Array
            Measured position at the start (3,), m.
        """
        self._seed = self._seed if seed is None else seed
        self._generator = None if self._seed is None else np.random.Generator(np.random.PCG64(self._seed))
        self._begun = start_loop(
            self.machine, self._law, np.zeros(0), self.schedule, *self._start, self._generator
        )
        loop = self._begun.loop
        # Copies, because `_renew` writes rows, which must not change the arrays of the schedule.
        copies = {name: getattr(loop.signals, name).copy() for name in ("references", "feedforward", "loads")}
        self._loop = loop._replace(signals=loop.signals._replace(**copies))
        self._times: list[float] = []
        self._asked: list[Array] = []
        self._even = True
        event = self._begun.event
        self._event = self._loop.go_on() if event == compiled.GOES_ON else event
        return self.measured

    def step(self, outputs: ArrayLike, dt: float | None = None) -> Array:
        """Take the outputs for the present sample, and run to the next sample.

        Parameters
        ----------
        outputs
            Outputs (m,) of the controller.
        dt
            Time to the next sample, s: a whole number of mechanical steps of the schedule, and no less than its
            delay. The default is the schedule's period.

        Returns
        -------
        Array
            Measured position at the next sample (3,), m.

        Raises
        ------
        InputError
            For invalid outputs or dt, and after an event has ended the run.
        """
        loop, names, given = self._loop, self.output_names, np.asarray(outputs, float)
        fits = given.shape == (len(names),) or (given.ndim == 0 and len(names) == 1)
        if not (fits and np.isfinite(given).all()):
            must = f"must be {len(names)} finite numbers: {', '.join(names)}"
            received = f"{given.tolist()}" if fits else f"an array {given.shape}"
            raise InputError.of("RunningMachine.step(outputs)", must, received, "give one number for each")
        if self._event != compiled.PAUSED:
            event = self.event
            received = "an event" if event is None else f"{event.name} at {event.time:g} s"
            remedy = "look at `event`, and call reset() to begin again"
            raise InputError.of(
                "RunningMachine.step", "must be called before the run has ended", received, remedy
            )
        steps = self._steps(dt)
        sample = loop.done.samples
        if sample + 1 >= len(loop.signals.references):
            self._extend()
        self._even = self._even and steps == self._clock.per_period
        if not self._even:
            self._renew(sample, steps)
            self._loop = self._loop._replace(timing=self._clock._replace(per_period=steps))
        self._loop.outputs[:] = given
        if sample % self.schedule.every == 0:
            self._times.append(self.time)
            self._asked.append(self.reference)
        self._event = self._loop.go_on()
        return self.measured

    def _steps(self, dt: float | None) -> int:
        """Mechanical steps until the next sample."""
        clock = self._clock
        if dt is None:
            return clock.per_period
        ratio = dt / clock.step
        if not (
            np.isfinite(ratio) and abs(ratio - round(ratio)) < 1e-6 and round(ratio) >= max(1, clock.delay)
        ):
            late = f", and at least the delay of {clock.delay * clock.step:g} s" if clock.delay else ""
            must = f"must be one or more whole mechanical steps of {clock.step:g} s{late}"
            near = clock.step * max(round(ratio) if np.isfinite(ratio) else 1, 1, clock.delay)
            remedy = f"take dt={near:g}, or leave it out for the period of {self.schedule.period:g} s"
            raise InputError.of("RunningMachine.step(dt)", must, f"{dt:g} s", remedy)
        return round(ratio)

    def _extend(self) -> None:
        """Lengthen the signals by one schedule: new noise, and the last references, feed-forward and loads."""
        loop, old = self._loop, self._loop.signals
        new = draw_signals(self.machine, self.schedule, self._generator)
        longer = {name: np.concatenate([getattr(old, name), getattr(new, name)]) for name in old._fields}
        count = len(new.references)
        for name in ("references", "feedforward"):
            longer[name][-count:] = getattr(old, name)[-1]
        longer["loads"] = old.loads
        if len(old.loads) > 1:
            longer["loads"] = np.concatenate([old.loads, np.tile(old.loads[-1], (count, 1))])
        rows = np.concatenate([loop.rows, np.empty((count, loop.rows.shape[1]))])
        self._loop = loop._replace(signals=compiled.Signals(**longer), rows=rows)

    def _renew(self, sample: int, steps: int) -> None:
        """Fill the rows of a sample at an uneven time from the period of the schedule in which it lies."""
        clock, signals = self._clock, self._loop.signals
        done = self._loop.done.steps
        given = {"references": self.schedule.references, "feedforward": self.schedule.feedforward}
        given["loads"] = None if len(signals.loads) == 1 else self.schedule.loads
        for name, rows in given.items():
            if rows is not None:
                # Feed-forward and loads act after this sample, references are read at the next one.
                after = done + steps if name == "references" else done
                number = sample + 1 if name == "references" else sample
                getattr(signals, name)[number] = rows[min(after // clock.per_period, len(rows) - 1)]

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs that `step` takes, with units."""
        return self.machine.allocation.output_names

    @property
    def time(self) -> float:
        """Time of the present sample, s."""
        return self._loop.time

    @property
    def measured(self) -> Array:
        """Position of the sensed point by the sensors (3,), m, frame of the map."""
        return np.array(self._loop.seen[3:6])

    @property
    def readings(self) -> Array:
        """Readings of field sensors (s,), T; empty for position sensors."""
        return np.array(self._loop.seen[SIGNALS : len(self._loop.seen) - self.machine.drive.coils])

    @property
    def measured_currents(self) -> Array:
        """Currents (n,), A, measured with these readings."""
        return np.array(self._loop.seen[SIGNALS + len(self.readings) :])

    @property
    def reference(self) -> Array:
        """Reference of the sensed point (3,), m."""
        return np.array(self._loop.seen[:3])

    @property
    def outputs(self) -> Array:
        """The last outputs, within their limits (m,)."""
        return np.array(self._loop.outputs)

    @property
    def state(self) -> Array:
        """True position, velocity, quaternion and angular velocity (13,)."""
        return np.array(self._loop.state)

    @property
    def sensed(self) -> Array:
        """True position of the sensed point (3,), m."""
        return sensed_point(self._loop.state, self.machine.body.seen_at)

    @property
    def currents(self) -> Array:
        """Currents of the coils (n,), A."""
        return np.array(self._loop.currents)

    @property
    def event(self) -> Event | None:
        """The event that ended the run; None if none did."""
        number = compiled.GOES_ON if self._event == compiled.PAUSED else self._event
        return event_of(number, self.time, self.state, self.currents)

    @property
    def run(self) -> LevitationRun:
        """The run recorded so far."""
        loop = self._loop._replace(rows=self._loop.rows.copy())
        run = run_of(self.machine, self.schedule, replace(self._begun, loop=loop), compiled.GOES_ON)
        references = np.array(self._asked).reshape(-1, 3)
        return replace(run, time=np.array(self._times), references=references, event=self.event)


def given_outputs(gives: str, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf) -> FunctionController:
    """Kind and limits of outputs that the caller gives, as a controller that is never called."""

    def given(time: float, measured: Array, reference: Array, state: Array) -> Array:
        raise AssertionError

    return FunctionController(given, gives=gives, lower=lower, upper=upper)
