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
"""No event; and outputs that are given are asked for."""
NO_FUNCTION, GIVEN = 0, -1
"""In the place of an address: the controller is a block; outputs are given from outside, sample by sample."""


class Timing(NamedTuple):
    """Length of a mechanical step, s; steps per control period; delay in steps; periods from row to row."""

    step: float
    per_period: int
    delay: int
    every: int


class Sensing(NamedTuple):
    """into (3, 3), shift (3,): an ideal sensor reads into p + shift; chains (3, 10): as fieldmap_chain (instruments.h),
    positions in readings; back (3, 3): the inverse of into; scan (5,): s from scan to scan, 0 for no scanning; scans by
    which a mean comes late; scans whose mean each shows. field: sensors that the loop reads in the place of these."""

    into: Array
    shift: Array
    chains: Array
    back: Array
    scan: Array
    field: FieldSensing | None = None

    @property
    def shown(self) -> int:
        """How many readings and measured currents of field sensors the loop shows behind its signals."""
        return 0 if self.field is None else self.field.history.shape[1]

    @property
    def measured(self) -> slice:
        """Where the numbers that a controller function gets lie in what is seen."""
        if self.field is None or self.field.curve is not None:
            return slice(3, 6)
        return slice(SIGNALS, SIGNALS + self.shown)


class Ending(NamedTuple):
    """What ends a run: sum of the contacts that do; longest saturation in periods, 0 for any."""

    contacts: int
    longest_saturation: int


class Signals(NamedTuple):
    """References (p, 3), feed-forward (p, m), loads (p or 1, 6: disturbing force and torque), noise of the position
    (p, 3), of the input converters (p, 3), of the currents (p, n); scans (k, 3), which hold their noise;
    field_noise (p, 2 s + n) of s field sensors, T, their converters, V, and the measured currents, A; (p, 0)
    without."""

    references: Array
    feedforward: Array
    loads: Array
    noise: Array
    voltage_noise: Array
    current_noise: Array
    scans: Array
    field_noise: Array


class ControlLaw(NamedTuple):
    """From what is seen to voltages. address: of a function, NO_FUNCTION or GIVEN; controller: of a `CoreController`,
    of which a function takes the limits only; inverse: None for outputs that go to the allocation."""

    address: int
    controller: Any
    allocation: Allocation
    inverse: InverseMap | None


class Progress(NamedTuple):
    """What a run has done so far: samples; mechanical steps; rows; periods that a limit has held without a break;
    whether the next sample is sensed; what its controller returned; number of the next scan; what was ever touched;
    whether the currents lie where it is known how the field follows them."""

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
    controller, load (6,). progress: the numbers of `Progress`. Room: commands now, those that wait, and those before
    (n,) each; seen (7,): as a controller takes it, and (s + n,) of field sensors behind it; outputs (m,), scratch
    (memory + 2 m,), voltages (n,). rows (r, 13 + 2 n + 3 + m): state, currents, commands, what is seen, outputs."""

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
        """The load at the beginning, and the first scan; an event, or GOES_ON."""
        return int(LIBRARY.loop_begin(self))

    def go_on(self) -> int:
        """Run to the end, which is GOES_ON, an event or a pause; which of them."""
        return int(LIBRARY.loop_run(self))

    @property
    def done(self) -> Progress:
        """What was done so far."""
        return Progress(*self.progress.tolist())

    @property
    def time(self) -> float:
        """Of the mechanics, s."""
        return float(self.done.steps * self.timing.step)
