"""Wrench of a magnetic body in a sum of fields, and its derivatives by their weights: docs/theory/wrench.md (10)."""

from typing import Any, NamedTuple

import numpy as np
from numba import carray

from fieldmap.kernels.addresses import reals, words
from fieldmap.kernels.compilation import njit
from fieldmap.kernels.copy_vector import copy_vector
from fieldmap.kernels.map.current_solver import FOUND, SolverState, current_slopes
from fieldmap.kernels.map.induced_moment import ALONE, induced_moment, moment_slope
from fieldmap.kernels.map.lookup import evaluate_units
from fieldmap.kernels.map.map_block import OUTER, SETS


@njit(**OUTER)
def wrench_and_slopes(dipoles, arms, soft, turn, flux, slope, weights, wrench, slopes):
    """Fill wrench (6,), N and N m about the centre, and slopes (6, k) by the weights (k,).

    dipoles (q, 3): fixed moments; arms (q + s, 3): of all points, both in the frame of the map. soft: as in
    fieldmap.kernels.map.induced_moment, s pieces. turn (3, 3): columns the body's axes. flux (q + s, k, 3) and slope
    (q + s, k, 3, 3): of the fields at weight 1, at the points.
    """
    work, own, by_field = np.empty((3, 3, 3)), np.empty((3, 3)), np.zeros((3, 3))
    b, g, m, change, pull, fields = (
        np.empty(3),
        np.empty((3, 3)),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        weights.shape[0],
    )
    wrench[:] = 0.0
    slopes[:] = 0.0
    fixed = dipoles.shape[0]
    for p in range(arms.shape[0]):
        b[:] = 0.0
        g[:] = 0.0
        for k in range(fields):
            for i in range(3):
                b[i] += weights[k] * flux[p, k, i]
                for j in range(3):
                    g[i, j] += weights[k] * slope[p, k, i, j]
        if p < fixed:
            copy_vector(dipoles[p], m)
        else:
            x = turn[0, 0] * b[0] + turn[1, 0] * b[1] + turn[2, 0] * b[2]
            y = turn[0, 1] * b[0] + turn[1, 1] * b[1] + turn[2, 1] * b[2]
            z = turn[0, 2] * b[0] + turn[1, 2] * b[1] + turn[2, 2] * b[2]
            mx, my, mz, _ = induced_moment(soft, ALONE, p - fixed, x, y, z)
            moment_slope(soft, ALONE, p - fixed, x, y, z, work, own)
            for i in range(3):
                m[i] = turn[i, 0] * mx + turn[i, 1] * my + turn[i, 2] * mz
                for j in range(3):
                    by_field[i, j] = 0.0
                    for c in range(3):
                        for d in range(3):
                            by_field[i, j] += turn[i, c] * own[c, d] * turn[j, d]
        ax, ay, az = arms[p, 0], arms[p, 1], arms[p, 2]
        for j in range(3):
            pull[j] = g[0, j] * m[0] + g[1, j] * m[1] + g[2, j] * m[2]
            wrench[j] += pull[j]
        wrench[3] += m[1] * b[2] - m[2] * b[1] + ay * pull[2] - az * pull[1]
        wrench[4] += m[2] * b[0] - m[0] * b[2] + az * pull[0] - ax * pull[2]
        wrench[5] += m[0] * b[1] - m[1] * b[0] + ax * pull[1] - ay * pull[0]
        for k in range(fields):
            f, s = flux[p, k], slope[p, k]
            for j in range(3):
                pull[j] = s[0, j] * m[0] + s[1, j] * m[1] + s[2, j] * m[2]
            tx = m[1] * f[2] - m[2] * f[1]
            ty = m[2] * f[0] - m[0] * f[2]
            tz = m[0] * f[1] - m[1] * f[0]
            if p >= fixed:
                for i in range(3):
                    change[i] = by_field[i, 0] * f[0] + by_field[i, 1] * f[1] + by_field[i, 2] * f[2]
                for j in range(3):
                    pull[j] += g[0, j] * change[0] + g[1, j] * change[1] + g[2, j] * change[2]
                tx += change[1] * b[2] - change[2] * b[1]
                ty += change[2] * b[0] - change[0] * b[2]
                tz += change[0] * b[1] - change[1] * b[0]
            for j in range(3):
                slopes[j, k] += pull[j]
            slopes[3, k] += tx + ay * pull[2] - az * pull[1]
            slopes[4, k] += ty + az * pull[0] - ax * pull[2]
            slopes[5, k] += tz + ax * pull[1] - ay * pull[0]


# Tuples with names, because numba takes arrays in others for read-only where they are globals of a compiled function,
# and would compile everything for both kinds.
class Body(NamedTuple):
    """points (q + s, 3) of magnets and of soft pieces, m; moments (q, 3), A m^2; numbers of the soft pieces."""

    points: Any
    moments: Any
    soft: Any


class InSum(NamedTuple):
    """Of a map that superposes: its block, and the body."""

    block: Any
    body: Body


class InModel(NamedTuple):
    """Of a map of saturating iron: its block, `CompiledModel` and `SolverState`, the body, and the addresses (7,) of
    the state's arrays."""

    block: Any
    model: Any
    state: Any
    body: Body
    addresses: Any


@njit(**OUTER)
def _of_weights(block, body, place, turn, weights, wrench, slopes):
    """`wrench_and_slopes` of a body (points (q + s, 3), moments (q, 3), soft) centred at place (3,) in a map's block;
    whether all of its points lie in the map's box, NaN where one does not."""
    points, moments, soft = body
    count, fixed = points.shape[0], moments.shape[0]
    arms, where, dipoles = np.empty((count, 3)), np.empty((count, 3)), np.empty((fixed, 3))
    for p in range(count):
        for i in range(3):
            arms[p, i] = turn[i, 0] * points[p, 0] + turn[i, 1] * points[p, 1] + turn[i, 2] * points[p, 2]
            where[p, i] = place[i] + arms[p, i]
            if p < fixed:
                m = moments[p]
                dipoles[p, i] = turn[i, 0] * m[0] + turn[i, 1] * m[1] + turn[i, 2] * m[2]
    flux, slope = np.empty((count, weights.shape[0], 3)), np.empty((count, weights.shape[0], 3, 3))
    evaluate_units(block, where, flux, slope)
    wrench_and_slopes(dipoles, arms, soft, turn, flux, slope, weights, wrench, slopes)
    return np.isfinite(wrench[0])


@njit(**OUTER)
def sum_wrench(data, currents, place, turn, wrench, slopes):
    """Fill wrench (6,) and slopes (6, coils) at currents (coils,), of a map that superposes; False where the body
    leaves its box. data: `InSum`."""
    block, body = data
    coils = currents.shape[0]
    weights = np.ones(int(block[SETS]))
    copy_vector(currents, weights[:coils])
    every = np.empty((6, weights.shape[0]))
    inside = _of_weights(block, body, place, turn, weights, wrench, every)
    for row in range(6):
        copy_vector(every[row], slopes[row])
    return inside


@njit
def _live(state, addresses):
    """A state by the addresses (7,) of its arrays. Of a state that numba has compiled into a function as a constant the
    arrays are copies that may not be written to; their addresses stay right."""
    return SolverState(
        carray(reals(addresses[0]), state.currents.shape),
        carray(reals(addresses[1]), state.amplitudes.shape),
        carray(reals(addresses[2]), state.factor.shape),
        carray(reals(addresses[3]), state.h.shape),
        carray(words(addresses[4]), state.piece.shape),
        carray(reals(addresses[5]), state.numbers.shape),
        carray(reals(addresses[6]), state.weights.shape),
    )


@njit(nogil=True)
def model_wrench(data, currents, place, turn, wrench, slopes):
    """`sum_wrench` of a map of saturating iron; False and NaN also where its model has no solution. data:
    `InModel`."""
    block, model, constant_state, body, addresses = data
    state = _live(constant_state, addresses)
    weights = np.empty(state.weights.size)
    by_currents, every = np.empty((weights.size, currents.size)), np.empty((6, weights.size))
    if current_slopes(model, state, currents, weights, by_currents) != FOUND:
        wrench[:] = np.nan
        slopes[:, :] = np.nan
        return False
    inside = _of_weights(block, body, place, turn, weights, wrench, every)
    for r in range(6):
        for c in range(currents.size):
            total = 0.0
            for f in range(weights.size):
                total += every[r, f] * by_currents[f, c]
            slopes[r, c] = total
    return inside
