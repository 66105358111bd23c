"""How much work goes into the training of a reduced model."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """How a reduced model is trained.

    states: solved to train it; modes: most amplitudes; points: conditions of the cubature, about as many sample
    points; fields: most iron fields in the map; held_out: states solved to measure the error; tolerance: of the
    solver.
    """

    states: int
    modes: int
    points: int
    fields: int
    held_out: int
    tolerance: float
