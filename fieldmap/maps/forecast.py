"""Expected duration of the stages of a map, in seconds on the machine on which the factors were measured.

It follows from the numbers of nodes of the iron, states, points and modes, and the size of the iron's matrix. A run
corrects it by its own pace (`fieldmap.progress.Forecast`). The factors are from runs of `maps/workspace.toml`, whose
processor seconds tests/maps/test_forecast.py states, of `maps/division_quick.toml` and of `maps/eight_coils.toml`.
"""

from collections.abc import Sequence

import numpy as np

from fieldmap.maps.error_bound import SOLVER_POINTS
from fieldmap.progress import Forecast
from fieldmap.store import Grid
from fieldmap.store.large_map import LARGE, bytes_of_numbers

STAGES = ("assembling", "training", "extremes", "points", "random", "search", "modes")
# Seconds of one state that begins at a prediction, per node and per byte of the matrix of mutual potentials.
_NODE, _BYTE = 1.2e-5, 5.6e-10
# Duration of one state as a share of the duration of the assembly, used until the iron is assembled.
_OF_ASSEMBLY = 0.05
# In units of one state: the extra time of each of the first states; the predictions of a round; the modes per state.
_EACH_FIRST, _ROUND, _MODES = 1.5, 2.0, 0.11
# In units of one state: a state at an extreme; a state at random; the work after the extremes; the search for the worst
# currents; the fixed part of the choice of points; the fields of the modes with the states that fewer modes change
# most; the errors on all solved states.
EXTREME, _RANDOM, AFTER_EXTREMES, _SEARCH, _POINTS, _FIELDS, ERRORS = 0.85, 0.5, 8.0, 12.5, 11.0, 12.0, 15.0
# Number of extremes assumed before the domain is known.
_EXTREMES = 25
# Number of states expected until the errors of two rounds are known: _STATES, images included, but no more than the
# share _SHARE of the states that the plan allows.
_STATES, _SHARE = 54, 0.65
# Multiplications per second, and states of the trained model in the choice of fewer modes and points. A choice takes
# points times states times twice the square of the modes multiplications.
_PRODUCTS, _CONDENSED = 1.4e10, 5000
# Points of the B-H law per node, for second-order tetrahedra with four points each.
_POINTS_PER_NODE = 2.75
# Seconds for the field of one face, and of one coil, at one point. Then per field: compare two polynomials in a cell;
# the same in a large map per cell of the grid; compare its polynomials with the values at a node.
_FACE, _COIL, _CELL, _LARGE_CELL, _NUMBER = 1.2e-8, 5e-6, 7e-5, 1.6e-6, 1e-6
WARM = 1.0
"""Seconds of work assumed to be done at the expected pace when the states begin. The first states are slow, because
they fill caches, and say little about the pace."""
FIRST, AT_ONCE = 3, 4
"""States before the first round, and in each round."""


def seconds_of_state(nodes: int, matrix_bytes: float) -> float:
    """Seconds of one state of iron, from the number of nodes and the bytes of the matrix of mutual potentials."""
    return _NODE * nodes + _BYTE * matrix_bytes


def expect_by_assembly(forecast: Forecast, seconds: float, states: int, held_out: int) -> None:
    """Set the durations of a training of at most `states` states from the expected seconds of the assembly alone."""
    forecast.expect("assembling", seconds)
    each = _OF_ASSEMBLY * seconds
    forecast.expect("training", each * training(0, 0, states_expected((), (), states, 1.0, 0), 0)[1])
    expect_tried(forecast, each, _EXTREMES, held_out)
    for stage in ("points", "modes"):
        forecast.expect(stage, seconds)


def training(solved: int, rounds: int, left: int, images: int) -> tuple[float, float]:
    """Work done and total work of the training, in units of one state.

    Parameters
    ----------
    solved, rounds
        States and rounds that this run has finished.
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
    """Set the durations of the states that test the model, by their numbers. each: seconds of a training state."""
    forecast.expect("extremes", each * (EXTREME * extremes + AFTER_EXTREMES))
    forecast.expect("random", each * _RANDOM * held_out)
    forecast.expect("search", each * _SEARCH)


def expect_choices(
    forecast: Forecast, each: float, nodes: int, states: int, modes: int, sampled: int
) -> None:
    """Set the durations of the choice of sample points, and of the choice of fewer modes and points.

    Parameters
    ----------
    forecast
        Is set.
    each
        Seconds of a state.
    nodes
        Number of nodes of the iron.
    states
        Number of training states, images included.
    modes
        Number of trained modes.
    sampled
        Number of sample points.
    """
    of_points = states * _POINTS_PER_NODE * nodes * 2.0 * modes**2
    forecast.expect("points", each * _POINTS + of_points / _PRODUCTS)
    forecast.expect("modes", each * (_FIELDS + ERRORS) + _CONDENSED * sampled * 2.0 * modes**2 / _PRODUCTS)


def expect_fields(forecast: Forecast, grid: Grid, faces: int, fields: int) -> None:
    """Set the durations of the fields at the nodes and of the certificate, from the numbers of faces and fields."""
    cells = float(np.prod(np.array(grid.shape) - 1)) * fields
    of_cell = _NUMBER + _LARGE_CELL if bytes_of_numbers(grid, fields) > LARGE else _CELL
    point = faces * _FACE + fields * _COIL
    forecast.expect("nodes", grid.size * point)
    forecast.expect("certificate", SOLVER_POINTS * point + cells * of_cell)


def states_expected(
    shares: Sequence[float], solved: Sequence[int], most: int, accuracy: float, images: int
) -> int:
    """Expected number of states of a training.

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
        # Errors of few rounds may be small by chance, so the usual number still counts.
        fitted = states_needed(shares, solved, most, accuracy)
        found = fitted + (usual - fitted) / len(shares)
    return max(round(found), solved[-1] if solved else 0)


def states_needed(shares: Sequence[float], solved: Sequence[int], most: int, accuracy: float) -> int:
    """Number of states for an accuracy, extrapolated from a line through the logarithms of the largest errors of the
    rounds (`shares`) against the number of states trained on in each (`solved`)."""
    if len(shares) < 2:
        return max(round(_SHARE * most), solved[-1] if solved else 0)
    slope, level = np.polyfit(solved, np.log(np.maximum(shares, 1e-12)), 1)
    if slope >= 0.0:
        return most
    reached = (np.log(accuracy) - level) / slope
    return round(float(np.clip(reached, solved[-1], most)))
