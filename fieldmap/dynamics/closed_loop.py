"""A levitated magnet in closed loop on a map: one run of the compiled loop, and many of them."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_positive, check_signal
from fieldmap.dynamics.blocks import Controller
from fieldmap.dynamics.drives import CoilDrive
from fieldmap.dynamics.iron import FieldOfCurrents
from fieldmap.dynamics.outcome import LoopRun, event_of
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.sensors import Sensors
from fieldmap.dynamics.surroundings import Drag, Plate, Walls
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.motion.allocation import DIVISION, MATRIX
from fieldmap.kernels.motion.closed_loop import closed_loop
from fieldmap.kernels.motion.contact import ON_CEILING, ON_FLOOR, ON_WALL
from fieldmap.kernels.motion.events import BEYOND
from fieldmap.kernels.motion.layout import STATE
from fieldmap.typing import Array

CONTACTS = {"floor": ON_FLOOR, "ceiling": ON_CEILING, "tube": ON_WALL, "currents": BEYOND}


@dataclass(frozen=True, eq=False)
class Division:
    """Outputs (u, x, y) become the voltages of six coils by thesis (6-2), (6-3)."""

    n: float = 1.25


@dataclass(frozen=True, eq=False)
class Mixing:
    """Outputs (m,) become the voltages of the coils by matrix (n, m) @ outputs + constant (n,).

    names (m,): of the outputs. idle: axes whose output does nothing. assumptions: what it rests on.
    """

    matrix: Array
    constant: Array
    names: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Machine:
    """Everything that moves, senses and drives, but the controller.

    magnetic: the field of the currents. ending: what ends a run: the contacts "floor",
    "ceiling", "tube", and "currents" beyond the table of saturating iron.
    longest_saturation: s, after which a limit of outputs, amplifiers or supply that holds without a break ends it; 0
    for never.
    """

    magnetic: FieldOfCurrents
    body: RigidBody
    drive: CoilDrive
    sensors: Sensors = field(default_factory=Sensors)
    allocation: Division | Mixing = field(default_factory=Division)
    drag: Drag | None = None
    plate: Plate | None = None
    walls: Walls | None = None
    ending: tuple[str, ...] = ()
    longest_saturation: float = 0.0

    def __post_init__(self) -> None:
        for name in self.ending:
            if name not in CONTACTS:
                remedy = "choose among them"
                problem = Problem("Machine(ending)", f"must be among {', '.join(CONTACTS)}", name, remedy)
                raise InputError(problem)

    def end_numbers(self, period: float) -> tuple[int, int]:
        """What ends a run, as a sum; longest saturation in control periods, 0 for any."""
        longest = round(self.longest_saturation / period)
        return sum(CONTACTS[name] for name in self.ending), max(longest, int(self.longest_saturation > 0))

    def plant(self, step: float) -> tuple[Any, ...]:
        """Everything that moves, as compiled loops of this step, s, take it; new arrays at every call."""
        return (
            self.magnetic.block,
            self.body.numbers(self.drag, self.plate, self.walls),
            self.body.seen_at,
            self.magnetic.numbers,
            self.drive.numbers(step),
            self.drive.drives,
        )

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What its motion rests on."""
        drive = self.drive
        winding = "currents follow at once"
        if drive.resistance is not None:
            low, high = drive.supply
            winding = f"windings by R and L without mutual inductance, {low:g} to {high:g} V"
        plate = () if self.plate is None else self.plate.assumptions
        drag = () if self.drag is None else self.drag.assumptions
        mixing = self.allocation.assumptions if isinstance(self.allocation, Mixing) else ()
        return (
            *self.magnetic.assumptions,
            *self.body.assumptions,
            *mixing,
            winding,
            *drag,
            *plate,
            *self.sensors.assumptions,
        )


@dataclass(frozen=True, eq=False)
class Schedule:
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
    def clock(self) -> tuple[float, int, int, int]:
        """Step, steps per period, delay in steps, periods per row: as the compiled loop takes them."""
        return self.step, round(self.period / self.step), round(self.delay / self.step), self.every

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
) -> LoopRun:
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
    event, steps, filled, touched = closed_loop(
        schedule.clock,
        plant,
        machine.sensors.numbers,
        controller.arrays,
        allocation_numbers(machine.allocation, n, m),
        inverse,
        machine.end_numbers(schedule.period),
        _signals(machine, schedule, n, m, seed),
        (begin, amperes, controller.memory.copy()),
        rows,
    )
    return LoopRun(
        time=schedule.period * schedule.every * np.arange(filled),
        rows=rows[:filled],
        coils=n,
        seen_at=machine.body.seen_at,
        references=schedule.references[:: schedule.every][:filled],
        event=event_of(event, steps * schedule.step, begin, amperes),
        touched=tuple(name for name, bit in CONTACTS.items() if touched & bit),
        assumptions=machine.assumptions,
        forces=inverse[0] > 0,
    )


def _check_fit(machine: Machine, controller: Controller, currents: Array) -> None:
    n, m = machine.drive.coils, controller.outputs
    where, problems = "simulate_closed_loop", []
    if currents.shape != (n,):
        problems.append(Problem(f"{where}(currents)", f"must be ({n},)", f"{currents.shape}", "one per coil"))
    wanted = 3 if isinstance(machine.allocation, Division) else machine.allocation.matrix.shape[1]
    if m != wanted:
        remedy = "stack one block for each output: lift, x and y for a division"
        problems.append(Problem(f"{where}(controller)", f"must have {wanted} outputs", f"{m}", remedy))
    if isinstance(machine.allocation, Division) and n != 6:
        problems.append(Problem(f"{where}(machine)", "a division is for six coils", f"{n}", "take Mixing"))
    if problems:
        raise InputError(*problems)


def allocation_numbers(given: Division | Mixing, n: int, m: int) -> tuple[Any, ...]:
    """As fieldmap.kernels.motion.allocation takes it, for n coils and m outputs."""
    if isinstance(given, Division):
        return DIVISION, float(given.n), np.zeros((n, m)), np.zeros(n)
    return (
        MATRIX,
        1.0,
        np.ascontiguousarray(given.matrix, float),
        # Of its own and so writable: otherwise the loop would be compiled once more.
        np.array(np.broadcast_to(given.constant, (n,)), float),
    )


def _signals(
    machine: Machine, schedule: Schedule, n: int, m: int, seed: int | np.random.SeedSequence | None
) -> tuple[Array, ...]:
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
    return (
        schedule.references,
        np.ascontiguousarray(check_signal("Schedule(feedforward)", forward, columns=m)),
        np.ascontiguousarray(check_signal("Schedule(loads)", loads, columns=6)),
        *noise,
    )


def simulate_many(
    runs: Sequence[Callable[[np.random.SeedSequence], LoopRun]] | int,
    one: Callable[[np.random.SeedSequence], LoopRun] | None = None,
    *,
    seed: int = 0,
    threads: int = 1,
    keep: Callable[[LoopRun], Any] = lambda run: run,
    progress: Callable[[str, float], None] = lambda message, fraction: None,
) -> list[Any]:
    """Many runs, each with noise of its own that its number and `seed` alone decide, on several threads.

    runs: how many calls of `one`, or a function for each. Each takes the run's seed and returns its LoopRun, of which
    `keep` makes what is kept. The loop releases the interpreter's lock.
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
