"""A sampled linear plant in closed loop, as the C core simulates it (fieldmap/core/sampled_loop.h)."""

from typing import NamedTuple

from fieldmap.core.controller import CoreController
from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


class Plant(NamedTuple):
    """A (n, n), B (n,), C (n,): of one input and one output, strictly proper."""

    A: Array
    B: Array
    C: Array


class Instruments(NamedTuple):
    """chain (10,), drive (7,): numbers of `fieldmap.core.instruments`. position, output: the operating point, about
    which the loop's signals are deviations."""

    chain: Array
    drive: Array
    position: float
    output: float


class Signals(NamedTuple):
    """Reference, noise of position, of the converter's voltage and of the current, and disturbance of the plant's
    input: (runs or 1, samples or 1) each."""

    reference: Array
    position_noise: Array
    voltage_noise: Array
    current_noise: Array
    disturbance: Array


def simulate(
    plant: Plant,
    controller: CoreController,
    instruments: Instruments,
    signals: Signals,
    memory: Array,
    y: Array,
    u: Array,
) -> None:
    """Fill y and u (runs, samples): position and output of a controller of one output, each run from rest and from a
    memory (n,). Reference and measured position stand for all three axes. Several threads may call it at once."""
    LIBRARY.sampled_loop(plant, controller.controller, instruments, signals, memory, y, u)
