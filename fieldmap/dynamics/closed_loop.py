"""A levitated magnet in closed loop on a map: one run of the compiled loop, and many of them.

The controller, the instruments and what a run records are those of `fieldmap.control`, whose `simulate_loop` runs the
same controllers on a linear plant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_positive, check_signal
from fieldmap.control.blocks import Controller
from fieldmap.dynamics.loop_run import LevitationRun, event_of
from fieldmap.dynamics.machine import CONTACTS, Machine
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.motion.closed_loop import Moving, Signals, Timing, closed_loop
from fieldmap.kernels.motion.inverse import NO_INVERSE
from fieldmap.kernels.motion.layout import STATE
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Schedule(Record):
    """The two rates of a run, and what is asked for.

    references (p, 3): of the sensed point, m, frame of the map, one row per control period. period, step: s; step must
    go into the period a whole number of times. delay: from sample to command, s, at most one period. feedforward (p, m)
    or None: added to the outputs before their limits. loads (p, 6) or (1, 6): force (N) and torque (N m) that disturb.
    every: periods from one recorded row to the next.
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
        if not (whole and ratio >= 0.5 and -1e-9 <= late <= ratio + 1e-6):
            must = (
                "step must go into period and delay a whole number of times, delay must be at most a period"
            )
            received = f"period {self.period:g}, step {self.step:g}, delay {self.delay:g} s"
            raise InputError(
                Problem("Schedule(step)", must, received, "take for example 2e-3, 1e-4 and 5e-4")
            )

    @property
    def clock(self) -> Timing:
        """As the compiled loop takes it."""
        return Timing(
            float(self.step), round(self.period / self.step), round(self.delay / self.step), int(self.every)
        )

    @property
    def duration(self) -> float:
        """Length of a run, s."""
        return len(self.references) * self.period


def simulate_closed_loop(
    machine: Machine,
    controller: Controller,
    schedule: Schedule,
    state: ArrayLike,
    currents: ArrayLike,
    seed: int | np.random.SeedSequence | None = 0,
) -> LevitationRun:
    """One run from a state (13,) and currents (n,), A.

    seed: of all noise: equal seeds give equal bits; None for a run without noise. Raises InputError for arguments that
    do not fit.
    """
    begin = np.array(check_signal("simulate_closed_loop(state)", state, columns=STATE))
    amperes = np.array(check_signal("simulate_closed_loop(currents)", currents))
    n, m = machine.drive.coils, controller.outputs
    _check_fit(machine, controller, amperes)
    rows = np.empty((-(-len(schedule.references) // schedule.every), STATE + 2 * n + 3 + m))
    plant, inverse = machine.plant(schedule.step), controller.inverse(begin)
    forces = inverse is not None
    event, steps, filled, touched = closed_loop(
        schedule.clock,
        plant,
        machine.sensors.numbers,
        controller.arrays,
        machine.allocation.numbers(),
        inverse if forces else NO_INVERSE,
        machine.end_numbers(schedule.period),
        _signals(machine, schedule, n, m, seed),
        Moving(begin, amperes, controller.memory.copy()),
        rows,
    )
    return LevitationRun(
        time=schedule.period * schedule.every * np.arange(filled),
        rows=rows[:filled],
        coils=n,
        seen_at=machine.body.seen_at,
        references=schedule.references[:: schedule.every][:filled],
        event=event_of(event, steps * schedule.step, begin, amperes),
        touched=tuple(name for name, bit in CONTACTS.items() if touched & bit),
        assumptions=machine.assumptions,
        forces=forces,
    )


def _check_fit(machine: Machine, controller: Controller, currents: Array) -> None:
    n, m = machine.drive.coils, controller.outputs
    where, problems = "simulate_closed_loop", []
    if currents.shape != (n,):
        problems.append(Problem(f"{where}(currents)", f"must be ({n},)", f"{currents.shape}", "one per coil"))
    wanted, coils = len(machine.allocation.output_names), machine.allocation.coils
    if m != wanted:
        remedy = "stack one block for each output, such as lift, x and y"
        problems.append(Problem(f"{where}(controller)", f"must have {wanted} outputs", f"{m}", remedy))
    if coils != n:
        must, remedy = f"must have the {coils} coils of its allocation", "take one for these coils"
        problems.append(Problem(f"{where}(machine)", must, f"{n}", remedy))
    if problems:
        raise InputError(*problems)


def _signals(
    machine: Machine, schedule: Schedule, n: int, m: int, seed: int | np.random.SeedSequence | None
) -> Signals:
    """References, feed-forward, loads, and all noise of a run."""
    periods, sensors = len(schedule.references), machine.sensors
    forward = np.zeros((periods, m)) if schedule.feedforward is None else schedule.feedforward
    loads = np.zeros((1, 6)) if schedule.loads is None else schedule.loads
    shapes = ((periods, 3), (periods, 3), (periods, n), (sensors.scans(schedule.duration), 3))
    if seed is None:
        noise = [np.zeros(shape) for shape in shapes]
    else:
        generator = np.random.Generator(np.random.PCG64(seed))
        noise = [generator.standard_normal(shape) for shape in shapes]
        noise[0] *= sensors.deviations
        noise[1] *= sensors.voltage_noise
        noise[2] *= machine.drive.amplifier.deviation
        noise[3] *= sensors.scan_deviations
    return Signals(
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
    """Many runs, each with noise of its own that its number and `seed` alone decide, on several threads.

    runs: how many calls of `one`, or a function for each. Each takes the run's seed and returns its LevitationRun, of
    which `keep` makes what is returned. The loop releases the interpreter's lock.
    """
    jobs = [one] * runs if isinstance(runs, int) else list(runs)
    seeds = np.random.SeedSequence(seed).spawn(len(jobs))

    def job(k: int) -> Any:
        call = jobs[k]
        if call is None:
            raise InputError(Problem("simulate_many(one)", "must be a function", "None", "give what to run"))
        return keep(call(seeds[k]))

    def done(results: Iterator[Any]) -> list[Any]:
        found = []
        for result in results:
            found.append(result)
            progress(f"run {len(found)} of {len(jobs)}", len(found) / len(jobs))
        return found

    if threads <= 1:
        return done(map(job, range(len(jobs))))
    with ThreadPoolExecutor(threads, "fieldmap dynamics") as pool:
        return done(pool.map(job, range(len(jobs))))
