"""Limits of the training of a reduced model, and its accuracy."""

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import whole
from fieldmap.records import Record

MOST_STATES = 4096
Accuracy = Annotated[float, Field(gt=0, lt=1)]


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Record):
    """How a reduced model is trained.

    The model must predict the states that it was not trained on within twice the accuracy; otherwise more states are
    solved. `tolerance` is that of the solver.
    """

    states: Annotated[int, Key(whole(4, MOST_STATES), "most states solved to train it")] = 64
    accuracy: Annotated[
        float,
        Key(
            Accuracy, "relative error of B at new states at which training stops; twice that of the gradient"
        ),
    ] = 1e-3
    modes: Annotated[
        int, Key(whole(2, 200), "amplitudes of the iron that are trained at most, unless a state falls short")
    ] = 60
    points: Annotated[
        int,
        Key(
            whole(20, 5000), "points of the iron for the law in training at most, unless a state falls short"
        ),
    ] = 800
    fields: Annotated[int, Key(whole(1, 100), "most fields of the iron in the map")] = 20
    held_out: Annotated[
        int,
        Key(whole(1, 1000), "states at random solved to measure the error; extremes of the domain are too"),
    ] = 12
    inductance: Annotated[
        bool,
        Key(
            bool,
            "whether inductances are accurate as well; a change of currents then takes 3 to 17 times as long",
        ),
    ] = False
    tolerance: float = 1e-3
