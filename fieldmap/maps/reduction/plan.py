"""How much work goes into the training of a reduced model."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """How a reduced model is trained.

    states: most that are solved to train it; accuracy: share of the largest flux density in the workspace (of the
    largest gradient: twice that) within which the model must foretell the states that it is least sure of, so that no
    more are solved; modes: most amplitudes; points: conditions of the cubature, about as many sample points; fields:
    most iron fields in the map; held_out: states at random solved to measure the error; tolerance: of the solver.
    """

    states: int
    accuracy: float
    modes: int
    points: int
    fields: int
    held_out: int
    tolerance: float
