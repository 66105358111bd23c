"""What the stages of a map take, by the amounts of their work: seconds on the machine on which they were measured.

The amounts are nodes of the iron, its matrix, states, points and modes. The run corrects the seconds by its own
pace (`fieldmap.progress.Forecast`). The factors are from runs of `maps/workspace.toml`, with the processor seconds that
tests/maps/test_forecast.py has for each stage, and of `maps/division_quick.toml` and `maps/eight_coils.toml`.
"""

from collections.abc import Sequence

import numpy as np

from fieldmap.maps.error_bound import SOLVER_POINTS
from fieldmap.progress import Forecast
from fieldmap.store import Grid
from fieldmap.store.large_map import LARGE, bytes_of_numbers

STAGES = ("assembling", "training", "extremes", "points", "random", "search", "modes")
# Seconds of one state that begins at a prediction: for each node, and for each byte of the mutual potentials.
_NODE, _BYTE = 1.2e-5, 5.6e-10
# The same before the iron is assembled, as a share of the time of the assembly.
_OF_ASSEMBLY = 0.05
# In states: what each of the first takes beyond another; the predictions of a round; the modes of all after the last,
# for each of them and of their images.
_EACH_FIRST, _ROUND, _MODES = 1.5, 2.0, 0.11
# In states: one at an extreme, one at random, and what follows those at extremes; the search for the worst currents;
# what of the choice of points does not follow their number; the fields of the modes with the states that fewer modes
# change most, and the errors on all solved states.
EXTREME, _RANDOM, AFTER_EXTREMES, _SEARCH, _POINTS, _FIELDS, ERRORS = 0.85, 0.5, 8.0, 12.5, 11.0, 12.0, 15.0
# Extremes that are to be solved, where the domain has not been looked at.
_EXTREMES = 25
# States that are expected until the errors of two rounds tell: so many with their images, but no more than this share
# of those that a plan allows.
_STATES, _SHARE = 54, 0.65
# Products in one second: of points times states times twice the square of the modes in the choice of points, and of as
# many states of the trained model in the choice of fewer modes and points.
_PRODUCTS, _CONDENSED = 1.4e10, 5000
# Points of the law at each node, for second-order tetrahedra with four points each.
_POINTS_PER_NODE = 2.75
# The fields of one face, and of one coil, at one point. Of each field: the differences of two polynomials in a cell;
# the same in a large map for each of its small cells, and that of its polynomials to the numbers at a node.
_FACE, _COIL, _CELL, _LARGE_CELL, _NUMBER = 1.2e-8, 5e-6, 7e-5, 1.6e-6, 1e-6
WARM = 1.0
"""Seconds of states that count as expected: the first ones load what later ones find."""
FIRST, AT_ONCE = 3, 4
"""States before the first round, and in each."""


def seconds_of_state(nodes: int, matrix_bytes: float) -> float:
    """Of one state of iron with so many nodes and such a matrix of mutual potentials."""
    return _NODE * nodes + _BYTE * matrix_bytes


def expect_by_assembly(forecast: Forecast, seconds: float, states: int, held_out: int) -> None:
    """Of a training of at most so many states, where nothing is known but the seconds that the assembly seems to
    take."""
    forecast.expect("assembling", seconds)
    each = _OF_ASSEMBLY * seconds
    forecast.expect("training", each * training(0, 0, states_expected((), (), states, 1.0, 0), 0)[1])
    expect_tried(forecast, each, _EXTREMES, held_out)
    for stage in ("points", "modes"):
        forecast.expect(stage, seconds)


def training(solved: int, rounds: int, left: int, images: int) -> tuple[float, float]:
    """How much of the training is done, and how much it is in all, in states.

    Parameters
    ----------
    solved, rounds
        States and rounds that this run has behind it.
    left
        States that are to be solved.
    images
        Images that each state has by symmetry.
    """
    done = solved + _EACH_FIRST * min(solved, FIRST) + _ROUND * rounds
    first = max(0, FIRST - solved) if left else 0
    after = _MODES * (solved + left) * (1 + images)
    return done, done + left + _EACH_FIRST * first + _ROUND * -(-(left - first) // AT_ONCE) + after


def expect_tried(forecast: Forecast, each: float, extremes: int, held_out: int) -> None:
    """States to try the model on, so many of them at extremes and at random; each: seconds of one to train on."""
    forecast.expect("extremes", each * (EXTREME * extremes + AFTER_EXTREMES))
    forecast.expect("random", each * _RANDOM * held_out)
    forecast.expect("search", each * _SEARCH)


def expect_choices(
    forecast: Forecast, each: float, nodes: int, states: int, modes: int, sampled: int
) -> None:
    """The choice of sample points, and that of fewer modes and points.

    Parameters
    ----------
    forecast
        Of the time.
    each
        Seconds of a state.
    nodes
        Of the iron.
    states
        How many are trained on, images too.
    modes
        How many are trained.
    sampled
        Number of sample points.
    """
    of_points = states * _POINTS_PER_NODE * nodes * 2.0 * modes**2
    forecast.expect("points", each * _POINTS + of_points / _PRODUCTS)
    forecast.expect("modes", each * (_FIELDS + ERRORS) + _CONDENSED * sampled * 2.0 * modes**2 / _PRODUCTS)


def expect_fields(forecast: Forecast, grid: Grid, faces: int, fields: int) -> None:
    """So many fields at the nodes of a map, of so many charged faces, and the certificate of the map."""
    cells = float(np.prod(np.array(grid.shape) - 1)) * fields
    of_cell = _NUMBER + _LARGE_CELL if bytes_of_numbers(grid, fields) > LARGE else _CELL
    point = faces * _FACE + fields * _COIL
    forecast.expect("nodes", grid.size * point)
    forecast.expect("certificate", SOLVER_POINTS * point + cells * of_cell)


def states_expected(
    shares: Sequence[float], solved: Sequence[int], most: int, accuracy: float, images: int
) -> int:
    """How many states a training will take.

    Parameters
    ----------
    shares, solved, most, accuracy
        As for `states_needed`.
    images
        Images that each state has by symmetry.
    """
    usual = min(max(_STATES / (1 + images), FIRST + AT_ONCE), _SHARE * most)
    found = usual
    if len(shares) >= 2:
        # Two rounds may be lucky.
        fitted = states_needed(shares, solved, most, accuracy)
        found = fitted + (usual - fitted) / len(shares)
    return max(round(found), solved[-1] if solved else 0)


def states_needed(shares: Sequence[float], solved: Sequence[int], most: int, accuracy: float) -> int:
    """How many states a training takes, by the largest errors of its rounds and how many states each knew: their
    logarithms on a line."""
    if len(shares) < 2:
        return max(round(_SHARE * most), solved[-1] if solved else 0)
    slope, level = np.polyfit(solved, np.log(np.maximum(shares, 1e-12)), 1)
    if slope >= 0.0:
        return most
    reached = (np.log(accuracy) - level) / slope
    return round(float(np.clip(reached, solved[-1], most)))
