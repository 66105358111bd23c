"""A sampled linear plant in closed loop, as the C core simulates it (fieldmap/core/sampled_loop.h)."""

from typing import NamedTuple

import numpy as np

from fieldmap.core.controller import CoreController
from fieldmap.core.instruments import Chain, Drive
from fieldmap.core.library import LIBRARY
from fieldmap.plain import Plain, plain_items
from fieldmap.records import tuple_line
from fieldmap.typing import Array


class Plant(NamedTuple):
    """A strictly proper plant of one input and one output: A (n, n), B (n,), C (n,)."""

    A: Array
    B: Array
    C: Array


class LoopInstruments(NamedTuple):
    """Numbers of sensor, converters and amplifier for compiled loops; ideal unless given.

    chain (10,), drive (7,): `Chain` and `Drive` of fieldmap.core.instruments, or arrays in their order;
    fieldmap.instruments makes them from data sheets. position, output: the operating point, in the units of plant and
    controller, from which the loop's signals deviate. Steps and limits of the instruments are absolute.
    """

    chain: Chain | Array = Chain()
    drive: Drive | Array = Drive()
    position: float = 0.0
    output: float = 0.0

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """Return the values by name, as plain Python."""
        return plain_items(**self._asdict())


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
    instruments: LoopInstruments,
    signals: Signals,
    memory: Array,
    y: Array,
    u: Array,
) -> None:
    """Fill y and u (runs, samples): position and output of a controller of one output, each run from rest and from a
    memory (n,). Reference and measured position are used for all three axes. Several threads may call it at once."""
    chain, drive = np.array(instruments.chain, float), np.array(instruments.drive, float)
    numbers = instruments._replace(chain=chain, drive=drive)
    LIBRARY.sampled_loop(plant, controller.controller, numbers, signals, memory, y, u)
