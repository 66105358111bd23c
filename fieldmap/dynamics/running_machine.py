"""A machine that runs sample by sample, for control loops written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.control.function_controller import FunctionController
from fieldmap.core.closed_loop import GIVEN, GOES_ON, PAUSED, Signals
from fieldmap.core.machine import sensed_point
from fieldmap.dynamics.closed_loop import (
    Schedule,
    draw_signals,
    function_law,
    machine_for,
    run_of,
    start_loop,
)
from fieldmap.dynamics.loop_run import Event, LevitationRun, PartsOfState, event_of
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.errors import InputError
from fieldmap.typing import Array

_WHERE = "RunningMachine.step"


class RunningMachine(PartsOfState):
    """A machine with its coils, amplifiers, sensors, delay and noise, moved one sample at a time by who calls `step`.

    Arguments as of `simulate_closed_loop`; gives, lower, upper as of `FunctionController`. The machine code is that of
    whole runs: a loop that calls `step` with what a function says has the bits of a run with that function. Noise is
    drawn for the length of the schedule, and anew for as long again whenever it is used up; references and loads then
    stay as they were last.
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
        self._law = function_law(self.machine, GIVEN, limits)
        self._start = (np.array(state, float), np.array(currents, float))
        self._seed = seed
        self._clock = schedule.clock
        self.reset()

    def reset(self, seed: int | np.random.SeedSequence | None = None) -> Array:
        """Back to the start.

        Parameters
        ----------
        seed
            Of the noise; that of the last run unless given.

        Returns
        -------
        Array
            What is measured at the start (3,), m.
        """
        self._seed = self._seed if seed is None else seed
        self._generator = None if self._seed is None else np.random.Generator(np.random.PCG64(self._seed))
        self._begun = start_loop(
            self.machine, self._law, np.zeros(0), self.schedule, *self._start, self._generator
        )
        loop = self._begun.loop
        # Rows that `_renew` writes must not be those of the schedule.
        copies = {name: getattr(loop.signals, name).copy() for name in ("references", "feedforward", "loads")}
        self._loop = loop._replace(signals=loop.signals._replace(**copies))
        self._times: list[float] = []
        self._asked: list[Array] = []
        self._even = True
        self._advance(self._begun.event)
        return self.measured

    def step(self, outputs: ArrayLike, dt: float | None = None) -> Array:
        """Put outputs in, as a controller does after a sample, and move on to the next one.

        Parameters
        ----------
        outputs
            Outputs (m,) of the controller.
        dt
            Time to the next sample, s: a whole number of mechanical steps of the schedule, and no less than
            its delay. The schedule's period unless given.

        Returns
        -------
        Array
            What is then measured (3,), m.

        Raises
        ------
        InputError
            For outputs and dt that do not fit, and after an event has ended the run.
        """
        loop, names, given = self._loop, self.output_names, np.asarray(outputs, float)
        fits = given.shape == (len(names),) or (given.ndim == 0 and len(names) == 1)
        if not (fits and np.isfinite(given).all()):
            must = f"must be {len(names)} finite numbers: {', '.join(names)}"
            received = f"{given.tolist()}" if fits else f"an array {given.shape}"
            raise InputError.of(f"{_WHERE}(outputs)", must, received, "give one number for each")
        if self._event != PAUSED:
            event = self.event
            received = "an event" if event is None else f"{event.name} at {event.time:g} s"
            remedy = "look at `event`, and call reset() to begin again"
            raise InputError.of(_WHERE, "must be called before the run has ended", received, remedy)
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
        self._advance(GOES_ON)
        return self.measured

    def _advance(self, event: int) -> None:
        self._event = self._loop.go_on() if event == GOES_ON else event

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
            raise InputError.of(f"{_WHERE}(dt)", must, f"{dt:g} s", remedy)
        return round(ratio)

    def _extend(self) -> None:
        """Noise for as long again, and references, feed-forward and loads as they were last."""
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
        self._loop = loop._replace(signals=Signals(**longer), rows=rows)

    def _renew(self, sample: int, steps: int) -> None:
        """Rows of the samples at uneven times: those of the schedule's periods in which they lie."""
        clock, signals = self._clock, self._loop.signals
        done = self._loop.done.steps
        given = {"references": self.schedule.references, "feedforward": self.schedule.feedforward}
        given["loads"] = None if len(signals.loads) == 1 else self.schedule.loads
        for name, rows in given.items():
            if rows is not None:
                # Feed-forward and loads are taken after this sample, references with the next one.
                after = done + steps if name == "references" else done
                number = sample + 1 if name == "references" else sample
                getattr(signals, name)[number] = rows[min(after // clock.per_period, len(rows) - 1)]

    @property
    def output_names(self) -> tuple[str, ...]:
        """What `step` takes, with units."""
        return self.machine.allocation.output_names

    @property
    def time(self) -> float:
        """s."""
        return self._loop.time

    @property
    def measured(self) -> Array:
        """What the sensors say now of the sensed point (3,), m, frame of the map."""
        return np.array(self._loop.seen[3:6])

    @property
    def reference(self) -> Array:
        """Of the sensed point (3,), m."""
        return np.array(self._loop.seen[:3])

    @property
    def outputs(self) -> Array:
        """The last that were put in, within their limits (m,)."""
        return np.array(self._loop.outputs)

    @property
    def state(self) -> Array:
        """Place, velocity, quaternion, angular velocity (13,), as they are."""
        return np.array(self._loop.state)

    @property
    def sensed(self) -> Array:
        """The sensed point (3,), m, as it is."""
        return sensed_point(self._loop.state, self.machine.body.seen_at)

    @property
    def currents(self) -> Array:
        """(n,), A."""
        return np.array(self._loop.currents)

    @property
    def event(self) -> Event | None:
        """What has ended the run, if anything has."""
        number = GOES_ON if self._event == PAUSED else self._event
        return event_of(number, self.time, self.state, self.currents)

    @property
    def run(self) -> LevitationRun:
        """What was recorded so far: one row for each step."""
        loop = self._loop._replace(rows=self._loop.rows.copy())
        run = run_of(self.machine, self.schedule, replace(self._begun, loop=loop), GOES_ON)
        references = np.array(self._asked).reshape(-1, 3)
        return replace(run, time=np.array(self._times), references=references, event=self.event)


def given_outputs(gives: str, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf) -> FunctionController:
    """What stands for the controller of a machine that is moved by hand: its outputs and limits. It is never called."""

    def given(time: float, measured: Array, reference: Array, state: Array) -> Array:
        raise AssertionError

    return FunctionController(given, gives=gives, lower=lower, upper=upper)
