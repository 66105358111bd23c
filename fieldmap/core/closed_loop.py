"""A levitated magnet in closed loop, as the C core runs it (fieldmap/core/closed_loop.h)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.controller import SIGNALS
from fieldmap.core.field_sensors import FieldSensing
from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import Allocation, InverseMap
from fieldmap.typing import Array

GOES_ON, PAUSED = LIBRARY.GOES_ON, LIBRARY.PAUSED
"""Status of a run: no event; the run waits for outputs from the caller."""
NO_FUNCTION, GIVEN = 0, -1
"""Instead of the address of a function: the controller is a block; the caller gives the outputs, sample by sample."""


class Timing(NamedTuple):
    """Length of a mechanical step, s; steps per control period; delay in steps; control periods per recorded row."""

    step: float
    per_period: int
    delay: int
    every: int


class Sensing(NamedTuple):
    """into (3, 3), shift (3,): ideal sensors read into p + shift; chains (3, 10): as fieldmap_chain (instruments.h),
    with positions as readings; back (3, 3): the inverse of into; scan (5,): time between scans, s, or 0 for no
    scanning, then the delay of the averages in scans, then the number of scans that each sensor averages. field:
    field sensors that replace these."""

    into: Array
    shift: Array
    chains: Array
    back: Array
    scan: Array
    field: FieldSensing | None = None

    @property
    def shown(self) -> int:
        """Number of readings and measured currents of field sensors that follow the signals of the loop."""
        return 0 if self.field is None else self.field.history.shape[1]

    @property
    def measured(self) -> slice:
        """Slice of `Loop.seen` that a controller function gets."""
        if self.field is None or self.field.curve is not None:
            return slice(3, 6)
        return slice(SIGNALS, SIGNALS + self.shown)


class Ending(NamedTuple):
    """Ends of a run: sum of the contacts that end it; longest saturation in periods, 0 for no limit."""

    contacts: int
    longest_saturation: int


class Signals(NamedTuple):
    """References (p, 3), feed-forward (p, m), loads (p or 1, 6: disturbing force and torque), noise of the position
    (p, 3), of the input converters (p, 3), of the currents (p, n); scans (k, 3), which initially hold their noise;
    field_noise (p, 2 s + n) of s field sensors, T, their converters, V, and the measured currents, A."""

    references: Array
    feedforward: Array
    loads: Array
    noise: Array
    voltage_noise: Array
    current_noise: Array
    scans: Array
    field_noise: Array


class ControlLaw(NamedTuple):
    """From measurements to voltages. address: of a function, NO_FUNCTION or GIVEN; controller: of a `CoreController`;
    a function uses only its limits; inverse: None if the outputs go to the allocation."""

    address: int
    controller: Any
    allocation: Allocation
    inverse: InverseMap | None


class Progress(NamedTuple):
    """State of a run: numbers of samples, mechanical steps and rows so far; consecutive periods in which a limit was
    active; whether the next sample is sensed already; number that the controller function returned; index of the next
    scan; flags of all contacts so far; whether the currents lie in the table or the model of the iron."""

    samples: int
    steps: int
    rows: int
    held: int
    sensed: int
    answer: int
    scan: int
    touched: int
    within: int


class Loop(NamedTuple):
    """A run, which is advanced in place. machine: of a `CoreMachine`; state (13,), currents (n,), memory of the
    controller, load (6,). progress: the numbers of `Progress`. Room: commands at present, waiting ones and earlier
    ones, (n,) each; seen (7,): the signals of the controller, then (s + n,) numbers of field sensors; outputs (m,),
    scratch (memory + 2 m,), voltages (n,). rows (r, 13 + 2 n + 3 + m): state, currents, commands, measured position,
    outputs; voltages and temperatures (2 n) more with coupled coils."""

    machine: Any
    timing: Timing
    sensing: Sensing
    law: ControlLaw
    ending: Ending
    signals: Signals
    state: Array
    currents: Array
    memory: Array
    load: Array
    progress: NDArray[np.int64]
    commands: Array
    waiting: Array
    late: Array
    seen: Array
    outputs: Array
    scratch: Array
    voltages: Array
    rows: Array

    def __repr__(self) -> str:
        return f"Loop({len(self.signals.references)} samples)"

    def begin(self) -> int:
        """Compute the load at the beginning and the first scan; return an event, or GOES_ON."""
        return int(LIBRARY.loop_begin(self))

    def go_on(self) -> int:
        """Run on; return GOES_ON at the end of the run, an event, or PAUSED."""
        return int(LIBRARY.loop_run(self))

    @property
    def done(self) -> Progress:
        """Progress of the run so far."""
        return Progress(*self.progress.tolist())

    @property
    def time(self) -> float:
        """Time of the mechanical steps so far, s."""
        return float(self.done.steps * self.timing.step)
