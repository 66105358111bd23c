"""Wrench of a magnetic body in a sum of fields, and its derivatives by their weights: docs/theory/wrench.md (10)."""

import numpy as np
from numba import njit

from fieldmap.kernels.map.induced_moment import induced_moment, moment_slope
from fieldmap.kernels.map.map_block import OUTER


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
            m[:] = dipoles[p]
        else:
            x = turn[0, 0] * b[0] + turn[1, 0] * b[1] + turn[2, 0] * b[2]
            y = turn[0, 1] * b[0] + turn[1, 1] * b[1] + turn[2, 1] * b[2]
            z = turn[0, 2] * b[0] + turn[1, 2] * b[1] + turn[2, 2] * b[2]
            mx, my, mz, _ = induced_moment(soft, 0, p - fixed, x, y, z)
            moment_slope(soft, 0, p - fixed, x, y, z, work, own)
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
