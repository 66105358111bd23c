"""What the stages of a training are expected to take: priors, until their own pieces tell better.

The priors are ratios that were measured on the shipped devices; half or twice of them does no harm, as each stage that
runs replaces its own.
"""

import numpy as np

from fieldmap.maps.forecast import Forecast
from fieldmap.maps.recipe import Plan

STAGES = ("assembling", "training", "extremes", "points", "random", "search", "modes")
# One state, and the fields of the modes, over the assembly of the solver.
_STATE, _MODES = 0.17, 0.7
# Of the states that a plan allows, how many it is expected to take until the errors of some rounds tell.
_SHARE = 0.65
# States to try the model on begin from its prediction: over those that it is trained on.
_TRIED = 0.3
# Points times states times twice the square of the modes that the whole choice does in one second, and how many states
# of the trained model the choice of fewer modes and points takes, solved several times each.
_PRODUCTS, _CONDENSED = 1e10, 5000
# Extremes that are to be solved, of those that there may be: the others are images. What the search for the worst
# currents costs, as so many states to try.
_EXTREMES, _SEARCH = 25, 30


def expect_training(forecast: Forecast, plan: Plan) -> None:
    """Before a state is solved, by what the assembly is expected to take."""
    assembling = forecast.expected("assembling")
    forecast.expect("training", _SHARE * plan.states * _STATE * assembling)
    forecast.expect("points", assembling)
    forecast.expect("modes", _MODES * assembling)
    expect_tried(forecast, plan, _STATE * assembling)


def expect_tried(forecast: Forecast, plan: Plan, state: float) -> None:
    """States to try the model on, by the seconds that one takes to train on."""
    forecast.expect("extremes", _TRIED * state * _EXTREMES)
    forecast.expect("random", _TRIED * state * plan.held_out)
    forecast.expect("search", _TRIED * state * _SEARCH)


def expect_points(forecast: Forecast, points: int, modes: int, states: int) -> None:
    """The choice of sample points, for so many points of the iron and states, images too."""
    forecast.expect("points", states * points * modes * 2.0 * modes / _PRODUCTS)


def expect_modes(forecast: Forecast, points: int, modes: int) -> None:
    """The fields of the modes, and the choice of those that are kept, for so many that were trained."""
    fields = _MODES * forecast.expected("assembling")
    forecast.expect("modes", fields + _CONDENSED * points * 2.0 * modes**2 / _PRODUCTS)


def states_needed(shares: list[float], solved: list[int], plan: Plan) -> int:
    """How many states a training will take, by the largest errors of its rounds and how many states each knew: their
    logarithms on a line."""
    most = plan.states
    if len(shares) < 2:
        return max(round(_SHARE * most), solved[-1] if solved else 0)
    slope, level = np.polyfit(solved, np.log(np.maximum(shares, 1e-12)), 1)
    if slope >= 0.0:
        return most
    reached = (np.log(plan.accuracy) - level) / slope
    return round(float(np.clip(reached, solved[-1], most)))
