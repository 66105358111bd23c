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
    """A (n, n), B (n,), C (n,): of one input and one output, strictly proper."""

    A: Array
    B: Array
    C: Array


class LoopInstruments(NamedTuple):
    """The numbers of sensor, converters and amplifier as compiled loops take them; ideal unless given.

    chain (10,), drive (7,): `Chain` and `Drive` of fieldmap.core.instruments, or arrays in their order;
    fieldmap.instruments makes them of data sheets. position, output: the operating point, in the units of plant and
    controller, about which the loop's signals are deviations: where steps and limits of the instruments lie depends
    on it.
    """

    chain: Chain | Array = Chain()
    drive: Drive | Array = Drive()
    position: float = 0.0
    output: float = 0.0

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The values by their names, as plain Python."""
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
    memory (n,). Reference and measured position stand for all three axes. Several threads may call it at once."""
    chain, drive = np.array(instruments.chain, float), np.array(instruments.drive, float)
    numbers = instruments._replace(chain=chain, drive=drive)
    LIBRARY.sampled_loop(plant, controller.controller, numbers, signals, memory, y, u)
